"""Verdict in words: the first sentence of terminal, page and JSON, and its parts.

It needs only diagnosis.json. A `Spelling` sets how names of effects and ports are written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from pamid.base.errors import join_words
from pamid.base.schemas.diagnosis_file import Cause, DiagnosisFile, Remainder, Where
from pamid.base.share_words import chance_text, percent_text, percents_text, times_text

RECORD_MORE = "Record for longer, or with larger excitation."
#: an immaterial remainder above this many noise floors may contain smaller effects
LEAST_FLOORS = 10.0
LOOK_FURTHER = "smaller effects may remain: add the named effects to the rig, then diagnose again"
NOT_IN_CATALOGUE = "No effect of the catalogue removes a material share of the gap."


@dataclass(frozen=True)
class Spelling:
    """Functions that write the names of effects and ports."""

    effect: Callable[[str], str] = str
    port: Callable[[str], str] = str


AS_IN_FILE = Spelling()


def sentence(diagnosis: DiagnosisFile, spelling: Spelling = AS_IN_FILE) -> str:
    """Verdict in a few sentences: shares first, then doubts about the recordings. A remark of the
    diagnosis replaces the verdict."""
    doubts = (
        f" First correct the recording: {' '.join(diagnosis.doubts)}" if diagnosis.doubts else ""
    )
    return f"{_verdict_text(diagnosis, spelling)}{doubts}"


def _verdict_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    if diagnosis.remark:
        return diagnosis.remark
    if diagnosis.verdict == "no-structural-gap":
        return _no_gap_text(diagnosis)
    if diagnosis.verdict == "unknown-effect":
        return f"{NOT_IN_CATALOGUE} {_curve_text(diagnosis, spelling)}"
    if diagnosis.verdict == "cannot-tell":
        return _undecided_text(diagnosis, spelling)
    if diagnosis.verdict == "ambiguous":
        return f"{_set_text(diagnosis, spelling)}{_rest_text(diagnosis, spelling)}"
    if len(diagnosis.causes) > 1:
        return f"{_joint_text(diagnosis, spelling)}{_rest_text(diagnosis, spelling)}"
    removing = _share_text(diagnosis, findings_of(diagnosis)[0], spelling)
    return f"{removing}.{_next_family_text(diagnosis, spelling)}{_rest_text(diagnosis, spelling)}"


def _no_gap_text(diagnosis: DiagnosisFile) -> str:
    """Text for no gap, or for a gap that no known effect or curve closes."""
    rest = diagnosis.remainder
    if rest is None or rest.floors is None:
        return "The refitted model is at the noise floor: no structural gap was found."
    return (
        "No structural gap was found. The refitted model leaves "
        f"{times_text(rest.floors)} times the noise floor. No effect and no curve at a port "
        "removes a material share of this error."
    )


def _curve_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """Text for a gap without a named effect: nonparametric curve, its family, port and share."""
    forms = diagnosis.unknown.free_forms if diagnosis.unknown is not None else ()
    if not forms:
        at = (
            _entry_port(diagnosis.where, spelling)
            if diagnosis.where and diagnosis.where.port
            else ""
        )
        return f"A curve at any of the ports does.{at}"
    share = percent_text(forms[0].removes.share) if forms[0].removes else "a material share"
    first, *others = dict.fromkeys(spelling.port(form.port) for form in forms)
    elsewhere = f", or equally at the {join_words(others, 'or')} port," if others else ""
    return (
        f"A curve at the {first} port{elsewhere} removes {share} of it. The effect is "
        f"{free_families(diagnosis, spelling)}."
    )


#: causes with the same effect, at any number of ports
Finding: TypeAlias = tuple[Cause, ...]


def findings_of(diagnosis: DiagnosisFile) -> list[Finding]:
    """Group the causes by effect, because an effect may act at several ports."""
    effects: dict[str, list[Cause]] = {}
    for c in diagnosis.causes:
        effects.setdefault(_effect_name(c), []).append(c)
    return [tuple(causes) for causes in effects.values()]


def _effect_name(c: Cause) -> str:
    return c.effect.partition("@")[0]


def _share_text(diagnosis: DiagnosisFile, finding: Finding, spelling: Spelling) -> str:
    """Text such as "play at the camera port removes 80 % of the gap (P 0.93)"."""
    first = finding[0]
    share = percent_text(first.removes.share) if first.removes else "a part"
    name = finding_text(diagnosis, finding, spelling)
    return f"{name} removes {share} of the gap{_probability_text(first)}"


def finding_label(
    diagnosis: DiagnosisFile, finding: Finding, spelling: Spelling = AS_IN_FILE
) -> str:
    """Label such as "play", "friction in the joints" or "friction at shoulder and wrist"."""
    first = finding[0]
    if len(finding) == 1:
        return spelling.effect(first.effect)
    return f"{spelling.effect(_effect_name(first))} {_places_text(diagnosis, finding, spelling)}"


def finding_text(
    diagnosis: DiagnosisFile, finding: Finding, spelling: Spelling = AS_IN_FILE
) -> str:
    """Text such as "play at the camera port", with other ports at which the effect fits equally."""
    first, label = finding[0], finding_label(diagnosis, finding, spelling)
    if len(finding) > 1:
        return label
    unplaced = first.port and "@" not in first.effect
    place = f" at the {spelling.port(first.port)} port" if unplaced else ""
    ports = join_words((spelling.port(port) for port in first.or_at), "or")
    elsewhere = f" (or equally at the {ports} port)" if ports else ""
    return f"{label}{place}{elsewhere}"


def _places_text(diagnosis: DiagnosisFile, finding: Finding, spelling: Spelling) -> str:
    """Ports of an effect; "in the joints" if these are all motion ports with a torque."""
    ports = {c.port for c in finding}
    mapped = diagnosis.rig.ports if diagnosis.rig is not None else ()
    joints = {q.group or q.port for q in mapped if q.kind == "motion" and q.unit == "N m"}
    if ports == joints:
        return "in the joints"
    return f"at {join_words(spelling.port(c.port) for c in finding)}"


def _probability_text(c: Cause) -> str:
    return f" (P {chance_figure(c.probability)})" if c.probability is not None else ""


def _next_family_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """Sentence about the best effect of another family than the only cause, or "". It begins with a
    space."""
    cause = diagnosis.causes[0]
    others = (
        r
        for r in diagnosis.ranking
        if r.family not in (cause.family, "", *cause.instead) and not r.set_aside
    )
    rival = next((r for r in others if r.removes is not None and r.removes.share > 0.0), None)
    if rival is None or rival.removes is None:
        return ""
    share = percent_text(rival.removes.share)
    rival_effect = shortened(rival.effect, spelling.effect)
    return f" The best of another family, {rival_effect}, removes {share}."


def shortened(effect: str, spell: Callable[[str], str] = str) -> str:
    """Text such as "gravity@arm_1 and 5 more ports" for an effect at more than two ports."""
    first, *more = effect.split(" + ")
    same = all(part.partition("@")[0] == first.partition("@")[0] for part in more)
    return f"{spell(first)} and {len(more)} more ports" if same and len(more) > 1 else spell(effect)


def _joint_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """Share that several causes remove together, and the shares without each of them.

    Shares of single causes do not add up, because two causes may each remove the same part.
    """
    findings = findings_of(diagnosis)
    causes = join_words(
        f"{finding_text(diagnosis, k, spelling)}{_probability_text(k[0])}" for k in findings
    )
    together = " together" if len(findings) > 1 else ""
    rest = diagnosis.remainder
    if rest is None or rest.share is None:
        return f"{causes} act{together or 's'}."
    total = 1.0 - rest.share
    verb = "remove" if together else "removes"
    text = f"{causes}{together} {verb} {percent_text(total)} of the gap"
    without = {c.effect: total - c.removes.share for c in diagnosis.causes if c.removes}
    if max(without.values(), default=0.0) <= 0.0:
        return f"{text}. If a cause is left out, the others remove no part of the gap."
    # the most important cause first: without it the removed share is smallest
    shares = (
        f"without {spelling.effect(effect)} {percent_text(max(share, 0.0))}"
        for effect, share in sorted(without.items(), key=lambda item: item[1])
    )
    return f"{text}, {join_words(shares)}."


def _set_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """Members of the confidence set: two with their shares, more as a group."""
    findings = findings_of(diagnosis)
    if len(findings) == 2:
        first, other = findings
        share = f", {percent_text(other[0].removes.share)}" if other[0].removes else ""
        return (
            f"{_share_text(diagnosis, first, spelling)}. These recordings cannot separate it from "
            f"{finding_text(diagnosis, other, spelling)}{share}{_probability_text(other[0])}."
        )
    names = join_words(finding_label(diagnosis, k, spelling) for k in findings)
    removes = diagnosis.causes[0].removes
    size = f" Each removes about {percent_text(removes.share)} of the gap." if removes else ""
    return f"On these recordings {names} predict the same and cannot be separated.{size}"


def _rest_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """Sentences on the size and place of the remainder, or "". They begin with a space."""
    rest = diagnosis.remainder
    if rest is None or rest.share is None:
        return ""
    floors = f", and the error is {_floors_text(rest.floors)}" if rest.floors is not None else ""
    remains = f" {percent_text(max(rest.share, 0.0))} of the gap remains{floors}."
    if not rest.real:
        return remains
    at = f" It enters at the {spelling.port(rest.port)} port" if rest.port else ""
    family = f"a curve of the {spelling.effect(rest.family)} family removes it"
    if not rest.family:
        return f"{remains}{at}." if at else remains
    return f"{remains}{at}, where {family}." if at else f"{remains} There {family}."


def _floors_text(floors: float) -> str:
    """Text such as "3.7 times the noise floor" or "at the noise floor"."""
    times = times_text(max(floors, 1.0))
    return "at the noise floor" if times == "1" else f"{times} times the noise floor"


def free_families(diagnosis: DiagnosisFile, spelling: Spelling = AS_IN_FILE) -> str:
    """Text such as "of the friction family, in a form that is not in the catalogue", or ""."""
    forms = diagnosis.unknown.free_forms if diagnosis.unknown is not None else ()
    if not forms:
        return ""
    names = join_words(
        (spelling.effect(family) for family in dict.fromkeys(f.family for f in forms)), "or"
    )
    return f"of the {names} family, in a form that is not in the catalogue"


def size_of(rest: Remainder, *, with_causes: bool) -> str:
    """Size of the remainder, such as "36 % of the gap (95 % interval 30 to 42 %), 1.4 times the
    noise floor in the worst channel". with_causes: False if the remainder is the whole gap."""
    texts = []
    if with_causes and rest.share is not None:
        text = f"{percent_text(rest.share)} of the gap"
        if rest.low is not None and rest.high is not None and rest.low < rest.high:
            text += f" (95 % interval {percents_text(rest.low, rest.high)})"
        texts.append(text)
    if rest.floors is not None:
        texts.append(f"{_floors_text(rest.floors)} in the worst channel")
    return ", ".join(texts)


