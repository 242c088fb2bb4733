"""One pass by torch.func.jacfwd (no training), on a short record, scaled up; runs in pamid's
environment.

Its J'J is compared with pamid's to 1e-9 on the way.
"""

import numpy as np
import torch
from measuring import cpu_seconds, peak_mb, record, tell

from pamid.networks.elman import Elman

SAMPLES = 4_000


def torch_pass_seconds(
    network: Elman, weights: np.ndarray, u: np.ndarray, target: np.ndarray
) -> float:
    """CPU seconds of Jacobian, J'J and J'e by forward-mode automatic differentiation."""
    torch.set_num_threads(1)
    h, m = network.hidden, network.inputs
    rows, wanted = torch.from_numpy(u), torch.from_numpy(target)

    def output(flat):
        units = flat[: -h - 1].reshape(h, h + m + 1)
        drive = rows @ units[:, h:-1].T + units[:, -1]
        x, states = torch.zeros(h, dtype=torch.float64), []
        for k in range(len(rows)):
            x = torch.tanh(units[:, :h] @ x + drive[k])
            states.append(x)
        return torch.stack(states) @ flat[-h - 1 : -1] + flat[-1]

    def one_pass():
        flat = torch.from_numpy(weights)
        jacobian, error = torch.func.jacfwd(output)(flat), wanted - output(flat)
        return jacobian.T @ jacobian, jacobian.T @ error

    jtj = one_pass()[0].numpy()
    assert np.allclose(jtj, network.normal_equations(weights, u, target)[1], rtol=1e-9, atol=1e-9)
    return cpu_seconds(one_pass, 2)


def main() -> None:
    u, target, weights = record()
    n = min(len(u), SAMPLES)
    seconds = torch_pass_seconds(Elman(), weights, u[:n], target[:n])
    tell(
        None,
        cpu_s=seconds * len(u) / n,
        wall_s=None,
        steps=0,
        peak_mb=peak_mb(),
        measured_samples=n,
        version=f"torch {torch.__version__}",
    )


if __name__ == "__main__":
    main()
