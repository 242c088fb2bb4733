"""The answers of a run in words: where, which, how far, what is left, what next. Page, cards,
terminal and notebook show these, so that no two of them can contradict each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import join_words, quoted
from pamid.base.schemas.diagnosis_file import DiagnosisFile, Unknown
from pamid.base.schemas.estimates import Estimate
from pamid.base.share_words import (
    chance_text,
    minutes_text,
    percent_text,
    percents_text,
    times_text,
)
from pamid.base.units import split_column
from pamid.diagnosis.verdict import verdict_words
from pamid.diagnosis.verdict.verdict_words import chance_figure, shortened
from pamid.intake.checks.sampling_slips import OF_THE_LOG
from pamid.report import formatting
from pamid.report.captions import (
    SPELLING,
    added_leaders,
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
from pamid.report.channel_errors import ChannelErrors, aligned, headline
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

LEAST_SHARE = 0.005  # of the gap, at a port that a table lists
MOST_RANKED = 8

PROBABILITY_MEANS = (
    "A probability is how often, among virtual machines with figures like these, an effect of that "
    "family was really there"
)
DIAGNOSE_HINT = "`pamid diagnose` on the same recordings adds this answer."
CHECK_FIRST = "Check the recordings first."
_MOST_WINDOWS, _MOST_PORTS, _MOST_CAUSES, _NO_SHARE = 6, 3, 3, 0.005
_DOMINANT_SHARE = 0.95  # share of a port above which no further sensor is advised
# least refit that is shown: of a prior standard deviation, and of the value; precise data resolve
# smaller shifts, which matter to nobody
LEAST_SHIFT, LEAST_PART = 0.1, 0.05
MOST_UNDETERMINED = 4  # parameters that are named; more are counted


@dataclass(frozen=True)
class Card:
    """A short answer at the top of the page. lead: the answer; lines: details; place: linked
    heading; quiet: there is no finding."""

    question: str
    lead: str
    lines: tuple[str, ...] = ()
    place: str = ""
    quiet: bool = False


@dataclass(frozen=True)
class Answer:
    """An answer to a question.

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
    remainder = _what_is_left(run.diagnosis)
    if run.diagnosis is None:
        where, which = (
            Answer(question, "Not diagnosed yet.", (DIAGNOSE_HINT,))
            for question in ("Where", "Which")
        )
    else:
        where, which = _where(run.diagnosis), _which(run, run.diagnosis)
    return (
        where,
        which,
        _how_far(run, rows),
        *((remainder,) if remainder else ()),
        _next_experiment(run),
    )


def _answer(
    question: str,
    lead: str,
    details: list[str],
    card: tuple[str, list[str]],
    points: list[str] | None = None,
    *,
    quiet: bool = False,
) -> Answer:
    """Build an answer with its card, from the lead and its lines, without empty sentences."""
    short_lead, lines = card
    place = question.lower().replace(" ", "-")
    shown = Card(question, short_lead, tuple(filter(None, lines)), place, quiet)
    return Answer(question, lead, tuple(filter(None, details)), tuple(points or ()), shown)


# ---- where ---------------------------------------------------------------------------------------


