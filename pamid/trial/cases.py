"""The cases of the blind trial: what is planted, under which conditions it is recorded, what the
tool may not know.

A case depends on the trial's machine, seed, part and number alone, never on how many are drawn and
never on the processor: what is drawn is rounded to DRAWN_DIGITS before it is used or digested.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from pamid.base.errors import UsageError
from pamid.base.json_file import json_text
from pamid.model.effect import Effect
from pamid.model.registry import catalogue_rig, effects
from pamid.model.rig import Rig
from pamid.trial.conditions import Conditions
from pamid.trial.faults import Fault
from pamid.trial.machine import ONE_DOF, TWO_LINK, Machine, machine_named
from pamid.trial.own_machine import OwnMachine

TRIAL_PARTS = ("calibration", "test")
STRATA = {"single": 0.45, "double": 0.12, "no-gap": 0.23, "withheld": 0.12, "nameless": 0.08}
NAMELESS = "nameless:"
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0  # steps of this share spread evenly, wherever they stop
# exp, log and pow differ in their last bit (1e-16) between processors. A number near the edge
# between two rounded ones still goes either way: once in 10^(16 - digits) numbers. With 9 digits
# that is once in 10^4 trials of 200 cases.
DRAWN_DIGITS = 9


@dataclass(frozen=True)
class Case:
    """One case with its label. planted: fault, or fault@place, -> sizes; removed: effects taken out
    of the tool's catalogue; conditions: as the machine draws them; own: the machine, where there is
    none of the name of the rig to be found; bare: what the rig states of its tolerances is taken
    away from the tool."""

    number: int
    part: str
    seed: int
    stratum: str
    planted: dict[str, dict[str, float]]
    removed: tuple[str, ...]
    conditions: Conditions
    rig: str = ONE_DOF
    own: OwnMachine | None = field(default=None, compare=False, repr=False)
    bare: bool = False

    @property
    def machine(self) -> Machine:
        return self.own or machine_named(self.rig)

    @property
    def told(self) -> dict[str, Any]:
        """The case as plain data."""
        fields = asdict(replace(self, own=None))
        del fields["own"]
        if not self.bare:
            del fields["bare"]
        return fields

    @property
    def tools_rig(self) -> Rig:
        """What the tool is given of the machine."""
        rig = self.own.rig if self.own else catalogue_rig(self.rig)
        if self.bare:
            rig = copy(rig)  # a machine made of the rig keeps its own
            rig.background = {}  # type: ignore[misc]
        return rig

    @property
    def sha256(self) -> str:
        fields = self.told
        if self.rig in (ONE_DOF, TWO_LINK):  # their conditions tell them apart
            del fields["rig"]
        if self.own is not None:
            fields["own"] = self.own.sha256
        return hashlib.sha256(json_text(fields).encode()).hexdigest()

    def label(self) -> dict[str, Any]:
        """The case as plain data, with what counts as the right answer to each fault."""
        truth = [self.machine.truth(site) for site in self.planted]
        return {**self.told, "sha256": self.sha256, "truth": truth}


def draw_cases(
    part: str, count: int, seed: int, rig: str | OwnMachine = ONE_DOF, *, bare: bool = False
) -> tuple[Case, ...]:
    """The first `count` cases of a part. UsageError for an unknown part or rig."""
    machine = machine_named(rig) if isinstance(rig, str) else rig
    if part not in TRIAL_PARTS:
        raise UsageError(f"unknown part {part!r}", f"parts: {', '.join(TRIAL_PARTS)}")
    cases = tuple(replace(_draw(machine, part, number, seed), bare=bare) for number in range(count))
    for other in TRIAL_PARTS:
        if other != part:
            assert not {c.seed for c in cases} & {_seed(other, n, seed) for n in range(count)}, (
                "parts share a seed"
            )
    return cases


def cases_sha256(cases: Sequence[Case]) -> str:
    """One digest over all cases, labels and all: two trials with the same one posed the same
    questions."""
    return hashlib.sha256("".join(c.sha256 for c in cases).encode()).hexdigest()


def _stream(part: str, number: int, seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(TRIAL_PARTS.index(part), number))


def _seed(part: str, number: int, seed: int) -> int:
    # exact in any JSON
    return int(_stream(part, number, seed).generate_state(1, np.uint64)[0] >> np.uint64(11))


def _draw(machine: Machine, part: str, number: int, seed: int) -> Case:
    random = np.random.default_rng(_stream(part, number, seed).spawn(1)[0])
    stratum, place = _stratum(part, number, seed)
    clean = stratum == "no-gap" and place < 0.5
    names = _planted(machine, stratum, place, random)
    conditions = machine.draw_conditions(random, [machine.faults[n] for n in names], clean)
    conditions = replace(conditions, **_rounded(asdict(conditions)))
    planted = {site: _rounded(sizes) for site, sizes in (machine.plant(n, random) for n in names)}
    removed = withheld(machine.faults[names[0]], effects()) if stratum == "withheld" else ()
    return Case(
        number,
        part,
        _seed(part, number, seed),
        stratum,
        planted,
        removed,
        conditions,
        machine.name,
        machine if isinstance(machine, OwnMachine) else None,
    )


def _rounded(drawn: dict[str, Any]) -> dict[str, Any]:
    return {
        k: float(f"{v:.{DRAWN_DIGITS}g}") if isinstance(v, float) else v for k, v in drawn.items()
    }


def _stratum(part: str, number: int, seed: int) -> tuple[str, float]:
    """Stratum of a case and its place in it, both spread evenly over the numbers however many are
    drawn."""
    first = np.random.default_rng([seed, TRIAL_PARTS.index(part)]).random()
    at = (first + number * GOLDEN) % 1.0
    for stratum, share in STRATA.items():
        if at < share:
            return stratum, at / share
        at -= share
    return stratum, 1.0 - 1e-9  # rounding of the sum of the shares


def _planted(
    machine: Machine, stratum: str, place: float, random: np.random.Generator
) -> list[str]:
    if stratum == "no-gap":
        return []
    faults = machine.faults
    known = [n for n in faults if n.startswith(NAMELESS) == (stratum == "nameless")]
    names = [known[int(place * len(known))]]
    if stratum == "double":
        first = faults[names[0]]
        others = [n for n in known if faults[n].family != first.family]
        names.append(str(random.choice(others)))
    return names


def withheld(fault: Fault, catalogue: dict[str, type[Effect]]) -> tuple[str, ...]:
    """A fault's whole family, and whatever its members call a look-alike or are called one by."""
    exact, family = fault.exact, fault.family
    kin = {
        n for n, e in catalogue.items() if n in exact or family in (e.family, *e.families.values())
    }
    named = {other for n in kin for other in catalogue[n].look_alikes}
    naming = {n for n, e in catalogue.items() if kin & set(e.look_alikes)}
    return tuple(sorted((kin | named | naming) & catalogue.keys()))
