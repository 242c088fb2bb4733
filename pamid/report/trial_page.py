"""Report of a trial: the targets first, then the derivation of the figures."""

from __future__ import annotations

from collections.abc import Mapping

from markupsafe import Markup

from pamid.base.schemas.run_file import Step
from pamid.report import formatting
from pamid.report.formatting import channel_label, channel_unit, clean, count, effect_label
from pamid.report.page import Page, Section, bullets, details, figures, note, strong, table, text
from pamid.report.provenance import provenance
from pamid.report.style import Picture
from pamid.report.trial_results import Trial, bin_label, reached_text, signs
from pamid.trial.figure_table import TABLE_HEAD, TITLES, strata, summary

_SHOWN_FAILURES = 20


def trial_page(trial: Trial, steps: tuple[Step, ...], pictures: Mapping[str, Picture]) -> Page:
    """The report of a trial with the pictures that were drawn of it."""
    body = []
    for score in trial.scored:
        outcome: Markup | str = ""
        if score.reached is not None:
            outcome = "reached" if score.reached else strong("missed")
        elif score.row.target is not None and score.value is None:
            outcome = "no cases"
        body.append([*(signs(cell.replace(" .. ", " to ")) for cell in score.texts), outcome])
    targets = table(["figure", *TABLE_HEAD[1:], "outcome"], body, (1, 2, 3, 4))
    answers = [
        [
            effect_label(family),
            ", ".join(f"{effect_label(answer)} {count(n)}" for answer, n in row.items()),
        ]
        for family, row in trial.file.confusion.items()
    ]
    in_words = [details("The same in words", table(["planted", "answers"], answers))]
    contents = (
        (
            "Figures and targets",
            (*figures(pictures, "targets"), targets),
            "Intervals: Wilson for shares, bootstrap over cases for the others, 95 %.",
        ),
        (
            "Are stated probabilities right?",
            figures(pictures, "reliability"),
            "Answers in ten bins of the probability that the diagnosis stated for its first "
            "candidate.",
        ),
        (
            "Which effects are confused?",
            (*figures(pictures, "confusion"), *(in_words if answers else [])),
            "Visible single faults; in parentheses: answers that name no family.",
        ),
        (
            "When does it work?",
            (*figures(pictures, "strata"), *_strata(trial)),
            "Family first: of visible single faults; detected: single faults, visible or not; "
            "false alarm: of cases in which nothing is planted.",
        ),
    )
    sections = [Section(title, (*shown, note(words))) for title, shown, words in contents if shown]
    if trial.file.failures:
        lines = [f"Case {clean(case)}: {clean(why)}" for case, why in trial.file.failures.items()]
        rest = len(lines) - _SHOWN_FAILURES
        more = [f"... and {rest} more"] if rest > 0 else []
        failed = bullets([*lines[:_SHOWN_FAILURES], *more])
        sections.append(Section("Failed cases", (failed,)))
    notes = [f"Seed {count(trial.file.seed)}."]
    if trial.file.cases_sha256:
        notes.append(f"sha256 of the cases and their labels: `{clean(trial.file.cases_sha256)}`.")
    return Page(
        headline=formatting.sentence(reached_text(trial)),
        subtitle=f"Blind trial, part {clean(trial.file.part)}",
        preface=text(clean(summary(trial.content))),
        sections=(*sections, provenance(steps, notes=notes)),
    )


def _strata(trial: Trial) -> list[Markup]:
    tables = []
    for name, rows in strata(trial.content).items():
        unit_text = channel_unit(name)
        head = f"{channel_label(name)}{f' [{unit_text}]' if unit_text else ''}"
        body = [[bin_label(name, key), *rates] for key, rates in rows]
        tables.append(table([head, *TITLES.values()], body, range(1, 1 + len(TITLES))))
    return tables