def _where(diagnosis: DiagnosisFile) -> Answer:
    """Where the gap lies: ports, a sensor that separates them, regimes, band and windows."""
    question, where = "Where", diagnosis.where
    if diagnosis.remark:
        return _answer(question, "Undetermined.", [], ("Undetermined", [CHECK_FIRST]), quiet=True)
    if diagnosis.verdict == "no-structural-gap":
        lead = "Nowhere: there is no gap."
        return _answer(question, lead, [], ("Nowhere", ["There is no gap."]), quiet=True)
    if where is None or not (where.port or where.ports):
        lead = "The diagnosis names no port."
        return _answer(question, lead, [], ("Undetermined", [lead]), quiet=True)
    causes = diagnosis.causes if diagnosis.verdict != "ambiguous" else ()
    # the form of an effect separates ports that the sensors alone cannot
    inseparable = (
        sorted({port for cause in causes for port in cause.or_at})
        if causes
        else sorted(where.inseparable_from(where.port))
    )
    lead = "no single port stands out"
    if where.port:
        at = list(dict.fromkeys(cause.port for cause in causes if cause.port)) or [where.port]
        labels = join_words(map(port_label, at))
        lead = f"at the {labels} port{'s' if len(at) > 1 else ''}"
        if inseparable and causes:
            lead += f", or at {ports_text(inseparable)}: these recordings cannot separate them"
        elif inseparable:
            lead += f"; these sensors cannot separate it from {ports_text(inseparable)}"
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
    lines = [
        f"of the gap enters here{f'; {join_words(others)}' if others else ''}",
        f"cannot be separated from {ports_text(inseparable)} yet" if inseparable else "",
    ]
    best = where.regimes[0] if where.regimes else None
    if best is not None and best.share_of_gap is not None:
        lines.append(
            f"{percent(best.share_of_gap)} of it in {percent(best.share_of_time)} of the time: "
            f"{regime_label(best)}"
        )
    # ports that the sensors cannot separate, and the sensor that would help most
    texts = []
    groups = [group for group in where.indistinguishable if len(group) > 1]
    if groups:
        together = ", or at ".join(join_words(map(port_label, group)) for group in groups)
        texts.append(f"these sensors cannot separate effects of unknown form at {together}")
    if where.unseen:
        texts.append(f"they do not respond to {join_words(map(port_label, where.unseen))}")
    splitting = next((sensor for sensor in where.sensors if sensor.splits), None)
    if splitting is not None and max(shares.values(), default=0.0) < _DOMINANT_SHARE:
        texts.append(
            f"measuring {sensor_label(splitting.sensor)} as well would separate "
            f"{', and '.join(split_labels(splitting))}"
        )
    details = [sentence("; ".join(texts))]
    # the band and the windows in which the gap shows
    if where.frequency_hz:
        low, high = (short(edge, 2) for edge in where.frequency_hz)
        details.append(f"Most of it lies between {low} and {high} Hz.")
    if where.windows_s:
        windows = sorted(where.windows_s[:_MOST_WINDOWS])
        further = len(where.windows_s) - len(windows)
        details.append(
            "It shows most in these windows of the recording: "
            f"{', '.join(formatting.span(*window, 's') for window in windows)}"
            f"{f', and {further} more' if further else ''}."
        )
    points = []
    for regime in where.regimes:
        text = regime_label(regime)
        if regime.share_of_gap is not None:
            text += f": {percent(regime.share_of_gap)} of the gap"
            if regime.share_of_time:
                ratio = times_text(regime.share_of_gap / regime.share_of_time)
                text += f" in {percent(regime.share_of_time)} of the time, {ratio} times its share"
        points.append(sentence(text))
    card = join_words(map(with_share, named)), lines
    return _answer(question, sentence(lead), details, card, points)


# ---- which ---------------------------------------------------------------------------------------


def _which(run: RunData, diagnosis: DiagnosisFile) -> Answer:
    """Cause of the gap, similar effects, and the runner-up."""
    question, verdict = "Which", diagnosis.verdict
    # parameters that were refitted, inseparable candidates if the lead does not name them, and the
    # meaning of a probability; the ranking of the page shows the other candidates
    supplements = []
    if not diagnosis.remark and (refits := refitted_texts(diagnosis.parameters)):
        supplements.append(sentence(f"refitted: {'; '.join(refits)}"))
    if verdict == "cannot-tell" and len(diagnosis.tied) > 1:
        names = join_words(map(effect_label, diagnosis.tied))
        supplements.append(f"These recordings cannot separate {names}.")
    if len(diagnosis.ranking) <= 1:
        supplements.append("No other candidate was refitted.")
    if not diagnosis.remark and any(each.probability is not None for each in diagnosis.ranking):
        supplements.append(f"{PROBABILITY_MEANS}.")
    if diagnosis.remark or verdict == "cannot-tell":
        best = next((each for each in diagnosis.ranking if each.removes is not None), None)
        line = "These recordings do not suffice."
        if diagnosis.remark:
            line = CHECK_FIRST
        elif best is not None and best.removes is not None and best.probability is not None:
            line = (
                f"{effect_label(best.effect)} may be missing: removes "
                f"{percent(best.removes.share)} of the gap (P {chance_figure(best.probability)})."
            )
        card = "Undetermined", [line]
        return _answer(question, "Undetermined.", supplements, card, quiet=True)
    if verdict == "no-structural-gap":
        lead = "No effect is needed beyond refitted parameters and the tolerances."
        card = "No effect", ["Refitted parameters and ordinary tolerances suffice."]
        return _answer(question, lead, supplements, card, quiet=True)
    if verdict == "unknown-effect":
        families = verdict_words.free_families(diagnosis, SPELLING)
        lead = f"None of the catalogue; it is {families}." if families else "None of the catalogue."
        lines = [sentence(families) if families else "No effect of the catalogue explains it."]
        candidate = closest(diagnosis)
        if (
            candidate is not None
            and candidate.probability is not None
            and candidate.shrinkage is not None
        ):
            lines.append(
                f"closest: {effect_label(candidate.effect)}, removes "
                f"{percent(candidate.shrinkage)} of the held-out error, "
                f"P {chance_figure(candidate.probability)}"
            )
        texts = _unknown_texts(diagnosis.unknown) if diagnosis.unknown is not None else []
        return _answer(question, lead, texts + supplements, ("None of the catalogue", lines))
    if verdict == "ambiguous":
        lead = f"{causes_label(diagnosis)}: these recordings cannot separate them"
    else:
        labels = []
        for finding in verdict_words.findings_of(diagnosis):
            cause, text = finding[0], verdict_words.finding_label(diagnosis, finding, SPELLING)
            text += at_port(cause.port) if len(finding) == 1 and "@" not in cause.effect else ""
            chance = cause.probability
            labels.append(
                text if chance is None else f"{text}, with probability {chance_text(chance)}"
            )
        lead = join_words(labels)
    details = [*_share_texts(diagnosis), *supplements]
    causes, plots = diagnosis.causes[:_MOST_CAUSES], added_leaders(run)
    several = len(causes) > 1
    named, lines = [], []
    for cause in causes:
        name, parts = effect_label(cause.effect), []
        if cause.removes is not None:
            parts.append(f"removes {percent(cause.removes.share)} of the gap")
        if cause.probability is not None:
            parts.append(f"P {chance_figure(cause.probability)}")
        value = ""
        if (parameter := first_parameter(cause)) is not None:
            column, size = parameter
            label, unit_text = channel_label(column), channel_unit(column)
            value = f" {formatting.unbroken(with_unit_text(size.value, unit_text))}"
            # a number without unit needs the name of its parameter
            value = value if unit_text else f", {label}{value}"
            if None not in (size.low, size.high):
                parts.append(f"{label} {formatting.span(size.low, size.high, unit_text)}")
        named.append(f"{name}{value}")
        text = ", ".join(parts)
        lines.append(f"{name}: {text}" if several and text else text)
    if plots:
        name = f"{effect_label(plots[0].effect)} " if several else ""
        lines.append(name + added_line(plots[0]))
    short_lead = formatting.capital(join_words(named, "or" if verdict == "ambiguous" else "and"))
    return _answer(question, sentence(lead), details, (short_lead, lines))


