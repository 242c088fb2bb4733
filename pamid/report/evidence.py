"""The evidence behind the answers of a run, section by section: errors, candidates, sensors,
parameters, background, network and provenance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from markupsafe import Markup

from pamid.base.errors import join_words
from pamid.base.schemas.diagnosis_file import Candidate, DiagnosisFile, Transfer, Where
from pamid.base.schemas.estimates import Estimate
from pamid.base.schemas.fit_file import Combination, FitFile, LoopError
from pamid.base.share_words import chance_text
from pamid.base.units import split_column
from pamid.report import formatting
from pamid.report.added_variable_figure import added_places
from pamid.report.captions import sensor_label, split_labels
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors, disagreements, models_of
from pamid.report.equation import model_equations
from pamid.report.evidence_figures import correlation_note
from pamid.report.formatting import (
    DASH,
    INTERVAL,
    channel_label,
    channel_unit,
    clean,
    count,
    effect_label,
    number,
    percent,
    percent_span,
    port_label,
    sentence,
    unit_label,
)
from pamid.report.load import RunData
from pamid.report.markup import joined, tag
from pamid.report.page import (
    Section,
    bullets,
    code,
    details,
    figures,
    note,
    strong,
    table,
    text,
)
from pamid.report.provenance import provenance
from pamid.report.recording_errors import held_out_errors, recording_errors_table
from pamid.report.style import Picture
from pamid.simulation.scored_recording import IN_LOOP

STRAINED = 3.0
_CLOSE = 0.02  # shares that differ by less say nothing


def evidence_of(
    run: RunData, rows: tuple[ChannelErrors, ...], pictures: Mapping[str, Picture]
) -> Iterator[Section]:
    """The sections of the evidence that this run has, a level below."""
    diagnosis, fit = run.diagnosis, run.fit
    yield Section("Mean absolute error per channel", tuple(_errors(run, rows)), 3)
    if recordings := held_out_errors(run):
        texts = ["Replay: the held-out windows, on the recorded command."]
        if any(row.comparison == IN_LOOP for row in recordings):
            texts.append(
                "Closed loop: the held-out part of a run of the refitted model under its "
                "controller, from the recording's beginning."
            )
        texts.append(
            "With cause: refitted to all fitted data. The figures above are cross-validated: each "
            "half of the held-out windows is scored with the model chosen on the other half."
        )
        content = recording_errors_table(recordings), note(" ".join(texts))
        yield Section("Errors by recording and model", content, 3)
    if diagnosis is not None and diagnosis.transfer and diagnosis.causes:
        yield _transfer(diagnosis.transfer, run)
    if fit is not None and fit.closed_loop:
        yield _closed_loop(fit.closed_loop)
    if diagnosis is not None and diagnosis.ranking:
        words = f"All {len(diagnosis.ranking)} candidates that were refitted, and why they lost"
        tables = _ranking(diagnosis, added_places(run))
        yield Section("Comparison of the candidates", (details(words, *tables),), 3)
    notes = (diagnosis or fit).notes if diagnosis or fit else ()  # type: ignore[union-attr]
    if notes:
        listed = bullets(map(clean, notes))
        yield Section("What to know before believing a figure", (listed,), 3)
    if diagnosis is not None and diagnosis.where is not None and diagnosis.where.sensors:
        yield _sensors(diagnosis.where)
    yield from _parameters(run, pictures)
    yield from _background(run, pictures)
    yield Section("Residual network", tuple(_network(run, pictures)), 3)
    yield provenance(run.steps, fit, 3)


# ---- errors --------------------------------------------------------------------------------------


def _errors(run: RunData, rows: tuple[ChannelErrors, ...]) -> Iterator[Markup]:
    if rows:
        fields = models_of([row.known() for row in rows])
        shrinks = any(row.shrinkage is not None for row in rows)
        heads = ["channel", "unit", *(MODEL_NAMES[name] for name in fields)]
        heads += [f"shrinkage ({INTERVAL})"] if shrinks else []
        body = []
        for row in rows:
            cells = [*_channel(row.channel), *(number(row.known().get(name)) for name in fields)]
            if shrinks:
                interval = percent_span(row.low, row.high)
                tail = "" if interval == DASH else f" ({interval})"
                cells.append(f"{percent(row.shrinkage)}{tail}")
            body.append(cells)
        yield table(heads, body, range(2, len(heads)))
    texts = [
        "Mean of |measured − model| over the held-out windows, each model driven by the recorded "
        "command."
    ]
    differing = disagreements(run, rows)
    for file in dict.fromkeys(name for _, name, _, _ in differing):
        differences = join_words(
            f"{channel_label(channel)} {formatting.with_unit_text(other, channel_unit(channel))}"
            for channel, name, other, _ in differing
            if name == file
        )
        texts.append(f"{file} scored the refitted model on other windows: {differences}.")
    if run.residual is None:
        texts.append("There is no residual.csv, so no window is shown; `pamid fit` writes it.")
    yield note(*texts)


def _channel(name: str) -> list[str]:
    """The cells of a channel and its unit."""
    return [channel_label(name), channel_unit(name) or "-"]


def _mae_heads(channels: Sequence[str]) -> list[str]:
    return [f"{channel_label(name)} MAE [{channel_unit(name) or '-'}]" for name in channels]


def _closed_loop(errors: Mapping[str, LoopError]) -> Section:
    heads = ["channel", "unit", "data sheet", "refitted", "band (0.1 % of conductances)"]
    body = [
        [
            *_channel(channel),
            number(error.data_sheet),
            number(error.refitted),
            "" if error.band is None else f"± {number(error.band)}",
        ]
        for channel, error in errors.items()
    ]
    words = (
        "Mean absolute error of the model under its controller, over the held-out part. The "
        "band is how far it moves when the conductances change by 0.1 %: differences inside it "
        "mean nothing."
    )
    return Section("In its control loop", (table(heads, body, (2, 3, 4)), note(words)), 3)


def _transfer(transfers: tuple[Transfer, ...], run: RunData) -> Section:
    channels = list(dict.fromkeys(name for transfer in transfers for name in transfer.channels))
    body = []
    for transfer in transfers:
        known = [r.name for r in run.recordings if r.sha256.startswith(transfer.recording)]
        differs = ", ".join(f"{key} {_plainly(value)}" for key, value in transfer.differs.items())
        row = [
            clean(known[0]) if known else code(clean(transfer.recording)),
            clean(differs) or DASH,
        ]
        for channel in channels:
            errors = transfer.channels.get(channel)
            row.append(
                DASH
                if errors is None or errors.mae_with_cause is None
                else f"{number(errors.mae_refitted)} → {number(errors.mae_with_cause)} "
                f"({percent(errors.shrinkage)} removed)"
            )
        body.append(row)
    heads = ["recording", "differs in", *_mae_heads(channels)]
    words = (
        "Held-out recordings under conditions that no fitted recording has: mean absolute error "
        "of the refitted model and with the cause, on windows that were not used to choose the "
        "cause."
    )
    content = table(heads, body, range(2, len(heads))), note(words)
    return Section("Does it hold elsewhere?", content, 3)


def _plainly(value: object) -> str:
    """A value of `differs` as text: a number, a word, or the changed entries of a table."""
    if isinstance(value, dict):
        return " and ".join(f"{key} {_plainly(entry)}" for key, entry in value.items())
    plain = isinstance(value, float | int) and not isinstance(value, bool)
    return f"{value:.3g}" if plain else str(value)


# ---- candidates and sensors ----------------------------------------------------------------------


def _ranking(diagnosis: DiagnosisFile, places: Mapping[str, str]) -> Iterator[Markup]:
    """Every candidate that was refitted, best first: with its errors per channel, then with its
    parameters and why it is not the answer. places: by effect, the figure that its row leads to."""
    channels = list(
        dict.fromkeys(name for candidate in diagnosis.ranking for name in candidate.held_out)
    )
    heads = ["effect", "family", "port", "P", "held-out error removed", INTERVAL]
    heads += _mae_heads(channels)
    body = []
    for candidate in diagnosis.ranking:
        row = [
            code(clean(candidate.effect), place=places.get(candidate.effect, "")),
            effect_label(candidate.family),
            port_label(candidate.port),
            number(candidate.probability, 2),
            percent(candidate.shrinkage),
            percent_span(candidate.low, candidate.high),
        ]
        for name in channels:
            held = candidate.held_out.get(name)
            row.append(
                DASH
                if held is None or held.mae_after is None
                else f"{number(held.mae_before)} → {number(held.mae_after)}"
            )
        body.append(row)
    yield table(heads, body, range(3, len(heads)))
    reasons = []
    for candidate in diagnosis.ranking:
        values = "; ".join(
            f"{channel_label(name)} {formatting.with_unit_text(size.value, channel_unit(name))}"
            for name, size in candidate.parameters.items()
        )
        bounds = ", ".join(map(channel_label, candidate.at_bound))
        small = tag("small", f"at its bound: {bounds}") if bounds else ""
        parameters = joined([values or DASH, small])
        reasons.append([code(clean(candidate.effect)), parameters, _why_not(candidate, diagnosis)])
    yield table(["effect", "its parameters", "why it is not the answer"], reasons)


def _why_not(candidate: Candidate, diagnosis: DiagnosisFile) -> str:
    """Reason why a candidate was not chosen, from its figures."""
    named = {cause.effect for cause in diagnosis.causes}
    if candidate.effect in named:
        return "is named"
    if not candidate.converged:
        return formatting.not_converged("its fit", candidate.why)
    if candidate.shrinkage is None:
        return clean(candidate.why) or "was not refitted"
    reasons = list(candidate.set_aside)
    if candidate.effect in diagnosis.tied and named:
        reasons.append("these recordings cannot separate it from the first")
    if candidate.low is not None and candidate.low <= 0.0:
        reasons.append("its gain is not sure: the interval reaches 0")
    best = next((each for each in diagnosis.ranking if each.effect in named), None)
    if best is not None and (best.shrinkage or 0.0) - candidate.shrinkage > _CLOSE:
        reasons.append(
            f"removes {percent(candidate.shrinkage)} where {effect_label(best.effect)} removes "
            f"{percent(best.shrinkage)}"
        )
    if candidate.at_bound:
        reasons.append("needs a value at its bound")
    if not reasons and candidate.probability is not None:
        reasons.append(f"is there with probability {chance_text(candidate.probability)}")
    return "; ".join(reasons) or DASH


def _sensors(where: Where) -> Section:
    """Further sensors and the groups of ports that each would take apart."""
    body = [
        [formatting.capital(sensor_label(s.sensor)), "; ".join(split_labels(s)) or DASH]
        for s in where.sensors
    ]
    checks = ""
    if where.redundancy:
        many = "" if where.redundancy == 1 else "s"
        checks = f"These sensors allow {count(where.redundancy)} independent check{many}. "
    words = (
        f"{checks}From the structure of the rig's equations alone, for an effect of unknown form."
    )
    content = table(["additional sensor", "takes apart"], body), note(words)
    return Section("Which further sensor would help", content, 3)


# ---- parameters ----------------------------------------------------------------------------------


def parameters_of(run: RunData) -> tuple[Mapping[str, Estimate], Mapping[str, Estimate]]:
    """The parameters of the answer's model; with causes, also those without them."""
    fitted = run.fit.parameters if run.fit is not None else {}
    diagnosis = run.diagnosis
    if diagnosis is None or not diagnosis.parameters or (fitted and not diagnosis.causes):
        return fitted, {}
    return diagnosis.parameters, fitted


