"""pyrenn's train_LM on the same network; its derivative is real-time recurrent learning in plain
NumPy.

pyrenn gives the output a self-loop that cannot be left out: 172 weights, the loop's started at
zero, where the other 171 derivatives are those of the Elman network. A step runs from one
derivative pass to the next.
"""

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
import pyrenn
from measuring import HIDDEN, INPUTS, Array, Stamps, peak_mb, record, tell

STEPS = 2
LOOP = HIDDEN * (INPUTS + HIDDEN + 1) + HIDDEN  # place of the output's self-loop in pyrenn's order


def places() -> list[int]:
    """For each of pyrenn's 171 weights other than the loop its place in pamid's vector."""
    wide = INPUTS + HIDDEN + 1
    unit = [wide * i for i in range(HIDDEN)]
    # matrices column by column
    entering = [first + HIDDEN + j for j in range(INPUTS) for first in unit]
    context = [first + j for j in range(HIDDEN) for first in unit]
    bias = [first + wide - 1 for first in unit]
    return [*entering, *context, *bias, *range(wide * HIDDEN, wide * HIDDEN + HIDDEN + 1)]


def watched(
    derive: Callable[..., Any], stamps: Stamps, gradients: list[Array]
) -> Callable[..., Any]:
    def derived(*args: Any) -> Any:
        jacobian, total, error = derive(*args)  # the derivative of the error, target - output
        stamps()
        if not gradients:
            gradients.append(-np.delete(error @ jacobian, LOOP))
        return jacobian, total, error

    return derived


def main() -> None:
    given = record()
    net = pyrenn.CreateNN([INPUTS, HIDDEN, 1], dIn=[0], dIntern=[1], dOut=[])
    order = places()
    net["w"] = np.insert(given.weights[order], LOOP, 0.0)
    net["normP"], net["normY"] = np.ones(INPUTS), np.ones(1)  # the record is scaled already
    stamps, gradients = Stamps(), []
    pyrenn.RTRL = watched(pyrenn.RTRL, stamps, gradients)
    print("pyrenn:", end=" ")  # it ends its training with a line of its own
    pyrenn.train_LM(given.u.T, given.target, net, k_max=STEPS)
    jte = np.empty(len(order))
    jte[order] = gradients[0]
    tell(jte, **stamps.step, peak_mb=peak_mb(), version=f"pyrenn {version('pyrenn')}")


if __name__ == "__main__":
    main()
