"""The three answers and the next experiment: for each a lead sentence and the ones that stand below
its picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import quoted
from pamid.base.share_words import minutes_text, times_text
from pamid.report import formatting
from pamid.report.captions import (
    SPELLING,
    causes_label,
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
    not_converged,
    percent,
    percent_span,
    sentence,
    short,
)
from pamid.report.load import RunData
from pamid.report.missing_term import formula_texts, missing_term, nature_texts
from pamid.schemas.diagnosis_file import (
    DiagnosisFile,
    NextExperiment,
    Regime,
    Unknown,
    Where,
)
from pamid.verdict import verdict_words
from pamid.verdict.refitted_parameters import bound_text, refitted_parameters

PROBABILITY_MEANS = (
    "A probability is how often, among virtual machines with figures like these, an effect of that "
    "family was really there"
)
DIAGNOSE_HINT = "`pamid diagnose` on the same recordings adds this answer."
_MOST_WINDOWS = 6
_NOT_APART = "nothing on the menu"  # in the reason for an experiment that shows little
_SETTLED = 0.95  # share of a port beside which nothing is left to be told apart


@dataclass(frozen=True)
class AnswerText:
    """`lead` is the answer; `details` are sentences, `points` a list below them."""

    lead: str
    details: tuple[str, ...] = ()
    points: tuple[str, ...] = ()


def where_answer(run: RunData) -> AnswerText:
    """Answer to where the gap lies: port, inseparable ports and a sensor that separates them,
    regimes, band and windows."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return AnswerText("Not diagnosed yet.", (DIAGNOSE_HINT,))
    if diagnosis.verdict == "no-structural-gap":
        return AnswerText("Nowhere: there is no gap.")
    if diagnosis.remark:
        return AnswerText("Undetermined.")
    where = diagnosis.where
    if where is None or not (where.port or where.ports):
        return AnswerText("The diagnosis names no port.")
    details = [_alike(where)]
    if where.frequency_hz:
        details.append(
            f"Most of it lies between {short(where.frequency_hz[0], 2)} and "
            f"{short(where.frequency_hz[1], 2)} Hz."
        )
    if where.windows_s:
        shown = [
            formatting.span(low, high, "s") for low, high in sorted(where.windows_s[:_MOST_WINDOWS])
        ]
        more = (
            f", and {len(where.windows_s) - len(shown)} more"
            if len(where.windows_s) > len(shown)
            else ""
        )
        details.append(
            f"It shows most in these windows of the recording: {', '.join(shown)}{more}."
        )
    return AnswerText(
        _where_lead(diagnosis, where), tuple(details), tuple(map(_regime, where.regimes))
    )


def _where_lead(diagnosis: DiagnosisFile, where: Where) -> str:
    if not where.port:
        return "No single port stands out."
    alike = sorted(where.inseparable_from(where.port))
    # the form of an effect separates ports that the sensors alone cannot
    if diagnosis.causes and diagnosis.verdict != "ambiguous":
        ports = dict.fromkeys(formatting.port_label(cause.port) for cause in diagnosis.causes)
        every = [port for port in ports if port] or [formatting.port_label(where.port)]
        lead = f"At the {formatting.join(every)} port{'s' if len(every) > 1 else ''}"
        elsewhere = sorted({port for cause in diagnosis.causes for port in cause.or_at})
        others = formatting.join(map(formatting.port_label, elsewhere), "or")
        tail = f", or at {others}: these recordings cannot separate them" if others else ""
        return sentence(f"{lead}{tail}")
    if not alike:
        return f"At the {formatting.port_label(where.port)} port."
    return sentence(
        f"at the {formatting.port_label(where.port)} port; these sensors cannot separate it from "
        f"{formatting.join(map(formatting.port_label, alike), 'or')}"
    )


def _alike(where: Where) -> str:
    """Ports that the sensors cannot separate, and the sensor that would help most; "" without
    any."""
    groups = [
        formatting.join(map(formatting.port_label, group))
        for group in where.indistinguishable
        if len(group) > 1
    ]
    texts = (
        [f"these sensors cannot separate effects of unknown form at {', or at '.join(groups)}"]
        if groups
        else []
    )
    texts += (
        [f"they do not respond to {formatting.join(map(formatting.port_label, where.unseen))}"]
        if where.unseen
        else []
    )
    texts += [
        f"measuring {sensor_label(sensor.sensor)} as well would separate "
        f"{', and '.join(split_labels(sensor))}"
        for sensor in where.sensors
        if sensor.splits and max((each.share for each in where.ports), default=0.0) < _SETTLED
    ][:1]
    return sentence("; ".join(texts))


