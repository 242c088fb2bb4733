"""One HTML page from what was read and drawn: three answers first, then the evidence. Nothing in it
is loaded from elsewhere and nothing runs but the player of the rig's movement; a policy in its head
says so to the browser as well.
"""

from __future__ import annotations

import base64
import hashlib
from importlib import resources

from pamid.report import words
from pamid.report.answers import Answer, how_far_answer, next_answer, where_answer, which_answer
from pamid.report.budget import ChannelErrors, disagreements
from pamid.report.equation import equations_html, model_equations_html
from pamid.report.load import RunData
from pamid.report.markup import Html, Part, joined, paragraphs, prose, tag
from pamid.report.player import player_html, player_script
from pamid.report.sentences import verdict_sentence
from pamid.report.style import COLOURS, Picture
from pamid.report.tables import (
    grounds_table,
    inputs_table,
    loop_table,
    mae_table,
    parameter_table,
    parameters_of,
    ranking_table,
    recordings_table,
    sensors_table,
    steps_table,
    together_table,
    transfer_table,
    versions_words,
)
from pamid.report.traces import Traces, traces_of, traces_scripts, traces_style
from pamid.schemas.fit import FitFile

MARK = "<!doctype html>\n<!-- pamid.report/1 -->\n"
#: drawings carry their styles themselves, hence the attributes; style elements and scripts are
#: allowed by their hashes
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; style-src-attr 'unsafe-inline'"
)


def page_html(run: RunData, rows: tuple[ChannelErrors, ...], pictures: dict[str, Picture]) -> str:
    """The whole page of a run as text."""
    verdict = verdict_sentence(run, rows)
    rig, player, traces = words.clean(run.rig), player_html(run), traces_of(run, rows)
    main = tag(
        "main",
        tag(
            "header",
            tag("p", _subtitle(run), class_="rig"),
            tag("h1", prose(verdict)),
            _warnings(run),
        ),
        answers_html(run, rows, pictures, traces, player),
        traces.section,
        _evidence(run, rows, pictures),
    )
    scripts = (
        *((player_script(),) if player else ()),
        *(traces_scripts() if traces.section else ()),
    )
    return document(
        f"{rig}: {verdict}" if rig else verdict,
        main,
        scripts,
        traces_style() if traces.section else "",
    )


def answers_html(
    run: RunData,
    rows: tuple[ChannelErrors, ...],
    pictures: dict[str, Picture],
    traces: Traces | None = None,
    player: Part = "",
) -> Html:
    """The three answers and the next experiment, with buttons that lead to places in the traces."""
    where, far = (
        ("", "") if traces is None else (traces.buttons("where"), traces.buttons("how far"))
    )
    return joined(
        [
            _answer(
                "Where", where_answer(run), pictures, ("ports", "regimes"), ("timeline",), where
            ),
            _answer(
                "Which", which_answer(run), pictures, *_which_pictures(run), equations_html(run)
            ),
            _answer(
                "How far",
                how_far_answer(run, rows),
                pictures,
                ("budget",),
                ("window",),
                [far, player],
            ),
            _answer("Next experiment", next_answer(run), pictures),
        ]
    )


def document(title: str, main: Html, scripts: tuple[str, ...] = (), style: str = "") -> str:
    """A page with this title and content, that loads nothing and runs nothing but what every page
    runs and these scripts of ours; style: rules that they need."""
    every, sheet = (page_script(), *scripts), f"{_style_sheet()}{style}"
    policy = f"{_POLICY}; style-src-elem {_hash(sheet)}; script-src {' '.join(map(_hash, every))}"
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        tag("style", Html(sheet)),
    )
    body = tag("body", main, [tag("script", Html(script)) for script in every])
    return MARK + tag("html", head, body, lang="en") + "\n"


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def page_script() -> str:
    """What runs on every page: its colours by choice, tables that can be copied."""
    return _asset("page.js")


def _asset(name: str) -> str:
    return resources.files("pamid.report").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def _style_sheet() -> str:
    """Light and dark as the system asks, unless the reader has chosen; prints are light."""
    light, dark = (
        "".join(f"--{role.replace('_', '-')}:{pair[k]};" for role, pair in COLOURS.items())
        for k in (0, 1)
    )
    font = (
        "--font:system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,'DejaVu "
        "Sans',sans-serif;"
    )
    return (
        f":root{{color-scheme:light "
        f"dark;{font}{light}}}\n:root[data-colours=light]{{color-scheme:light}}\n"
        f"@media screen{{:root[data-colours=dark]{{color-scheme:dark;{dark}}}}}\n@media screen and "
        f"(prefers-color-scheme:dark){{:root:not([data-colours=light]){{{dark}}}}}\n{_asset('page.css')}"
    )


