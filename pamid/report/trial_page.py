"""Report of a trial: the targets first, then the derivation of the figures."""

from __future__ import annotations

from collections.abc import Iterator

from pamid.report import formatting
from pamid.report.document import (
    Block,
    Bullets,
    Details,
    Document,
    Heading,
    Paragraphs,
    Section,
    TableCell,
    figures,
    notes,
    table,
)
from pamid.report.formatting import effect_label
from pamid.report.style import Picture
from pamid.report.tables import provenance
from pamid.report.trial_results import Trial, bin_label, reached_text, signs
from pamid.schemas.run_file import Step
from pamid.trial.figure_table import TABLE_HEAD, TITLES, strata, summary

_SHOWN_FAILURES = 20


def trial_document(trial: Trial, steps: tuple[Step, ...], pictures: dict[str, Picture]) -> Document:
    """The report of a trial with the pictures that were drawn of it."""
    headline = formatting.sentence(reached_text(trial))
    sections = (
        (
            "Figures and targets",
            figures(pictures, ["targets"]),
            _targets(trial),
            "Intervals: Wilson for shares, bootstrap over cases for the others, 95 %.",
        ),
        (
            "Are stated probabilities right?",
            figures(pictures, ["reliability"]),
            (),
            "Answers in ten bins of the probability that the diagnosis stated for its first "
            "candidate.",
        ),
        (
            "What is taken for what?",
            figures(pictures, ["confusion"]),
            _confusion(trial),
            "Visible single faults; in parentheses how naming a family was avoided.",
        ),
        (
            "When does it work?",
            figures(pictures, ["strata"]),
            _strata(trial),
            "Family first: of visible single faults; detected: single faults, visible or not; "
            "false alarm: of cases in which nothing is planted.",
        ),
    )
    cases = (
        f"sha256 of the cases and their labels: `{formatting.clean(trial.digest)}`."
        if trial.digest
        else ""
    )
    seed = f"Seed {formatting.count(trial.content['seed'])}."
    return Document(
        title=headline,
        subtitle=f"Blind trial, part {formatting.clean(trial.content['part'])}",
        headline=headline,
        preface=Paragraphs((formatting.clean(summary(dict(trial.content))),)),
        blocks=(
            *(
                Section((Heading(title), *drawn, *below, notes(note)))
                for title, drawn, below, note in sections
                if drawn or below
            ),
            *_failures(trial),
            Section(provenance(steps, notes_before=(seed, cases))),
        ),
    )


def _targets(trial: Trial) -> tuple[Block, ...]:
    body: list[list[str | TableCell]] = []
    for score in trial.scored:
        outcome: str | TableCell = (
            "no cases" if score.row.target is not None and score.value is None else ""
        )
        if score.reached is not None:
            outcome = "reached" if score.reached else TableCell("missed", "strong")
        body.append([*(signs(text.replace(" .. ", " to ")) for text in score.texts), outcome])
    return (table(["figure", *TABLE_HEAD[1:], "outcome"], body, (1, 2, 3, 4)),)


def _confusion(trial: Trial) -> tuple[Block, ...]:
    body = [
        [
            effect_label(family),
            ", ".join(f"{effect_label(answer)} {formatting.count(n)}" for answer, n in row.items()),
        ]
        for family, row in trial.confusion.items()
    ]
    if not body:
        return ()
    return (Details("The same in words", (table(["planted", "answers"], body),)),)


def _strata(trial: Trial) -> tuple[Block, ...]:
    tables = []
    for name, rows in strata(dict(trial.content)).items():
        unit_text = formatting.channel_unit(name)
        head = f"{formatting.channel_label(name)}{f' [{unit_text}]' if unit_text else ''}"
        body = [[bin_label(name, key), *rates] for key, rates in rows]
        tables.append(table([head, *TITLES.values()], body, range(1, 1 + len(TITLES))))
    return tuple(tables)


def _failures(trial: Trial) -> Iterator[Block]:
    if not trial.failures:
        return
    lines = [
        f"Case {formatting.clean(number)}: {formatting.clean(why)}"
        for number, why in trial.failures.items()
    ]
    more = [f"... and {len(lines) - _SHOWN_FAILURES} more"] if len(lines) > _SHOWN_FAILURES else []
    yield Section((Heading("Failed cases"), Bullets((*lines[:_SHOWN_FAILURES], *more))))
