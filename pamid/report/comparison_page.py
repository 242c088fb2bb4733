"""Comparison of runs: results, parameters, errors, and differences in data and settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from pamid.base.errors import UsageError, join_words
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.share_words import chance_text
from pamid.report import formatting
from pamid.report.answers import Card
from pamid.report.captions import causes_label, verdict_sentence
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors, errors_of
from pamid.report.evidence import parameters_of
from pamid.report.formatting import (
    DASH,
    channel_label,
    channel_unit,
    clean,
    count,
    effect_label,
    number,
    percent,
    port_label,
)
from pamid.report.load import RunData, load_run
from pamid.report.markup import joined, tag
from pamid.report.page import Page, Section, code, note, strong, table, text

MOST_COMPARED = 6
_SHA_DIGITS = 12
#: options of a run as people read them
_OPTIONS = {"effects": "effects of the user", "without": "effects left out (--without)"}


@dataclass(frozen=True)
class ComparedRun:
    """A compared run: name, content and errors."""

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
    for many in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-many:]) for part in parts]
        if len(set(names)) == len(names):
            return list(map(clean, names))
    return [f"{clean(part[-1])} ({k})" for k, part in enumerate(parts, start=1)]


def comparison_page(runs: Sequence[ComparedRun]) -> Page:
    """The page of several runs."""
    changed = changes_of(runs)
    differs = "The same data, run in the same way."
    if changed:
        differs = f"What differs: {join_words(changed)}."
    sections = (
        Section("What was found", (_results(runs),)),
        Section("Errors", _errors(runs)),
        Section("Parameters", _parameters(runs)),
        Section("What changed", (_data(runs, changed), note(differs))),
    )
    cards = []
    for run in runs:
        lines = (clean(verdict_sentence(run.run, run.rows)),)
        quiet = run.run.diagnosis is None or not run.run.diagnosis.causes
        lead = formatting.capital(_answer(run))
        cards.append(Card(run.name, lead, lines, "what-was-found", quiet))
    return Page(
        headline=comparison_sentence(runs),
        subtitle=f"{len(runs)} runs side by side",
        preface=text(differs),
        cards=tuple(cards),
        sections=tuple(section for section in sections if section.content),
    )


def comparison_sentence(runs: Sequence[ComparedRun]) -> str:
    """Whether the runs agree on the cause: "Both runs name Coulomb friction at the joint port"."""
    answers = [_answer(run) for run in runs]
    if len(set(answers)) == 1:
        every = "Both runs" if len(runs) == 2 else f"All {len(runs)} runs"
        return formatting.sentence(f"{every} say: {answers[0]}")
    each = "; ".join(
        f"{run.name} gives {answer}" for run, answer in zip(runs, answers, strict=True)
    )
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
        "cannot-tell": "undetermined",
    }.get(diagnosis.verdict, diagnosis.verdict)


# ---- tables: a column per run ----------------------------------------------------------------


def _results(runs: Sequence[ComparedRun]) -> Markup:
    rows: dict[str, Callable[[DiagnosisFile], str]] = {
        "verdict": lambda diagnosis: diagnosis.verdict,
        "causes": _causes,
        "port": lambda diagnosis: port_label(diagnosis.where.port) if diagnosis.where else "",
        "share of the gap left": lambda diagnosis: (
            f"{percent(rest.share)}{'' if rest.real else ', within noise and tolerances'}"
            if (rest := diagnosis.remainder) is not None
            else ""
        ),
        "do next": lambda diagnosis: (
            effect_label(diagnosis.next_experiment.name) if diagnosis.next_experiment else ""
        ),
    }
    body = []
    for what, text_of in rows.items():
        of_fit = "fit only" if what == "verdict" else DASH
        diagnoses = [run.run.diagnosis for run in runs]
        body.append([what, *(of_fit if d is None else text_of(d) or DASH for d in diagnoses)])
    return table(["found", *(run.name for run in runs)], body)


def _causes(diagnosis: DiagnosisFile) -> str:
    texts = []
    for cause in diagnosis.causes:
        values = ", ".join(
            f"{channel_label(name)} {formatting.span(size.low, size.high, channel_unit(name))}"
            for name, size in cause.parameters.items()
        )
        chance = f", P {chance_text(cause.probability)}" if cause.probability is not None else ""
        texts.append(f"{effect_label(cause.effect)}{chance}: {values}")
    return "; ".join(texts)


def _errors(runs: Sequence[ComparedRun]) -> tuple[Markup, ...]:
    # networks are trained on a single run
    fields = {key: name for key, name in MODEL_NAMES.items() if key != "with_network"}
    body = []
    for channel in dict.fromkeys(row.channel for run in runs for row in run.rows):
        known = [{row.channel: row.known() for row in run.rows}.get(channel, {}) for run in runs]
        label = f"{channel_label(channel)} [{channel_unit(channel) or '-'}]"
        body += [
            [label, name, *(number(errors.get(field)) for errors in known)]
            for field, name in fields.items()
            if any(field in errors for errors in known)
        ]
    if not body:
        return ()
    heads = ["held-out error of", "model", *(run.name for run in runs)]
    words = "Mean absolute error; each run on its held-out windows."
    return table(heads, body, range(2, 2 + len(runs))), note(words)


def _parameters(runs: Sequence[ComparedRun]) -> tuple[Markup, ...]:
    tables = [parameters_of(run.run)[0] for run in runs]
    body = []
    for name in dict.fromkeys(name for each in tables for name in each):
        known = [each.get(name) for each in tables]
        cells = [
            DASH
            if size is None
            else joined([number(size.value), tag("small", formatting.span(size.low, size.high))])
            for size in known
        ]
        # a parameter differs where two intervals do not overlap
        sizes = [size for size in known if size is not None]
        lows = [size.low for size in sizes if size.low is not None]
        highs = [size.high for size in sizes if size.high is not None]
        apart = bool(lows and highs) and max(lows) > min(highs)
        agreement: Markup | str = strong("differs") if apart else "agrees"
        if len(sizes) < 2:
            agreement = "in a single run"
        body.append([code(clean(name)), clean(channel_unit(name)) or "-", *cells, agreement])
    if not body:
        return ()
    heads = ["parameter", "unit", *(run.name for run in runs), "compared"]
    words = (
        "Values of each answer's model with 95 % intervals below them; a parameter differs where "
        "two of them do not overlap."
    )
    return table(heads, body, range(2, 2 + len(runs))), note(words)


# ---- what changed ----------------------------------------------------------------------------


def _facts(compared_run: ComparedRun) -> dict[str, str]:
    """Settings of a run by name."""
    step = compared_run.run.steps[0]
    recordings = compared_run.run.recordings
    options = {}
    for key, value in step.options.items():
        if key != "rig":
            items = value if isinstance(value, list | tuple) else () if value is None else (value,)
            text = ", ".join(clean(str(item)) for item in items)
            options[_OPTIONS.get(key, f"option {clean(key)}")] = text
    return {
        "rig": clean(compared_run.run.rig),
        "recordings": ", ".join(clean(each.name) for each in recordings),
        "content (sha256)": ", ".join(each.sha256[:_SHA_DIGITS] for each in recordings),
        "samples": count(sum(each.samples or 0 for each in recordings)),
        "seed": count(step.seed),
        **options,
        "pamid": clean(step.versions.get("pamid", "")),
    }


def changes_of(runs: Sequence[ComparedRun]) -> list[str]:
    """Names of the settings and data in which the runs differ."""
    facts = [_facts(run) for run in runs]
    names = dict.fromkeys(name for each in facts for name in each)
    return [name for name in names if len({each.get(name, "") for each in facts}) > 1]


def _data(runs: Sequence[ComparedRun], changed: Sequence[str]) -> Markup:
    facts = [_facts(run) for run in runs]
    body = [
        [
            name,
            *(each.get(name) or DASH for each in facts),
            strong("differs") if name in changed else "same",
        ]
        for name in dict.fromkeys(name for each in facts for name in each)
    ]
    return table(["of the run", *(run.name for run in runs), "compared"], body)
