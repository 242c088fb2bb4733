"""The tables of the page, and the tables of errors for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from types import MappingProxyType

from markupsafe import Markup

from pamid.base.units import duration_text, split_column
from pamid.report import formatting
from pamid.report.captions import sensor_label, split_labels
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors
from pamid.report.formatting import (
    DASH,
    INTERVAL,
    channel_label,
    channel_unit,
    clean,
    count,
    effect_label,
    number,
    percent,
    percent_span,
    port_label,
    unit_label,
)
from pamid.report.load import RunData
from pamid.report.markup import joined, tag
from pamid.report.page import Section, code, note, strong, table
from pamid.schemas.diagnosis_file import Candidate, DiagnosisFile, Transfer, Where
from pamid.schemas.estimates import Estimate
from pamid.schemas.fit_file import Combination, FitFile, LoopError
from pamid.schemas.run_file import Step

STRAINED = 3.0
_CLOSE = 0.02  # shares that differ by less say nothing


# ---- errors --------------------------------------------------------------------------------------


def mae_table(rows: tuple[ChannelErrors, ...]) -> Markup:
    """Held-out MAE (eq. 11) per channel and model."""
    fields = mae_fields(rows)
    shrinks = any(row.shrinkage is not None for row in rows)
    heads = ["channel", "unit", *(MODEL_NAMES[name] for name in fields)]
    heads += [f"shrinkage ({INTERVAL})"] if shrinks else []
    body = []
    for row in rows:
        cells = [*_channel(row.channel), *(number(row.known().get(name)) for name in fields)]
        if shrinks:
            interval = percent_span(row.low, row.high)
            tail = "" if interval == DASH else f" ({interval})"
            cells.append(f"{percent(row.shrinkage)}{tail}")
        body.append(cells)
    return table(heads, body, range(2, len(heads)))


def mae_fields(rows: tuple[ChannelErrors, ...]) -> list[str]:
    """The models whose error is known for at least one channel."""
    return [name for name in MODEL_NAMES if any(name in row.known() for row in rows)]


def mae_text(rows: tuple[ChannelErrors, ...]) -> str:
    """The same table in plain text, columns aligned."""
    fields = mae_fields(rows)
    lines = [["MAE, held out", *(MODEL_NAMES[name] for name in fields)]]
    for row in rows:
        name = f"{channel_label(row.channel)} [{channel_unit(row.channel) or '-'}]"
        lines.append([name, *(number(row.known().get(field)) for field in fields)])
    return aligned(lines, 1)


def aligned(lines: Sequence[Sequence[str]], left: int) -> str:
    """Rows of cells in plain text, columns aligned, the first ones to the left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = []
    for line in lines:
        cells = [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        texts.append("  ".join(cells).replace(formatting.SPACE, " ").rstrip())
    return "\n".join(texts)


def _channel(name: str) -> list[str]:
    """The cells of a channel and its unit."""
    return [channel_label(name), channel_unit(name) or "-"]


def _mae_heads(channels: Sequence[str]) -> list[str]:
    return [f"{channel_label(name)} MAE [{channel_unit(name) or '-'}]" for name in channels]


def loop_table(errors: Mapping[str, LoopError]) -> Markup:
    """MAE of the model in closed loop, with the band that small parameter changes cause."""
    heads = ["channel", "unit", "data sheet", "refitted", "band (0.1 % of conductances)"]
    body = [
        [
            *_channel(channel),
            number(error.data_sheet),
            number(error.refitted),
            "" if error.band is None else f"± {number(error.band)}",
        ]
        for channel, error in errors.items()
    ]
    return table(heads, body, (2, 3, 4))


def transfer_table(transfers: tuple[Transfer, ...], fit: FitFile | None) -> Markup:
    """MAE on held-out recordings made under other conditions, refitted and with the cause."""
    channels = list(dict.fromkeys(name for transfer in transfers for name in transfer.channels))
    body = []
    for transfer in transfers:
        recordings = fit.recordings if fit is not None else ()
        known = [r.name for r in recordings if r.sha256.startswith(transfer.recording)]
        differs = ", ".join(f"{key} {_plainly(value)}" for key, value in transfer.differs.items())
        row = [
            clean(known[0]) if known else code(clean(transfer.recording)),
            clean(differs) or DASH,
        ]
        for channel in channels:
            errors = transfer.channels.get(channel)
            row.append(
                DASH
                if errors is None or errors.mae_with_cause is None
                else f"{number(errors.mae_refitted)} → {number(errors.mae_with_cause)} "
                f"({percent(errors.shrinkage)} removed)"
            )
        body.append(row)
    heads = ["recording", "differs in", *_mae_heads(channels)]
    return table(heads, body, range(2, len(heads)))


def _plainly(value: object) -> str:
    """A value of `differs` as text: a number, a word, or the changed entries of a table."""
    if isinstance(value, dict):
        return " and ".join(f"{key} {_plainly(entry)}" for key, entry in value.items())
    plain = isinstance(value, float | int) and not isinstance(value, bool)
    return f"{value:.3g}" if plain else str(value)


# ---- candidates ----------------------------------------------------------------------------------


def ranking_table(
    diagnosis: DiagnosisFile, places: Mapping[str, str] = MappingProxyType({})
) -> Markup:
    """Every candidate that was refitted, best first, with its errors per channel. places: by
    effect, the figure of the page that its row leads to."""
    channels = list(
        dict.fromkeys(name for candidate in diagnosis.ranking for name in candidate.held_out)
    )
    heads = ["effect", "family", "port", "P", "held-out error removed", INTERVAL]
    heads += _mae_heads(channels)
    body = []
    for candidate in diagnosis.ranking:
        row = [
            code(clean(candidate.effect), place=places.get(candidate.effect, "")),
            effect_label(candidate.family),
            port_label(candidate.port),
            number(candidate.probability, 2),
            percent(candidate.shrinkage),
            percent_span(candidate.low, candidate.high),
        ]
        for name in channels:
            held = candidate.held_out.get(name)
            row.append(
                DASH
                if held is None or held.mae_after is None
                else f"{number(held.mae_before)} → {number(held.mae_after)}"
            )
        body.append(row)
    return table(heads, body, range(3, len(heads)))


def rivals_table(diagnosis: DiagnosisFile) -> Markup:
    """Every candidate with the parameters it was given, and why it is not the answer."""
    body = []
    for candidate in diagnosis.ranking:
        values = "; ".join(
            f"{channel_label(name)} {formatting.with_unit_text(size.value, channel_unit(name))}"
            for name, size in candidate.parameters.items()
        )
        bounds = ", ".join(map(channel_label, candidate.at_bound))
        small = tag("small", f"at its bound: {bounds}") if bounds else ""
        parameters = joined([values or DASH, small])
        body.append([code(clean(candidate.effect)), parameters, why_not(candidate, diagnosis)])
    return table(["effect", "its parameters", "why it is not the answer"], body)


def why_not(candidate: Candidate, diagnosis: DiagnosisFile) -> str:
    """Reason why a candidate was not chosen, from its figures."""
    named = {cause.effect for cause in diagnosis.causes}
    if candidate.effect in named:
        return "is named"
    if not candidate.converged:
        return formatting.not_converged("its fit", candidate.why)
    if candidate.shrinkage is None:
        return clean(candidate.why) or "was not refitted"
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
    return "; ".join(reasons) or DASH


def sensors_table(where: Where) -> Markup:
    """Further sensors and the groups of ports that each would take apart."""
    body = [
        [
            formatting.capital(sensor_label(sensor.sensor)),
            "; ".join(split_labels(sensor)) or DASH,
        ]
        for sensor in where.sensors
    ]
    return table(["one more sensor", "takes apart"], body)


# ---- parameters ----------------------------------------------------------------------------------


def parameters_of(run: RunData) -> tuple[Mapping[str, Estimate], Mapping[str, Estimate]]:
    """The parameters of the answer's model; where it has causes, also those of the refitted model
    without them."""
    fitted = run.fit.parameters if run.fit is not None else {}
    diagnosis = run.diagnosis
    if diagnosis is None or not diagnosis.parameters or (fitted and not diagnosis.causes):
        return fitted, {}
    return diagnosis.parameters, fitted


def parameter_table(
    parameters: Mapping[str, Estimate], without_cause: Mapping[str, Estimate]
) -> Markup:
    """Value, interval, prior, unit, certainty, strain and a remark; without_cause: those of the
    refitted model, if the answer has causes."""
    compared = any(name in without_cause for name in parameters)
    heads = ["parameter", "unit", "value", INTERVAL, "prior"]
    heads += ["without cause"] if compared else []
    body = []
    for name, parameter in parameters.items():
        other = without_cause.get(name)
        source = parameter.source or ("" if other is None else other.source)  # an older diagnosis
        row = [
            code(clean(name), clean(source)),
            _unit(name, parameter) or "-",
            number(parameter.value),
            formatting.span(parameter.low, parameter.high),
            number(parameter.prior),
        ]
        row += [DASH if other is None else number(other.value)] if compared else []
        strain, strained = DASH, False
        if parameter.strain is not None:
            strain = f"{parameter.strain:.1f}".replace("-", formatting.MINUS)
            strained = abs(parameter.strain) > STRAINED
        row.append(strong(strain) if strained else strain)
        body.append([*row, _remark(parameter, strained)])
    return table([*heads, "strain", "known"], body, range(2, 6 + compared))


def _unit(name: str, estimate: Estimate | Combination) -> str:
    return unit_label(split_column(name)[1] if estimate.unit is None else estimate.unit)


def _remark(estimate: Estimate, strained: bool) -> str:
    side = "lower" if estimate.at_bound == "low" else "upper"
    end = f"at its {side} bound" if estimate.at_bound else ""
    word = "" if end and estimate.word == "settled" else clean(estimate.word)
    strain = "may be absorbing structure" if strained else ""
    return ", ".join(filter(None, (word, strain, end))) or DASH


def combinations_table(fit: FitFile) -> Markup:
    """Combinations that are known where their parameters are not."""
    body = [
        [
            code(clean(name)),
            _unit(name, estimate) or DASH,
            number(estimate.value, 5),
            f"{number(estimate.low, 5)} to {number(estimate.high, 5)}",
            number(estimate.prior),
            clean(", ".join(group.parameters)),
        ]
        for group in fit.tied
        for name in group.known
        if (estimate := fit.combinations.get(name)) is not None
    ]
    heads = ["combination", "unit", "value", INTERVAL, "prior", "ties together"]
    return table(heads, body, range(2, 5))


# ---- provenance ----------------------------------------------------------------------------------


def provenance(
    steps: tuple[Step, ...], fit: FitFile | None = None, level: int = 2, notes: Sequence[str] = ()
) -> Section:
    """Every command that worked on the run, the recordings, input files and versions."""
    tables = [_steps_table(steps)]
    if fit is not None and fit.recordings:
        tables.append(_recordings_table(fit))
    inputs = dict.fromkeys((input_.path, input_.sha256) for step in steps for input_ in step.inputs)
    if inputs:
        body = [[clean(path), code(clean(sha))] for path, sha in inputs]
        tables.append(table(["input", "sha256"], body))
    # versions of the software that the commands ran on; the latest of several
    versions = dict(pair for step in steps for pair in step.versions.items())
    listed = ", ".join(f"{clean(name)} {clean(version)}" for name, version in versions.items())
    places = formatting.join(dict.fromkeys(clean(s.platform) for s in steps if s.platform))
    ran_on = f"Versions: {listed}{f'; on {places}' if places else ''}." if listed else ""
    return Section("Provenance", (*tables, note(*notes, ran_on)), level)


def _steps_table(steps: tuple[Step, ...]) -> Markup:
    """Every command that worked on the run, as it was typed: the program by its name, wherever it
    lies."""
    body = []
    for step in steps:
        first, *rest = step.command or ("",)
        typed = " ".join([PurePath(first.replace("\\", "/")).name, *rest])
        begun, ended = (
            clean(stamp or "").replace("T", " ").replace("+00:00", " UTC")
            for stamp in (step.begun, step.ended)
        )
        cells = [count(step.seed), begun or DASH, ended or "did not end", step.outcome or DASH]
        body.append([code(clean(typed)), *cells])
    return table(["command", "seed", "begun", "ended", "outcome"], body, (1,), "steps")


def _recordings_table(fit: FitFile) -> Markup:
    heads = ["recording", "role", "samples", "period", "loop"]
    body = [
        [
            clean(recording.name),
            clean(recording.role),
            count(recording.samples),
            DASH if recording.period_s is None else duration_text(recording.period_s, 4),
            clean(recording.loop or "") or DASH,
        ]
        for recording in fit.recordings
    ]
    return table(heads, body, (2, 3))