def _parameters(run: RunData, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    parameters, without_cause = parameters_of(run)
    if not parameters:
        return
    words = (
        "Strain is the distance from the prior in prior standard deviations. Settled: the "
        "data determine the value; weak: the prior contributes; silent: only the prior determines "
        "the value."
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
            content.append(_combinations(run.fit))
        steps, words = run.fit.stepping, ""
        if steps is not None and steps.substeps is not None:
            kind, many = "implicit" if steps.implicit else "explicit", "s" * (steps.substeps != 1)
            words = f"Simulated with {count(steps.substeps)} {kind} step{many} per sample"
            if steps.recheck is not None:
                words += (
                    "; with steps half as long no output changes by more than "
                    f"{formatting.number(steps.recheck, 2)} times its noise"
                )
            words += "."
        content.append(note(words))
    yield Section("Parameters", tuple(content), 3)


def parameter_table(
    parameters: Mapping[str, Estimate], without_cause: Mapping[str, Estimate]
) -> Markup:
    """Value, interval, prior, unit, certainty, strain and a remark; without_cause: those of the
    refitted model, if the answer has causes."""
    compared = any(name in without_cause for name in parameters)
    heads = ["parameter", "unit", "value", INTERVAL, "prior"]
    heads += ["without cause"] if compared else []
    body = []
    for name, parameter in parameters.items():
        other = without_cause.get(name)
        source = parameter.source or ("" if other is None else other.source)  # an older diagnosis
        row = [
            code(clean(name), clean(source)),
            _unit(name, parameter) or "-",
            number(parameter.value),
            formatting.span(parameter.low, parameter.high),
            number(parameter.prior),
        ]
        row += [DASH if other is None else number(other.value)] if compared else []
        strain, strained = DASH, False
        if parameter.strain is not None:
            strain = f"{parameter.strain:.1f}".replace("-", formatting.MINUS)
            strained = abs(parameter.strain) > STRAINED
        row.append(strong(strain) if strained else strain)
        end = formatting.bound_text(parameter)
        word = "" if end and parameter.word == "settled" else clean(parameter.word)
        absorbing = "may be absorbing structure" if strained else ""
        body.append([*row, ", ".join(filter(None, (word, absorbing, end))) or DASH])
    return table([*heads, "strain", "known"], body, range(2, 6 + compared))


def _unit(name: str, estimate: Estimate | Combination) -> str:
    return unit_label(split_column(name)[1] if estimate.unit is None else estimate.unit)


def _combinations(fit: FitFile) -> Section:
    body = [
        [
            code(clean(name)),
            _unit(name, estimate) or DASH,
            number(estimate.value, 5),
            f"{number(estimate.low, 5)} to {number(estimate.high, 5)}",
            number(estimate.prior),
            clean(", ".join(group.parameters)),
        ]
        for group in fit.tied
        for name in group.known
        if (estimate := fit.combinations.get(name)) is not None
    ]
    heads = ["combination", "unit", "value", INTERVAL, "prior", "ties together"]
    return Section("Known only in combination", (table(heads, body, range(2, 5)),), 4)


def _background(run: RunData, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    drawn = figures(pictures, "background")
    if not drawn:
        return
    background = run.diagnosis.background if run.diagnosis is not None else {}
    shares = [term.share_of_gap for term in background.values() if term.share_of_gap is not None]
    took = f"Together these corrections took {percent(sum(shares))} of the gap."
    words = (
        "Tolerance-sized corrections that stand in every model compared; an effect counts only "
        "beyond them."
    )
    yield Section("Background", (*drawn, note(took if shares else "", words)), 3)


def _network(run: RunData, pictures: Mapping[str, Picture]) -> Iterator[Markup]:
    network = run.network
    if network is None:
        yield note("No network was trained; `pamid train-residual` adds a network.")
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
        "It corrects the model in its loop: there the held-out error of "
        f"{clean(name)} goes from {mae['refitted']:.3g} to "
        f"{mae['with_network']:.3g}; the replay above is another comparison."
        for name, mae in run.network_errors(in_loop=True).items()
        if {"refitted", "with_network"} <= set(mae)
    ]
    if run.other_networks:
        others = ", ".join(clean(name) for other in run.other_networks for name in other.errors)
        texts.append(f"Other networks of this run correct {others}; the network above came last.")
    yield text(*texts)
    yield from figures(pictures, "window-network", "training")
