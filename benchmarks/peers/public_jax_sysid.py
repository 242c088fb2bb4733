"""jax-sysid on a public benchmark: the residual recurrent network of its readme, Adam and then
L-BFGS on the free run, its start state found on the first samples as its readme shows it.

    python public_jax_sysid.py SET FOLDER [quick]
"""

import contextlib
import sys
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from jax_sysid.models import Model
from public_sets import Record, Scaled, asked, judge, read_set, tell

jax.config.update("jax_enable_x64", True)
# order of the state, neurons, samples of the record that are fitted
SIZES = {"cascaded_tanks": (4, 8, 1024), "emps": (4, 8, 8000), "silverbox": (4, 8, 6000)}
EPOCHS = 1000  # of Adam, and again of L-BFGS


@jax.jit
def state_fcn(x, u, params):
    A, B, _, W1, W2, W3, b1, b2 = params[:8]
    return A @ x + B @ u + W3 @ jax.nn.sigmoid(W1 @ x + W2 @ u + b1) + b2


@jax.jit
def output_fcn(x, u, params):
    C, W4, W5, b3, b4 = params[2], *params[8:]
    return C @ x + W5 @ jax.nn.sigmoid(W4 @ x + b3) + b4


def drawn(order: int, neurons: int):
    """First weights, sized as in the readme."""
    random = np.random.default_rng(0)

    def normal(size, *shape):
        return size * random.standard_normal(shape)

    return [
        0.5 * np.eye(order),
        normal(0.1, order, 1),
        normal(0.1, 1, order),
        normal(0.1, neurons, order),
        normal(0.5, neurons, 1),
        normal(0.5, order, neurons),
        np.zeros(neurons),
        np.zeros(order),
        normal(0.5, neurons, order),
        normal(0.5, 1, neurons),
        np.zeros(neurons),
        np.zeros(1),
    ]


def main() -> None:
    one, folder, quick = asked()
    fit, tests = read_set(folder, one)
    order, neurons, samples = SIZES[one.name]
    scaled, epochs = Scaled(fit), EPOCHS // 10 if quick else EPOCHS
    part = Record(fit.u[:samples], fit.y[:samples], fit.period_s)
    model = Model(order, 1, 1, state_fcn=state_fcn, output_fcn=output_fcn)
    model.init(params=drawn(order, neurons))
    model.loss(rho_x0=1e-4, rho_th=1e-4)
    model.optimization(adam_epochs=epochs, lbfgs_epochs=epochs)
    with contextlib.redirect_stdout(sys.stderr):
        model.fit(scaled.y(part.y)[:, None], scaled.u(part.u)[:, None])

    def simulate(u, y0):
        us = scaled.u(u)[:, None]
        with contextlib.redirect_stdout(sys.stderr):
            x0 = model.learn_x0(us[: len(y0)], scaled.y(y0)[:, None])
            y, _ = model.predict(jnp.asarray(x0), us)
        return scaled.back(np.asarray(y, float).ravel())

    remark = f"{order} states, 2 x {neurons} neurons, {len(part.u)} samples, 2 x {epochs} epochs"
    tell(f"jax-sysid {version('jax-sysid')}", judge(one, tests, simulate), remark)


if __name__ == "__main__":
    main()
