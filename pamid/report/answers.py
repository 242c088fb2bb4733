"""The three answers, the remainder and the next experiment. An `Answer` holds both its card and
its section of the page, so that the two cannot contradict each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import quoted
from pamid.base.share_words import minutes_text, times_text
from pamid.checks.sampling_slips import OF_THE_LOG
from pamid.report import formatting
from pamid.report.added_variable_figure import added_leaders
from pamid.report.captions import (
    SPELLING,
    added_line,
    at_port,
    causes_label,
    closest,
    first_parameter,
    missing_term,
    ports_text,
    reason_text,
    regime_label,
    sensor_label,
    set_figures,
    split_labels,
    taken_up,
)
from pamid.report.channel_errors import ChannelErrors, headline
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    interval_tail,
    not_converged,
    percent,
    percent_span,
    port_label,
    sentence,
    short,
    with_unit_text,
)
from pamid.report.formula import formula_text
from pamid.report.load import RunData
from pamid.report.page import Card
from pamid.schemas.diagnosis_file import (
    Cause,
    DiagnosisFile,
    NextExperiment,
    Regime,
    Unknown,
    Where,
)
from pamid.verdict import verdict_words
from pamid.verdict.refitted_parameters import bound_text, refitted_parameters
from pamid.verdict.verdict_words import chance_figure

PROBABILITY_MEANS = (
    "A probability is how often, among virtual machines with figures like these, an effect of that "
    "family was really there"
)
DIAGNOSE_HINT = "`pamid diagnose` on the same recordings adds this answer."
CHECK_FIRST = "Check the recordings first."
_MOST_WINDOWS, _MOST_PORTS, _MOST_CAUSES, _NO_SHARE = 6, 3, 3, 0.005
_INSEPARABLE = "nothing on the menu"  # phrase in `why` of an experiment that separates little
_DOMINANT_SHARE = 0.95  # share of a port above which no further sensor is advised


@dataclass(frozen=True)
class Answer:
    """An answer of the page.

    lead: the answer in a sentence; details: further sentences; points: items of a list below; card:
    its short form, if any.
    """

    question: str
    lead: str
    details: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    card: Card | None = None


def answers_of(run: RunData, rows: tuple[ChannelErrors, ...]) -> tuple[Answer, ...]:
    """Return the answers of a run in the order of the page."""
    remainder = left_answer(run)
    return (
        where_answer(run),
        which_answer(run),
        how_far_answer(run, rows),
        *((remainder,) if remainder else ()),
        next_answer(run),
    )


def _answer(
    question: str,
    lead: str,
    details: list[str],
    short_lead: str,
    lines: list[str],
    points: list[str] | None = None,
    *,
    quiet: bool = False,
) -> Answer:
    """Build an answer with its card, without empty sentences."""
    place = question.lower().replace(" ", "-")
    card = Card(question, short_lead, tuple(filter(None, lines)), place, quiet)
    return Answer(question, lead, tuple(filter(None, details)), tuple(points or ()), card)


# ---- where ---------------------------------------------------------------------------------------


def where_answer(run: RunData) -> Answer:
    """Answer to where the gap lies: port, inseparable ports and a sensor that separates them,
    regimes, band and windows."""
    diagnosis, question = run.diagnosis, "Where"
    if diagnosis is None:
        return Answer(question, "Not diagnosed yet.", (DIAGNOSE_HINT,))
    if diagnosis.remark:
        return _answer(question, "Undetermined.", [], "Undetermined", [CHECK_FIRST], quiet=True)
    if diagnosis.verdict == "no-structural-gap":
        lead, line = "Nowhere: there is no gap.", "There is no gap."
        return _answer(question, lead, [], "Nowhere", [line], quiet=True)
    where = diagnosis.where
    if where is None or not (where.port or where.ports):
        lead = "The diagnosis names no port."
        return _answer(question, lead, [], "Undetermined", [lead], quiet=True)
    causes = diagnosis.causes if diagnosis.verdict != "ambiguous" else ()
    # the form of an effect separates ports that the sensors alone cannot
    inseparable = (
        sorted({port for cause in causes for port in cause.or_at})
        if causes
        else sorted(where.inseparable_from(where.port))
    )
    short_lead, lines = _where_card(diagnosis, where, inseparable)
    return _answer(
        question,
        _where_lead(where, causes, inseparable),
        [_sensors_text(where), *_concentration_texts(where)],
        short_lead,
        lines,
        list(map(_regime, where.regimes)),
    )


def _where_lead(where: Where, causes: tuple[Cause, ...], inseparable: list[str]) -> str:
    if not where.port:
        return "No single port stands out."
    named = dict.fromkeys(cause.port for cause in causes if cause.port) or [where.port]
    labels = list(map(port_label, named))
    lead = f"at the {formatting.join(labels)} port{'s' if len(labels) > 1 else ''}"
    if not inseparable:
        return sentence(lead)
    if causes:
        return sentence(
            f"{lead}, or at {ports_text(inseparable)}: these recordings cannot separate them"
        )
    return sentence(f"{lead}; these sensors cannot separate it from {ports_text(inseparable)}")


def _where_card(
    diagnosis: DiagnosisFile, where: Where, inseparable: list[str]
) -> tuple[str, list[str]]:
    shares = {item.port: item.share for item in where.ports}

    def with_share(port: str) -> str:
        return port_label(port) + (f" {percent(shares[port])}" if port in shares else "")

    ports = [cause.port for cause in diagnosis.causes] if diagnosis.causes else [where.port]
    named = list(filter(None, dict.fromkeys(ports))) or [max(shares, key=lambda p: shares[p])]
    others = [
        with_share(port)
        for port, share in sorted(shares.items(), key=lambda item: -item[1])
        if port not in named and share >= _NO_SHARE
    ][:_MOST_PORTS]
    best = where.regimes[0] if where.regimes else None
    return formatting.join(map(with_share, named)), [
        f"of the gap enters here{f'; {formatting.join(others)}' if others else ''}",
        f"cannot be separated from {ports_text(inseparable)} yet" if inseparable else "",
        f"{percent(best.share_of_gap)} of it in {percent(best.share_of_time)} of the time: "
        f"{regime_label(best)}"
        if best is not None and best.share_of_gap is not None
        else "",
    ]


def _sensors_text(where: Where) -> str:
    """Ports that the sensors cannot separate, and the sensor that would help most; "" without
    any."""
    groups = [
        formatting.join(map(port_label, group))
        for group in where.indistinguishable
        if len(group) > 1
    ]
    texts = []
    if groups:
        inseparable = ", or at ".join(groups)
        texts.append(f"these sensors cannot separate effects of unknown form at {inseparable}")
    if where.unseen:
        texts.append(f"they do not respond to {formatting.join(map(port_label, where.unseen))}")
    splitting = next((sensor for sensor in where.sensors if sensor.splits), None)
    largest = max((each.share for each in where.ports), default=0.0)
    if splitting is not None and largest < _DOMINANT_SHARE:
        texts.append(
            f"measuring {sensor_label(splitting.sensor)} as well would separate "
            f"{', and '.join(split_labels(splitting))}"
        )
    return sentence("; ".join(texts))


def _concentration_texts(where: Where) -> list[str]:
    """The band and the windows in which the gap shows."""
    details = []
    if where.frequency_hz:
        low, high = (short(edge, 2) for edge in where.frequency_hz)
        details.append(f"Most of it lies between {low} and {high} Hz.")
    if where.windows_s:
        shown_windows = sorted(where.windows_s[:_MOST_WINDOWS])
        further = len(where.windows_s) - len(shown_windows)
        details.append(
            "It shows most in these windows of the recording: "
            f"{', '.join(formatting.span(low, high, 's') for low, high in shown_windows)}"
            f"{f', and {further} more' if further else ''}."
        )
    return details


def _regime(regime: Regime) -> str:
    if regime.share_of_gap is None:
        return sentence(regime_label(regime))
    text = f"{regime_label(regime)}: {percent(regime.share_of_gap)} of the gap"
    if regime.share_of_time:
        ratio = times_text(regime.share_of_gap / regime.share_of_time)
        text += f" in {percent(regime.share_of_time)} of the time, {ratio} times its share"
    return sentence(text)


# ---- which ---------------------------------------------------------------------------------------


def which_answer(run: RunData) -> Answer:
    """Cause of the gap, similar effects, and the runner-up."""
    diagnosis, question = run.diagnosis, "Which"
    if diagnosis is None:
        return Answer(question, "Not diagnosed yet.", (DIAGNOSE_HINT,))
    supplements = [*_refit_texts(diagnosis), *_confidence_texts(diagnosis)]
    if diagnosis.remark or diagnosis.verdict == "cannot-tell":
        lines = [CHECK_FIRST] if diagnosis.remark else [_best_guess(diagnosis)]
        return _answer(question, "Undetermined.", supplements, "Undetermined", lines, quiet=True)
    if diagnosis.verdict == "no-structural-gap":
        lead = "No effect is needed beyond refitted parameters and the tolerances."
        lines = ["Refitted parameters and ordinary tolerances suffice."]
        return _answer(question, lead, supplements, "No effect", lines, quiet=True)
    if diagnosis.verdict == "unknown-effect":
        families = verdict_words.free_families(diagnosis, SPELLING)
        lead = f"None of the catalogue; it is {families}." if families else "None of the catalogue."
        first = sentence(families) if families else "No effect of the catalogue explains it."
        texts = _unknown_texts(diagnosis.unknown) if diagnosis.unknown is not None else []
        lines = [first, _closest_line(diagnosis)]
        return _answer(question, lead, texts + supplements, "None of the catalogue", lines)
    if diagnosis.verdict == "ambiguous":
        lead = sentence(f"{causes_label(diagnosis)}: these recordings cannot separate them")
    else:
        findings = verdict_words.findings_of(diagnosis)
        lead = sentence(
            formatting.join(_with_probability(diagnosis, finding) for finding in findings)
        )
    details = [
        *_share_texts(diagnosis),
        *_parameter_texts(diagnosis),
        *_not_converged_texts(diagnosis),
        *supplements,
    ]
    return _answer(question, lead, details, *_which_card(run, diagnosis))


def _which_card(run: RunData, diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    last = "or" if diagnosis.verdict == "ambiguous" else "and"
    causes, plots = diagnosis.causes[:_MOST_CAUSES], added_leaders(run)
    lead = formatting.capital(formatting.join(map(_with_value, causes), last))
    several = len(causes) > 1
    lines = [_cause_line(cause, several) for cause in causes]
    if plots:
        lines.append(
            (f"{effect_label(plots[0].effect)} " if several else "") + added_line(plots[0])
        )
    return lead, lines


def _with_value(cause: Cause) -> str:
    name, parameter = effect_label(cause.effect), first_parameter(cause)
    if parameter is None:
        return name
    unit_text = channel_unit(parameter[0])
    value = formatting.unbroken(with_unit_text(parameter[1].value, unit_text))
    # a number without unit needs the name of its parameter
    return f"{name} {value}" if unit_text else f"{name}, {channel_label(parameter[0])} {value}"


def _cause_line(cause: Cause, several: bool) -> str:
    parts = []
    if cause.removes is not None:
        parts.append(f"removes {percent(cause.removes.share)} of the gap")
    if cause.probability is not None:
        parts.append(f"P {chance_figure(cause.probability)}")
    parameter = first_parameter(cause)
    if parameter is not None and None not in (parameter[1].low, parameter[1].high):
        span = formatting.span(parameter[1].low, parameter[1].high, channel_unit(parameter[0]))
        parts.append(f"{channel_label(parameter[0])} {span}")
    text = ", ".join(parts)
    return f"{effect_label(cause.effect)}: {text}" if several and text else text


def _best_guess(diagnosis: DiagnosisFile) -> str:
    best = next((each for each in diagnosis.ranking if each.removes is not None), None)
    if best is None or best.removes is None or best.probability is None:
        return "These recordings do not suffice."
    return (
        f"{effect_label(best.effect)} may be missing: removes {percent(best.removes.share)} of the "
        f"gap (P {chance_figure(best.probability)})."
    )


def _closest_line(diagnosis: DiagnosisFile) -> str:
    """Closest candidate, with the evidence for it."""
    best = closest(diagnosis)
    if best is None or best.probability is None or best.shrinkage is None:
        return ""
    return (
        f"closest: {effect_label(best.effect)}, removes {percent(best.shrinkage)} of the held-out "
        f"error, P {chance_figure(best.probability)}"
    )


def _with_probability(diagnosis: DiagnosisFile, finding: verdict_words.Finding) -> str:
    cause, text = finding[0], verdict_words.finding_label(diagnosis, finding, SPELLING)
    text += at_port(cause.port) if len(finding) == 1 and "@" not in cause.effect else ""
    chance = cause.probability
    return text if chance is None else f"{text}, with probability {formatting.chance(chance)}"


def _share_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Share of the gap that each cause removes, and its part of the sum of shares."""
    several = len(diagnosis.causes) > 1
    context = " next to the other" + ("s" if len(diagnosis.causes) > 2 else "") if several else ""
    if diagnosis.verdict == "ambiguous":
        context = " alone"
    details = [
        sentence(
            f"{effect_label(cause.effect)} removes {percent(cause.removes.share)} of the gap"
            f"{context}{interval_tail(percent_span(cause.removes.low, cause.removes.high))}"
        )
        for cause in diagnosis.causes
        if cause.removes is not None
    ]
    if several and diagnosis.verdict != "ambiguous":
        shares = [
            f"{effect_label(cause.effect)} accounts for {percent(cause.share)}"
            for cause in diagnosis.causes
        ]
        details.append(f"Of the sum of their shares, {formatting.join(shares)}.")
    return details


