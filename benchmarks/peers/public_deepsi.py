"""deepSI on a public benchmark: a SUBNET encoder, as its readme shows it, in free run; the weights
of the training step that is best on the last fifth of the record that is fitted.

    python public_deepsi.py SET FOLDER [quick]
"""

import contextlib
import sys
from importlib.metadata import version

import deepSI as dsi
import numpy as np
import torch
from public_sets import asked, judge, read_set, tell

# order of the state, steps of Adam, samples a training section is long
SIZES = {"cascaded_tanks": (4, 1500, 60), "emps": (4, 800, 80), "silverbox": (4, 1500, 50)}


def main() -> None:
    one, folder, quick = asked()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    np.random.seed(0)
    fit, tests = read_set(folder, one)
    order, steps, section = SIZES[one.name]
    past = one.start
    whole = dsi.Input_output_data(u=fit.u, y=fit.y, sampling_time=fit.period_s)
    edge = int(0.8 * len(fit.u))
    nu, ny, norm = dsi.get_nu_ny_and_auto_norm(whole)
    model = dsi.SUBNET(nu, ny, norm, nx=order, nb=past, na=past)
    with contextlib.redirect_stdout(sys.stderr):
        dsi.fit(
            model,
            whole[:edge],
            whole[edge:],
            n_its=steps // 10 if quick else steps,
            T=section,
            batch_size=256,
            val_freq=250,
        )

    def simulate(u, y0):
        y = np.concatenate([y0, np.zeros(len(u) - len(y0))])  # the rest is not looked at
        data = dsi.Input_output_data(u=u, y=y, sampling_time=fit.period_s)
        with torch.no_grad():
            return np.asarray(model.simulate(data).y, float)

    remark = f"SUBNET, {order} states, {steps // 10 if quick else steps} steps, T {section}"
    tell(f"deepSI {version('deepSI')}", judge(one, tests, simulate), remark)


if __name__ == "__main__":
    main()
