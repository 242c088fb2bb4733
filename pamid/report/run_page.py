"""Report of a run: three answers first, then the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pamid.model.rig import Rig
from pamid.report import formatting
from pamid.report.added_variable_figure import ADDED_NOTE, added_panels, added_places
from pamid.report.answers import (
    AnswerText,
    how_far_answer,
    left_answer,
    next_answer,
    where_answer,
    which_answer,
)
from pamid.report.captions import verdict_sentence
from pamid.report.channel_errors import ChannelErrors, disagreements
from pamid.report.correlation_figure import correlation_note
from pamid.report.document import (
    Block,
    Bullets,
    Details,
    Document,
    Heading,
    Interactive,
    Paragraphs,
    Section,
    figures,
    notes,
)
from pamid.report.equation import cause_equations, model_equations, remainder_equations
from pamid.report.glance import cards_of, todo_of
from pamid.report.load import RunData
from pamid.report.player import player_html, player_script
from pamid.report.ranking import ranking_table, rivals_table
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
    sensors_table,
    transfer_table,
)
from pamid.report.traces import traces_of, traces_scripts, traces_style
from pamid.schemas.fit_file import FitFile
from pamid.simulation.scored_recording import IN_LOOP


def run_document(
    run: RunData,
    rows: tuple[ChannelErrors, ...],
    pictures: dict[str, Picture],
    drawn_by: Rig | None = None,
) -> Document:
    """The report of a run with the pictures that were drawn of it; drawn_by: the rig whose pose is
    played, where the catalogue does not have it."""
    verdict = verdict_sentence(run, rows)
    player, traces = player_html(run, drawn_by), traces_of(run, rows)
    rig = formatting.clean(run.rig)
    samples = [Interactive(traces.section, "All samples", "samples")] if traces.section else []
    return Document(
        title=f"{rig}: {verdict}" if rig else verdict,
        subtitle=_subtitle(run),
        headline=verdict,
        preface=_warnings(run),
        cards=cards_of(run, rows),
        todo=todo_of(run),
        blocks=(
            Section(
                answer_sections(
                    run,
                    rows,
                    pictures,
                    where=[Interactive(traces.buttons("where"))],
                    which=[Interactive(added_panels(run))],
                    how_far=[Interactive(traces.buttons("how far")), Interactive(player)],
                ),
                "answers",
            ),
            *samples,
            _evidence(run, rows, pictures),
        ),
        scripts=(
            *((player_script(),) if player else ()),
            *(traces_scripts() if samples else ()),
        ),
        styles=traces_style() if samples else "",
    )


def answer_sections(
    run: RunData,
    rows: tuple[ChannelErrors, ...],
    pictures: dict[str, Picture],
    *,
    where: Sequence[Block] = (),
    which: Sequence[Block] = (),
    how_far: Sequence[Block] = (),
) -> tuple[Section, ...]:
    """The three answers, the remainder and the next experiment; where, which, how_far: further
    blocks below these answers."""
    unknown = run.diagnosis is not None and run.diagnosis.unknown is not None
    left = left_answer(run)
    # the ranking leads, unless no effect of it is the answer
    order = ("free-form", "missing", "ranking") if unknown else ("ranking",)
    lead = next((name for name in order[:-1] if name in pictures), order[-1])
    above = () if unknown and lead == "ranking" else (lead,)

    def drawn(*names: str) -> tuple[Block, ...]:
        return figures(pictures, names)

    return (
        _answer(
            "Where",
            where_answer(run),
            (
                *drawn("rig"),
                *_panels(run, pictures),
                *(() if "rig" in pictures else drawn("ports")),
                *drawn("regimes"),
            ),
            (*drawn("timeline", "error-signal"), *where),
            listed="regimes" not in pictures,
        ),
        _answer(
            "Which",
            which_answer(run),
            drawn(*above),
            (
                *drawn(*(n for n in order if n not in above), "added-variable"),
                *([notes(ADDED_NOTE)] if "added-variable" in pictures else []),
                *which,
                *drawn("comparison"),
                *cause_equations(run),
            ),
        ),
        _answer(
            "How far",
            how_far_answer(run, rows),
            drawn("budget"),
            (*drawn("window", "free-run"), *how_far),
            listed="budget" not in pictures,
        ),
        *(
            (
                _answer(
                    "What is left",
                    left,
                    () if unknown else drawn("missing"),
                    remainder_equations(run),
                ),
            )
            if left is not None
            else ()
        ),
        _answer("Next experiment", next_answer(run)),
    )


def _answer(
    question: str,
    answer: AnswerText,
    above: Sequence[Block] = (),
    below: Sequence[Block] = (),
    *,
    listed: bool = True,
) -> Section:
    """Lead sentence, pictures, list, sentences and further blocks; listed: the list is shown
    because no picture has its content."""
    points = [Bullets(answer.points)] if answer.points and listed else []
    heading = Heading(answer.lead, question=question)
    return Section((heading, *above, *points, Paragraphs(answer.details), *below), "answer")


def _panels(run: RunData, pictures: dict[str, Picture]) -> tuple[Block, ...]:
    """Panels of the rig's diagram."""
    if "rig" not in pictures or run.diagnosis is None:
        return ()
    return (Interactive(panels_html(run.diagnosis)),)


