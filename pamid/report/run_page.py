"""Report of a run: three answers first, then the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from pamid.base.errors import join_words
from pamid.model.rig import Rig
from pamid.report import formatting
from pamid.report.added_variable_figure import ADDED_NOTE, added_panels
from pamid.report.answers import answers_of, todo_of
from pamid.report.captions import verdict_sentence
from pamid.report.channel_errors import ChannelErrors
from pamid.report.equation import cause_equations, remainder_equations
from pamid.report.evidence import evidence_of
from pamid.report.formatting import clean
from pamid.report.load import RunData
from pamid.report.markup import paragraphs
from pamid.report.page import Page, Section, asset, bullets, figures, note, text
from pamid.report.player import player_html
from pamid.report.rig_figure import panels_html
from pamid.report.style import Picture
from pamid.report.traces import Traces, traces_of, traces_scripts

Pictures = Mapping[str, Picture]


def run_page(
    run: RunData,
    rows: tuple[ChannelErrors, ...],
    pictures: Pictures,
    drawn_by: Rig | None = None,
) -> Page:
    """The report of a run with the pictures that were drawn of it; drawn_by: the rig whose pose is
    played, where the catalogue does not have it."""
    verdict, rig = verdict_sentence(run, rows), clean(run.rig)
    player, traces = player_html(run, drawn_by), traces_of(run, rows)
    scripts = (asset("player.js"),) if player else ()
    samples = (
        (Section("All samples", (traces.section,), style="samples"),) if traces.section else ()
    )
    names = [clean(recording.name) for recording in run.recordings]
    short = join_words(names) if len(names) <= 3 else f"{len(names)} recordings"
    return Page(
        headline=verdict,
        title=f"{rig}: {verdict}" if rig else verdict,
        subtitle=" · ".join(filter(None, (f"Rig {rig}" if rig else "", short))),
        preface=_warnings(run),
        cards=tuple(answer.card for answer in answers_of(run, rows) if answer.card is not None),
        todo=todo_of(run),
        sections=(
            Section("", answer_sections(run, rows, pictures, traces, player), style="answers"),
            *samples,
            Section("Evidence", tuple(evidence_of(run, rows, pictures))),
        ),
        scripts=(*scripts, *traces_scripts()) if samples else scripts,
        styles=asset("uplot.min.css").strip() + "\n" if samples else "",
    )


def _warnings(run: RunData) -> Markup:
    texts = []
    if run.fit is not None and not run.fit.converged:
        texts.append(f"{formatting.not_converged('The fit', run.fit.why)}.")
    texts += [
        f"This command did not end: {' '.join(step.command)}."
        for step in run.steps
        if not step.ended
    ]
    return paragraphs((clean(words).replace("..", ".") for words in texts), "warning")


def answer_sections(
    run: RunData,
    rows: tuple[ChannelErrors, ...],
    pictures: Pictures,
    traces: Traces | None = None,
    player: Markup | None = None,
) -> tuple[Section, ...]:
    """The three answers, the remainder and the next experiment; traces, player: the buttons and the
    motion, of a page that has them."""
    traces = traces or Traces()
    unknown = run.diagnosis is not None and run.diagnosis.unknown is not None
    # the ranking leads, unless no effect of it is the answer
    which = ["free-form", "missing", "ranking"] if unknown else ["ranking"]
    lead = next(name for name in which if name in pictures or name == "ranking")
    above = [] if unknown and lead == "ranking" else [lead]

    def drawn(*names: str) -> list[Markup]:
        return figures(pictures, *names)

    rig = ("rig",) if "rig" in pictures else ("ports",)
    panels = [panels_html(run.diagnosis)] if "rig" in pictures else []
    added = "added-variable"
    shown: dict[str, tuple[Sequence[Markup], Sequence[Markup]]] = {
        "Where": (
            [*drawn(*rig), *panels, *drawn("regimes")],
            [*drawn("timeline", "error-signal"), traces.buttons("where")],
        ),
        "Which": (
            drawn(*above),
            [
                *drawn(*(name for name in which if name not in above), added),
                *([note(ADDED_NOTE)] if added in pictures else []),
                *([added_panels(run)] if player is not None else []),
                *drawn("comparison"),
                *cause_equations(run),
            ],
        ),
        "How far": (
            drawn("budget"),
            [*drawn("window", "free-run"), traces.buttons("how far"), player or Markup("")],
        ),
        "What is left": ([] if unknown else drawn("missing"), remainder_equations(run)),
    }
    replaced = {"Where": "regimes", "How far": "budget"}  # pictures with the content of the list
    sections = []
    for answer in answers_of(run, rows):
        before, after = shown.get(answer.question, ([], []))
        listed = answer.points and replaced.get(answer.question) not in pictures
        points = [bullets(answer.points)] if listed else []
        content = (*before, *points, text(*answer.details), *after)
        sections.append(Section(answer.lead, content, 2, answer.question, "answer"))
    return tuple(sections)
