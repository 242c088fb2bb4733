"""One pass by torch.func.jacfwd (no training), on a short record, scaled up; runs in pamid's environment.

Its J'J is compared with pamid's to 1e-9 on the way (benchmarks/elman_pass.py).
"""

import torch
from elman_pass import TORCH_SAMPLES, torch_pass_seconds
from measuring import peak_mb, record, tell

from pamid.networks.elman import Elman


def main() -> None:
    u, target, weights = record()
    n = min(len(u), TORCH_SAMPLES)
    seconds = torch_pass_seconds(Elman(), weights, u[:n], target[:n])
    tell(None, cpu_s=seconds * len(u) / n, wall_s=None, steps=0, peak_mb=peak_mb(), measured_samples=n,
         version=f"torch {torch.__version__}")


if __name__ == "__main__":
    main()
