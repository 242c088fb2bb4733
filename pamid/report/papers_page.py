"""One HTML page from a reproduced paper: what came out, the tables, the pictures, provenance."""

from __future__ import annotations

import base64

from pamid.report import words
from pamid.report.budget import ChannelErrors
from pamid.report.load import RunData
from pamid.report.markup import Html, Part, paragraphs, prose, tag
from pamid.report.page import answers_html, document
from pamid.report.papers import Paper, Section, Still
from pamid.report.style import Picture
from pamid.report.tables import inputs_table, steps_table, table, versions_words
from pamid.schemas.run import Step


def paper_html(
    paper: Paper,
    steps: tuple[Step, ...],
    run: RunData | None,
    rows: tuple[ChannelErrors, ...],
    pictures: dict[str, Picture],
) -> str:
    """The whole page as text; run: of the diagnosis that belongs to the paper, where there is
    one."""
    answers = (
        ""
        if run is None
        else [tag("h2", "The diagnosis of the training record"), answers_html(run, rows, pictures)]
    )
    main = tag(
        "main",
        tag(
            "header",
            tag("p", paper.subtitle, class_="rig"),
            tag("h1", prose(paper.lead)),
            paragraphs(map(words.clean, paper.warnings), "warning"),
        ),
        [_section(one, {still.name: still for still in paper.stills}) for one in paper.sections],
        answers,
        _provenance(steps),
    )
    return document(paper.lead, main)


def _section(one: Section, stills: dict[str, Still]) -> Html:
    if not one.rows and not any(one.sentences):
        return Html("")
    head, *body = one.rows or ((),)
    numeric = [column for column in range(1, len(head)) if column not in one.left]
    shown: Part = table(head, body, numeric) if body else ""
    picture: Part = _still(stills[one.still], one.title) if one.still in stills else ""
    return tag(
        "section",
        tag("h2", one.title),
        shown,
        paragraphs(map(words.clean, one.sentences), "note"),
        picture,
    )


def _still(still: Still, title: str) -> Html:
    """The picture as the run has drawn it, its finding in it."""
    source = f"data:image/png;base64,{base64.b64encode(still.png).decode()}"
    return tag(
        "figure",
        tag("img", src=source, alt=title, width=str(still.wide_px), height=str(still.tall_px)),
        id=f"figure-still-{still.name}",
    )


def _provenance(steps: tuple[Step, ...]) -> Html:
    inputs = inputs_table(steps) if any(step.inputs for step in steps) else ""
    return tag(
        "section",
        tag("h2", "Provenance"),
        tag("div", steps_table(steps), class_="steps"),
        inputs,
        paragraphs([versions_words(steps)], "note"),
    )