def amount_of(rest: Remainder) -> str:
    """Size of the missing part and of the total value at the port, in its unit, or ""."""
    if rest.missing_rms is None or not rest.passing_rms:
        return ""
    share = rest.missing_rms / rest.passing_rms
    size = f"{percent_text(share)} of" if share < 1.0 else f"{times_text(share)} times"
    unit = f" {rest.unit}" if rest.unit else ""
    return (
        f"the missing value is an estimated {rest.missing_rms:.3g}{unit} rms, {size} the "
        f"{rest.passing_rms:.3g}{unit} total"
    )


def advice_of(rest: Remainder) -> str:
    """Advice about smaller effects in an immaterial remainder; "" if it is near the noise floor."""
    return "" if rest.real or (rest.floors or 0.0) < LEAST_FLOORS else LOOK_FURTHER


def _entry_port(where: Where, spelling: Spelling) -> str:
    """Port at which the gap enters, and inseparable ports whose share is at least as large."""
    shares = {item.port: item.share for item in where.ports}
    port_share = shares.get(where.port, 0.0)
    inseparable = where.inseparable_from(where.port)
    others = sorted(port for port in inseparable if shares.get(port, 0.0) >= port_share > 0.0)
    first = f" It enters at the {spelling.port(where.port)} port"
    if not others:
        return f"{first}."
    other_ports = join_words([spelling.port(p) for p in others], "or")
    return f"{first}, or at {other_ports}: these sensors cannot separate them."