def _parameter_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Parameters of the causes, with intervals."""
    return [
        sentence(f"{effect_label(cause.effect)}: {formatting.parameter_text(name, parameter)}")
        for cause in diagnosis.causes
        for name, parameter in cause.parameters.items()
    ]


def _not_converged_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Causes whose refit did not converge."""
    named = {cause.effect for cause in diagnosis.causes}
    return [
        sentence(not_converged(f"the refit with {effect_label(candidate.effect)}", candidate.why))
        for candidate in diagnosis.ranking
        if candidate.effect in named and not candidate.converged
    ]


def _refit_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Parameters of the answer's model that differ from the data sheet, with intervals."""
    if diagnosis.remark:
        return []
    refits = refitted_parameters(diagnosis.parameters)
    texts = []
    for name, entry in refits.shown.items():
        prior = "" if entry.prior is None else f"{short(entry.prior)} → "
        value = formatting.with_unit(short(entry.value), channel_unit(name))
        tail = interval_tail(formatting.span(entry.low, entry.high)) + bound_text(entry)
        texts.append(f"{channel_label(name)} {prior}{value}{tail}")
    texts += [refits.remark()] if refits.remark() else []
    return [sentence(f"refitted: {'; '.join(texts)}")] if texts else []


def _confidence_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Inseparable candidates, if the lead does not name them, and the meaning of a probability. The
    ranking of the page shows the other candidates."""
    details = []
    if diagnosis.verdict == "cannot-tell" and len(diagnosis.tied) > 1:
        names = formatting.join(map(effect_label, diagnosis.tied))
        details.append(f"These recordings cannot separate {names}.")
    if len(diagnosis.ranking) <= 1:
        details.append("No other candidate was refitted.")
    if not diagnosis.remark and any(each.probability is not None for each in diagnosis.ranking):
        details.append(f"{PROBABILITY_MEANS}.")
    return details


# ---- an effect outside the catalogue -------------------------------------------------------------


def _unknown_texts(unknown: Unknown) -> list[str]:
    """Share that each nonparametric curve removes; nature and formula of the missing term."""
    texts = []
    for form in unknown.free_forms:
        share = form.removes or form
        texts.append(
            sentence(f"{taken_up(form)}{interval_tail(percent_span(share.low, share.high))}")
        )
    if len(texts) > 1:
        texts.append("These recordings cannot separate these curves.")
    if texts:
        texts.append(
            "The curve is fitted together with the parameters of the rig. A part that both can "
            "take up, such as a part in proportion, may be divided differently."
        )
    return [*texts, *_nature_texts(unknown), *_formula_texts(unknown)]


def _nature_texts(unknown: Unknown) -> list[str]:
    """Parity, memory and dissipation of the missing term, in words."""
    against = port_label(
        "velocity" if "velocity" in unknown.variables else (unknown.variables or ("signal",))[0]
    )
    parity = {
        "odd": f"It changes its sign with the {against}.",
        "even": f"It is alike on both sides of the {against}.",
        "mixed": f"It is neither odd nor even in the {against}.",
    }
    memory = {
        True: "Most of it is no function of these signals at the same instant: it depends on the "
        "past, or on something that is not among them.",
        False: "It follows these signals without memory.",
        None: "",
    }
    energy = {
        True: "It takes energy out, as friction does.",
        False: "On the whole it takes no energy out beyond what the refitted model takes.",
        None: "",
    }
    return [
        parity.get(unknown.parity, "") if unknown.variables else "",
        memory[unknown.memory],
        energy[unknown.dissipative],
    ]


def _formula_texts(unknown: Unknown) -> list[str]:
    """Formula of the missing term, the certainty of its terms and the variance it covers."""
    if not unknown.formula:
        return ["No function of the signals at this port describes it."]
    variables = formatting.join(map(port_label, unknown.variables))
    texts = [
        f"The missing term{at_port(unknown.port)} is described best, as a function"
        f"{f' of {variables}' if variables else ''}, by "
        f"{formula_text(formatting.clean(unknown.formula))}, with the parameters estimated anew "
        "with it."
    ]
    if unknown.inclusion is not None:
        texts.append(
            f"Each of its terms came up in at least {percent(unknown.inclusion)} of the fits to "
            "resampled data."
        )
    if unknown.described is not None:
        texts.append(
            f"The formula covers {percent(unknown.described)} of its variance; it is a "
            "description, not a cause."
        )
    return texts


# ---- how far -------------------------------------------------------------------------------------


def how_far_answer(run: RunData, rows: tuple[ChannelErrors, ...]) -> Answer:
    """Answer to how far the gap shrinks: mean absolute errors of the headline channel, and the
    shrinkage of every channel."""
    question, row, diagnosis = "How far", headline(rows), run.diagnosis
    if row is None:
        lead = "No channel was scored."
        if diagnosis is None:
            return Answer(question, lead)
        return _answer(question, lead, [], "Not scored", [], quiet=True)
    unit_text, channel = channel_unit(row.channel), channel_label(row.channel)
    cause = causes_label(diagnosis) if diagnosis is not None else "the cause"
    steps = formatting.join(
        f"{with_unit_text(value, unit_text)} {name}"
        for value, name in (
            (row.data_sheet, "from the data sheet"),
            (row.refitted, "refitted"),
            (row.with_cause, f"with {cause}"),
        )
        if value is not None
    )
    points = [
        sentence(
            f"{channel_label(item.channel)}: {percent(item.shrinkage)} of the held-out error "
            f"removed{interval_tail(percent_span(item.low, item.high))}"
        )
        for item in rows
        if item.shrinkage is not None
    ]
    return _answer(
        question,
        sentence(f"the held-out {channel} error is {steps or 'unknown'}"),
        [_limits(row, unit_text), *_horizon(run, row, unit_text), _forecast(run)],
        *_how_far_card(row, diagnosis),
        points if len(rows) > 1 else [],
    )


def _how_far_card(row: ChannelErrors, diagnosis: DiagnosisFile | None) -> tuple[str, list[str]]:
    unit_text, channel = channel_unit(row.channel), channel_label(row.channel)
    steps = [error for error in (row.refitted, row.with_cause) if error is not None]
    if row.with_cause is None and row.data_sheet is not None and row.refitted is not None:
        steps = [row.data_sheet, row.refitted]
    names = "refitted → with the cause" if row.with_cause is not None else "data sheet → refitted"
    references = []
    if row.with_cause is not None and row.data_sheet is not None:
        references.append(f"data sheet {with_unit_text(row.data_sheet, unit_text)}")
    if row.noise_floor is not None:
        references.append(f"noise floor {with_unit_text(row.noise_floor, unit_text)}")
    lines = [f"held-out {channel} error, {names}", ", ".join(references)]
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is not None and rest is not None and not diagnosis.remark:
        size = set_figures(verdict_words.size_of(rest, with_causes=bool(diagnosis.causes)))
        at = f", at the {port_label(rest.port)}" if rest.port else ""
        lines.append(f"remaining: {size}{at}")
    return formatting.with_common_unit(steps, unit_text, " → "), lines


def _limits(row: ChannelErrors, unit_text: str) -> str:
    """Noise floor, compared with the error of the best model."""
    best = row.with_cause if row.with_cause is not None else row.refitted
    if row.noise_floor is None:
        return ""
    text = f"The noise floor is {with_unit_text(row.noise_floor, unit_text)}"
    if best is None or row.noise_floor <= 0:
        return f"{text}."
    times = best / row.noise_floor
    compared = "no larger" if times < 1.1 else f"{times_text(times)} times that"
    return f"{text}; the remaining error is {compared}."


def _horizon(run: RunData, row: ChannelErrors, unit_text: str) -> list[str]:
    """Prediction horizon; if it spans several windows, also the error over single windows."""
    diagnosis = run.diagnosis
    if diagnosis is None or diagnosis.horizon_s is None:
        return []
    time = with_unit_text(diagnosis.horizon_s, "s")
    texts = [f"The model predicts over up to {time} from an estimated state."]
    reach = diagnosis.how_far.get(row.channel)
    if reach is not None and reach.mae_refitted_short is not None:
        error = with_unit_text(reach.mae_refitted_short, unit_text)
        texts.append(f"With a state estimated in every window the refitted error is {error}.")
    return texts


def _forecast(run: RunData) -> str:
    """Share of the error that the causes would remove on a new recording."""
    forecast = run.diagnosis.forecast if run.diagnosis is not None else None
    if forecast is None:
        return ""
    interval = interval_tail(percent_span(forecast.low, forecast.high))
    return f"On a new recording {percent(forecast.share)} of the error would be removed{interval}."


# ---- what is left, and what next -----------------------------------------------------------------


def left_answer(run: RunData) -> Answer | None:
    """Answer to what is left of the gap: size, port and form of the remainder. Without causes, the
    remainder is the whole gap. None without a remainder."""
    diagnosis = run.diagnosis
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is None or rest is None or diagnosis.remark:
        return None
    has_causes = bool(diagnosis.causes)
    part = percent(max(rest.share, 0.0)) if has_causes and rest.share is not None else "all"
    place = f",{at_port(rest.port)}" if rest.port else ""
    lead = f"{part} of the gap{place}." if rest.real else "No material part of the gap."
    size = set_figures(verdict_words.size_of(rest, with_causes=has_causes))
    details = [
        sentence(f"remaining: {size}") if size else "",
        sentence(set_figures(verdict_words.amount_of(rest))),
    ]
    if has_causes:
        term = missing_term(diagnosis)
        details += _formula_texts(term) if term is not None else []
        details.append(sentence(verdict_words.advice_of(rest)))
    if rest.real and rest.family:
        details.append(
            sentence(f"a curve of the {effect_label(rest.family)} family would remove it")
        )
    return Answer("What is left", sentence(lead), tuple(filter(None, details)))


def next_answer(run: RunData) -> Answer:
    """Next experiment, its expected result, its duration and the place of its excitation."""
    question = "Next experiment"
    if run.diagnosis is None:
        lead = "Run the diagnosis on what is already recorded."
        return Answer(question, lead, (_diagnose_command(run),))
    experiment = run.diagnosis.next_experiment
    if experiment is None:
        none = "The diagnosis recommends no further experiment."
        return Answer(question, formatting.clean(run.diagnosis.withheld) or none)
    separated = formatting.join(map(effect_label, experiment.separates))
    details = [
        sentence(reason_text(experiment)),
        sentence(f"it separates {separated}") if separated else "",
        _expected(experiment),
        *(sentence(formatting.clean(text)) for text in experiment.cautions),
    ]
    # name only files in the run folder: pamid cannot vouch for others
    local_files = [name for name in experiment.files if name == Path(name).name]
    if local_files:
        single = len(local_files) == 1
        verb = "Its excitation is" if single else "Its excitations (a file per run) are"
        files = formatting.join(f"`{formatting.clean(name)}`" for name in local_files)
        details.append(f"{verb} {files} in the run folder, ready to be sent.")
    runs = [
        formatting.join(
            f"{channel_label(name)} {with_unit_text(value, channel_unit(name))}"
            for name, value in setting.items()
        )
        for setting in experiment.settings
    ]
    points = [sentence(f"run {k}: {item}") for k, item in enumerate(runs, start=1) if item]
    return Answer(
        question,
        sentence(effect_label(experiment.name)),
        tuple(filter(None, details)),
        tuple(points) if len(runs) > 1 else (),
    )


def _expected(experiment: NextExperiment) -> str:
    texts = []
    if experiment.expected_separation is not None:
        texts.append(
            "the nearest two of these models are expected to differ there by "
            f"{times_text(experiment.expected_separation)} times the noise of the sensors"
            + (", too little to set them apart clearly" if _INSEPARABLE in experiment.why else "")
        )
    if experiment.minutes is not None:
        takes = formatting.unbroken(minutes_text(experiment.minutes))
        texts.append(f"it takes about {takes} at the rig")
    return sentence("; ".join(texts))


def _diagnose_command(run: RunData) -> str:
    """Command line to copy. Names from the run are quoted as single words."""
    if run.fit is None or not run.fit.recordings:
        return DIAGNOSE_HINT
    words = ["`pamid diagnose"]
    for recording in run.fit.recordings:
        words += ["--held-out"] if recording.role == "held-out" else []
        words.append(quoted(formatting.clean(recording.path or recording.name)))
    words += ["--rig", quoted(formatting.clean(run.named_rig))] if run.named_rig else []
    return " ".join([*words, "--output diagnosis`"])


def todo_of(run: RunData) -> str:
    """Next step, in a line."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return "Find the cause: `pamid diagnose` on the same recordings."
    if diagnosis.remark:
        return "First check the recordings and their units; before that no verdict is valid."
    if any(OF_THE_LOG in note for note in diagnosis.notes):
        return (
            "Correct the order of the log's rows, as in the notes, and diagnose again before "
            "you measure more."
        )
    experiment = diagnosis.next_experiment
    if experiment is None and diagnosis.withheld:
        return (
            "Record again in closed loop: in open loop every experiment leaves the recorded range."
        )
    if experiment is None:
        return "This answer needs no further measurement."
    text = f"run the experiment “{effect_label(experiment.name)}”"
    if experiment.minutes is not None:
        text += f" ({formatting.unbroken(minutes_text(experiment.minutes))} at the rig)"
    if experiment.separates:
        text += f"; it separates {formatting.join(map(effect_label, experiment.separates))}"
    return sentence(text)
