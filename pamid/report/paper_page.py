"""Report of a reproduced paper: result, tables, pictures, provenance."""

from __future__ import annotations

from collections.abc import Iterator

from pamid.report import formatting
from pamid.report.channel_errors import ChannelErrors
from pamid.report.document import (
    Block,
    Document,
    Heading,
    Image,
    Paragraphs,
    Section,
    notes,
    table,
)
from pamid.report.load import RunData
from pamid.report.papers import PaperStory, Still, Topic
from pamid.report.run_page import answer_sections
from pamid.report.style import Picture
from pamid.report.tables import provenance
from pamid.schemas.run_file import Step


def paper_document(
    paper: PaperStory,
    steps: tuple[Step, ...],
    run: RunData | None,
    rows: tuple[ChannelErrors, ...],
    pictures: dict[str, Picture],
) -> Document:
    """The report of a paper; run: of the diagnosis that belongs to it, if there is one."""
    stills = {still.name: still for still in paper.stills}
    answers: tuple[Block, ...] = ()
    if run is not None:
        heading = Heading("The diagnosis of the training record")
        answers = (heading, *answer_sections(run, rows, pictures))
    return Document(
        title=paper.lead,
        subtitle=paper.subtitle,
        headline=paper.lead,
        preface=Paragraphs(tuple(map(formatting.clean, paper.warnings)), "warning"),
        blocks=(
            *(
                Section(tuple(_topic(topic, stills)))
                for topic in paper.topics
                if topic.rows or any(topic.sentences)
            ),
            *answers,
            Section(provenance(steps)),
        ),
    )


def _topic(topic: Topic, stills: dict[str, Still]) -> Iterator[Block]:
    yield Heading(topic.title)
    head, *body = topic.rows or ((),)
    if body:
        yield table(
            head, body, [column for column in range(1, len(head)) if column not in topic.left]
        )
    yield notes(*map(formatting.clean, topic.sentences))
    if topic.still in stills:
        still = stills[topic.still]
        yield Image(still.name, topic.title, still.png, still.wide_px, still.tall_px)