def _undecided_text(diagnosis: DiagnosisFile, spelling: Spelling) -> str:
    """First candidate of the ranking, and the reason why it is not named."""
    tied = diagnosis.comparison[0].tied if diagnosis.comparison else ()
    if len(tied) > 1:
        first, *others = (spelling.effect(m.effect) for m in tied)
        return (
            f"{first} removes {percent_text(tied[0].removes.share)} of the gap, but "
            f"{join_words(others)} remove as much. These recordings cannot separate them."
        )
    leader = next((r for r in diagnosis.ranking if r.removes and not r.set_aside), None)
    rest = diagnosis.remainder
    no_effect_helps = leader is None or leader.removes is None or leader.removes.low <= 0.0
    if no_effect_helps and rest is not None and rest.floors is not None:
        return (
            f"The refitted model leaves {times_text(rest.floors)} times the noise floor. No effect "
            "of the catalogue and no curve at a port removes a material share of this error. "
            "Another effect may be missing, or a map or a parameter may be very wrong."
        )
    if leader is None or leader.removes is None:
        return f"These recordings do not suffice for a verdict. {RECORD_MORE}"
    removes = leader.removes
    interval = percents_text(removes.low, removes.high)
    windows = len(diagnosis.comparison[0].reference_losses) if diagnosis.comparison else 0
    sample_size = f", from {windows} held-out windows" if windows else ""
    return (
        f"{spelling.effect(leader.effect)} may be missing. It removes "
        f"{percent_text(removes.share)} of the gap (95 % interval {interval}{sample_size}), which "
        f"is not certain enough. {RECORD_MORE}"
    )


def chance_figure(probability: float) -> str:
    """Probability as written in brackets, such as "> 0.99"."""
    return chance_text(probability).replace("above", ">").replace("below", "<")
