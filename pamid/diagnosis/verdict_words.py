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
from pamid.schemas.diagnosis_file import Cause, DiagnosisFile, Remainder, Where

if TYPE_CHECKING:
    from pamid.diagnosis.tournament import Diagnosis

RECORD_MORE = "Record for longer, or with larger motion."

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
    """The verdict in one sentence or two; a remark goes before it."""
    if found.remark:
        return found.remark
    if found.verdict == "no-structural-gap":
        return _no_gap(found)
    if found.verdict == "unknown-effect":
        at = _entrance(found.where, spelling) if found.where and found.where.port else ""
        families = free_families(found, spelling)
        return (
            "No effect of the catalogue removes a material share of the gap, but a curve at one of "
            f"its ports does.{at}{f' It is {families}.' if families else ''}"
        )
    if found.verdict == "cannot-tell":
        return _unsure(found, spelling)
    if found.verdict == "ambiguous":
        return f"{_set_text(found, spelling)}{_rest_text(found, spelling)}"
    removing = [_with_share(c, spelling) for c in found.causes]
    if len(removing) == 1:
        return f"{removing[0]}{_next_family(found, spelling)}.{_rest_text(found, spelling)}"
    rest = found.remainder
    together = (
        f", together {percent_text(1.0 - rest.share)}" if rest and rest.share is not None else ""
    )
    return f"{_joined(removing, 'and')}{together}.{_rest_text(found, spelling)}"


def _no_gap(found: DiagnosisFile) -> str:
    """No gap, or none that anything known would close."""
    rest = found.remainder
    if rest is None or rest.floors is None:
        return "The refitted model is at the noise floor: no structural gap was found."
    return (
        "No structural gap was found: no effect of the catalogue, and no curve at a port, removes "
        f"a material share of what the refitted model leaves, {times_text(rest.floors)} times the "
        "noise floor."
    )


def _with_share(c: Cause, spelling: Spelling) -> str:
    """ "Play at the camera port removes 80 % of the gap (P 0.93)"."""
    share = percent_text(c.removes.share) if c.removes else "a part"
    name = f"{spelling.effect(c.effect)}{_place_of(c, spelling)}"
    ports = _joined((spelling.port(port) for port in c.or_at), "or")
    elsewhere = f", or the like at the {ports} port," if ports else ""
    return f"{name}{elsewhere} removes {share} of the gap{_chance_of(c)}"


def _place_of(c: Cause, spelling: Spelling) -> str:
    return f" at the {spelling.port(c.port)} port" if c.port and "@" not in c.effect else ""


def _chance_of(c: Cause) -> str:
    return f" (P {chance_figure(c.probability)})" if c.probability is not None else ""


def _next_family(found: DiagnosisFile, spelling: Spelling) -> str:
    """How far the next family is behind a single cause; empty where there is none."""
    own = found.causes[0]
    others = (r for r in found.ranking if r.family not in (own.family, "", *own.instead))
    rival = next((r for r in others if r.removes is not None and r.removes.share > 0.0), None)
    if rival is None or rival.removes is None:
        return ""
    share = percent_text(rival.removes.share)
    return f"; of other families {spelling.effect(rival.effect)} removes most, {share}"


def _set_text(found: DiagnosisFile, spelling: Spelling) -> str:
    names = [_with_share(c, spelling) for c in found.causes]
    if len(names) == 2:
        return f"These recordings cannot separate two causes: {names[0]}; {names[1]}."
    same = _joined((spelling.effect(c.effect) for c in found.causes), "and")
    share = found.causes[0].removes
    size = f" Each removes about {percent_text(share.share)} of the gap." if share else ""
    return f"On these recordings {same} do the same, and no data of them can separate them.{size}"


def _rest_text(found: DiagnosisFile, spelling: Spelling) -> str:
    """What remains: size and place; begins with a space."""
    rest = found.remainder
    if rest is None or rest.share is None:
        return ""
    floors = f", {times_text(rest.floors)} times the noise floor" if rest.floors else ""
    if not rest.real:
        return f" {percent_text(max(rest.share, 0.0))} of the gap remains{floors}."
    return f" {percent_text(rest.share)} of the gap remains{floors}{_entering(rest, spelling)}."


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
    return f"of the {names} family, in a form not in the catalogue"


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
    """Whether what is left is a material part of the gap."""
    return "a material part of the gap" if rest.real else "no material part of the gap"


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
    """The leader of the ranking, and why it is not named."""
    steps = [step for step in found.comparison if step.tied]
    if steps:
        names = [spelling.effect(m.effect) for m in steps[0].tied]
        share = percent_text(steps[0].tied[0].removes.share)
        return (
            f"{names[0]} removes most of the gap, {share}, but {_joined(names[1:], 'and')} do next "
            "to as well: these recordings cannot separate them."
        )
    leader = next((r for r in found.ranking if r.removes is not None), None)
    if leader is None or leader.removes is None:
        return f"These recordings do not suffice for a verdict. {RECORD_MORE}"
    removes = leader.removes
    windows = len(found.comparison[0].reference_losses) if found.comparison else 0
    interval = percents_text(removes.low, removes.high)
    return (
        f"{spelling.effect(leader.effect)} may be missing: it removes "
        f"{percent_text(removes.share)} of the gap (95 % interval {interval}), which "
        f"{windows} held-out windows do not make certain. {RECORD_MORE}"
    )


def chance_figure(probability: float) -> str:
    """As figures stand in brackets: "> 0.99"."""
    return chance_text(probability).replace("above", ">").replace("below", "<")


def _joined(parts: Iterable[str], last: str) -> str:
    words = list(parts)
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))
