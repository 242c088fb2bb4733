"""Models of which only the held-out errors are known, for tests of the comparison and the answer.

The noise floor is 1 in every window and channel, so that a loss of a single channel is its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.model.attachment import Addition, Attachment, additions_of


class _AnyPorts(dict[str, Any]):
    """A port of every name; numbered ones ("joint_1") are like each other."""

    def __missing__(self, name: str) -> Any:
        kind = name.rpartition("_")[0] or name
        return SimpleNamespace(kind="motion" if kind == "joint" else kind, unit="", kin="")


RIG = SimpleNamespace(name="made-up", ports=_AnyPorts(), group_of=lambda port: port)


@dataclass(frozen=True)
class MadeEffect:
    """An effect of a family that is the same at every port. label: name@port."""

    name: str
    of_family: str
    ports: tuple[str, ...]

    @property
    def effect(self) -> MadeEffect:
        return self

    @property
    def label(self) -> str:
        return f"{self.name}@{self.ports[0]}"

    def family(self, rig: Any) -> str:
        return self.of_family

    def group(self, rig: Any) -> str:
        return self.ports[0]


def effect(name: str, family: str = "", port: str = "joint") -> Attachment:
    return cast(Attachment, MadeEffect(name, family or name, (port,)))


def model(losses: ArrayLike, *effects: Attachment, parameters: int = 0) -> CandidateModel:
    """losses: errors per window (n,) or per window and channel (n, channels)."""
    errors = np.asarray(losses, dtype=float)
    return cast(
        CandidateModel,
        MadeModel(
            errors[:, None] if errors.ndim == 1 else errors,
            effects,
            parameters or 3 + len(effects),
        ),
    )


@dataclass(frozen=True, eq=False)
class MadeModel:
    absolutes: Array
    attached: tuple[Attachment, ...]
    free_count: int
    finite: bool = True

    @property
    def label(self) -> str:
        return " + ".join(a.label for a in self.attached) or "baseline"

    @property
    def additions(self) -> tuple[Addition, ...]:
        return tuple(additions_of(cast(Any, RIG), self.attached))

    @property
    def assembly(self) -> Any:
        return SimpleNamespace(rig=RIG, attachments=self.attached)


def comparison(
    baseline: ArrayLike, *, floor: ArrayLike = 1.0, seed: int = 0, settings: Settings = DEFAULT
) -> Comparison:
    """Of a baseline with these errors; floor: per channel."""
    base = model(baseline)
    floors = np.broadcast_to(np.asarray(floor, dtype=float), base.absolutes.shape)
    evidence = cast(Any, None)
    grey_box = cast(Any, SimpleNamespace(evidence=None))
    budget = Budget(grey_box, evidence, base, base.absolutes, floors, settings)
    return Comparison(budget, seed)