def _share_texts(diagnosis: DiagnosisFile) -> list[str]:
    """Share of the gap that each cause removes and its part of the sum of shares, its parameters
    with intervals, and refits that did not converge."""
    causes = diagnosis.causes
    several = len(causes) > 1
    context = " next to the other" + ("s" if len(causes) > 2 else "") if several else ""
    if diagnosis.verdict == "ambiguous":
        context = " alone"
    texts = [
        f"{effect_label(cause.effect)} removes {percent(cause.removes.share)} of the gap"
        f"{context}{interval_tail(percent_span(cause.removes.low, cause.removes.high))}"
        for cause in causes
        if cause.removes is not None
    ]
    if several and diagnosis.verdict != "ambiguous":
        shares = [
            f"{effect_label(cause.effect)} accounts for {percent(cause.share)}" for cause in causes
        ]
        texts.append(f"Of the sum of their shares, {join_words(shares)}")
    texts += [
        f"{effect_label(cause.effect)}: {formatting.parameter_text(name, parameter)}"
        for cause in causes
        for name, parameter in cause.parameters.items()
    ]
    named = {cause.effect for cause in causes}
    texts += [
        not_converged(f"the refit with {effect_label(candidate.effect)}", candidate.why)
        for candidate in diagnosis.ranking
        if candidate.effect in named and not candidate.converged
    ]
    return list(map(sentence, texts))


def refitted_texts(parameters: dict[str, Estimate]) -> list[str]:
    """Parameters that the model of the answer moved off the data sheet, the largest shift first:
    "mass 0.5 → 0.62 kg (95 % interval 0.61 to 0.63)".

    A parameter is listed if its 95 % interval excludes the data-sheet value and the shift exceeds
    LEAST_SHIFT prior deviations or LEAST_PART of the value. The others are counted. Undetermined
    parameters are named: their values are those of the priors.
    """

    def moved(estimate: Estimate) -> bool:
        prior, low, high = estimate.prior, estimate.low, estimate.high
        if prior is None or low is None or high is None:
            return prior is None
        if low <= prior <= high:
            return False
        strained = estimate.strain is None or abs(estimate.strain) >= LEAST_SHIFT
        return strained or abs(estimate.value - prior) >= LEAST_PART * abs(prior)

    shown = [name for name, estimate in parameters.items() if moved(estimate)]
    shown.sort(key=lambda name: -abs(parameters[name].strain or 0.0))
    texts = []
    for name in shown:
        entry = parameters[name]
        prior = "" if entry.prior is None else f"{short(entry.prior)} → "
        value = formatting.with_unit(short(entry.value), channel_unit(name))
        interval = interval_tail(formatting.span(entry.low, entry.high))
        text = f"{channel_label(name)} {prior}{value}{interval}"
        texts.append(", ".join(filter(None, (text, formatting.bound_text(entry)))))
    rest = len(parameters) - len(shown)
    if not rest:
        return texts
    noun = "other" if shown else "parameter"
    text = f"{rest} {noun}{'s' if rest > 1 else ''} not moved materially"
    silent = [k for k, e in parameters.items() if e.word == "silent" and k not in shown]
    if silent:
        names = [split_column(name)[0] for name in silent[:MOST_UNDETERMINED]]
        more = len(silent) - len(names)
        names += [f"{more} more"] if more else []
        text += f"; not determined by these recordings: {', '.join(names)}"
    return [*texts, text]


