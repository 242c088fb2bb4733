"""anfis-toolbox: epochs of its hybrid training (least squares, then Adam for the sets) until an
error is reached.

    python anfis_steps.py record.npz SETS STEP EPOCHS WANTED

The record holds u, target, grid, truth. Prints one line of JSON: per epoch the CPU seconds so far
and the RMSE on the grid. Only their steps are counted; before an epoch is judged, its sets get the
best consequents there are for them.
"""

import json
import sys
import time

import numpy as np
from anfis_toolbox import ANFISRegressor
from anfis_toolbox.optim import HybridAdamTrainer

RIDGE = 1e-6  # as in their training


def features(model, u):
    firing = model.forward_antecedents(u)
    row = np.concatenate([u, np.ones((len(u), 1))], axis=1)
    return (firing[:, :, None] * row[:, None, :]).reshape(len(u), -1)


def main() -> None:
    path, sets, step, epochs, wanted = sys.argv[1], *map(float, sys.argv[2:])
    record = np.load(path)
    u, target, grid, truth = (record[name] for name in ("u", "target", "grid", "truth"))
    begun = time.process_time()
    made = ANFISRegressor(n_mfs=int(sets), mf_type="gaussian", optimizer="hybrid_adam", epochs=0)
    model = made.fit(u, target).model_
    trainer = HybridAdamTrainer(learning_rate=step, epochs=1)
    x, y = trainer._prepare_training_data(model, u, target)
    state = trainer.init_state(model, x, y)
    spent, seconds, errors = time.process_time() - begun, [], []
    while len(errors) < epochs and (not errors or errors[-1] > wanted):
        begun = time.process_time()
        _, state = trainer.train_step(model, x, y, state)
        spent += time.process_time() - begun
        table = features(model, u)
        gram = table.T @ table + RIDGE * np.eye(table.shape[1])
        consequents = np.linalg.solve(gram, table.T @ target)
        seconds.append(spent)
        errors.append(float(np.sqrt(np.mean((features(model, grid) @ consequents - truth) ** 2))))
    print(json.dumps({"cpu_s": seconds, "rmse": errors}))


if __name__ == "__main__":
    main()
