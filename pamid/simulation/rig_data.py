"""Recording of a rig, with columns resolved to the rig's names and converted to SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError, listed, nearest, quoted
from pamid.base.units import from_si, split_column, to_si
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, match_column


@dataclass(frozen=True, repr=False)
class Data(Recording):
    """Recording of a rig.

    values: samples (n,) of its inputs, outputs and loop signals in SI, by the rig's name of the
    column; unused: columns that the rig does not define.
    """

    values: dict[str, Array] = field(default_factory=dict)
    unused: tuple[str, ...] = ()

    def shown(self, name: str) -> Array:
        """Return the samples of a column of the rig in the unit of its name."""
        if name in self.columns:
            return self.columns[name]
        return np.asarray(from_si(self.values[name], split_column(name)[1]))

    def slice(self, start: int, stop: int) -> Data:
        rows = slice(start, stop)
        return replace(
            self,
            time=self.time[rows],
            columns={name: x[rows] for name, x in self.columns.items()},
            values={name: x[rows] for name, x in self.values.items()},
        )

    def inputs(self, assembly: Assembly, names: tuple[str, ...] | None = None) -> Array:
        """Return the assembly's inputs, or those in `names` (samples x inputs). Missing optional
        inputs have their default value."""
        columns = []
        for name in assembly.traced.inputs if names is None else names:
            if name in self.values:
                columns.append(self.values[name])
            elif name in assembly.rig.optional or name.startswith("noise_"):
                columns.append(np.full(len(self), assembly.rig.optional.get(name, 0.0)))
            else:
                raise FileError(
                    f"{self.path}: rig {assembly.rig.name!r} needs the input column {name!r}.",
                    nearest(name, list(self.columns))
                    or f"Add this column, or rename any of: {', '.join(self.columns)}.",
                    code="missing-column",
                )
        return np.stack(columns, axis=1) if columns else np.zeros((len(self), 0))

    def outputs(self, names: Sequence[str]) -> Array:
        """Return measured outputs (samples x names); NaN for outputs that were not recorded."""
        missing = np.full(len(self), np.nan)
        return np.stack([self.values.get(name, missing) for name in names], axis=1)

    def runs_in_loop(self, rig: Rig) -> bool:
        """Whether this is a closed-loop recording that contains every reference of the rig."""
        references = [q.reference for q in rig.loops]
        return self.loop == "closed" and bool(references) and self.values.keys() >= {*references}

    def measured(self, rig: Rig) -> tuple[str, ...]:
        """Return the rig's outputs that were recorded; FileError if there are none."""
        names = tuple(name for name in rig.outputs if name in self.values)
        if not names:
            raise FileError(
                f"{self.path} holds none of the outputs of rig {rig.name!r}: "
                f"{', '.join(rig.outputs)}",
                f"{nearest(next(iter(rig.outputs)), list(self.columns))} Name another "
                f"--rig, or rename the columns; there are {listed(self.columns)}. "
                f"`pamid new-rig {quoted(self.path)}` writes a rig for them.".lstrip(),
            )
        return names


def data_of(rig: Rig, recording: Recording) -> Data:
    """Resolve columns to the rig's names; FileError if a unit belongs to another quantity."""
    loops = (name for q in rig.loops for name in (q.command, q.reference, q.reading))
    values, used_columns = {}, set()
    for name in dict.fromkeys((*rig.inputs, *rig.optional, *rig.outputs, *loops)):
        column = match_column(recording.columns, name)
        if column is not None:
            samples = to_si(recording.columns[column], split_column(column)[1])
            values[name] = np.asarray(samples, dtype=np.float64)
            used_columns.add(column)
    unused = tuple(name for name in recording.columns if name not in used_columns)
    return Data(**{**vars(recording), "values": values, "unused": unused})
