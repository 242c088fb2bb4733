"""One HTML page from a trial: the targets first, then how the figures come about."""

from __future__ import annotations

from pamid.report import words
from pamid.report.markup import Html, Part, joined, paragraphs, prose, tag
from pamid.report.page import document, figure_html
from pamid.report.style import Picture
from pamid.report.tables import inputs_table, steps_table, table, versions_words
from pamid.report.trial import Trial, reached_words
from pamid.report.words import effect_words
from pamid.schemas.run import Step
from pamid.trial.table import HEAD, TITLES, strata, summary

_SHOWN_FAILURES = 20


def trial_html(trial: Trial, steps: tuple[Step, ...], pictures: dict[str, Picture]) -> str:
    """The whole page as text."""
    lead = words.sentence(reached_words(trial))
    main = tag(
        "main",
        tag(
            "header",
            tag("p", f"Blind trial, part {words.clean(trial.content['part'])}", class_="rig"),
            tag("h1", prose(lead)),
            paragraphs([words.clean(summary(dict(trial.content)))]),
        ),
        _section(
            "Figures and targets",
            pictures,
            "targets",
            _figures(trial),
            "Intervals: Wilson for shares, bootstrap over cases for the others, 95 %.",
        ),
        _section(
            "Are stated probabilities right?",
            pictures,
            "reliability",
            Html(""),
            "Answers in ten bins of the probability that the diagnosis stated for its first "
            "candidate.",
        ),
        _section(
            "What is taken for what?",
            pictures,
            "confusion",
            _confusion(trial),
            "Visible single faults; in parentheses how naming a family was avoided.",
        ),
        _section(
            "When does it work?",
            pictures,
            "strata",
            _strata(trial),
            "Family first: of visible single faults; detected: single faults, visible or not; "
            "false alarm: of "
            "cases in which nothing is planted.",
        ),
        _failures(trial),
        _provenance(trial, steps),
    )
    return document(lead, main)


def _section(title: str, pictures: dict[str, Picture], name: str, below: Html, note: str) -> Html:
    if name not in pictures and not below:
        return Html("")
    shown = [figure_html(pictures[name])] if name in pictures else []
    return tag("section", tag("h2", title), shown, below, paragraphs([note], "note"))


def _figures(trial: Trial) -> Html:
    body: list[list[Part]] = []
    for one in trial.scored:
        outcome: Part = "no cases" if one.row.target is not None and one.value is None else ""
        if one.reached is not None:
            outcome = "reached" if one.reached else tag("strong", "missed")
        body.append([*(text.replace(" .. ", " to ") for text in one.texts), outcome])
    return table([*HEAD, ""], body, (1, 2, 3, 4))


def _confusion(trial: Trial) -> Html:
    body = [
        [
            effect_words(family),
            ", ".join(f"{effect_words(answer)} {words.count(n)}" for answer, n in row.items()),
        ]
        for family, row in trial.confusion.items()
    ]
    if not body:
        return Html("")
    return tag("details", tag("summary", "The same in words"), table(["planted", "answers"], body))


def _strata(trial: Trial) -> Html:
    parts = []
    for name, rows in strata(dict(trial.content)).items():
        unit_text = words.channel_unit(name)
        head = f"{words.channel_words(name)}{f' [{unit_text}]' if unit_text else ''}"
        parts.append(
            table(
                [head, *TITLES.values()],
                [[words.clean(key), *rates] for key, rates in rows],
                range(1, 1 + len(TITLES)),
            )
        )
    return joined(parts)


def _failures(trial: Trial) -> Html:
    if not trial.failures:
        return Html("")
    told = [
        f"Case {words.clean(number)}: {words.clean(why)}" for number, why in trial.failures.items()
    ]
    more = [f"... and {len(told) - _SHOWN_FAILURES} more"] if len(told) > _SHOWN_FAILURES else []
    points = [tag("li", one) for one in told[:_SHOWN_FAILURES] + more]
    return tag("section", tag("h2", "Failed cases"), tag("ul", points))


def _provenance(trial: Trial, steps: tuple[Step, ...]) -> Html:
    told = [f"Seed {words.count(trial.content['seed'])}."]
    told += (
        [f"sha256 of the cases and their labels: `{words.clean(trial.digest)}`."]
        if trial.digest
        else []
    )
    parts: list[Part] = [tag("h2", "Provenance"), tag("div", steps_table(steps), class_="steps")]
    parts += [inputs_table(steps)] if any(step.inputs for step in steps) else []
    return tag("section", parts, paragraphs([*told, versions_words(steps)], "note"))
