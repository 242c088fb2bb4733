"""Does a diagnosis contradict itself? Verdict, causes, remainder, ports and sentence have to say
the same, whatever the figures are."""

from __future__ import annotations

from collections.abc import Iterator

from pamid.diagnosis.decision import is_material, is_ordinary_bend, is_sure
from pamid.diagnosis.judgement import calibration
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.verdict_words import MEASURE_MAP, RECORD_MORE
from pamid.schemas.diagnosis_file import CAUSED, BestMember, Cause, DiagnosisFile

#: how a note on it begins, in the file itself
CONTRADICTS = "This result contradicts itself"


def inconsistencies(found: DiagnosisFile, settings: Settings = DEFAULT) -> list[str]:
    """What contradicts what, in words; empty where nothing does."""
    return [
        *_verdict(found),
        *(
            f"{cause.effect}: {why}"
            for cause in found.causes
            for why in _cause(found, cause, settings)
        ),
        *(
            f"{m.effect} is probable (P {m.probability:.2f}) and nothing here speaks against it, "
            "but it is not named"
            for m, why in unnamed(found, settings)
            if not why
        ),
        *_decided(found, settings),
        *_where(found),
        *_sentence(found),
    ]


def unnamed(
    found: DiagnosisFile, settings: Settings = DEFAULT
) -> list[tuple[BestMember, list[str]]]:
    """Probable effects of the best model, and found beside it, that the verdict does not name, and
    what speaks against each."""
    if found.remark or found.verdict in ("ambiguous", "no-structural-gap"):
        return []
    named, yes = {c.effect for c in found.causes}, calibration().lines["cause"].yes
    return [
        (m, list(_cause(found, m, settings)))
        for m in _weighed(found)
        if m.effect not in named and m.probability is not None and m.probability >= yes
    ]


def _weighed(found: DiagnosisFile) -> tuple[BestMember, ...]:
    return (*found.members, *found.dropped)


def _verdict(found: DiagnosisFile) -> Iterator[str]:
    """The word follows from causes and remainder."""
    verdict, rest = found.verdict, found.remainder
    named = len(found.causes)
    if (verdict in CAUSED) != bool(named):
        yield f"the verdict is {verdict}, with {named} causes"
    if len({c.effect for c in found.causes}) < named:
        yield "a cause stands twice"
    if verdict == "ambiguous" and len({c.family for c in found.causes}) < 2:
        yield "the verdict is ambiguous, and the causes are of one family"
    if verdict in ("partly-explained", "unknown-effect") and (rest is None or not rest.real):
        yield f"the verdict is {verdict}, and nothing real remains"
    if verdict in ("explained", "no-structural-gap") and rest is not None and rest.real:
        yield f"the verdict is {verdict}, and what remains is real"
    if rest is not None and rest.port and not rest.real:
        yield "what remains is not real, and enters at a port"
    if found.unknown is not None and verdict != "unknown-effect":
        yield f"the verdict is {verdict}, and an unknown effect is described"
    if found.remark and verdict != "cannot-tell":
        yield f"the verdict is {verdict}, and a remark says that nothing can be said"


def _cause(found: DiagnosisFile, cause: Cause | BestMember, settings: Settings) -> Iterator[str]:
    """What may not be said of a cause (`pamid.diagnosis.decision.Weighed.objections`)."""
    own = [m.signature for m in _weighed(found) if m.effect == cause.effect] or [
        c.signature for c in found.ranking if c.effect == cause.effect
    ]
    of_left = max((one.of_left or 0.0 for one in own if one is not None), default=0.0)
    if cause.probability is None:
        yield "a cause without a probability"
    if cause.removes is None:
        yield "it is not told what it removes"
    elif cause.removes.low <= 0.0:
        yield "the interval of what it removes goes through zero"
    elif not is_material(cause.removes.share, of_left, settings):
        yield "it removes next to nothing"
    if any(one is not None and (one.bounds or 0.0) > 0.0 for one in own):
        yield "a parameter ended at a bound that physics did not set"
    bent = [m.bent for m in _weighed(found) if m.effect == cause.effect]
    if any(is_ordinary_bend(one, settings) for one in bent):
        yield "it bends what passes its port by no more than ordinary machines do"
    if any(m.again for m in _weighed(found) if m.effect == cause.effect):
        yield "it does what a parameter of the rig does"
    where = found.where
    if where is None or not where.ports:
        return
    together = {cause.port} | where.not_told_from(cause.port)
    # an effect at several ports together is reported at what their names have in common
    here = [one for one in where.ports if one.port in together or one.port.startswith(cause.port)]
    evidence = max((one.at_port or 0.0 for one in own if one is not None), default=0.0)
    sure = max(
        (min(one.sure or 0.0, one.lead_sure or 0.0) for one in own if one is not None), default=0.0
    )
    plain = cause.removes is not None and is_sure(cause.removes.low, sure, settings)
    if max(sum(one.share for one in here), evidence) < settings.port_negligible and not plain:
        yield "next to nothing of the gap enters at its port"


def _decided(found: DiagnosisFile, settings: Settings) -> Iterator[str]:
    """What is left counts as more than noise and tolerances where it is above the floor and its
    probability or the latent evidence reaches its line, and nowhere else."""
    rest = found.remainder
    if rest is None or found.remark or rest.probable_from is None or rest.plain_from is None:
        return
    enough = (rest.probability or 0.0) >= rest.probable_from or (
        rest.evidence or 0.0
    ) >= rest.plain_from
    above = (rest.floors or 0.0) >= 1.0 + settings.gap_margin
    if rest.real and not (enough and above):
        yield "what is left counts as more than noise and tolerances, and neither line is reached"
    elif not rest.real and enough and above:
        yield "what is left does not count as more than noise and tolerances, and a line is reached"


def _where(found: DiagnosisFile) -> Iterator[str]:
    """The port that is named is the first cause's, or the one with the largest share, or one that
    the sensors cannot tell from it."""
    where, rest = found.where, found.remainder
    if where is None or not where.ports:
        return
    if found.causes:
        if where.port not in {cause.port for cause in found.causes}:
            yield f"the gap is said to enter at {where.port}, where no cause acts"
        return
    largest = max(one.share for one in where.ports)
    together = {where.port} | where.not_told_from(where.port)
    own = max((one.share for one in where.ports if one.port in together), default=0.0)
    if own < largest * (1.0 - 1e-9):
        yield f"the gap is said to enter at {where.port}, and more of it enters elsewhere"
    if rest is not None and rest.port not in ("", where.port):
        yield f"what remains is the gap, and enters at {rest.port} instead of {where.port}"


def _sentence(found: DiagnosisFile) -> Iterator[str]:
    """It names what the verdict names, and says what to record where nothing can be said."""
    lacking = [cause.effect for cause in found.causes if cause.effect not in found.sentence]
    if lacking:
        yield f"the sentence does not name {', '.join(lacking)}"
    if not found.causes and "with the cause" in found.sentence:
        yield "the sentence speaks of a cause, and there is none"
    said = any(advice in found.sentence for advice in (RECORD_MORE, MEASURE_MAP))
    advised = found.remark or found.next_experiment or said
    if found.verdict == "cannot-tell" and not advised:
        yield "nothing can be told, and it is not said what to check or to record"