def _subtitle(run: RunData) -> str:
    parts = [f"Rig {formatting.clean(run.rig)}"] if run.rig else []
    if run.fit is not None and run.fit.recordings:
        names = [formatting.clean(recording.name) for recording in run.fit.recordings]
        parts.append(formatting.join(names) if len(names) <= 3 else f"{len(names)} recordings")
    return " · ".join(parts)


def _warnings(run: RunData) -> Paragraphs:
    texts = []
    if run.fit is not None and not run.fit.converged:
        texts.append(f"{formatting.not_converged('The fit', run.fit.why)}.")
    texts += [
        f"This command did not end: {' '.join(step.command)}."
        for step in run.steps
        if not step.ended
    ]
    return Paragraphs(tuple(formatting.clean(text).replace("..", ".") for text in texts), "warning")


def _evidence(
    run: RunData, rows: tuple[ChannelErrors, ...], pictures: dict[str, Picture]
) -> Section:
    return Section(
        (
            Heading("Evidence"),
            *_errors(run, rows),
            *_transfer(run),
            *_closed_loop(run),
            *_candidates(run),
            *_notes(run),
            *_sensors(run),
            *_parameters(run, pictures),
            *_background(run, pictures),
            *_network(run, pictures),
            *provenance(run.steps, run.fit, level=3),
        )
    )


def _errors(run: RunData, rows: tuple[ChannelErrors, ...]) -> Iterator[Block]:
    yield Heading("Mean absolute error per channel", 3)
    if rows:
        yield mae_table(rows)
    texts = [
        "Mean of |measured − model| over the held-out windows, each model driven by the recorded "
        "command."
    ]
    differing = disagreements(run, rows)
    for file in dict.fromkeys(difference[1] for difference in differing):
        differences = [
            f"{formatting.channel_label(channel)} "
            f"{formatting.with_unit_text(other, formatting.channel_unit(channel))}"
            for channel, name, other, _ in differing
            if name == file
        ]
        texts.append(
            f"{file} scored the refitted model on other windows: {formatting.join(differences)}."
        )
    if run.residual is None:
        texts.append("There is no residual.csv, so no window is shown; `pamid fit` writes it.")
    yield notes(*texts)
    if recordings := held_out_errors(run):
        yield Heading("Errors by recording and model", 3)
        yield recording_errors_table(recordings)
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
        yield notes(" ".join(texts))


def _transfer(run: RunData) -> Iterator[Block]:
    if run.diagnosis is None or not (run.diagnosis.transfer and run.diagnosis.causes):
        return
    yield Heading("Does it hold elsewhere?", 3)
    yield transfer_table(run.diagnosis.transfer, run.fit)
    yield notes(
        "Held-out recordings made under other conditions than any that was fitted: mean absolute "
        "error refitted and with the cause, on windows that did not choose it."
    )


def _closed_loop(run: RunData) -> Iterator[Block]:
    if run.fit is None or not run.fit.closed_loop:
        return
    yield Heading("In its own control loop", 3)
    yield loop_table(run.fit.closed_loop)
    yield notes(
        "Mean absolute error of the model under its own controller, over the held-out part. The "
        "band is how far it moves when the conductances change by 0.1 %: differences inside it "
        "mean nothing."
    )


def _candidates(run: RunData) -> Iterator[Block]:
    diagnosis = run.diagnosis
    if diagnosis is None or not diagnosis.ranking:
        return
    yield Heading("Comparison of the candidates", 3)
    yield Details(
        f"All {len(diagnosis.ranking)} candidates that were refitted, and why they lost",
        (ranking_table(diagnosis, added_places(run)), rivals_table(diagnosis)),
    )


