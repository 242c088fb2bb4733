"""A verdict in words: the sentence that opens terminal, page and JSON, and the remark that goes
before it where nothing can be said."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.diagnosis.tournament import Diagnosis
from pamid.schemas.diagnosis_file import Cause, Remainder


def remark(d: Diagnosis) -> str:
    """What is wrong with the recordings, or with how they were read, where no verdict on the model
    means anything."""
    units = d.judged.units if d.judged else None
    if units and (units["slips"] or not d.empty):
        channel, share = max(units["error_over_spread"].items(), key=lambda pair: pair[1])
        return (
            f"The refitted model misses {channel} by {share:.2g} times what it moves. "
            f"{units['advice']}"
        )
    if not d.empty:
        return ""
    return (
        "The recordings show nothing that this model could have made of its input: it predicts "
        "them no better than their own mean or a straight line does. Check that every column is "
        "the channel that it is named after, that all were recorded together on one clock, and "
        "that the input acted on the rig."
    )


def sentence(d: Diagnosis, causes: Sequence[Cause], rest: Remainder | None, port: str) -> str:
    """The verdict in one sentence; a remark goes before it. port: where most of the gap enters."""
    if said := remark(d):
        return said
    if d.verdict == "no-structural-gap":
        return (
            "Nothing beyond retuned parameters and ordinary tolerances: no structural gap was "
            "found."
        )
    if d.verdict == "unknown-effect":
        where = rest.port if rest and rest.port else port
        at = f" It enters at the {where}." if where else ""
        return (
            "Something material is missing from the model, and no effect of the catalogue "
            f"explains it.{at}"
        )
    if d.verdict == "cannot-tell" or rest is None:
        return _unsure(d)
    share = _percent(1.0 - (rest.share or 0.0))
    if d.verdict == "ambiguous":
        names = " or ".join(_with_chance(c) for c in causes)
        return (
            f"{names} explains {share} of the gap: these recordings cannot tell them apart."
            f"{_left(rest, 'The rest')}"
        )
    names = " and ".join(_with_chance(c) for c in causes)
    verb = "explains" if len(causes) == 1 else "explain"
    if not rest.real:
        return f"{names} {verb} {share} of the gap; what remains is within noise and tolerances."
    at = f", at the {rest.port}" if rest.port else ""
    return f"{names} {verb} {share} of the gap; {_percent(rest.share or 0.0)} remain{at}."


def _left(rest: Remainder, subject: str) -> str:
    return (
        f" {subject}, {_percent(rest.share or 0.0)}, is more than tolerances." if rest.real else ""
    )


def _unsure(d: Diagnosis) -> str:
    """A probable cause that the held-out windows do not confirm."""
    assert d.judged is not None
    m = max(d.judged.members, key=lambda m: m.probability)
    return (
        f"{m.effect.label} may be missing (P {m.probability:.2f}), but the held-out windows do not "
        f"suffice to confirm it: it removes {_percent(m.removes.share)} of the gap "
        f"({100.0 * m.removes.low:.0f} to {_percent(m.removes.high)}). Record for longer, or with "
        "larger motion."
    )


def _with_chance(c: Cause) -> str:
    place = "" if "@" in c.effect else f" at the {c.port}"
    return f"{c.effect}{place} (P {c.probability:.2f})"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
