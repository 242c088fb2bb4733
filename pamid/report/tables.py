"""The tables of the page, and the table of errors for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath

from pamid.base.units import duration_text, split_column
from pamid.report import formatting
from pamid.report.captions import sensor_label, split_labels
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors
from pamid.report.document import Block, Heading, Table, TableCell, notes, table
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    count,
    number,
    percent,
    percent_span,
)
from pamid.report.load import RunData
from pamid.schemas.diagnosis_file import Transfer, Where
from pamid.schemas.estimates import Estimate
from pamid.schemas.fit_file import Combination, FitFile, LoopError
from pamid.schemas.run_file import Step

STRAINED = 3.0


def mae_fields(rows: tuple[ChannelErrors, ...]) -> list[str]:
    """The models whose error is known for at least one channel."""
    return [name for name in MODEL_NAMES if any(name in row.known() for row in rows)]


def mae_table(rows: tuple[ChannelErrors, ...]) -> Table:
    """Held-out MAE (eq. 11) per channel and model."""
    fields = mae_fields(rows)
    shrinks = any(row.shrinkage is not None for row in rows)
    heads = [
        "channel",
        "unit",
        *(MODEL_NAMES[name] for name in fields),
        *([f"shrinkage ({formatting.INTERVAL})"] * shrinks),
    ]
    body = []
    for row in rows:
        known = row.known()
        cells = [channel_label(row.channel), channel_unit(row.channel) or "-"]
        cells += [number(known.get(name)) for name in fields]
        interval = percent_span(row.low, row.high)
        cells += (
            [percent(row.shrinkage) + ("" if interval == formatting.DASH else f" ({interval})")]
            if shrinks
            else []
        )
        body.append(cells)
    return table(heads, body, range(2, len(heads)))


def mae_text(rows: tuple[ChannelErrors, ...]) -> str:
    """The same table in plain text, columns aligned."""
    fields = mae_fields(rows)
    lines = [["MAE, held out", *(MODEL_NAMES[name] for name in fields)]]
    for row in rows:
        known, unit_text = row.known(), channel_unit(row.channel)
        name = f"{channel_label(row.channel)} [{unit_text or '-'}]"
        lines.append(
            [name, *(number(known.get(field)).replace(formatting.SPACE, " ") for field in fields)]
        )
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if column else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def loop_table(errors: Mapping[str, LoopError]) -> Table:
    """MAE of the model in closed loop, with the band that small parameter changes cause."""
    heads = ["channel", "unit", "data sheet", "refitted", "band (0.1 % of conductances)"]
    body = [
        [
            channel_label(channel),
            channel_unit(channel) or "-",
            number(error.data_sheet),
            number(error.refitted),
            "" if error.band is None else f"± {number(error.band)}",
        ]
        for channel, error in errors.items()
    ]
    return table(heads, body, (2, 3, 4))


def parameter_table(
    parameters: Mapping[str, Estimate], without_cause: Mapping[str, Estimate]
) -> Table:
    """Value, interval, prior, unit, certainty, strain and a remark; without_cause: those of the
    refitted model, if the answer has causes."""
    compared = any(name in without_cause for name in parameters)
    heads = [
        "parameter",
        "unit",
        "value",
        formatting.INTERVAL,
        "prior",
        *(["without cause"] * compared),
        "strain",
        "known",
    ]
    body: list[list[str | TableCell]] = []
    for name, parameter in parameters.items():
        other = without_cause.get(name)
        source = parameter.source or ("" if other is None else other.source)  # an older diagnosis
        row: list[str | TableCell] = [
            TableCell(formatting.clean(name), "code", formatting.clean(source)),
            formatting.unit_label(_unit(name, parameter)) or "-",
            number(parameter.value),
            formatting.span(parameter.low, parameter.high),
            number(parameter.prior),
        ]
        if compared:
            row.append(number(other.value) if other is not None else formatting.DASH)
        strained = parameter.strain is not None and abs(parameter.strain) > STRAINED
        shown = (
            formatting.DASH
            if parameter.strain is None
            else f"{parameter.strain:.1f}".replace("-", formatting.MINUS)
        )
        strain = TableCell(shown, "strong" if strained else "")
        body.append([*row, strain, _remark(parameter, strained)])
    return table(heads, body, range(2, 6 + compared))


def _unit(name: str, estimate: Estimate | Combination) -> str:
    return split_column(name)[1] if estimate.unit is None else estimate.unit


def combinations_table(fit: FitFile) -> Table:
    """Combinations that are known where their parameters are not."""
    body: list[list[str | TableCell]] = []
    for group in fit.tied:
        for name in group.known:
            if (estimate := fit.combinations.get(name)) is None:
                continue
            body.append(
                [
                    TableCell(formatting.clean(name), "code"),
                    formatting.unit_label(_unit(name, estimate)) or formatting.DASH,
                    number(estimate.value, 5),
                    f"{number(estimate.low, 5)} to {number(estimate.high, 5)}",
                    number(estimate.prior),
                    formatting.clean(", ".join(group.parameters)),
                ]
            )
    return table(
        ["combination", "unit", "value", formatting.INTERVAL, "prior", "ties together"],
        body,
        range(2, 5),
    )


def parameters_of(run: RunData) -> tuple[Mapping[str, Estimate], Mapping[str, Estimate]]:
    """The parameters of the answer's model; where it has causes, also those of the refitted model
    without them."""
    fitted = run.fit.parameters if run.fit is not None else {}
    diagnosis = run.diagnosis
    if diagnosis is None or not diagnosis.parameters or (fitted and not diagnosis.causes):
        return fitted, {}
    return diagnosis.parameters, fitted


def _remark(estimate: Estimate, strained: bool) -> str:
    end = (
        f"at its {'lower' if estimate.at_bound == 'low' else 'upper'} bound"
        if estimate.at_bound
        else ""
    )
    word = "" if end and estimate.word == "settled" else formatting.clean(estimate.word)
    strain = "may be absorbing structure" if strained else ""
    remarks = [text for text in (word, strain, end) if text]
    return ", ".join(remarks) or formatting.DASH


def recordings_table(fit: FitFile) -> Table:
    """Table of the recordings and their roles."""
    heads = ["recording", "role", "samples", "period", "loop"]
    body = [
        [
            formatting.clean(recording.name),
            formatting.clean(recording.role),
            count(recording.samples),
            formatting.DASH if recording.period_s is None else duration_text(recording.period_s, 4),
            formatting.clean(recording.loop or "") or formatting.DASH,
        ]
        for recording in fit.recordings
    ]
    return table(heads, body, (2, 3))


def provenance(
    steps: tuple[Step, ...],
    fit: FitFile | None = None,
    *,
    level: int = 2,
    notes_before: tuple[str, ...] = (),
) -> tuple[Block, ...]:
    """Every command that worked on the run, the recordings, input files and versions."""
    recordings = [recordings_table(fit)] if fit is not None and fit.recordings else []
    inputs = [_inputs_table(steps)] if any(step.inputs for step in steps) else []
    return (
        Heading("Provenance", level),
        _steps_table(steps),
        *recordings,
        *inputs,
        notes(*notes_before, _versions(steps)),
    )


def _typed(words: Sequence[str]) -> str:
    """The command as it was typed: the program by its name, wherever it lies."""
    first, *rest = words or ("",)
    return " ".join([PurePath(first.replace("\\", "/")).name, *rest])


def _steps_table(steps: tuple[Step, ...]) -> Table:
    """Every command that worked on the run."""
    heads = ["command", "seed", "begun", "ended", "outcome"]
    body: list[list[str | TableCell]] = [
        [
            TableCell(formatting.clean(_typed(step.command)), "code"),
            count(step.seed),
            _moment(step.begun) or formatting.DASH,
            _moment(step.ended or "") or "did not end",
            step.outcome or formatting.DASH,
        ]
        for step in steps
    ]
    return table(heads, body, (1,), fixed=True)


def _versions(steps: tuple[Step, ...]) -> str:
    """Versions of the software that the commands ran on; the latest of several."""
    versions = dict(pair for step in steps for pair in step.versions.items())
    listed = ", ".join(
        f"{formatting.clean(name)} {formatting.clean(version)}"
        for name, version in versions.items()
    )
    places = formatting.join(
        dict.fromkeys(formatting.clean(step.platform) for step in steps if step.platform)
    )
    return f"Versions: {listed}{f'; on {places}' if places else ''}." if listed else ""


def _moment(stamp: str) -> str:
    """ "2024-05-01T10:00:00+00:00" -> "2024-05-01 10:00:00 UTC"."""
    return formatting.clean(stamp).replace("T", " ").replace("+00:00", " UTC")


def _inputs_table(steps: tuple[Step, ...]) -> Table:
    """Every input file with the sha256 it had."""
    inputs = dict.fromkeys((input_.path, input_.sha256) for step in steps for input_ in step.inputs)
    return table(
        ["input", "sha256"],
        [
            [formatting.clean(path), TableCell(formatting.clean(sha), "code")]
            for path, sha in inputs
        ],
    )


def transfer_table(transfers: tuple[Transfer, ...], fit: FitFile | None) -> Table:
    """MAE on held-out recordings made under other conditions, refitted and with the cause."""
    channels = list(dict.fromkeys(name for transfer in transfers for name in transfer.channels))
    heads = ["recording", "differs in"]
    heads += [f"{channel_label(name)} MAE [{channel_unit(name) or '-'}]" for name in channels]
    body: list[list[str | TableCell]] = []
    for transfer in transfers:
        known = [
            r.name
            for r in (fit.recordings if fit is not None else ())
            if r.sha256.startswith(transfer.recording)
        ]
        row: list[str | TableCell] = [
            formatting.clean(known[0])
            if known
            else TableCell(formatting.clean(transfer.recording), "code"),
            formatting.clean(_differences(transfer.differs)) or formatting.DASH,
        ]
        for name in channels:
            errors = transfer.channels.get(name)
            row.append(
                formatting.DASH
                if errors is None or errors.mae_with_cause is None
                else f"{number(errors.mae_refitted)} → {number(errors.mae_with_cause)} "
                f"({percent(errors.shrinkage)} removed)"
            )
        body.append(row)
    return table(heads, body, range(2, 2 + len(channels)))


def _differences(values: Mapping[str, object]) -> str:
    return ", ".join(f"{key} {_plainly(value)}" for key, value in values.items())


def _plainly(value: object) -> str:
    """A value of `differs` as text: a number, a word, or the changed entries of a table."""
    if isinstance(value, dict):
        return " and ".join(f"{key} {_plainly(entry)}" for key, entry in value.items())
    return (
        f"{value:.3g}"
        if isinstance(value, float | int) and not isinstance(value, bool)
        else str(value)
    )


def sensors_table(where: Where) -> Table:
    """Further sensors and the groups of ports that each would take apart."""
    body = [
        [
            formatting.sentence(sensor_label(sensor.sensor)).removesuffix("."),
            "; ".join(split_labels(sensor)) or formatting.DASH,
        ]
        for sensor in where.sensors
    ]
    return table(["one more sensor", "takes apart"], body)


def _figure(value: float) -> str:
    """A count without decimals."""
    return count(value) if float(value).is_integer() else number(value)
