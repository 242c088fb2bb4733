"""Report of a run: three answers first, then the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from markupsafe import Markup

from pamid.model.rig import Rig
from pamid.report import formatting
from pamid.report.added_variable_figure import ADDED_NOTE, added_panels, added_places
from pamid.report.answers import answers_of, todo_of
from pamid.report.captions import verdict_sentence
from pamid.report.channel_errors import ChannelErrors, disagreements
from pamid.report.equation import cause_equations, model_equations, remainder_equations
from pamid.report.evidence_figures import correlation_note
from pamid.report.formatting import clean, count, sentence
from pamid.report.load import RunData
from pamid.report.markup import paragraphs
from pamid.report.page import Page, Section, bullets, details, figures, note, text
from pamid.report.player import player_html, player_script
from pamid.report.recording_errors import held_out_errors, recording_errors_table
from pamid.report.rig_figure import panels_html
from pamid.report.style import Picture
from pamid.report.tables import (
    combinations_table,
    loop_table,
    mae_table,
    parameter_table,
    parameters_of,
    provenance,
    ranking_table,
    rivals_table,
    sensors_table,
    transfer_table,
)
from pamid.report.traces import Traces, traces_of, traces_scripts, traces_style
from pamid.schemas.fit_file import FitFile
from pamid.simulation.scored_recording import IN_LOOP

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
    scripts = (player_script(),) if player else ()
    samples = (
        (Section("All samples", (traces.section,), style="samples"),) if traces.section else ()
    )
    recordings = run.fit.recordings if run.fit is not None else ()
    names = [clean(recording.name) for recording in recordings]
    short = formatting.join(names) if len(names) <= 3 else f"{len(names)} recordings"
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
            Section("Evidence", tuple(_evidence(run, rows, pictures))),
        ),
        scripts=(*scripts, *traces_scripts()) if samples else scripts,
        styles=traces_style() if samples else "",
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


# ---- evidence ------------------------------------------------------------------------------------


def _evidence(
    run: RunData, rows: tuple[ChannelErrors, ...], pictures: Pictures
) -> Iterator[Section]:
    """The sections of the evidence that this run has, one level below."""
    yield Section("Mean absolute error per channel", tuple(_errors(run, rows)), 3)
    if recordings := held_out_errors(run):
        texts = ["Replay: the held-out windows, on the recorded command."]
        if any(row.comparison == IN_LOOP for row in recordings):
            texts.append(
                "Closed loop: the held-out part of a run of the refitted model under its own "
                "controller, from the recording's beginning."
            )
        texts.append(
            "With cause: refitted to all that is fitted; the figures above are of what either half "
            "of the held-out windows chose for the other."
        )
        content = recording_errors_table(recordings), note(" ".join(texts))
        yield Section("Errors by recording and model", content, 3)
    diagnosis, fit = run.diagnosis, run.fit
    if diagnosis is not None and diagnosis.transfer and diagnosis.causes:
        words = (
            "Held-out recordings made under other conditions than any that was fitted: mean "
            "absolute error refitted and with the cause, on windows that did not choose it."
        )
        elsewhere = transfer_table(diagnosis.transfer, fit), note(words)
        yield Section("Does it hold elsewhere?", elsewhere, 3)
    if fit is not None and fit.closed_loop:
        words = (
            "Mean absolute error of the model under its own controller, over the held-out part. "
            "The band is how far it moves when the conductances change by 0.1 %: differences "
            "inside it mean nothing."
        )
        yield Section("In its own control loop", (loop_table(fit.closed_loop), note(words)), 3)
    if diagnosis is not None and diagnosis.ranking:
        words = f"All {len(diagnosis.ranking)} candidates that were refitted, and why they lost"
        tables = ranking_table(diagnosis, added_places(run)), rivals_table(diagnosis)
        yield Section("Comparison of the candidates", (details(words, *tables),), 3)
    notes = (diagnosis or fit).notes if diagnosis or fit else ()  # type: ignore[union-attr]
    if notes:
        listed = bullets(map(clean, notes))
        yield Section("What to know before believing a figure", (listed,), 3)
    yield from _sensors(run)
    yield from _parameters(run, pictures)
    yield from _background(run, pictures)
    yield Section("Residual network", tuple(_network(run, pictures)), 3)
    yield provenance(run.steps, fit, 3)


def _errors(run: RunData, rows: tuple[ChannelErrors, ...]) -> Iterator[Markup]:
    if rows:
        yield mae_table(rows)
    texts = [
        "Mean of |measured − model| over the held-out windows, each model driven by the recorded "
        "command."
    ]
    differing = disagreements(run, rows)
    for file in dict.fromkeys(name for _, name, _, _ in differing):
        differences = formatting.join(
            f"{formatting.channel_label(channel)} "
            f"{formatting.with_unit_text(other, formatting.channel_unit(channel))}"
            for channel, name, other, _ in differing
            if name == file
        )
        texts.append(f"{file} scored the refitted model on other windows: {differences}.")
    if run.residual is None:
        texts.append("There is no residual.csv, so no window is shown; `pamid fit` writes it.")
    yield note(*texts)


def _sensors(run: RunData) -> Iterator[Section]:
    where = run.diagnosis.where if run.diagnosis is not None else None
    if where is None or not where.sensors:
        return
    checks = ""
    if where.redundancy:
        many = "" if where.redundancy == 1 else "s"
        checks = f"These sensors allow {count(where.redundancy)} independent check{many}. "
    words = (
        f"{checks}From the structure of the rig's equations alone, for an effect of unknown form."
    )
    yield Section("Which sensor would tell more", (sensors_table(where), note(words)), 3)


def _parameters(run: RunData, pictures: Pictures) -> Iterator[Section]:
    parameters, without_cause = parameters_of(run)
    if not parameters:
        return
    words = (
        "Strain is the distance from the prior in prior standard deviations. Settled: the data "
        "fix it; weak: partly the prior; silent: the data say nothing about it."
    )
    content: list[Markup | Section] = [
        parameter_table(parameters, without_cause),
        note(words),
        *figures(pictures, "correlation"),
        note(correlation_note(run.fit)),
        *model_equations(run),
    ]
    if run.fit is not None:
        if run.fit.tied:
            combinations = (combinations_table(run.fit),)
            content.append(Section("Known only in combination", combinations, 4))
        content.append(note(_stepping(run.fit)))
    yield Section("Parameters", tuple(content), 3)


def _stepping(fit: FitFile) -> str:
    steps = fit.stepping
    if steps is None or steps.substeps is None:
        return ""
    kind, many = "implicit" if steps.implicit else "explicit", "s" * (steps.substeps != 1)
    words = f"Simulated with {count(steps.substeps)} {kind} step{many} per sample"
    if steps.recheck is not None:
        words += (
            "; with steps half as long no output changes by more than "
            f"{formatting.number(steps.recheck, 2)} times its noise"
        )
    return f"{words}."


def _background(run: RunData, pictures: Pictures) -> Iterator[Section]:
    drawn = figures(pictures, "background")
    if not drawn:
        return
    background = run.diagnosis.background if run.diagnosis is not None else {}
    shares = [term.share_of_gap for term in background.values() if term.share_of_gap is not None]
    took = f"Together these corrections took {formatting.percent(sum(shares))} of the gap."
    words = (
        "Tolerance-sized corrections that stand in every model compared; an effect counts only "
        "beyond them."
    )
    yield Section("Background", (*drawn, note(took if shares else "", words)), 3)


def _network(run: RunData, pictures: Pictures) -> Iterator[Markup]:
    network = run.network
    if network is None:
        yield note("No network was trained; `pamid train-residual` adds one.")
        return
    weights = network.n_weights
    size = f" with {count(weights)} parameters" if weights is not None else ""
    ended = clean(network.summary.why) or "no word of it"
    texts = [
        sentence(f"{clean(network.kind)} network{size}; how training ended: {ended}"),
        sentence(clean(network.summary.remark)),
        sentence(f"trained on {clean(network.target)}") if network.target else "",
    ]
    texts += [
        "It corrects the model in its own loop: there the held-out error of "
        f"{clean(name)} goes from {mae['refitted']:.3g} to "
        f"{mae['with_network']:.3g}; the replay above is another comparison."
        for name, mae in run.network_errors(in_loop=True).items()
        if {"refitted", "with_network"} <= set(mae)
    ]
    if run.beside:
        others = ", ".join(clean(name) for other in run.beside for name in other.errors)
        texts.append(f"Other networks of this run correct {others}; the one above came last.")
    yield text(*texts)
    yield from figures(pictures, "window-network", "training")
