"""The three answers at a glance: a card each, and one line with the next step."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.base.share_words import minutes_text
from pamid.checks.sampling_slips import OF_THE_LOG
from pamid.report import formatting
from pamid.report.added_variable_figure import added_leaders
from pamid.report.captions import SPELLING, added_line, closest, regime_label, set_figures
from pamid.report.channel_errors import ChannelErrors, headline
from pamid.report.document import AnswerCard
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    percent,
    port_label,
    sentence,
)
from pamid.report.load import RunData
from pamid.report.rig_texts import first_parameter
from pamid.schemas.added_variables_file import AddedVariable
from pamid.schemas.diagnosis_file import Cause, DiagnosisFile
from pamid.verdict import verdict_words
from pamid.verdict.verdict_words import chance_figure

_MOST_PORTS, _MOST_CAUSES, _NOTHING = 3, 3, 0.005


def cards_of(run: RunData, rows: tuple[ChannelErrors, ...]) -> tuple[AnswerCard, ...]:
    """Where, which, how far; of a run that was not diagnosed how far refitting leads."""
    if run.diagnosis is None:
        return (_how_far_card(None, rows),) if rows else ()
    return (
        _where_card(run.diagnosis),
        _which_card(run.diagnosis, added_leaders(run)),
        _how_far_card(run.diagnosis, rows),
    )


def todo_of(run: RunData) -> str:
    """The next step, in one line."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return "Find the cause: `pamid diagnose` on the same recordings."
    if diagnosis.remark:
        return "First check the recordings and their units; before that no verdict is valid."
    if any(OF_THE_LOG in note for note in diagnosis.notes):
        return (
            "Correct the order of the log's rows, as in the notes, and diagnose again before "
            "you measure more."
        )
    experiment = diagnosis.next_experiment
    if experiment is None and diagnosis.withheld:
        return (
            "Record again in closed loop: in open loop every experiment leaves the recorded range."
        )
    if experiment is None:
        return "This answer needs no further measurement."
    text = f"run the experiment “{effect_label(experiment.name)}”"
    if experiment.minutes is not None:
        text += f" ({set_spaces(minutes_text(experiment.minutes))} at the rig)"
    if experiment.separates:
        text += f"; it separates {formatting.join(map(effect_label, experiment.separates))}"
    return sentence(text)


def set_spaces(text: str) -> str:
    """A figure and its unit stay on one line."""
    return text.replace(" ", formatting.SPACE)


# ---- where ---------------------------------------------------------------------------------------


def _where_card(diagnosis: DiagnosisFile) -> AnswerCard:
    where = diagnosis.where
    if diagnosis.remark:
        return AnswerCard("Where", "Undetermined", ("Check the recordings first.",), "where", True)
    if diagnosis.verdict == "no-structural-gap":
        return AnswerCard("Where", "Nowhere", ("There is no gap.",), "where", True)
    if where is None or not (where.port or where.ports):
        return AnswerCard("Where", "Undetermined", ("The diagnosis names no port.",), "where", True)
    shares = {item.port: item.share for item in where.ports}
    named = _named_ports(diagnosis) or [max(shares, key=lambda item: shares[item])]
    lead = formatting.join(_with_share(name, shares) for name in named)
    others = [
        _with_share(port, shares)
        for port, share in sorted(shares.items(), key=lambda item: -item[1])
        if port not in named and share >= _NOTHING
    ][:_MOST_PORTS]
    lines = [f"of the gap enters here{f'; {formatting.join(others)}' if others else ''}"]
    alike = _alike(diagnosis)
    if alike:
        lines.append(
            f"cannot be separated from {formatting.join(map(port_label, alike), 'or')} yet"
        )
    if where.regimes and where.regimes[0].share_of_gap is not None:
        best = where.regimes[0]
        lines.append(
            f"{percent(best.share_of_gap)} of it in {percent(best.share_of_time)} of the time: "
            f"{regime_label(best)}"
        )
    return AnswerCard("Where", lead, tuple(lines), "where")


def _named_ports(diagnosis: DiagnosisFile) -> list[str]:
    if diagnosis.causes:
        return [port for port in dict.fromkeys(cause.port for cause in diagnosis.causes) if port]
    return [diagnosis.where.port] if diagnosis.where is not None and diagnosis.where.port else []


def _with_share(port: str, shares: dict[str, float]) -> str:
    name = port_label(port)
    return f"{name} {percent(shares[port])}" if port in shares else name


def _alike(diagnosis: DiagnosisFile) -> list[str]:
    """Ports that cannot be separated from the named one, by a cause's form or by the sensors."""
    where = diagnosis.where
    if where is None:
        return []
    if diagnosis.causes and diagnosis.verdict != "ambiguous":
        return sorted({port for cause in diagnosis.causes for port in cause.or_at})
    return sorted(where.inseparable_from(where.port))


# ---- which ---------------------------------------------------------------------------------------


