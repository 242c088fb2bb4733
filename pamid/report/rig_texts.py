"""Texts of a rig's diagram and of the panels below it: share of the gap, the effects that act
there, the candidates tried, and indistinguishable ones."""

from __future__ import annotations

from pamid.model.effect import KINDS
from pamid.report import formatting
from pamid.report.block_diagram import BlockText
from pamid.report.captions import sensor_label
from pamid.report.formatting import channel_label, channel_unit, effect_label, percent, sentence
from pamid.report.formula import formula_text
from pamid.schemas.diagnosis_file import Cause, DiagnosisFile
from pamid.schemas.estimates import Estimate
from pamid.schemas.rig_map import RigMap
from pamid.verdict.verdict_words import chance_figure

PIN, DOUBT = "◆ ", "? "
_MOST_TRIED = 4


def block_texts(diagnosis: DiagnosisFile, rig: RigMap) -> dict[str, BlockText]:
    """Group of ports -> text of its block."""
    shares = _shares(diagnosis)
    unseen = set(diagnosis.where.unseen) if diagnosis.where is not None else set()
    blocks = {}
    for group in dict.fromkeys(port.group or port.port for port in rig.ports):
        share = shares.get(group)
        lines = [
            (share_line, "") for share_line in _share_lines(share, group in unseen, bool(shares))
        ]
        pins = _pins(diagnosis, group)
        lines += [(pin, "pin") for pin in pins]
        blocks[group] = BlockText(
            formatting.port_label(group),
            tuple(lines),
            max(0.0, share or 0.0),
            named=bool(pins),
        )
    return blocks


def _shares(diagnosis: DiagnosisFile) -> dict[str, float]:
    """Shares of the gap by group; none without a gap."""
    if diagnosis.where is None or diagnosis.remark or diagnosis.verdict == "no-structural-gap":
        return {}
    return {port.port: port.share for port in diagnosis.where.ports}


def _share_lines(share: float | None, unseen: bool, gap: bool) -> list[str]:
    if not gap:
        return []
    if unseen and not share:
        return ["not seen"]
    return [f"{percent(share)} of gap" if share is not None else "share unknown"]


def _pins(diagnosis: DiagnosisFile, group: str) -> list[str]:
    """Marks at this group: causes with their first value and probability, and the remainder."""
    texts = []
    either = "either " if diagnosis.verdict == "ambiguous" else ""
    for cause in diagnosis.causes:
        if cause.port == group:
            texts.append(f"{PIN}{either}{effect_label(cause.effect.partition('@')[0])}")
            texts += [pin for pin in (_first_value(cause), _chance(cause)) if pin]
    rest = diagnosis.remainder
    if rest is not None and rest.real and rest.port == group and not diagnosis.remark:
        left = f"{percent(rest.share)} left" if diagnosis.causes else "gap"
        texts.append(f"{DOUBT}{left}, unexplained")
    return texts


def _first_value(cause: Cause) -> str:
    parameter = first_parameter(cause)
    if parameter is None:
        return ""
    name, estimate = parameter
    return formatting.with_unit_text(estimate.value, channel_unit(name))


def first_parameter(cause: Cause) -> tuple[str, Estimate] | None:
    """The most informative parameter of an effect: the first that is not 0."""
    every = list(cause.parameters.items())
    return next((item for item in every if item[1].value), every[0] if every else None)


def _chance(cause: Cause) -> str:
    return "" if cause.probability is None else f"P {chance_figure(cause.probability)}"


def port_evidence_texts(diagnosis: DiagnosisFile, rig: RigMap, group: str) -> list[str]:
    """Sentences about a group of ports."""
    ports = [port for port in rig.ports if (port.group or port.port) == group]
    named = [
        f"{formatting.port_label(name.port)}"
        + (f" [{formatting.unit_label(name.unit)}]" if formatting.unit_label(name.unit) else "")
        for name in ports
    ]
    kinds = dict.fromkeys(KINDS.get(name.kind, name.kind) for name in ports)
    texts = [f"Quantity at this port: {'; '.join(kinds)} ({formatting.join(named)})."]
    texts += _alike(diagnosis, group)
    for cause in diagnosis.causes:
        if cause.port == group:
            texts.append(_cause_text(cause))
    rest = diagnosis.remainder
    if rest is not None and rest.real and rest.port == group and rest.formula:
        texts.append(
            f"The remainder here is similar to {formula_text(formatting.clean(rest.formula))}."
        )
    return [*texts, _tried(diagnosis, group)]


def _alike(diagnosis: DiagnosisFile, group: str) -> list[str]:
    where = diagnosis.where
    if where is None:
        return []
    texts = []
    others = where.inseparable_from(group)
    if others:
        order = [port.port for port in where.ports]
        named = sorted(others, key=lambda item: order.index(item) if item in order else len(order))
        ports = formatting.join(map(formatting.port_label, named), "or")
        texts.append(
            f"For an effect of unknown form these sensors cannot separate it from {ports}."
        )
    split = next(
        (sensor.sensor for sensor in where.sensors if any(group in g for g in sensor.splits)), None
    )
    if split is not None:
        texts.append(f"Measuring {sensor_label(split)} as well would separate them.")
    if group in where.unseen:
        texts.append("These sensors do not respond to this port.")
    return texts


def _cause_text(cause: Cause) -> str:
    values = [
        f"{channel_label(name)} "
        f"{formatting.with_interval(size.value, size.low, size.high, channel_unit(name))}"
        for name, size in cause.parameters.items()
    ]
    text = f"{effect_label(cause.effect)} acts here"
    if cause.probability is not None:
        text += f", with probability {formatting.chance(cause.probability)}"
    if cause.removes is not None:
        text += f": it removes {percent(cause.removes.share)} of the gap"
    return sentence(text + (f"; {formatting.join(values)}" if values else ""))


def _tried(diagnosis: DiagnosisFile, group: str) -> str:
    tried = [
        candidate
        for candidate in diagnosis.ranking
        if candidate.port == group and candidate.shrinkage is not None
    ]
    if not tried:
        return "No candidate at this port was promising enough for a refit."
    shown = [
        f"{effect_label(other.effect)} ({percent(other.shrinkage)})"
        for other in tried[:_MOST_TRIED]
    ]
    more = f" and {len(tried) - len(shown)} more" if len(tried) > len(shown) else ""
    return (
        "Refitted here, with the share of the held-out error over all channels that each removes: "
        f"{', '.join(shown)}{more}."
    )