def _regime(regime: Regime) -> str:
    if regime.share_of_gap is None:
        return sentence(regime_label(regime))
    text = f"{regime_label(regime)}: {percent(regime.share_of_gap)} of the gap"
    if regime.share_of_time:
        text += (
            f" in {percent(regime.share_of_time)} of the time, "
            f"{times_text(regime.share_of_gap / regime.share_of_time)} times"
        )
        text += " its share"
    return sentence(text)


def which_answer(run: RunData) -> AnswerText:
    """Cause of the gap, similar effects, and the runner-up."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return AnswerText("Not diagnosed yet.", (DIAGNOSE_HINT,))
    leads = {
        "explained": _explained,
        "partly-explained": _explained,
        "ambiguous": _ambiguous,
        "unknown-effect": _unknown,
        "no-structural-gap": _no_gap,
        "cannot-tell": _cannot_tell,
    }
    lead, details = leads[diagnosis.verdict](diagnosis)
    details += _refits(diagnosis)
    return AnswerText(lead, (*details, *_confidence_set(diagnosis), _confidence(diagnosis)))


def _refits(diagnosis: DiagnosisFile) -> list[str]:
    """The parameters of the answer's model that moved off the data sheet, with intervals."""
    if diagnosis.remark:
        return []
    refits = refitted_parameters(diagnosis.parameters)
    texts = []
    for name, entry in refits.shown.items():
        prior = "" if entry.prior is None else f"{short(entry.prior)} → "
        unit_text = channel_unit(name)
        value = (
            f"{short(entry.value)}{formatting.SPACE}{unit_text}"
            if unit_text
            else short(entry.value)
        )
        tail = formatting.interval_tail(formatting.span(entry.low, entry.high)) + bound_text(entry)
        texts.append(f"{channel_label(name)} {prior}{value}{tail}")
    texts += [refits.remark()] if refits.remark() else []
    return [sentence(f"refitted: {'; '.join(texts)}")] if texts else []


def _confidence(diagnosis: DiagnosisFile) -> str:
    """The meaning of a probability."""
    if diagnosis.remark or not any(
        candidate.probability is not None for candidate in diagnosis.ranking
    ):
        return ""
    return f"{PROBABILITY_MEANS}."


