"""A verdict in words: the sentence that opens terminal, page and JSON, and the remark that goes
before it where nothing can be said.

The sentence is made of what stands in diagnosis.json and of nothing else, so that whoever reads the
file can say the same, with names spelt in another way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pamid.base.share_words import chance_text, percent_text, percents_text, times_text
from pamid.diagnosis.judgement import calibration
from pamid.diagnosis.settings import DEFAULT
from pamid.schemas.diagnosis_file import BestMember, Cause, DiagnosisFile, Remainder, Where

if TYPE_CHECKING:
    from pamid.diagnosis.tournament import Diagnosis

RECORD_MORE = "Record for longer, or with larger motion."
MEASURE_MAP = "Measure what comes out there for what goes in, slowly, over the whole range."

#: how the note begins that stands in the place of an experiment
WITHHELD = "No next experiment is proposed"


@dataclass(frozen=True)
class Spelling:
    """How names are written."""

    effect: Callable[[str], str] = str
    port: Callable[[str], str] = str


AS_IN_FILE = Spelling()


def remark(d: Diagnosis) -> str:
    """What is wrong with the recordings, or with how they were read, where no verdict on the model
    means anything."""
    units = d.judged.units if d.judged else None
    if units and (units["slips"] or not d.silent):
        channel, share = max(units["error_over_spread"].items(), key=lambda pair: pair[1])
        # no slip of the pen explains it: then the units may well be right
        lost = (
            ""
            if units["slips"]
            else " If they are right, the refit got nowhere: something large is missing, a prior "
            "is far off, or a window begins in a state that no sensor reads."
        )
        return (
            f"The refitted model misses {channel} by {times_text(share)} times what it moves. "
            f"{units['advice']}{lost}"
        )
    if not d.silent:
        return ""
    sent, channels, one = _moving_inputs(d), _joined(d.silent, "and"), len(d.silent) == 1
    if d.response is None:
        shown = f"The model predicts {channels} no better than the mean or a straight line does."
    elif d.response.is_reversed:
        shown = (
            f"{channels} {'precedes' if one else 'precede'} {sent}: the rows seem to be in reverse "
            "order of time."
        )
    else:
        hardly = not d.response.absent.any()
        respond = ("responds" if one else "respond") if hardly else "respond"
        negation = "hardly" if hardly else f"{'does' if one else 'do'} not"
        shown = (
            f"{channels} {negation} {respond} to {sent}: the model predicts no better with the "
            "recorded input than without it."
        )
    rest = (
        " Without it the others can be diagnosed."
        if len(d.silent) < len(d.evidence.channels)
        else ""
    )
    return (
        f"The recordings do not show this machine. {shown} Check that every column is the channel "
        "in its name, that one clock recorded all of them, and that the input acted on the rig."
        f"{rest}"
    )


def _moving_inputs(d: Diagnosis) -> str:
    """Names of the recorded inputs that move in any recording, joined; empty without any."""
    moving = (
        name
        for name in d.evidence.rig.inputs
        if any(r.has(name) and np.ptp(r.signal(name)) > 0.0 for r in d.evidence.recordings)
    )
    return _joined(moving, "or")


def sentence(found: DiagnosisFile, spelling: Spelling = AS_IN_FILE) -> str:
    """The verdict in one sentence; a remark goes before it."""
    if found.remark:
        return found.remark
    rest = found.remainder
    if found.verdict == "no-structural-gap":
        return (
            "Nothing beyond retuned parameters and ordinary tolerances: no structural gap was "
            f"found.{_tolerated(rest)}"
        )
    if found.verdict == "unknown-effect":
        at = _entrance(found.where, spelling) if found.where and found.where.port else ""
        families = free_families(found, spelling)
        return (
            "Something material is missing from the model, and no effect of the catalogue "
            f"explains it.{at}{f' It is {families}.' if families else ''}{_as_a_rough_map(found)}"
        )
    if found.verdict == "cannot-tell":
        return _unsure(found, spelling)
    last = "or" if found.verdict == "ambiguous" else "and"
    names = _joined((_with_places(c, spelling) for c in found.causes), last)
    verb = "explain" if last == "and" and len(found.causes) > 1 else "explains"
    if rest is None or rest.share is None:
        return f"{names} {verb} the gap."
    said = f"{names} {verb} {percent_text(1.0 - rest.share)} of the gap"
    if found.verdict == "ambiguous":
        said += ": these recordings do not decide between them"
    if not rest.real:
        return f"{said}; {left_beside(rest)}."
    return f"{said}; {percent_text(rest.share)} remain{_entering(rest, spelling)}."


def _as_a_rough_map(found: DiagnosisFile) -> str:
    """Where what is missing is no more than a map leaves that is rough, and the rig states by how
    much none of its maps may be: that; begins with a space."""
    rest = found.remainder
    if rest is None or found.background or rest.missing_rms is None or not rest.passing_rms:
        return ""
    share = rest.missing_rms / rest.passing_rms
    if share > DEFAULT.rough_share:
        return ""
    return f" A map that is rough by {percent_text(share)} there would look alike."


def withheld(found: DiagnosisFile) -> str:
    """The note on why no experiment is proposed although models are in question; empty where there
    is none."""
    return next((note for note in found.notes if note.startswith(WITHHELD)), "")


def free_families(found: DiagnosisFile, spelling: Spelling = AS_IN_FILE) -> str:
    """ "of the friction family, in a form not in the catalogue", with the nearest that is in it;
    empty where no free form takes it up."""
    forms = found.unknown.free_forms if found.unknown is not None else ()
    families = {one.family for one in forms}
    if not families:
        return ""
    names = _joined((spelling.effect(one) for one in dict.fromkeys(f.family for f in forms)), "or")
    text = f"of the {names} family, in a form not in the catalogue"
    nearest = found.members[0] if len(found.members) == 1 and not found.causes else None
    if nearest is None or nearest.family not in families or nearest.removes is None:
        return text
    if nearest.removes.low <= 0.0:
        return text
    share = percent_text(nearest.removes.share)
    return f"{text} (the nearest in it is {_with_chance(nearest, spelling)}, {share} of the gap)"


def size_of(rest: Remainder, *, beside: bool) -> str:
    """What is left, in figures: "36 % of the gap (95 % interval 30 to 42 %), 1.4 times the noise
    floor in the worst channel"; beside: causes, without which it is the gap itself."""
    texts = []
    if beside and rest.share is not None:
        text = f"{percent_text(rest.share)} of the gap"
        if rest.low is not None and rest.high is not None and rest.low < rest.high:
            text += f" (95 % interval {percents_text(rest.low, rest.high)})"
        texts.append(text)
    if rest.floors is not None:
        times = times_text(rest.floors)
        floors = "as much as the noise floor" if times == "1" else f"{times} times the noise floor"
        texts.append(f"{floors} in the worst channel")
    return ", ".join(texts)


