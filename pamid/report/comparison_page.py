"""Comparison of runs: results, parameters, errors, and differences in data and settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import UsageError
from pamid.report import formatting
from pamid.report.captions import causes_label, verdict_sentence
from pamid.report.channel_errors import ChannelErrors, errors_of
from pamid.report.document import (
    AnswerCard,
    Block,
    Document,
    Heading,
    Paragraphs,
    Section,
    Table,
    TableCell,
    notes,
    table,
)
from pamid.report.formatting import channel_label, channel_unit, number, percent
from pamid.report.load import RunData, load_run
from pamid.report.tables import parameters_of
from pamid.schemas.estimates import Interval
from pamid.schemas.fit_file import RecordingUsed

MOST_COMPARED = 6
_SHA_DIGITS = 12
#: options of a run as people read them
_OPTIONS = {"effects": "effects of one's own", "without": "effects left out (--without)"}


@dataclass(frozen=True)
class ComparedRun:
    """One of the compared runs: name, content and errors."""

    name: str
    run: RunData
    rows: tuple[ChannelErrors, ...]


def compared_runs(folders: Sequence[Path]) -> tuple[ComparedRun, ...]:
    """Runs of `pamid fit` or `pamid diagnose`, read; UsageError for fewer than two or too many,
    FileError as of a report."""
    if not 2 <= len(folders) <= MOST_COMPARED:
        raise UsageError(
            f"--compare needs 2 to {MOST_COMPARED} runs, but {len(folders)} were given.",
            "pamid report --compare RUN1 RUN2",
        )
    names = _names(folders)
    return tuple(
        ComparedRun(name, run, errors_of(run))
        for name, run in zip(names, map(load_run, folders), strict=True)
    )


def _names(folders: Sequence[Path]) -> list[str]:
    """The last parts of each path, as many as needed to distinguish them."""
    parts = [folder.resolve().parts for folder in folders]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-count:]) for part in parts]
        if len(set(names)) == len(names):
            return list(map(formatting.clean, names))
    return [f"{formatting.clean(part[-1])} ({k})" for k, part in enumerate(parts, start=1)]


def comparison_document(runs: Sequence[ComparedRun]) -> Document:
    """The page of several runs."""
    headline = comparison_sentence(runs)
    changed = changes_of(runs)
    differs = (
        f"What differs: {formatting.join(changed)}."
        if changed
        else "The same data, run in the same way."
    )
    sections: list[tuple[str, tuple[Block, ...]]] = [
        ("What was found", (_result_rows(runs),)),
        ("Errors", _errors(runs)),
        ("Parameters", _parameters(runs)),
        ("What changed", (_data(runs), notes(differs))),
    ]
    return Document(
        title=headline,
        subtitle=f"{len(runs)} runs side by side",
        headline=headline,
        preface=Paragraphs((differs,)),
        cards=tuple(_card(run) for run in runs),
        blocks=tuple(Section((Heading(title), *below)) for title, below in sections if below),
    )


def comparison_sentence(runs: Sequence[ComparedRun]) -> str:
    """Whether the runs agree on the cause: "Both runs name Coulomb friction at the joint port"."""
    answers = [_answer(run) for run in runs]
    if len(set(answers)) == 1:
        every = "Both runs" if len(runs) == 2 else f"All {len(runs)} runs"
        return formatting.sentence(f"{every} say: {answers[0]}")
    each = "; ".join(f"{run.name} says {answer}" for run, answer in zip(runs, answers, strict=True))
    return formatting.sentence(f"the runs differ: {each}")


def _answer(compared_run: ComparedRun) -> str:
    diagnosis = compared_run.run.diagnosis
    if diagnosis is None:
        return "fitted, not diagnosed"
    if diagnosis.causes:
        return causes_label(diagnosis)
    return {
        "unknown-effect": "an effect outside the catalogue",
        "no-structural-gap": "no structural gap",
        "cannot-tell": "not told",
    }.get(diagnosis.verdict, diagnosis.verdict)


def _card(compared_run: ComparedRun) -> AnswerCard:
    lines = [formatting.clean(verdict_sentence(compared_run.run, compared_run.rows))]
    quiet = compared_run.run.diagnosis is None or not compared_run.run.diagnosis.causes
    lead = formatting.sentence(_answer(compared_run)).removesuffix(".")
    return AnswerCard(compared_run.name, lead, tuple(lines), "what-was-found", quiet)


# ---- tables: a column per run ----------------------------------------------------------------


def _heads(runs: Sequence[ComparedRun], *first: str, last: str = "") -> list[str]:
    return [*first, *(run.name for run in runs), *([last] if last else [])]


def _result_rows(runs: Sequence[ComparedRun]) -> Table:
    columns: dict[str, Callable[[ComparedRun], str]] = {
        "verdict": lambda item: item.run.diagnosis.verdict if item.run.diagnosis else "fit only",
        "causes": _causes,
        "port": _port,
        "share of the gap left": _remainder_text,
        "do next": _next,
    }
    return table(
        _heads(runs, "found"),
        [
            [what, *(text_of(run) or formatting.DASH for run in runs)]
            for what, text_of in columns.items()
        ],
    )


def _causes(compared_run: ComparedRun) -> str:
    diagnosis = compared_run.run.diagnosis
    texts = []
    for cause in diagnosis.causes if diagnosis is not None else ():
        values = [
            f"{channel_label(name)} {formatting.span(size.low, size.high, channel_unit(name))}"
            for name, size in cause.parameters.items()
        ]
        chance = (
            f", P {formatting.chance(cause.probability)}" if cause.probability is not None else ""
        )
        texts.append(f"{formatting.effect_label(cause.effect)}{chance}: {', '.join(values)}")
    return "; ".join(texts)


def _port(compared_run: ComparedRun) -> str:
    where = compared_run.run.diagnosis.where if compared_run.run.diagnosis is not None else None
    return formatting.port_label(where.port) if where is not None else ""


def _remainder_text(compared_run: ComparedRun) -> str:
    rest = compared_run.run.diagnosis.remainder if compared_run.run.diagnosis is not None else None
    if rest is None:
        return ""
    real = "" if rest.real else ", within noise and tolerances"
    return f"{percent(rest.share)}{real}"


def _next(compared_run: ComparedRun) -> str:
    experiment = (
        compared_run.run.diagnosis.next_experiment
        if compared_run.run.diagnosis is not None
        else None
    )
    return formatting.effect_label(experiment.name) if experiment is not None else ""


def _errors(runs: Sequence[ComparedRun]) -> tuple[Block, ...]:
    channels = list(dict.fromkeys(row.channel for run in runs for row in run.rows))
    fields = {
        "data_sheet": "data sheet",
        "refitted": "refitted",
        "with_cause": "with cause",
        "noise_floor": "noise floor",
    }
    body = []
    for channel in channels:
        known = [
            next((row.known() for row in run.rows if row.channel == channel), {}) for run in runs
        ]
        for field, name in fields.items():
            if any(field in each for each in known):
                cells = [number(each.get(field)) for each in known]
                label = f"{channel_label(channel)} [{channel_unit(channel) or '-'}]"
                body.append([label, name, *cells])
    if not body:
        return ()
    return (
        table(_heads(runs, "held-out error of", "model"), body, range(2, 2 + len(runs))),
        notes("Mean absolute error; each run on its own held-out windows."),
    )


def _parameters(runs: Sequence[ComparedRun]) -> tuple[Block, ...]:
    tables = [dict(parameters_of(run.run)[0]) for run in runs]
    names = list(dict.fromkeys(name for each in tables for name in each))
    body: list[list[str | TableCell]] = []
    for name in names:
        known = [each.get(name) for each in tables]
        unit = formatting.clean(channel_unit(name))
        body.append(
            [
                TableCell(formatting.clean(name), "code"),
                unit or "-",
                *(
                    TableCell(number(item.value), small=formatting.span(item.low, item.high))
                    if item is not None
                    else formatting.DASH
                    for item in known
                ),
                _agreement([item for item in known if item is not None]),
            ]
        )
    if not body:
        return ()
    heads = _heads(runs, "parameter", "unit", last="compared")
    return (
        table(heads, body, range(2, 2 + len(runs))),
        notes(
            "Values of each answer's model with 95 % intervals below them; a parameter differs "
            "where two of them do not overlap."
        ),
    )


def _agreement(known: Sequence[Interval]) -> TableCell:
    """Whether all intervals overlap."""
    if len(known) < 2:
        return TableCell("in one run only")
    lows = [name.low for name in known if name.low is not None]
    highs = [name.high for name in known if name.high is not None]
    apart = bool(lows and highs) and max(lows) > min(highs)
    return TableCell("differs", "strong") if apart else TableCell("agrees")


# ---- what changed ----------------------------------------------------------------------------


def _facts(compared_run: ComparedRun) -> dict[str, str]:
    """Settings of a run by name."""
    step = compared_run.run.steps[0]
    recordings = compared_run.run.fit.recordings if compared_run.run.fit is not None else ()
    options = {
        _OPTIONS.get(key, f"option {formatting.clean(key)}"): _option_text(value)
        for key, value in step.options.items()
        if key != "rig"
    }
    return {
        "rig": formatting.clean(compared_run.run.rig),
        "recordings": ", ".join(formatting.clean(each.name) for each in recordings),
        "content (sha256)": ", ".join(each.sha256[:_SHA_DIGITS] for each in recordings),
        "samples": _sum(recordings),
        "seed": formatting.count(step.seed),
        **options,
        "pamid": formatting.clean(step.versions.get("pamid", "")),
    }


def _option_text(value: object) -> str:
    """An option as text: a list by its members, an empty value as a dash."""
    if isinstance(value, list | tuple):
        return ", ".join(formatting.clean(str(item)) for item in value)
    return "" if value is None else formatting.clean(str(value))


def _sum(recordings: Sequence[RecordingUsed]) -> str:
    return formatting.count(sum(each.samples or 0 for each in recordings))


def changes_of(runs: Sequence[ComparedRun]) -> list[str]:
    """Names of the settings and data in which the runs differ."""
    facts = [_facts(run) for run in runs]
    names = list(dict.fromkeys(name for each in facts for name in each))
    return [name for name in names if len({each.get(name, "") for each in facts}) > 1]


def _data(runs: Sequence[ComparedRun]) -> Table:
    facts, changed = [_facts(run) for run in runs], changes_of(runs)
    names = list(dict.fromkeys(name for each in facts for name in each))
    body: list[list[str | TableCell]] = [
        [
            name,
            *(each.get(name) or formatting.DASH for each in facts),
            TableCell("differs", "strong") if name in changed else "same",
        ]
        for name in names
    ]
    return table(_heads(runs, "of the run", last="compared"), body)