# ---- an effect outside the catalogue -------------------------------------------------------------


def _unknown_texts(unknown: Unknown) -> list[str]:
    """Shares that nonparametric curves remove; parity, memory, energy and formula of the term."""
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
            "represent, such as a linear part, may be divided differently between them."
        )
    against = port_label(
        "velocity" if "velocity" in unknown.variables else (unknown.variables or ("signal",))[0]
    )
    parity = {
        "odd": f"It is odd in the {against}.",
        "even": f"It is even in the {against}.",
        "mixed": f"It is neither odd nor even in the {against}.",
    }
    memory = {
        True: "Most of it is not a function of these signals at the same instant: it depends on "
        "the past, or on another signal.",
        False: "It is a function of these signals, without memory.",
        None: "",
    }
    energy = {
        True: "It dissipates energy, like friction.",
        False: "On average it dissipates no more energy than the refitted model.",
        None: "",
    }
    return [
        *texts,
        parity.get(unknown.parity, "") if unknown.variables else "",
        memory[unknown.memory],
        energy[unknown.dissipative],
        *_formula_texts(unknown),
    ]


def _formula_texts(unknown: Unknown) -> list[str]:
    """Formula of the missing term, the certainty of its terms and the variance it covers."""
    if not unknown.formula:
        return ["No function of the signals at this port describes it."]
    variables = join_words(map(port_label, unknown.variables))
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


