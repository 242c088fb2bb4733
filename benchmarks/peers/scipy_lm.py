"""scipy.optimize.least_squares fed by pamid's compiled exact Jacobian; runs in pamid's environment.

    python scipy_lm.py RECORD lm|trf

A step runs from one Jacobian to the next.
"""

import sys

import scipy
from measuring import Array, Stamps, peak_mb, record, tell
from scipy.optimize import least_squares

from pamid.networks.elman import Elman

EVALUATIONS = 8


def main() -> None:
    u, target, weights = record()
    network, stamps = Elman(), Stamps()

    def slope(w: Array) -> Array:
        stamps()
        return network.jacobian(w, u)

    jte = (target - network.simulate(weights, u)) @ network.jacobian(weights, u)
    least_squares(
        lambda w: network.simulate(w, u) - target,
        weights,
        slope,
        method=sys.argv[2],
        max_nfev=EVALUATIONS,
    )
    tell(jte, **stamps.step, peak_mb=peak_mb(), version=f"scipy {scipy.__version__}")


if __name__ == "__main__":
    main()
