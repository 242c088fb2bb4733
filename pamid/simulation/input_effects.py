"""How far every input moves the outputs of a model: the run with the recorded inputs against the
run with an input held at its mean. An input that moves no output has a dead term: another
unit, a factor of many tens, a product with zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import motion
from pamid.base.units import NONE, from_si, size_from_si, split_column

#: outputs (samples x channels, SI) at inputs (samples x inputs, SI); None where the run blows up
Simulate = Callable[[Array], Array | None]


def held_at_mean(u: Array, place: int | slice = slice(None)) -> Array:
    """Inputs (samples x inputs) with those at `place` (default: all) held at their means."""
    held = np.array(u)
    held[:, place] = u[:, place].mean(axis=0)
    return held


def input_effects(
    simulate: Simulate, u: Array, names: Sequence[str], run: Array | None
) -> dict[str, Array]:
    """Largest change of every output (channels, SI) by input, of the inputs that move.

    u: inputs (samples x inputs, SI). run: outputs at these inputs; None where the model blows up,
    and then no input is assessed.
    """
    effects = dict[str, Array]()
    for place, name in enumerate(names):
        if run is None or motion(u[:, place]) == 0.0:
            continue
        without = simulate(held_at_mean(u, place))
        if without is not None:
            effects[name] = np.abs(run - without).max(axis=0)
    return effects


def idle_text(
    name: str, values: Array, change: Array, channels: Sequence[str], noise: Array
) -> str:
    """Sentence without its full stop on an input that moves no output by more than its noise, ""
    for another input. values (SI): what was recorded of it; change, noise: per channel (SI)."""
    if not bool(np.all(change < noise)):
        return ""
    nearest = int(np.argmax(change / noise))
    symbol, unit = (split_column(c)[1] for c in (name, channels[nearest]))
    low, high = (float(from_si(x, symbol)) for x in (values.min(), values.max()))
    moved, noisy = (float(size_from_si(x[nearest], unit)) for x in (change, noise))
    shown = "" if unit == NONE else f" {unit}"
    return (
        f"{name} ({low:.4g} .. {high:.4g}) changes no output by more than its noise: "
        f"{channels[nearest]} by {moved:.2g}{shown} at most, its noise is {noisy:.2g}{shown}"
    )


IDLE_CURE = "Check its unit, its scale and its term in the equations of the rig."
