"""A machine of the trial: which faults it can have, how it is drawn and how it is recorded.

Each has a file in `pamid.trial.machines`, named after the rig that it stands for, with
the machine as its `MACHINE`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Protocol

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError, nearest
from pamid.trial.conditions import Conditions
from pamid.trial.faults import Fault

#: planted sizes by fault (or fault@place), excitation, seed of the noise -> columns of a recording
Record = Callable[[Mapping[str, Mapping[str, float]], Any, int], dict[str, Array]]

ONE_DOF, TWO_LINK = "one-dof", "two-link"
AHEAD = 32  # samples run on after the end, for readings stamped early
_FOLDER = "pamid.trial.machines"


class Machine(Protocol):
    """Machine for a rig, with separate equations.

    name              of the rig
    period_s          between two samples
    faults            what can be planted, by name
    controller        [controller] of its closed loop
    withheld_columns  channels of a case -> how the columns begin that its recordings do not have
    """

    @property
    def name(self) -> str: ...
    @property
    def period_s(self) -> float: ...
    @property
    def faults(self) -> Mapping[str, Fault]: ...
    @property
    def controller(self) -> Mapping[str, float]: ...
    @property
    def withheld_columns(self) -> Mapping[str, tuple[str, ...]]: ...

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> Conditions:
        """How a case with these faults is recorded; clean: without background."""
        ...

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        """Where the fault is planted (its name, or fault@place), and its sizes (SI)."""
        ...

    def truth(self, site: str) -> dict[str, Any]:
        """Right answer to a planted fault."""
        ...

    def known(self, c: Any) -> dict[str, float]:
        """[known] of a recording."""
        ...

    def excitation(self, c: Any, record: Record, seed: int, noise: int) -> Any:
        """Reference of a closed loop, or command of an open loop: that may be the command that this
        machine without a fault would have used. noise: the seed of its readings'."""
        ...

    def build(self, random: np.random.Generator, c: Any) -> Record:
        """A drawn machine, recorded under these conditions."""
        ...


def machine_names() -> list[str]:
    folder = import_module(_FOLDER)
    return sorted(module.name.replace("_", "-") for module in iter_modules(folder.__path__))


def machine_named(rig: str) -> Machine:
    """Machine for this rig; UsageError if the trial has none."""
    known = machine_names()
    if rig not in known:
        raise UsageError(
            f"The trial has no machine for the rig {rig!r}.",
            nearest(rig, known) or f"Rigs: {', '.join(known)}.",
        )
    machine: Machine = import_module(f"{_FOLDER}.{rig.replace('-', '_')}").MACHINE
    return machine


def packed(**values: float) -> Any:
    """Numbers as the record that compiled code reads by name."""
    return np.array([tuple(values.values())], dtype=[(name, np.float64) for name in values])[0]