def amount_of(rest: Remainder) -> str:
    """What is missing at its port to the model as fitted, in the port's unit, beside what passes
    there with all that acts; "" where that is not known."""
    if rest.missing_rms is None or not rest.passing_rms:
        return ""
    share = rest.missing_rms / rest.passing_rms
    beside = f"{percent_text(share)} of" if share < 1.0 else f"{times_text(share)} times"
    unit = f" {rest.unit}" if rest.unit else ""
    return (
        f"{rest.missing_rms:.3g}{unit} (root mean square, estimated there) missing to the model as "
        f"fitted, {beside} the {rest.passing_rms:.3g}{unit} that pass there"
    )


def weight_of(rest: Remainder) -> str:
    """Whether what is left is more than noise and tolerances, by what that was decided, and how
    often these alone leave as much."""
    text = (
        "more than noise and ordinary tolerances"
        if rest.real
        else "not told from noise and ordinary tolerances"
    )
    if rest.by_evidence and rest.evidence is not None and rest.plain_from is not None:
        return (
            f"{text}: the recordings speak for a missing value with {rest.evidence:.3g} nats per "
            f"sample, which decides from {rest.plain_from:.3g} on; the errors alone would not have "
            f"(P {chance_figure(rest.probability or 0.0)})"
        )
    text += _chance_beside(rest)
    if rest.p_value is not None:
        of = 100.0 * rest.p_value
        often = "fewer than 1" if of < 1.0 else f"{of:.0f}"
        text += (
            f"; of 100 machines on which nothing is missing, {often} would leave as much or more"
        )
    return text


def _chance_beside(rest: Remainder) -> str:
    """How probable it is that what is left is more, with the line that it did not reach where that
    is not plain; begins with a space."""
    if rest.probability is None:
        return ""
    if not rest.real and rest.floors is not None and rest.floors < 1.0 + DEFAULT.gap_margin:
        return f" (within {percent_text(DEFAULT.gap_margin)} of the noise floor)"
    short = not rest.real and rest.probability >= DEFAULT.plainly_not
    line = f"; it counts from {rest.probable_from:.2f} on" if short and rest.probable_from else ""
    return f" (P {chance_figure(rest.probability)} that it is more{line})"