def _notes(run: RunData) -> Iterator[Block]:
    """Notes of the diagnosis, of a fit without one those of the fit."""
    source = run.diagnosis or run.fit
    texts = (source.notes if source is not None else None) or ()
    if texts:
        yield Heading("What to know before believing a figure", 3)
        yield Bullets(tuple(formatting.clean(note) for note in texts))


def _sensors(run: RunData) -> Iterator[Block]:
    where = run.diagnosis.where if run.diagnosis is not None else None
    if where is None or not where.sensors:
        return
    checks = (
        f"These sensors allow {formatting.count(where.redundancy)} independent "
        f"check{'' if where.redundancy == 1 else 's'}. "
        if where.redundancy
        else ""
    )
    yield Heading("Which sensor would tell more", 3)
    yield sensors_table(where)
    yield notes(
        f"{checks}From the structure of the rig's equations alone, for an effect of unknown form."
    )


def _parameters(run: RunData, pictures: dict[str, Picture]) -> Iterator[Block]:
    parameters, without_cause = parameters_of(run)
    if not parameters:
        return
    yield Heading("Parameters", 3)
    yield parameter_table(parameters, without_cause)
    yield notes(
        "Strain is the distance from the prior in prior standard deviations. Settled: the data "
        "fix it; weak: partly the prior; silent: the data say nothing about it."
    )
    yield from figures(pictures, ["correlation"])
    yield notes(correlation_note(run.fit))
    yield from model_equations(run)
    if run.fit is not None and run.fit.tied:
        yield Heading("Known only in combination", 4)
        yield combinations_table(run.fit)
    if run.fit is not None:
        yield notes(_stepping(run.fit))


def _stepping(fit: FitFile) -> str:
    steps = fit.stepping
    if steps is None or steps.substeps is None:
        return ""
    kind = "implicit" if steps.implicit else "explicit"
    text = (
        f"Simulated with {formatting.count(steps.substeps)} {kind} "
        f"step{'' if steps.substeps == 1 else 's'} per sample"
    )
    if steps.recheck is not None:
        text += (
            "; with steps half as long no output changes by more than "
            f"{formatting.number(steps.recheck, 2)} times its noise"
        )
    return f"{text}."


def _background(run: RunData, pictures: dict[str, Picture]) -> Iterator[Block]:
    drawn = figures(pictures, ["background"])
    if not drawn:
        return
    background = run.diagnosis.background if run.diagnosis is not None else {}
    shares = [term.share_of_gap for term in background.values() if term.share_of_gap is not None]
    took = f"Together these corrections took {formatting.percent(sum(shares))} of the gap."
    yield Heading("Background", 3)
    yield from drawn
    yield notes(
        took if shares else "",
        "Tolerance-sized corrections that stand in every model compared; an effect counts only "
        "beyond them.",
    )


def _network(run: RunData, pictures: dict[str, Picture]) -> Iterator[Block]:
    yield Heading("Residual network", 3)
    network = run.network
    if network is None:
        yield notes("No network was trained; `pamid train-residual` adds one.")
        return
    size = (
        f" with {formatting.count(network.n_weights)} parameters"
        if network.n_weights is not None
        else ""
    )
    ended = formatting.clean(network.summary.why) or "no word of it"
    texts = [
        formatting.sentence(
            f"{formatting.clean(network.kind)} network{size}; how training ended: {ended}"
        ),
        formatting.sentence(formatting.clean(network.summary.remark)),
        formatting.sentence(f"trained on {formatting.clean(network.target)}")
        if network.target
        else "",
    ]
    texts += [
        "It corrects the model in its own loop: there the held-out error of "
        f"{formatting.clean(name)} goes from {mae['refitted']:.3g} to "
        f"{mae['with_network']:.3g}; the replay above is another comparison."
        for name, mae in run.network_errors(in_loop=True).items()
        if {"refitted", "with_network"} <= set(mae)
    ]
    if run.beside:
        others = ", ".join(formatting.clean(name) for other in run.beside for name in other.errors)
        texts.append(f"Other networks of this run correct {others}; the one above came last.")
    yield Paragraphs(tuple(texts))
    yield from figures(pictures, ["window-network", "training"])
