"""The cases of the blind trial: what is planted, under which conditions it is recorded, what the
tool may not know.

In a closed case an effect or two are the whole gap. In an open case further effects of other
families act as well, each a share of the planted effect, the maps are rougher than the rig states,
and the logger is poor (`pamid.trial.logger`), as on real machines.

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
from pamid.trial.faults import NAMELESS, Fault
from pamid.trial.logger import draw_logger
from pamid.trial.machine import ONE_DOF, TWO_LINK, Machine, machine_named, machine_names
from pamid.trial.own_machine import OwnMachine

TRIAL_PARTS = ("calibration", "test")
CLOSED, OPEN = "closed", "open"
#: world -> stratum -> share of its cases
STRATA = {
    CLOSED: {"single": 0.45, "double": 0.12, "no-gap": 0.23, "withheld": 0.12, "nameless": 0.08},
    OPEN: {"single": 0.6, "no-gap": 0.2, "nameless": 0.2},
}
WORLDS = tuple(STRATA)
#: change of the readings by a further effect, in that by the planted effect; a real machine's
#: second and third effect are neither as large as its first nor lost in its noise
FURTHER_SHARES = (0.1, 0.6)
MOST_FURTHER = 2
CANDIDATES = 8  # drawn for these: some cannot be scaled, or set a size that the planted effect sets
MAP_TOLERANCE = 0.02  # that rigs state (`background`)
BEYOND_TOLERANCE = (1.0, 2.5)  # times it, in an open case
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0  # steps of this share spread evenly, wherever they stop
# exp, log and pow differ in their last bit (1e-16) between processors. A number near the edge
# between two rounded ones still goes either way: once in 10^(16 - digits) numbers. With 9 digits
# that is once in 10^4 trials of 200 cases.
DRAWN_DIGITS = 9


@dataclass(frozen=True)
class Case:
    """A case with its label.

    planted     fault, or fault@place -> sizes
    removed     effects taken out of the tool's catalogue
    conditions  as the machine draws them
    given_machine  the machine, if none has the name of the rig
    bare        what the rig states of its tolerances is taken away from the tool
    world       "closed" or "open"
    further     candidates for the further effects of an open case -> sizes before they are scaled
    shares      of the further effects: change of the readings, in that by the planted effect
    """

    number: int
    part: str
    seed: int
    stratum: str
    planted: dict[str, dict[str, float]]
    removed: tuple[str, ...]
    conditions: Conditions
    rig: str = ONE_DOF
    given_machine: OwnMachine | None = field(default=None, compare=False, repr=False)
    bare: bool = False
    world: str = CLOSED
    further: dict[str, dict[str, float]] = field(default_factory=dict)
    shares: tuple[float, ...] = ()

    @property
    def machine(self) -> Machine:
        return self.given_machine or machine_named(self.rig)

    @property
    def plain_data(self) -> dict[str, Any]:
        """The case as plain data."""
        fields = asdict(replace(self, given_machine=None))
        del fields["given_machine"]
        if not self.bare:
            del fields["bare"]
        if self.world == CLOSED:
            del fields["world"], fields["further"], fields["shares"]
            del fields["conditions"]["logger"]
        return fields

    @property
    def tools_rig(self) -> Rig:
        """Rig of the machine as the tool receives it."""
        rig = self.given_machine.rig if self.given_machine else catalogue_rig(self.rig)
        if self.bare:
            rig = copy(rig)  # a machine made of the rig keeps its values
            rig.background = {}  # type: ignore[misc]
        return rig

    @property
    def sha256(self) -> str:
        fields = self.plain_data
        if self.rig in (ONE_DOF, TWO_LINK):  # their conditions tell them apart
            del fields["rig"]
        if self.given_machine is not None:
            fields["own"] = self.given_machine.sha256
        return hashlib.sha256(json_text(fields).encode()).hexdigest()

    def label(self) -> dict[str, Any]:
        """The case as plain data, with the right answers to each fault."""
        truth = [self.machine.truth(site) for site in self.planted]
        return {**self.plain_data, "sha256": self.sha256, "truth": truth}


def draw_cases(
    part: str,
    count: int,
    seed: int,
    rig: str | OwnMachine = ONE_DOF,
    *,
    bare: bool = False,
    world: str = CLOSED,
) -> tuple[Case, ...]:
    """The first `count` cases of a part, in a closed or in an open world. UsageError for an unknown
    part, rig or world, and for an open world with a machine that is made of its rig."""
    machine = machine_named(rig) if isinstance(rig, str) else rig
    for word, known, what in ((part, TRIAL_PARTS, "part"), (world, WORLDS, "world")):
        if word not in known:
            raise UsageError(f"unknown {what} {word!r}", f"{what}s: {', '.join(known)}")
    if world == OPEN and isinstance(machine, OwnMachine):
        raise UsageError(
            f"There are no open cases of {machine.name!r}: they need a machine with other "
            "equations than the rig.",
            f"Rigs with a machine: {', '.join(machine_names())}.",
        )
    numbers = range(count)
    cases = tuple(replace(_draw(machine, part, n, seed, world), bare=bare) for n in numbers)
    for other in TRIAL_PARTS:
        if other != part:
            others = {_seed(other, n, seed, world) for n in numbers}
            assert not {c.seed for c in cases} & others, "parts share a seed"
    return cases


def cases_sha256(cases: Sequence[Case]) -> str:
    """A digest over all cases and labels: trials with the same digest posed the same questions."""
    return hashlib.sha256("".join(c.sha256 for c in cases).encode()).hexdigest()


def _branch(part: str, world: str) -> int:
    return TRIAL_PARTS.index(part) + len(TRIAL_PARTS) * WORLDS.index(world)


def _stream(part: str, number: int, seed: int, world: str) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(_branch(part, world), number))


def _seed(part: str, number: int, seed: int, world: str) -> int:
    # exact in any JSON
    return int(_stream(part, number, seed, world).generate_state(1, np.uint64)[0] >> np.uint64(11))


def _draw(machine: Machine, part: str, number: int, seed: int, world: str) -> Case:
    random = np.random.default_rng(_stream(part, number, seed, world).spawn(1)[0])
    stratum, place = _stratum(part, number, seed, world)
    clean = world == CLOSED and stratum == "no-gap" and place < 0.5
    names = _planted(machine, stratum, place, random)
    conditions = machine.draw_conditions(random, [machine.faults[n] for n in names], clean)
    planted = {site: _rounded(sizes) for site, sizes in (machine.plant(n, random) for n in names)}
    case = Case(
        number,
        part,
        _seed(part, number, seed, world),
        stratum,
        planted,
        withheld(machine.faults[names[0]], effects()) if stratum == "withheld" else (),
        replace(conditions, **_rounded(vars(conditions))),
        machine.name,
        machine if isinstance(machine, OwnMachine) else None,
        world=world,
    )
    return _opened(case, names, random) if world == OPEN else case


def _opened(case: Case, names: Sequence[str], random: np.random.Generator) -> Case:
    """A case with the additions of an open world; names: planted faults, without places."""
    machine, c = case.machine, case.conditions
    logger = draw_logger(random, c.seconds)
    rough = {"background": MAP_TOLERANCE * float(random.uniform(*BEYOND_TOLERANCE))}
    conditions = replace(c, **_rounded(rough), logger=replace(logger, **_rounded(vars(logger))))
    case = replace(case, conditions=conditions)
    if not names:
        return case
    count = int(random.integers(1, MOST_FURTHER + 1))
    shares = _rounded({str(k): float(random.uniform(*FURTHER_SHARES)) for k in range(count)})
    families = {machine.faults[n].family for n in names}
    exact = frozenset().union(*(machine.faults[n].exact for n in names))
    others = [
        n
        for n, f in machine.faults.items()
        if not n.startswith(NAMELESS) and f.family not in families and not f.exact & exact
    ]
    drawn = [str(n) for n in random.permutation(others)[:CANDIDATES]]
    sites = [machine.plant(n, random) for n in drawn]
    further = {site: _rounded(sizes) for site, sizes in sites}
    return replace(case, further=further, shares=tuple(shares.values()))


def _rounded(drawn: dict[str, Any]) -> dict[str, Any]:
    return {
        k: float(f"{v:.{DRAWN_DIGITS}g}") if isinstance(v, float) else v for k, v in drawn.items()
    }


def _stratum(part: str, number: int, seed: int, world: str) -> tuple[str, float]:
    """Stratum of a case and its place in it, both spread evenly over the numbers."""
    first = np.random.default_rng([seed, _branch(part, world)]).random()
    at = (first + number * GOLDEN) % 1.0
    for stratum, share in STRATA[world].items():
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
    """Family of a fault, with all effects that are similar to its members."""
    exact, family = fault.exact, fault.family
    kin = {
        n for n, e in catalogue.items() if n in exact or family in (e.family, *e.families.values())
    }
    named = {other for n in kin for other in catalogue[n].look_alikes}
    naming = {n for n, e in catalogue.items() if kin & set(e.look_alikes)}
    return tuple(sorted((kin | named | naming) & catalogue.keys()))