def _which_card(diagnosis: DiagnosisFile, plots: Sequence[AddedVariable]) -> AnswerCard:
    if diagnosis.remark:
        lines = ("Check the recordings first.",)
        return AnswerCard("Which", "Undetermined", lines, "which", True)
    if diagnosis.verdict == "cannot-tell":
        return AnswerCard("Which", "Undetermined", _best_guess(diagnosis), "which", True)
    if diagnosis.verdict == "no-structural-gap":
        lines = ("Refitted parameters and ordinary tolerances suffice.",)
        return AnswerCard("Which", "No effect", lines, "which", True)
    if diagnosis.verdict == "unknown-effect" or not diagnosis.causes:
        families = verdict_words.free_families(diagnosis, SPELLING)
        first = sentence(families) if families else "No effect of the catalogue explains it."
        closest_too = (first, *_closest_line(diagnosis))
        return AnswerCard("Which", "None of the catalogue", closest_too, "which")
    last = "or" if diagnosis.verdict == "ambiguous" else "and"
    shown = diagnosis.causes[:_MOST_CAUSES]
    lead = formatting.join(map(_with_value, shown), last)
    figures = [_cause_line(entry, len(shown) > 1) for entry in shown]
    if plots:
        named = f"{effect_label(plots[0].effect)} " if len(shown) > 1 else ""
        figures.append(named + added_line(plots[0]))
    return AnswerCard(
        "Which",
        sentence(lead).removesuffix("."),
        tuple(filter(None, figures)),
        "which",
    )


def _best_guess(diagnosis: DiagnosisFile) -> tuple[str, ...]:
    best = next(
        (candidate for candidate in diagnosis.ranking if candidate.removes is not None), None
    )
    if best is None or best.probability is None:
        return ("These recordings do not suffice.",)
    share = percent(best.removes.share) if best.removes is not None else "a part"
    return (
        f"{effect_label(best.effect)} may be missing: removes {share} of the gap "
        f"(P {chance_figure(best.probability)}).",
    )


def _closest_line(diagnosis: DiagnosisFile) -> tuple[str, ...]:
    """Closest candidate, with the evidence for it."""
    best = closest(diagnosis)
    if best is None or best.probability is None or best.shrinkage is None:
        return ()
    return (
        f"closest: {effect_label(best.effect)}, removes {percent(best.shrinkage)} of the held-out "
        f"error, P {chance_figure(best.probability)}",
    )


def _with_value(cause: Cause) -> str:
    name = effect_label(cause.effect)
    parameter = first_parameter(cause)
    if parameter is None:
        return name
    unit_text = channel_unit(parameter[0])
    value = set_spaces(formatting.with_unit_text(parameter[1].value, unit_text))
    # a number without unit says nothing without its name
    return f"{name} {value}" if unit_text else f"{name}, {channel_label(parameter[0])} {value}"


def _cause_line(cause: Cause, several: bool) -> str:
    parts = []
    if cause.removes is not None:
        parts.append(f"removes {percent(cause.removes.share)} of the gap")
    if cause.probability is not None:
        parts.append(f"P {chance_figure(cause.probability)}")
    parameter = first_parameter(cause)
    if parameter is not None and None not in (parameter[1].low, parameter[1].high):
        span = formatting.span(parameter[1].low, parameter[1].high, channel_unit(parameter[0]))
        parts.append(f"{channel_label(parameter[0])} {span}")
    text = ", ".join(parts)
    return f"{effect_label(cause.effect)}: {text}" if several and text else text


# ---- how far -------------------------------------------------------------------------------------


def _how_far_card(diagnosis: DiagnosisFile | None, rows: tuple[ChannelErrors, ...]) -> AnswerCard:
    row = headline(rows)
    if row is None:
        return AnswerCard("How far", "Not scored", (), "how-far", True)
    unit_text, what = channel_unit(row.channel), channel_label(row.channel)
    steps = [error for error in (row.refitted, row.with_cause) if error is not None]
    if row.with_cause is None and row.data_sheet is not None and row.refitted is not None:
        steps = [row.data_sheet, row.refitted]
    lead = formatting.in_one_unit(steps, unit_text, " → ")
    names = "refitted → with the cause" if row.with_cause is not None else "data sheet → refitted"
    lines = [f"held-out {what} error, {names}"]
    known = []
    if row.with_cause is not None and row.data_sheet is not None:
        known.append(f"data sheet {formatting.with_unit_text(row.data_sheet, unit_text)}")
    if row.noise_floor is not None:
        known.append(f"noise floor {formatting.with_unit_text(row.noise_floor, unit_text)}")
    lines += [", ".join(known)] if known else []
    lines += _left_line(diagnosis)
    return AnswerCard("How far", lead, tuple(lines), "how-far")


def _left_line(diagnosis: DiagnosisFile | None) -> list[str]:
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is None or rest is None or diagnosis.remark:
        return []
    size = set_figures(verdict_words.size_of(rest, with_causes=bool(diagnosis.causes)))
    at = f", at the {port_label(rest.port)}" if rest.port else ""
    return [f"remaining: {size}{at}"]
