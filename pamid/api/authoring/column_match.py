"""Matching of a recording's columns to those of a rig, by name and by unit.

It also selects the rig of the catalogue whose columns match a recording best.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from pamid.base.errors import FileError, UsageError, listed, nearest
from pamid.base.units import NONE, compatible, quantity_of, quotient, split_column
from pamid.intake.logs.channel_words import meanings
from pamid.intake.logs.matcher import best_pairs, recorded_fit
from pamid.model.registry import rigs
from pamid.model.rig import Rig

UNUSED = 0.1  # penalty for a recorded column without a place
UNCONTROLLED = 0.3  # penalty for a recorded reference without a controller in the rig
NEAR = 0.5  # of the best score: a worse match is not listed
LISTED_RIGS = 4  # rigs whose gaps an error lists
UNRECORDED = 0.25  # weight of an output that was not recorded
_SPEEDS = ("velocity", "angular velocity")
#: modules that a copied rig file may import; parts shared between rigs are not copied
_COPIED = ("pamid.model.", "pamid.engine.symbolic.")


@dataclass(frozen=True)
class Pair:
    """A column of a rig, with the recorded column that is assigned to it.

    by: "name", "word" or "unit"; "you" if the user assigned it. scaled: the quantities differ, so
    that a gain converts between them.
    """

    wanted: str
    recorded: str
    role: str  # input, output or reference
    by: str
    scaled: bool
    score: float


@dataclass(frozen=True)
class Match:
    """Assignment of a recording's columns to a rig.

    missing      inputs that the rig cannot do without
    unrecorded   outputs and optional inputs that the recording lacks
    unused       recorded columns without a place
    score        1 if everything matches by name
    """

    rig: type[Rig]
    pairs: tuple[Pair, ...]
    missing: tuple[str, ...]
    unrecorded: tuple[str, ...]
    unused: tuple[str, ...]
    score: float

    @property
    def fits(self) -> bool:
        """True if every necessary input is recorded, and an output to compare with."""
        return not self.missing and any(q.role == "output" for q in self.pairs)

    @property
    def named(self) -> bool:
        """True if a necessary input or an output matches by more than its unit."""
        return any(
            q.by != "unit" and q.role != "reference" and q.wanted not in self.rig.optional
            for q in self.pairs
        )

    def columns_by_role(self, role: str) -> tuple[str, ...]:
        """Recorded inputs, as causes, and outputs, as effects."""
        return tuple(q.recorded for q in self.pairs if q.role == role)

    @property
    def exchanged_rigs(self) -> tuple[str, ...]:
        """Template rigs with a force or torque exchanged for a motion, or the reverse."""
        sides = {"load", "motion"}
        sent = {_side(q.wanted) for q in self.pairs if q.role == "input"} & sides
        read = {_side(q.wanted) for q in self.pairs if q.role == "output"} & sides
        if not sent or not read or sent & read:
            return ()
        return tuple(
            name
            for name, rig in examples().items()
            if {_side(c) for c in rig.inputs if c not in rig.optional} == read
            and {*map(_side, rig.outputs)} & sent
        )

    def missing_parts(self) -> str:
        """Missing parts, as text."""
        rates = [(q, w) for w in self.missing for q in self.unused if _is_rate(q, w)]
        if rates:
            return "; ".join(
                f"no column for {_column_text(w)}, of which {q} is the rate" for q, w in rates
            )
        if self.missing:
            return f"no column for {', '.join(map(_column_text, self.missing))}"
        return f"none of its outputs: {', '.join(map(_column_text, self.rig.outputs))}"


def _side(column: str) -> str:
    """Kind of a column: "load" for a force or torque, "motion" for a length, an angle or a speed.

    Any other column has its quantity.
    """
    quantity = quantity_of(split_column(column)[1])
    sides = {"load": ("force", "torque"), "motion": ("position", "angle", *_SPEEDS)}
    return next((side for side, those in sides.items() if quantity in those), quantity)


def _is_rate(recorded: str, wanted: str) -> bool:
    """True if the recorded column is the speed of a length or angle that the rig needs."""
    symbol, wanted_unit = split_column(recorded)[1], split_column(wanted)[1]
    return wanted_unit != NONE and symbol != NONE and compatible(symbol, quotient(wanted_unit, "s"))


def _integration_hint(symbol: str, wanted: str) -> str:
    """Hint on how to integrate a speed to a position."""
    return (
        f"Integrate {symbol} over time into a separate column and give --column {wanted}=NAME. "
        f"Or copy the rig, make {symbol} the input and pass {symbol} as velocity."
    )


def _column_text(column: str) -> str:
    symbol = split_column(column)[1]
    return column if symbol == NONE else f"{column} ({quantity_of(symbol)})"


def examples() -> dict[str, type[Rig]]:
    """Rigs of the catalogue that can serve as a template: those written in a single file."""
    alone = {}
    for name, rig in rigs().items():
        lines = inspect.getsource(sys.modules[rig.__module__]).splitlines()
        ours = (line for line in lines if line.startswith(("from pamid", "import pamid")))
        if all(line.split()[1].startswith(_COPIED) for line in ours):
            alone[name] = rig
    return alone


def example_named(name: str) -> type[Rig]:
    """Return a rig of `examples`. An unknown name raises UsageError with the nearest name."""
    known = examples()
    if name in known:
        return known[name]
    if name in rigs():
        raise UsageError(
            f"rig {name!r} shares parts with other rigs and cannot be copied into a file.",
            f"Use the rig unchanged with --rig {name}, or start from {', '.join(known)}.",
        )
    hint = nearest(name, known) or f"Rigs: {', '.join(known)}."
    raise UsageError(f"Rig {name!r} is not in the catalogue.", hint)


def roles_of(rig: type[Rig]) -> dict[str, str]:
    """Return every column of a rig with its role."""
    return {
        **{name: "input" for name in rig.inputs},
        **{name: "output" for name in rig.outputs},
        **{loop.reference: "reference" for loop in rig.loops},
    }


def match_columns(
    recorded: Iterable[str],
    rig: type[Rig],
    stated: Mapping[str, str] | None = None,
    held: Collection[str] = (),
) -> Match:
    """Assign recorded columns to those of a rig.

    stated: column of the rig -> recorded column; the user's assignments, which are not questioned.
    held: recorded columns that step from level to level, which no measured or moving quantity does.
    Raises UsageError: a stated name does not exist on its side.
    """
    recorded, roles, stated = list(recorded), roles_of(rig), dict(stated or {})
    for wanted, column in stated.items():
        if wanted not in roles:
            raise UsageError(
                f"rig {rig.name!r} has no column {wanted!r}.",
                nearest(wanted, roles) or f"Its columns: {', '.join(roles)}.",
            )
        if column not in recorded:
            raise UsageError(
                f"The recording has no column {column!r}.",
                nearest(column, recorded) or f"Its columns: {listed(recorded)}.",
            )
        if _is_rate(column, wanted):
            raise UsageError(
                f"{column} is the rate of {wanted}: no gain converts between them.",
                _integration_hint(column, wanted),
            )
    assigned = {}
    for wanted, column in stated.items():
        scaled = not compatible(split_column(column)[1], split_column(wanted)[1])
        assigned[wanted] = Pair(wanted, column, roles[wanted], "you", scaled, 1.0)
    free = [column for column in recorded if column not in stated.values()]
    needed = [name for name in rig.inputs if name not in rig.optional]
    fits = {
        (wanted, column): recorded_fit(column, wanted, sent=wanted in needed)
        # an optional input, such as a room's temperature, comes after the oven's
        for wanted, role in sorted(roles.items(), key=lambda item: item[0] in rig.optional)
        for column in free
        if wanted not in stated
        and not ((role == "output" or wanted in rig.ramped) and column in held)
    }
    for wanted, column in best_pairs(fits).items():
        fit = fits[wanted, column]
        assigned[wanted] = Pair(wanted, column, roles[wanted], fit.by, fit.scaled, fit.score)
    pairs = tuple(assigned[wanted] for wanted in roles if wanted in assigned)
    used = {q.recorded for q in pairs}
    unused = tuple(name for name in recorded if name not in used)
    weights = {
        **dict.fromkeys(needed, 1.0),
        **{name: 1.0 if name in assigned else UNRECORDED for name in rig.outputs},
        **{name: 0.1 for name in roles if name in assigned and name not in (*needed, *rig.outputs)},
    }
    got = sum(w * assigned[name].score for name, w in weights.items() if name in assigned)
    return Match(
        rig,
        pairs,
        tuple(name for name in needed if name not in assigned),
        tuple(name for name in (*rig.inputs, *rig.outputs) if name not in (*assigned, *needed)),
        unused,
        got / sum(weights.values())
        - UNUSED * len(unused) / max(1, len(recorded))
        - UNCONTROLLED * any("reference" in meanings(split_column(column)[0]) for column in unused),
    )


def best_match(
    recorded: Iterable[str],
    like: str | None = None,
    stated: Mapping[str, str] | None = None,
    held: Collection[str] = (),
) -> tuple[Match, list[Match]]:
    """Return the rig that matches best, or the stated rig, and the other matching rigs, best first.

    A match by units alone is reported, but not used. Two quantities of the same kind do not
    identify a machine.

    Raises FileError: no rig matches, or only by units. The message lists the gaps of each rig.
    Raises UsageError: a stated name does not exist.
    """
    recorded = list(recorded)
    if like is not None:
        wanted = match_columns(recorded, example_named(like), stated, held)
        speeds = [(q, w) for w in wanted.missing for q in wanted.unused if _is_rate(q, w)]
        if wanted.fits and not speeds:
            return wanted, []
        column = (wanted.missing or tuple(wanted.rig.outputs))[0]
        hint = f"Name the column with --column {column}=NAME; the recording has {listed(recorded)}."
        hint = _integration_hint(*speeds[0]) if speeds else hint
        message = f"The recording does not fit {like!r}: {wanted.missing_parts()}."
        raise FileError(message, hint, code="no-match")
    every = []
    for rig in examples().values():
        known = {k: v for k, v in (stated or {}).items() if k in roles_of(rig)}
        if len(known) == len(stated or {}):
            every.append(match_columns(recorded, rig, known, held))
    every.sort(key=lambda match: -match.score)
    # a column without a place may be the input, which a rig without inputs cannot take
    fitting = [m for m in every if m.fits and (m.rig.inputs or not m.unused)]
    # by units alone the smallest machine is most plausible: columns of larger ones are missing
    guessed = sorted(
        (match for match in fitting if not match.named),
        key=lambda match: (len(match.unused), len(match.unrecorded), len(match.rig.states)),
    )
    fitting = [match for match in fitting if match.named]
    names = set(recorded)
    whole = ""
    for name, rig in rigs().items():
        # the recording has all inputs of the rig and an output, under the rig's names
        needed = set(rig.inputs) - set(rig.optional)
        if needed and names >= needed and names & set(rig.outputs):
            whole = name
            break
    by_names = (all(q.by == "name" and not q.scaled for q in m.pairs) for m in fitting)
    if whole and whole not in examples() and not any(by_names):
        raise FileError(
            f"These are the columns of rig {whole!r}, which cannot be copied into a file.",
            f"Use the rig unchanged with --rig {whole}.",
            code="no-match",
        )
    if guessed and not fitting:
        machines = ", ".join(
            f"{match.rig.name} ({inspect.cleandoc(match.rig.__doc__ or '').splitlines()[0]})"
            for match in guessed[:4]
        )
        raise FileError(
            f"The columns {listed(recorded)} fit by their units alone: {machines}.",
            f"Name the rig, for example --like {guessed[0].rig.name}.",
            code="no-match",
        )
    fitting = [match for match in fitting if match.score > NEAR * fitting[0].score]
    if not fitting:
        near = "; ".join(f"{m.rig.name}: {m.missing_parts()}" for m in every[:LISTED_RIGS])
        raise FileError(
            f"No rig fits the columns {listed(recorded)}"
            + (f" ({near})." if near else ": no rig has the columns given with --column."),
            "Name a rig with --like, and its columns with --column RIG_COLUMN=COLUMN.",
            code="no-match",
        )
    return fitting[0], fitting[1:]