def _subtitle(run: RunData) -> str:
    parts = [f"Rig {words.clean(run.rig)}"] if run.rig else []
    if run.fit is not None and run.fit.recordings:
        names = [words.clean(one.name) for one in run.fit.recordings]
        shown = words.join(names) if len(names) <= 3 else f"{len(names)} recordings"
        parts.append(shown)
    return " · ".join(parts)


def _warnings(run: RunData) -> Html:
    told = []
    if run.fit is not None and not run.fit.converged:
        told.append(f"The fit did not converge: {words.clean(run.fit.why) or 'no reason given'}.")
    if run.network is not None and not run.network.summary.converged:
        told.append(
            f"The training of the network did not converge: {words.clean(run.network.summary.why)}."
        )
    told += [
        f"This command did not end: {' '.join(step.command)}."
        for step in run.steps
        if not step.ended
    ]
    return paragraphs((words.clean(one).replace("..", ".") for one in told), "warning")


def _which_pictures(run: RunData) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The ranking leads, unless no effect of it is the answer."""
    unknown = run.diagnosis is not None and run.diagnosis.unknown is not None
    return (("missing",), ("ranking",)) if unknown else (("ranking",), ())


def _answer(
    question: str,
    answer: Answer,
    pictures: dict[str, Picture],
    above: tuple[str, ...] = (),
    below: tuple[str, ...] = (),
    more: Part = "",
) -> Html:
    """Lead sentence, pictures, list, sentences, further pictures, what else belongs to it."""
    heading = tag("h2", tag("span", question, class_="question"), prose(answer.lead))
    first, last = (
        [figure_html(pictures[name]) for name in names if name in pictures]
        for names in (above, below)
    )
    points = (
        tag("ul", [tag("li", prose(point)) for point in answer.points]) if answer.points else ""
    )
    return tag(
        "section", heading, first, points, paragraphs(answer.details), last, more, class_="answer"
    )


def figure_html(picture: Picture) -> Html:
    """The picture in both widths, its finding above it; one of the two shows."""
    return tag(
        "figure",
        tag("figcaption", prose(picture.title)),
        tag("div", Html(picture.wide), class_="wide", role="img", aria_label=picture.title),
        tag("div", Html(picture.narrow), class_="narrow", role="img", aria_label=picture.title),
        id=f"figure-{picture.name}",
    )


def _evidence(run: RunData, rows: tuple[ChannelErrors, ...], pictures: dict[str, Picture]) -> Html:
    return tag(
        "section",
        tag("h2", "Evidence"),
        _errors(run, rows),
        _transfer(run),
        _closed_loop(run),
        _candidates(run),
        _sensors(run),
        _parameters(run),
        _background(run, pictures),
        _network(run, pictures),
        _provenance(run),
    )


def _errors(run: RunData, rows: tuple[ChannelErrors, ...]) -> Html:
    parts: list[Part] = [tag("h3", "Mean absolute error per channel")]
    if rows:
        parts.append(mae_table(rows))
    notes = [
        "Mean of |measured − model| over the held-out windows, each model driven by the recorded "
        "command."
    ]
    told = disagreements(run, rows)
    for file in dict.fromkeys(one[1] for one in told):
        found = [
            f"{words.channel_words(channel)} "
            f"{words.with_unit_text(other, words.channel_unit(channel))}"
            for channel, name, other, _ in told
            if name == file
        ]
        notes.append(f"{file} scored the refitted model on other windows: {words.join(found)}.")
    if run.residual is None:
        notes.append("There is no residual.csv, so no window is shown; `pamid fit` writes it.")
    return joined([*parts, paragraphs(notes, "note")])


def _closed_loop(run: RunData) -> Html:
    head = tag("h3", "In its own control loop")
    if run.fit is None or not run.fit.closed_loop:
        return joined(
            [
                head,
                paragraphs(
                    [
                        "No closed-loop error: it needs a recording whose controller is known "
                        "(`[controller]` in its TOML file) in `pamid fit`."
                    ],
                    "note",
                ),
            ]
        )
    note = (
        "Mean absolute error of the model under its own controller, over the held-out part. The "
        "band is how far "
        "it moves when the conductances change by 0.1 %: differences inside it mean nothing."
    )
    return joined([head, loop_table(run.fit.closed_loop), paragraphs([note], "note")])


def _transfer(run: RunData) -> Html:
    if run.diagnosis is None or not run.diagnosis.transfer:
        return Html("")
    note = (
        "Held-out recordings made under other conditions than any that was fitted: mean absolute "
        "error refitted "
        "and with the cause, on windows that did not choose it."
    )
    return joined(
        [
            tag("h3", "Does it hold elsewhere?"),
            transfer_table(run.diagnosis.transfer, run.fit),
            paragraphs([note], "note"),
        ]
    )


def _candidates(run: RunData) -> Html:
    diagnosis = run.diagnosis
    if diagnosis is None or not diagnosis.ranking:
        return Html("")
    count = len(diagnosis.ranking)
    parts: list[Part] = [tag("h3", "What the verdict rests on")]
    if diagnosis.grounds is not None and (figures := diagnosis.grounds.numbers()):
        parts += [
            grounds_table(figures),
            paragraphs(["All on the held-out windows that choose."], "note"),
        ]
    parts.append(
        tag(
            "details",
            tag("summary", f"All {count} candidates that were refitted"),
            ranking_table(diagnosis),
        )
    )
    classes = [
        words.join(map(words.effect_words, group))
        for group in diagnosis.look_alikes
        if len(group) > 1
    ]
    if classes:
        parts += [
            tag("h3", "Look-alikes"),
            tag("ul", [tag("li", prose(one)) for one in classes]),
            paragraphs(
                ["Effects of one class predict the same, within the noise, on these recordings."],
                "note",
            ),
        ]
    return joined(parts)


def _sensors(run: RunData) -> Html:
    where = run.diagnosis.where if run.diagnosis is not None else None
    if where is None or not where.sensors:
        return Html("")
    checks = (
        f"These sensors allow {words.count(where.redundancy)} independent checks. "
        if where.redundancy
        else ""
    )
    note = (
        f"{checks}From the structure of the rig's equations alone, for an effect of unknown form."
    )
    return joined(
        [
            tag("h3", "Which sensor would tell more"),
            sensors_table(where),
            paragraphs([note], "note"),
        ]
    )


def _parameters(run: RunData) -> Html:
    parameters, with_cause = parameters_of(run)
    if not parameters:
        return Html("")
    note = (
        "Strain is the distance from the prior in prior standard deviations. Settled: the data "
        "fix it; weak: "
        "partly the prior; silent: the data say nothing about it."
    )
    return joined(
        [
            tag("h3", "Parameters"),
            parameter_table(parameters, with_cause),
            paragraphs([note], "note"),
            model_equations_html(run),
            *(
                [tag("h4", "Known only in combination"), together_table(run.fit)]
                if run.fit is not None and run.fit.tied
                else []
            ),
            paragraphs([_stepping(run.fit)] if run.fit is not None else [], "note"),
        ]
    )


def _stepping(fit: FitFile) -> str:
    steps = fit.stepping
    if steps is None or steps.substeps is None:
        return ""
    kind = "implicit" if steps.implicit else "explicit"
    text = (
        f"Simulated with {words.count(steps.substeps)} {kind} "
        f"step{'' if steps.substeps == 1 else 's'} per sample"
    )
    if steps.recheck is not None:
        text += (
            f"; doubled steps change no output by more than {words.number(steps.recheck, 2)} "
            "noise standard "
        )
        text += "deviations"
    return f"{text}."


def _background(run: RunData, pictures: dict[str, Picture]) -> Html:
    if "background" not in pictures:
        return Html("")
    told = []
    if run.diagnosis is not None:
        shares = [
            one.share_of_gap
            for one in run.diagnosis.background.values()
            if one.share_of_gap is not None
        ]
        told = (
            [f"Together these corrections took {words.percent(sum(shares))} of the gap."]
            if shares
            else []
        )
    note = (
        "Tolerance-sized corrections that stand in every model compared; an effect counts only "
        "beyond them."
    )
    return joined(
        [
            tag("h3", "Background"),
            figure_html(pictures["background"]),
            paragraphs([*told, note], "note"),
        ]
    )


def _network(run: RunData, pictures: dict[str, Picture]) -> Html:
    head = tag("h3", "Residual network")
    if run.network is None:
        return joined(
            [head, paragraphs(["No network was trained; `pamid train-residual` adds one."], "note")]
        )
    one = run.network
    size = f" with {words.count(one.n_weights)} parameters" if one.n_weights is not None else ""
    ended = words.clean(one.summary.why) or "no word of it"
    told = [
        words.sentence(f"{words.clean(one.kind)} network{size}; how training ended: {ended}"),
        words.sentence(words.clean(one.summary.remark)),
    ]
    if one.in_loop:
        told += [
            "It corrects the model in its own loop: there the held-out error of "
            f"{words.clean(name)} goes from "
            f"{mae['refitted']:.3g} to {mae['with_network']:.3g}; the replay above is another "
            "comparison."
            for name, mae in one.errors.items()
            if {"refitted", "with_network"} <= set(mae)
        ]
    shown = [
        figure_html(pictures[name]) for name in ("window-network", "training") if name in pictures
    ]
    return joined([head, paragraphs(told), *shown])


def _provenance(run: RunData) -> Html:
    parts: list[Part] = [
        tag("h3", "Provenance"),
        tag("div", steps_table(run.steps), class_="steps"),
    ]
    if run.fit is not None and run.fit.recordings:
        parts.append(recordings_table(run.fit))
    if any(step.inputs for step in run.steps):
        parts.append(inputs_table(run.steps))
    return joined([*parts, paragraphs([versions_words(run.steps)], "note")])
