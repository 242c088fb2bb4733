"""The cases of the blind trial: what is planted, under which conditions it is recorded, what the tool may not know.

A case depends on the trial's seed, its part and its number alone, never on how many are drawn.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pamid.effect import Effect
from pamid.errors import UsageError
from pamid.library import effects
from pamid.run import json_text
from pamid.trial.faults import FAULTS, HIGH_INERTIA, LONG_HOLDS, PRESSURES, WIDE_RANGE, Fault

PARTS = ("calibration", "test")
STRATA = {"single": 0.45, "double": 0.12, "no-gap": 0.23, "withheld": 0.12, "nameless": 0.08}
INERTIAS = (0.014, 0.0896)                # kg m2: the arm of the first paper, and 6.4 times it
HOLDS, SLOW_HOLD = ((0.4, 1.6), (0.8, 3.0)), (3.0, 12.0)   # s
BACKGROUND = (0.005, 0.04)                # log-uniform
SECONDS = 40.0
NAMELESS = "nameless:"
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0     # steps of this share spread evenly, wherever they stop


@dataclass(frozen=True)
class Conditions:
    """How a case is recorded. loop: "closed" | "open"; channels: "all" | "no-forces" | "angle"; noise: factor on the
    sensors' usual noise; background: size of what no model of the tool can represent; amplitude in deg, holds in s."""

    inertia_kg_m2: float
    loop: str
    channels: str
    noise: float
    background: float
    seconds: float
    amplitude_deg: float
    hold_s: tuple[float, float]


@dataclass(frozen=True)
class Case:
    """One case with its label. planted: fault -> sizes; removed: effects taken out of the tool's catalogue."""

    number: int
    part: str
    seed: int
    stratum: str
    planted: dict[str, dict[str, float]]
    removed: tuple[str, ...]
    conditions: Conditions

    @property
    def sha256(self) -> str:
        return hashlib.sha256(json_text(asdict(self)).encode()).hexdigest()

    def label(self) -> dict[str, Any]:
        """The case as plain data, with what counts as the right answer to each fault."""
        truth = [{"fault": name, "family": FAULTS[name].family, "port": FAULTS[name].port,
                  "exact": sorted(FAULTS[name].exact)} for name in self.planted]
        return {**asdict(self), "sha256": self.sha256, "truth": truth}


def draw_cases(part: str, count: int, seed: int) -> tuple[Case, ...]:
    """The first `count` cases of a part. UsageError for an unknown part."""
    if part not in PARTS:
        raise UsageError(f"unknown part {part!r}", f"parts: {', '.join(PARTS)}")
    cases = tuple(_draw(part, number, seed) for number in range(count))
    for other in PARTS:
        if other != part:
            assert not {c.seed for c in cases} & {_seed(other, n, seed) for n in range(count)}, "parts share a seed"
    return cases


def cases_sha256(cases: Sequence[Case]) -> str:
    """One digest over all cases, labels and all: two trials with the same one posed the same questions."""
    return hashlib.sha256("".join(c.sha256 for c in cases).encode()).hexdigest()


def _stream(part: str, number: int, seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(PARTS.index(part), number))


def _seed(part: str, number: int, seed: int) -> int:
    return int(_stream(part, number, seed).generate_state(1, np.uint64)[0] >> np.uint64(11))  # exact in any JSON


def _draw(part: str, number: int, seed: int) -> Case:
    random = np.random.default_rng(_stream(part, number, seed).spawn(1)[0])
    stratum, place = _stratum(part, number, seed)
    clean = stratum == "no-gap" and place < 0.5
    names = _planted(stratum, place, random)
    conditions = _conditions(random, [FAULTS[n] for n in names], clean)
    planted = {n: FAULTS[n].draw(random) for n in names}
    removed = withheld(names[0], effects()) if stratum == "withheld" else ()
    return Case(number, part, _seed(part, number, seed), stratum, planted, removed, conditions)


def _stratum(part: str, number: int, seed: int) -> tuple[str, float]:
    """Stratum of a case and its place in it, both spread evenly over the numbers however many are drawn."""
    first = np.random.default_rng([seed, PARTS.index(part)]).random()
    at = (first + number * GOLDEN) % 1.0
    for stratum, share in STRATA.items():
        if at < share:
            return stratum, at / share
        at -= share
    return stratum, 1.0 - 1e-9  # rounding of the sum of the shares


def _planted(stratum: str, place: float, random: np.random.Generator) -> list[str]:
    if stratum == "no-gap":
        return []
    known = [n for n in FAULTS if n.startswith(NAMELESS) == (stratum == "nameless")]
    names = [known[int(place * len(known))]]
    if stratum == "double":
        first = FAULTS[names[0]]
        others = [n for n in known if FAULTS[n].family != first.family]
        names.append(str(random.choice(others)))
    return names


def withheld(fault: str, catalogue: dict[str, type[Effect]]) -> tuple[str, ...]:
    """A fault's whole family, and whatever its members call a look-alike or are called one by."""
    exact, family = FAULTS[fault].exact, FAULTS[fault].family
    kin = {n for n, e in catalogue.items() if n in exact or family in (e.family, *e.families.values())}
    named = {other for n in kin for other in catalogue[n].look_alikes}
    naming = {n for n, e in catalogue.items() if kin & set(e.look_alikes)}
    return tuple(sorted((kin | named | naming) & catalogue.keys()))


def _conditions(random: np.random.Generator, faults: list[Fault], clean: bool) -> Conditions:
    """Drawn at large, then narrowed to what the faults need to show."""
    needs = frozenset().union(*(f.needs for f in faults))
    u = random.random(7)
    low, high = BACKGROUND
    slow = LONG_HOLDS in needs
    angle_only = u[2] < 0.2 and PRESSURES not in needs
    return Conditions(
        inertia_kg_m2=INERTIAS[1] if HIGH_INERTIA in needs else INERTIAS[int(u[0] * 2)],
        loop="open" if u[1] < 0.25 else "closed",
        channels="angle" if angle_only else "no-forces" if u[2] < 0.6 else "all",
        noise=5.0 if u[3] < 0.15 else 1.0,
        background=0.0 if clean else float(low * (high / low) ** u[4]),
        seconds=2.0 * SECONDS if slow else SECONDS,
        amplitude_deg=float(32.0 + 8.0 * u[5] if WIDE_RANGE in needs else 25.0 + 15.0 * u[5]),
        hold_s=SLOW_HOLD if slow else HOLDS[int(u[6] * 2)])
