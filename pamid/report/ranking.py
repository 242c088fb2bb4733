"""Every refitted candidate: its errors, its parameters, and the reason against it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pamid.report import formatting
from pamid.report.document import Table, TableCell, table
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    number,
    percent,
    percent_span,
)
from pamid.schemas.diagnosis_file import Candidate, DiagnosisFile

_CLOSE = 0.02  # shares that differ by less say nothing


def ranking_table(
    diagnosis: DiagnosisFile, places: Mapping[str, str] = MappingProxyType({})
) -> Table:
    """Every candidate that was refitted, best first, with its errors per channel. places: by
    effect, the figure of the page that its row leads to."""
    channels = list(
        dict.fromkeys(name for candidate in diagnosis.ranking for name in candidate.held_out)
    )
    heads = ["effect", "family", "port", "P", "held-out error removed", formatting.INTERVAL]
    heads += [f"{channel_label(name)} MAE [{channel_unit(name) or '-'}]" for name in channels]
    body: list[list[str | TableCell]] = []
    for candidate in diagnosis.ranking:
        row: list[str | TableCell] = [
            TableCell(
                formatting.clean(candidate.effect), "code", place=places.get(candidate.effect, "")
            ),
            effect_label(candidate.family),
            formatting.port_label(candidate.port),
            number(candidate.probability, 2),
            percent(candidate.shrinkage),
            percent_span(candidate.low, candidate.high),
        ]
        for name in channels:
            held = candidate.held_out.get(name)
            row.append(
                formatting.DASH
                if held is None or held.mae_after is None
                else f"{number(held.mae_before)} → {number(held.mae_after)}"
            )
        body.append(row)
    return table(heads, body, range(3, 6 + len(channels)))


def rivals_table(diagnosis: DiagnosisFile) -> Table:
    """Every candidate with the parameters it was given, and why it is not the answer."""
    body: list[list[str | TableCell]] = [
        [
            TableCell(formatting.clean(candidate.effect), "code"),
            TableCell(_parameters(candidate), small=_bounds(candidate)),
            why_not(candidate, diagnosis),
        ]
        for candidate in diagnosis.ranking
    ]
    return table(["effect", "its parameters", "why it is not the answer"], body)


def _parameters(candidate: Candidate) -> str:
    texts = [
        f"{channel_label(name)} {formatting.with_unit_text(estimate.value, channel_unit(name))}"
        for name, estimate in candidate.parameters.items()
    ]
    return "; ".join(texts) or formatting.DASH


def _bounds(candidate: Candidate) -> str:
    return (
        f"at its bound: {', '.join(map(channel_label, candidate.at_bound))}"
        if candidate.at_bound
        else ""
    )


def why_not(candidate: Candidate, diagnosis: DiagnosisFile) -> str:
    """Reason why a candidate was not chosen, from its figures."""
    named = {cause.effect for cause in diagnosis.causes}
    if candidate.effect in named:
        return "is named"
    if not candidate.converged:
        return formatting.not_converged("its fit", candidate.why)
    if candidate.shrinkage is None:
        return formatting.clean(candidate.why) or "was not refitted"
    reasons = list(candidate.set_aside)
    if candidate.effect in diagnosis.tied and named:
        reasons.append("these recordings cannot separate it from the first")
    if candidate.low is not None and candidate.low <= 0.0:
        reasons.append("its gain is not sure: the interval reaches 0")
    best = next((each for each in diagnosis.ranking if each.effect in named), None)
    if best is not None and (best.shrinkage or 0.0) - candidate.shrinkage > _CLOSE:
        reasons.append(
            f"removes {percent(candidate.shrinkage)} where {effect_label(best.effect)} removes "
            f"{percent(best.shrinkage)}"
        )
    if candidate.at_bound:
        reasons.append("needs a value at its bound")
    if not reasons and candidate.probability is not None:
        reasons.append(f"is there with probability {formatting.chance(candidate.probability)}")
    return "; ".join(reasons) or formatting.DASH