def _explained(diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    findings = verdict_words.findings_of(diagnosis)
    lead = sentence(formatting.join(_with_chance(diagnosis, finding) for finding in findings))
    return lead, _removed(diagnosis) + _sizes(diagnosis) + _unsettled(diagnosis)


def _with_chance(diagnosis: DiagnosisFile, finding: verdict_words.Finding) -> str:
    cause, text = finding[0], verdict_words.finding_label(diagnosis, finding, SPELLING)
    port = formatting.port_label(cause.port) if len(finding) == 1 else ""
    text += f" at the {port} port" if port and "@" not in cause.effect else ""
    chance = cause.probability
    return text if chance is None else f"{text}, with probability {formatting.chance(chance)}"


def _removed(diagnosis: DiagnosisFile) -> list[str]:
    """Share of the gap that every cause removes, and the parts of the causes in the sum."""
    several = len(diagnosis.causes) > 1
    company = " next to the other" + ("s" if len(diagnosis.causes) > 2 else "") if several else ""
    if diagnosis.verdict == "ambiguous":
        company = " alone"
    details = [
        sentence(
            f"{effect_label(cause.effect)} removes {percent(cause.removes.share)} of the gap"
            f"{company}"
            f"{formatting.interval_tail(percent_span(cause.removes.low, cause.removes.high))}"
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


def _sizes(diagnosis: DiagnosisFile) -> list[str]:
    """Parameters of the causes with their intervals."""
    texts = []
    for cause in diagnosis.causes:
        for name, parameter in cause.parameters.items():
            size = formatting.with_interval(
                parameter.value, parameter.low, parameter.high, channel_unit(name)
            )
            texts.append(sentence(f"{effect_label(cause.effect)}: {channel_label(name)} {size}"))
    return texts


def _ambiguous(diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    lead = sentence(f"{causes_label(diagnosis)}: these recordings cannot separate them")
    return lead, _removed(diagnosis) + _sizes(diagnosis) + _unsettled(diagnosis)


def _unsettled(diagnosis: DiagnosisFile) -> list[str]:
    """Causes whose refit did not converge."""
    named = {cause.effect for cause in diagnosis.causes}
    return [
        sentence(not_converged(f"the refit with {effect_label(candidate.effect)}", candidate.why))
        for candidate in diagnosis.ranking
        if candidate.effect in named and not candidate.converged
    ]


def _unknown(diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    unknown, families = diagnosis.unknown, verdict_words.free_families(diagnosis, SPELLING)
    lead = f"None of the catalogue; it is {families}." if families else "None of the catalogue."
    if unknown is None:
        return lead, []
    texts = (*_free_forms(unknown), *nature_texts(unknown), *formula_texts(unknown))
    return lead, [text for text in texts if text]


def _free_forms(unknown: Unknown) -> list[str]:
    """Share that each family's free form removes, and the parameters fitted with its curve."""
    texts = []
    for form in unknown.free_forms:
        share = form.removes or form
        interval = formatting.interval_tail(percent_span(share.low, share.high))
        texts.append(sentence(f"{taken_up(form)}{interval}"))
    if len(texts) > 1:
        texts.append("These recordings cannot separate these curves.")
    if texts:
        texts.append(
            "The curve is fitted together with the parameters of the rig. A part that both can "
            "take up, such as one in proportion, may be divided differently."
        )
    return texts


def _no_gap(diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    return "No effect is needed beyond refitted parameters and the tolerances.", []


def _cannot_tell(diagnosis: DiagnosisFile) -> tuple[str, list[str]]:
    return "Undetermined.", []


def _confidence_set(diagnosis: DiagnosisFile) -> list[str]:
    """The confidence set, if it is too large for the lead; the ranking shows the other
    candidates."""
    details = []
    if diagnosis.verdict == "cannot-tell" and len(diagnosis.tied) > 1:
        names = formatting.join(map(effect_label, diagnosis.tied))
        details.append(f"These recordings cannot separate {names}.")
    return details if len(diagnosis.ranking) > 1 else [*details, "No other candidate was refitted."]


def how_far_answer(run: RunData, rows: tuple[ChannelErrors, ...]) -> AnswerText:
    """How far the gap shrinks: mean absolute errors of the headline channel, and the shrinkage of
    every channel."""
    row = headline(rows)
    if row is None:
        return AnswerText("No channel was scored.")
    what, unit_text = channel_label(row.channel), channel_unit(row.channel)
    details = [*_limits(row, unit_text), *_horizon(run, row, unit_text), *_forecast(run)]
    points = (
        [_channel_point(item) for item in rows if item.shrinkage is not None]
        if len(rows) > 1
        else []
    )
    lead = sentence(f"the held-out {what} error is {_steps(run, row, unit_text)}")
    return AnswerText(lead, tuple(details), tuple(points))


def _steps(run: RunData, row: ChannelErrors, unit_text: str) -> str:
    steps = [
        (row.data_sheet, "from the data sheet"),
        (row.refitted, "refitted"),
        (row.with_cause, _cause_label(run)),
    ]
    texts = [
        f"{formatting.with_unit_text(value, unit_text)} {name}"
        for value, name in steps
        if value is not None
    ]
    return formatting.join(texts) or "unknown"


def _cause_label(run: RunData) -> str:
    return f"with {causes_label(run.diagnosis)}" if run.diagnosis is not None else "with the cause"


def _limits(row: ChannelErrors, unit_text: str) -> list[str]:
    """Noise floor, compared with the error of the best model."""
    best = row.with_cause if row.with_cause is not None else row.refitted
    texts = []
    if row.noise_floor is not None:
        text = f"The noise floor is {formatting.with_unit_text(row.noise_floor, unit_text)}"
        if best is not None and row.noise_floor > 0:
            times = best / row.noise_floor
            text += (
                "; the remaining error is no larger"
                if times < 1.1
                else f"; the remaining error is {times_text(times)} times that"
            )
        texts.append(f"{text}.")
    return texts


def _horizon(run: RunData, row: ChannelErrors, unit_text: str) -> list[str]:
    """The time over which the model predicts, and the error over single windows where that is
    longer."""
    diagnosis = run.diagnosis
    if diagnosis is None or diagnosis.horizon_s is None:
        return []
    time = formatting.with_unit_text(diagnosis.horizon_s, "s")
    texts = [f"The model predicts over up to {time} from one estimated state."]
    reach = diagnosis.how_far.get(row.channel)
    if reach is not None and reach.mae_refitted_short is not None:
        short = formatting.with_unit_text(reach.mae_refitted_short, unit_text)
        texts.append(f"With a state estimated in every window the refitted error is {short}.")
    return texts


def _forecast(run: RunData) -> list[str]:
    """The share of the error that the causes would remove on a new recording."""
    forecast = run.diagnosis.forecast if run.diagnosis is not None else None
    if forecast is None:
        return []
    interval = formatting.interval_tail(percent_span(forecast.low, forecast.high))
    return [
        f"On a new recording {percent(forecast.share)} of the error would be removed{interval}."
    ]


def _channel_point(row: ChannelErrors) -> str:
    interval = percent_span(row.low, row.high)
    tail = formatting.interval_tail(interval)
    return sentence(
        f"{channel_label(row.channel)}: {percent(row.shrinkage)} of the held-out error "
        f"removed{tail}"
    )


def left_answer(run: RunData) -> AnswerText | None:
    """Remainder of the gap with the causes, or the gap without any: size, place and form. None
    without a remainder."""
    diagnosis = run.diagnosis
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is None or rest is None or diagnosis.remark:
        return None
    caused = bool(diagnosis.causes)
    at = f", at the {formatting.port_label(rest.port)} port" if rest.port else ""
    part = percent(max(rest.share, 0.0)) if caused and rest.share is not None else "all"
    lead = f"{part} of the gap{at}." if rest.real else "No material part of the gap."
    size = set_figures(verdict_words.size_of(rest, with_causes=caused))
    amount = set_figures(verdict_words.amount_of(rest))
    details = [sentence(f"remaining: {size}") if size else "", sentence(amount) if amount else ""]
    if caused and (term := missing_term(diagnosis)) is not None:
        details += formula_texts(term)
    if caused and (advice := verdict_words.advice_of(rest)):
        details.append(sentence(advice))
    if rest.real and rest.family:
        details.append(
            sentence(f"a curve of the {effect_label(rest.family)} family would remove it")
        )
    return AnswerText(sentence(lead), tuple(filter(None, details)))


def next_answer(run: RunData) -> AnswerText:
    """Next experiment, its expected result, its duration and the place of its excitation."""
    if run.diagnosis is None:
        return AnswerText(
            "Run the diagnosis on what is already recorded.", (_diagnose_command(run),)
        )
    experiment = run.diagnosis.next_experiment
    if experiment is None:
        none = "The diagnosis recommends no further experiment."
        return AnswerText(formatting.clean(run.diagnosis.withheld) or none)
    separated = formatting.join(map(effect_label, experiment.separates))
    details = [
        sentence(reason_text(experiment)),
        sentence(f"it separates {separated}") if separated else "",
        _expected(experiment),
        *(sentence(formatting.clean(text)) for text in experiment.cautions),
    ]
    # no file elsewhere is vouched for
    local_files = [name for name in experiment.files if name == Path(name).name]
    if local_files:
        verb = (
            "Its excitation is"
            if len(local_files) == 1
            else "Its excitations, one for each run, are"
        )
        files = formatting.join(f"`{formatting.clean(name)}`" for name in local_files)
        details.append(f"{verb} {files} in the run folder, ready to be sent.")
    runs = [
        formatting.join(
            f"{channel_label(name)} {formatting.with_unit_text(value, channel_unit(name))}"
            for name, value in setting.items()
        )
        for setting in experiment.settings
    ]
    points = (
        [sentence(f"run {k}: {item}") for k, item in enumerate(runs, start=1) if item]
        if len(runs) > 1
        else []
    )
    return AnswerText(
        sentence(effect_label(experiment.name)),
        tuple(detail for detail in details if detail),
        tuple(points),
    )


def _expected(experiment: NextExperiment) -> str:
    texts = []
    if experiment.expected_separation is not None:
        texts.append(
            "the nearest two of these models are expected to differ there by "
            f"{times_text(experiment.expected_separation)} times the noise of the sensors"
            + (", too little to set them apart clearly" if _NOT_APART in experiment.why else "")
        )
    if experiment.minutes is not None:
        takes = minutes_text(experiment.minutes).replace(" ", formatting.SPACE)
        texts.append(f"it takes about {takes} at the rig")
    return sentence("; ".join(texts))


def _diagnose_command(run: RunData) -> str:
    """A command line to copy; names of the run are quoted as single words."""
    if run.fit is None or not run.fit.recordings:
        return DIAGNOSE_HINT
    files = [
        f"{'--held-out ' if recording.role == 'held-out' else ''}{quoted(formatting.clean(recording.path or recording.name))}"  # noqa: E501
        for recording in run.fit.recordings
    ]
    rig = quoted(formatting.clean(run.named_rig)) if run.named_rig else ""
    return " ".join(
        ["`pamid diagnose", *files, *([f"--rig {rig}"] if rig else []), "--output diagnosis`"]
    )
