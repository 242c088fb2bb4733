"""Background terms that recordings cannot determine: curves over a quantity that hardly moves.

A rough map over a pressure that is held constant, or over a speed of three values, bends freely
between these few points. It then takes up what no other term explains and ruins the refit. Such a
term is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.engine.symbolic.expression import symbols
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig, background_by_port, with_declared
from pamid.model.step_rig import StepRig
from pamid.simulation.free_runs import free_run, known_values
from pamid.simulation.rig_data import Data

FEW_VALUES = 3
BINS = 20  # of the range, as fine as a rough map of ten waves
RESTING = 0.02  # of the size of a quantity: a smaller range is a single value
IN_PASSING = 0.005  # of the samples: values on the way to the next level


@dataclass(frozen=True)
class IdleTerm:
    """A background term that is left out: its port, its name, the signal that it is a curve over,
    and how many values (at most FEW_VALUES) the signal takes."""

    port: str
    name: str
    signal: str
    values: int

    @property
    def text(self) -> str:
        """Reason for leaving the term out, and a recording that would determine it."""
        count = "is constant" if self.values <= 1 else f"takes only {self.values} values"
        what = "the value" if self.signal == "value" else self.signal
        return (
            f"The background term {self.name} at port {self.port} is left out: {what} there "
            f"{count} in the fitted recordings, so the curve is not determined between them. "
            f"Record with {what} moving over its range to keep the term"
        )


def without_idle_terms(rig: Rig, recordings: Sequence[Data]) -> tuple[Rig, tuple[IdleTerm, ...]]:
    """The rig without the background terms that these recordings cannot determine, and these terms.

    Only quantities that follow from inputs are judged: what depends on a state moves between its
    levels.
    """
    # the signal that a term is a curve over, "" where it is none
    curves = [
        (port, term.name, over if isinstance(over, str) else str(over[0]))
        for port, terms in background_by_port(rig).items()
        for term in terms
        if (over := getattr(term, "over", ""))
    ]
    if not curves or isinstance(rig, StepRig):
        return rig, ()
    assembly = Assembly(rig)
    probes: dict[str, Expr] = {}
    wanted: dict[tuple[str, str], list[str]] = {}
    for port, signal in {(port, over) for port, _, over in curves}:
        for passage in (q for q in assembly.traced.passages if q.port == port):
            value = {"value": passage.value, **dict(passage.signals)}.get(signal)
            if isinstance(value, Expr):
                probes[f"{passage.where}.{signal}"] = value
                wanted.setdefault((port, signal), []).append(f"{passage.where}.{signal}")
    given = {
        key
        for key, value in probes.items()
        if not any(space in ("state", "cell") for space, _ in symbols([value]))
    }
    judged = {pair: keys for pair, keys in wanted.items() if given.issuperset(keys)}
    if not judged:
        return rig, ()
    names = sorted({key for keys in judged.values() for key in keys})
    try:
        table = _values(assembly, {key: probes[key] for key in names}, recordings)
    except PamidError:  # reported where the recordings are read
        return rig, ()
    counts = {
        pair: max(_value_count(table[:, names.index(key)]) for key in keys)
        for pair, keys in judged.items()
    }
    idle = [
        IdleTerm(port, name, over, counts[port, over])
        for port, name, over in curves
        if counts.get((port, over), FEW_VALUES + 1) <= FEW_VALUES
    ]
    if not idle:
        return rig, ()
    left_out = {(term.port, term.name) for term in idle}
    background = {
        port: tuple(term for term in terms if (port, term.name) not in left_out)
        for port, terms in background_by_port(rig).items()
    }
    background = {port: terms for port, terms in background.items() if terms}
    return with_declared(rig, background=background), tuple(idle)


def _values(assembly: Assembly, probes: dict[str, Expr], recordings: Sequence[Data]) -> Array:
    """The probes over the recordings' inputs, samples x probes."""
    tables = []
    for recording in recordings:
        p, _ = known_values(assembly, recording.known)
        u, period = recording.inputs(assembly), recording.sampling_period_s
        tables.append(free_run(assembly, u, p, period, further=probes).further)
    return np.concatenate(tables)


def _value_count(values: Array) -> int:
    """Number of values of a quantity, at the resolution of a rough curve; more than FEW_VALUES
    where it is not finite."""
    if not np.isfinite(values).all():
        return FEW_VALUES + 1
    low, high, size = values.min(), values.max(), np.abs(values).max()
    width = max((high - low) / BINS, RESTING * size)
    if width <= 0.0:
        return 1
    counts = []
    for shift in (0.0, 0.5):  # a level must not lie on an edge both times
        _, often = np.unique(np.floor((values - low) / width + shift), return_counts=True)
        counts.append(int((often > IN_PASSING * values.size).sum()))
    return min(counts)