def _how_far(run: RunData, rows: tuple[ChannelErrors, ...]) -> Answer:
    """How far the gap shrinks: errors of the headline channel, shrinkage of every channel."""
    question, row, diagnosis = "How far", headline(rows), run.diagnosis
    if row is None:
        lead = "No channel was scored."
        if diagnosis is None:
            return Answer(question, lead)
        return _answer(question, lead, [], ("Not scored", []), quiet=True)
    unit_text, channel = channel_unit(row.channel), channel_label(row.channel)
    cause = causes_label(diagnosis) if diagnosis is not None else "the cause"
    steps = join_words(
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
    details, references = [], []
    if row.with_cause is not None and row.data_sheet is not None:
        references.append(f"data sheet {with_unit_text(row.data_sheet, unit_text)}")
    if row.noise_floor is not None:
        floor = with_unit_text(row.noise_floor, unit_text)
        references.append(f"noise floor {floor}")
        text = f"The noise floor is {floor}"
        best = row.with_cause if row.with_cause is not None else row.refitted
        if best is not None and row.noise_floor > 0:
            times = best / row.noise_floor
            compared = "no larger" if times < 1.1 else f"{times_text(times)} times that"
            text += f"; the remaining error is {compared}"
        details.append(f"{text}.")
    # prediction horizon; if it spans several windows, also the error over single windows
    if diagnosis is not None and diagnosis.horizon_s is not None:
        time = with_unit_text(diagnosis.horizon_s, "s")
        details.append(f"The model predicts over up to {time} from an estimated state.")
        reach = diagnosis.how_far.get(row.channel)
        if reach is not None and reach.mae_refitted_short is not None:
            error = with_unit_text(reach.mae_refitted_short, unit_text)
            details.append(f"With a state estimated in every window the refitted error is {error}.")
    if diagnosis is not None and (forecast := diagnosis.forecast) is not None:
        interval = interval_tail(percent_span(forecast.low, forecast.high))
        share = percent(forecast.share)
        details.append(f"On a new recording {share} of the error would be removed{interval}.")
    compared_errors = [error for error in (row.refitted, row.with_cause) if error is not None]
    if row.with_cause is None and row.data_sheet is not None and row.refitted is not None:
        compared_errors = [row.data_sheet, row.refitted]
    names = "refitted → with the cause" if row.with_cause is not None else "data sheet → refitted"
    lines = [f"held-out {channel} error, {names}", ", ".join(references)]
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is not None and rest is not None and not diagnosis.remark:
        size = set_figures(verdict_words.size_of(rest, with_causes=bool(diagnosis.causes)))
        at = f", at the {port_label(rest.port)}" if rest.port else ""
        lines.append(f"remaining: {size}{at}")
    return _answer(
        question,
        sentence(f"the held-out {channel} error is {steps or 'unknown'}"),
        details,
        (formatting.with_common_unit(compared_errors, unit_text, " → "), lines),
        points if len(rows) > 1 else [],
    )


# ---- what is left, and what next -----------------------------------------------------------------


def _what_is_left(diagnosis: DiagnosisFile | None) -> Answer | None:
    """Size, port and form of the remainder, which without causes is the whole gap."""
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


def _next_experiment(run: RunData) -> Answer:
    """Next experiment, its expected result, its duration and the place of its excitation."""
    question = "Next experiment"
    if run.diagnosis is None:
        lead = "Run the diagnosis on what is already recorded."
        command = DIAGNOSE_HINT
        if run.recordings:  # names from the run are quoted as single words
            words = ["`pamid diagnose"]
            for recording in run.recordings:
                words += ["--held-out"] if recording.role == "held-out" else []
                words.append(quoted(formatting.clean(recording.path or recording.name)))
            words += ["--rig", quoted(formatting.clean(run.named_rig))] if run.named_rig else []
            command = " ".join([*words, "--output diagnosis`"])
        return Answer(question, lead, (command,))
    experiment = run.diagnosis.next_experiment
    if experiment is None:
        none = "The diagnosis recommends no further experiment."
        return Answer(question, formatting.clean(run.diagnosis.withheld) or none)
    separated = join_words(map(effect_label, experiment.separates))
    expected = []
    if experiment.expected_separation is not None:
        expected.append(
            "the nearest two of these models are expected to differ there by "
            f"{times_text(experiment.expected_separation)} times the noise of the sensors"
            + (", too little to set them apart clearly" if experiment.separates_little else "")
        )
    if experiment.minutes is not None:
        takes = formatting.unbroken(minutes_text(experiment.minutes))
        expected.append(f"it takes about {takes} at the rig")
    details = [
        reason_text(experiment),
        f"it separates {separated}" if separated else "",
        "; ".join(expected),
        *map(formatting.clean, experiment.cautions),
    ]
    # name only files in the run folder: pamid cannot vouch for others
    local_files = [name for name in experiment.files if name == Path(name).name]
    if local_files:
        single = len(local_files) == 1
        verb = "its excitation is" if single else "its excitations, a file per run, are"
        files = join_words(f"`{formatting.clean(name)}`" for name in local_files)
        details.append(f"{verb} {files} in the run folder, ready to be sent")
    runs = [
        join_words(
            f"{channel_label(name)} {with_unit_text(value, channel_unit(name))}"
            for name, value in setting.items()
        )
        for setting in experiment.settings
    ]
    points = [sentence(f"run {k}: {item}") for k, item in enumerate(runs, start=1) if item]
    return Answer(
        question,
        sentence(effect_label(experiment.name)),
        tuple(map(sentence, filter(None, details))),
        tuple(points) if len(runs) > 1 else (),
    )


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
        text += f"; it separates {join_words(map(effect_label, experiment.separates))}"
    return sentence(text)


def tables_of(diagnosis: DiagnosisFile) -> list[str]:
    """Tables in plain text: share of the gap by port, and the candidates in the order of the
    ranking, by what each removes by itself and its distance to the first in standard errors."""
    gap = diagnosis.verdict != "no-structural-gap"
    shares = [
        [port.port, percent_text(port.share)]
        for port in (diagnosis.where.ports if gap and diagnosis.where is not None else ())
        if port.share >= LEAST_SHARE
    ]
    rows = [["candidate", "family", "removes", "95 % interval", "behind", "P"]]
    for each in diagnosis.ranking:
        if each.removes is not None and len(rows) <= MOST_RANKED:
            share = percent_text(each.removes.share)
            interval = percents_text(each.removes.low, each.removes.high)
            behind = "-" if each.behind is None else f"{each.behind:.1f}"
            chance = "-" if each.probability is None else chance_figure(each.probability)
            rows.append([shortened(each.effect), each.family, share, interval, behind, chance])
    tables = [(["port", "share of the gap"], *shares), rows]
    return [f"{aligned(table, k)}\n" for k, table in enumerate(tables, 1) if len(table) > 1]