def _tolerated(rest: Remainder | None) -> str:
    """How much tolerances are made to answer for, where it is plainly more than noise; begins with
    a space."""
    if rest is None or rest.floors is None or rest.floors < DEFAULT.naive_near_floor:
        return ""
    return (
        f" What is left, {times_text(rest.floors)} times the noise floor, machines leave as well "
        "on which nothing is missing."
    )


def left_beside(rest: Remainder) -> str:
    """What remains beside the causes and is not real: said with its size and chance where it is
    plainly more than noise, for then tolerances alone have to answer for it."""
    if rest.floors is None or rest.floors < DEFAULT.naive_near_floor:
        return "what remains is within noise and tolerances"
    text = (
        f"what remains, {times_text(rest.floors)} times the noise floor, is not told from ordinary "
        "tolerances"
    )
    return f"{text}{_chance_beside(rest)}"


def _entrance(where: Where, spelling: Spelling) -> str:
    """Where the gap enters: the port that the evidence prefers, and those that take as much of it
    or more where the sensors do not tell one from the other."""
    shares = {one.port: one.share for one in where.ports}
    own = shares.get(where.port, 0.0)
    alike = where.not_told_from(where.port)
    others = sorted(port for port in alike if shares.get(port, 0.0) >= own > 0.0)
    first = f" It enters at the {spelling.port(where.port)} port"
    if not others:
        return f"{first}."
    rest = _joined([spelling.port(p) for p in others], "or")
    return f"{first}, or at {rest}: these sensors do not tell them apart."


def _entering(rest: Remainder, spelling: Spelling) -> str:
    at = f", at the {spelling.port(rest.port)} port" if rest.port else ""
    return at + (f", of the {spelling.effect(rest.family)} family" if rest.family else "")


def _unsure(found: DiagnosisFile, spelling: Spelling) -> str:
    """A probable cause that the held-out windows do not confirm, or a gap that may be none."""
    m = max(found.members, key=lambda m: m.probability or 0.0, default=None)
    rest = found.remainder
    if m is not None and m.removes is not None and m.bent is not None and _only_bent(m):
        return (
            f"{_with_chance(m, spelling)} would remove {percent_text(m.removes.share)} of the gap, "
            f"but it bends what passes there by {percent_text(m.bent)} only: machines on which "
            f"nothing is missing are as far from straight. {MEASURE_MAP}"
        )
    if rest is not None and not rest.real and rest.probability is not None:
        text = (
            "These recordings leave open whether anything is missing "
            f"(P {chance_figure(rest.probability)})"
        )
        if rest.floors is not None:
            text += f": what is left is {size_of(rest, beside=False)}"
        text += "."
        if m is not None and m.removes is not None and m.removes.share >= DEFAULT.worth:
            text += (
                f" The nearest is {_with_chance(m, spelling)}, {percent_text(m.removes.share)} of "
                f"it (95 % interval {percents_text(m.removes.low, m.removes.high)})."
            )
        return f"{text} {RECORD_MORE}"
    if m is None or m.removes is None:
        return f"These recordings do not suffice for a verdict. {RECORD_MORE}"
    return (
        f"{_with_chance(m, spelling)} may be missing, but the held-out windows do not suffice to "
        f"confirm it: it removes {percent_text(m.removes.share)} of the gap (95 % interval "
        f"{percents_text(m.removes.low, m.removes.high)}). {RECORD_MORE}"
    )


def _only_bent(m: BestMember) -> bool:
    """Is it probable, and held back for being no more than an ordinary machine's characteristic?"""
    probable = (m.probability or 0.0) >= calibration().lines["cause"].yes
    backed = m.removes is not None and m.removes.low > 0.0
    return probable and backed and m.bent is not None and m.bent <= DEFAULT.ordinary_bend


def _with_chance(c: Cause | BestMember, spelling: Spelling) -> str:
    place = f" at the {spelling.port(c.port)} port" if c.port and "@" not in c.effect else ""
    chance = f" (P {chance_figure(c.probability)})" if c.probability is not None else ""
    return f"{spelling.effect(c.effect)}{place}{chance}"


def _with_places(c: Cause, spelling: Spelling) -> str:
    """The same, and where else it may as well act."""
    ports = _joined((spelling.port(port) for port in c.or_at), "or")
    elsewhere = f", or the like at the {ports} port," if ports else ""
    return f"{_with_chance(c, spelling)}{elsewhere}"


def chance_figure(probability: float) -> str:
    """As figures stand in brackets: "> 0.99"."""
    return chance_text(probability).replace("above", ">").replace("below", "<")


def _joined(parts: Iterable[str], last: str) -> str:
    words = list(parts)
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))
