"""The findings in sentences, built from the numbers: verdict, titles of the figures. No file
content is trusted here to be more than text; escaping happens where the page is made.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from pamid.report import formatting
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors, WorstWindow, headline
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    percent,
    with_unit_text,
)
from pamid.report.load import RunData
from pamid.report.reading import FloatArray
from pamid.schemas.added_variables_file import AddedVariable
from pamid.schemas.diagnosis_file import (
    Candidate,
    DiagnosisFile,
    FamilyForm,
    NextExperiment,
    Regime,
    Sensor,
    Where,
)
from pamid.schemas.network_file import NetworkFile
from pamid.verdict.verdict_words import (
    Spelling,
    finding_label,
    findings_of,
    free_families,
    sentence,
)

#: where the reason for an experiment goes on with its settings, or with what it was weighed by
_WEIGHED = re.compile(r"; (?:with \w+ =|simulated on )")
LEAST_SIGNAL_SHARE = 0.1  # share of an error that a signal explains, to be named
#: names in the sentence of a verdict
SPELLING = Spelling(effect_label, formatting.port_label)


def causes_label(diagnosis: DiagnosisFile) -> str:
    """ "Coulomb friction", "Coulomb friction in the joints and dead time"; for an ambiguous verdict
    joined by "or"."""
    last = "or" if diagnosis.verdict == "ambiguous" else "and"
    findings = findings_of(diagnosis)
    return formatting.join(
        (finding_label(diagnosis, finding, SPELLING) for finding in findings), last
    )


def model_label(field: str, diagnosis: DiagnosisFile | None) -> str:
    """Legend entry of a field of ChannelErrors: "refitted", "with Coulomb friction", "with the
    causes"."""
    if field == "with_cause" and diagnosis is not None and _together(diagnosis):
        return (
            f"with {causes_label(diagnosis)}" if len(diagnosis.causes) == 1 else "with the causes"
        )
    return MODEL_NAMES[field]


def _together(diagnosis: DiagnosisFile) -> bool:
    """Whether one model has all the causes, so that the figures belong to it."""
    return bool(diagnosis.causes) and diagnosis.verdict != "ambiguous"


def candidate_order(diagnosis: DiagnosisFile) -> list[Candidate]:
    """The ranking as the diagnosis wrote it: best first."""
    return list(diagnosis.ranking)


def over_channels(diagnosis: DiagnosisFile) -> str:
    """ " over all channels" where the ranking is about several of them."""
    several = (
        any(len(candidate.held_out) > 1 for candidate in diagnosis.ranking)
        or len(diagnosis.how_far) > 1
    )
    return " over all channels" if several else ""


def runner_up(diagnosis: DiagnosisFile) -> Candidate | None:
    """The best candidate of a family that is neither named nor tied; else the best that is not a
    cause."""
    named = {cause.effect for cause in diagnosis.causes}
    families = {cause.family for cause in diagnosis.causes}
    others = [candidate for candidate in diagnosis.ranking if candidate.effect not in named]
    different = [
        other
        for other in others
        if other.family not in families
        and other.effect not in diagnosis.tied
        and not other.set_aside
    ]
    return (different or others or [None])[0]  # type: ignore[list-item]


def reason_text(experiment: NextExperiment) -> str:
    """Kind and purpose of an experiment; its settings and scores are listed separately."""
    return _WEIGHED.split(formatting.clean(experiment.why), maxsplit=1)[0].rstrip(".")


def closest(diagnosis: DiagnosisFile) -> Candidate | None:
    """Where no effect is named: the candidate that is there most probably, the best ranked of those
    that are as probable."""
    return max(diagnosis.ranking, key=lambda item: item.probability or 0.0, default=None)


def verdict_sentence(run: RunData, rows: tuple[ChannelErrors, ...]) -> str:
    """The whole page in one sentence."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return _fit_sentence(headline(rows))
    return formatting.sentence(set_figures(sentence(diagnosis, SPELLING)))


def set_figures(text: str) -> str:
    """One line without a line break between a number and its sign, or the P before it."""
    clean = formatting.clean(text).replace(" %", f"{formatting.SPACE}%")
    return clean.replace("(P ", f"(P{formatting.SPACE}")


def free_form_title(diagnosis: DiagnosisFile, family_form: FamilyForm) -> str:
    """ "A function of the velocity at the guide port removes 87 % of the gap: of the friction
    family, in a form that is not in the catalogue"."""
    text = f"{taken_up(family_form)}: {free_families(diagnosis, SPELLING)}"
    return formatting.sentence(text).removesuffix(".")


def taken_up(family_form: FamilyForm) -> str:
    """ "a function of the velocity at the guide port removes 87 % of the gap"; of the held-out
    error where the file is of an older version."""
    at = f" at the {formatting.port_label(family_form.port)} port" if family_form.port else ""
    what = formatting.clean(family_form.known_by) or effect_label(family_form.effect)
    if family_form.removes is None:
        return f"{what}{at} removes {percent(family_form.shrinkage)} of the held-out error"
    return f"{what}{at} removes {percent(family_form.removes.share)} of the gap"


def _fit_sentence(row: ChannelErrors | None) -> str:
    if row is None or row.refitted is None:
        return "Fitted, not yet diagnosed."
    unit_text, what = channel_unit(row.channel), channel_label(row.channel)
    if row.data_sheet is None:
        return (
            f"Refitted, not yet diagnosed: the held-out {what} error is "
            f"{with_unit_text(row.refitted, unit_text)}."
        )
    if row.refitted >= row.data_sheet:
        return (
            f"Refitting does not help: the held-out {what} error is "
            f"{with_unit_text(row.refitted, unit_text)}, {formatting.short(row.data_sheet)} from "
            "the data sheet; the cause is not yet diagnosed."
        )
    return (
        f"Refitting takes the held-out {what} error from {formatting.short(row.data_sheet)} to "
        f"{with_unit_text(row.refitted, unit_text)}; what is left is not yet diagnosed."
    )


def _changes(diagnosis: DiagnosisFile, row: ChannelErrors) -> str:
    """Verb phrase for the reduction of the error, in the number of the causes."""
    grows = (row.with_cause or 0.0) > (row.refitted or 0.0)
    single = len(diagnosis.causes) == 1
    verb = ("raise" if grows else "take") + ("s" if single else "")
    return verb if single else f"together {verb}"


def ports_title(where: Where) -> str:
    """ "81 % of the gap enters at the joint port, 12 % at the muscle port", or that the verdict
    names another port."""
    ordered = sorted(((item.port, item.share) for item in where.ports), key=lambda item: -item[1])
    named = [entry for entry in ordered if entry[0] == where.port]
    if named and named[0][1] < ordered[0][1]:
        return (
            f"{percent(ordered[0][1])} of the gap might enter at the "
            f"{formatting.port_label(ordered[0][0])} port; the verdict names the "
            f"{formatting.port_label(where.port)} port, with {percent(named[0][1])}"
        )
    ordered = named + [entry for entry in ordered if entry[0] != where.port]
    (port, share), others = ordered[0], ordered[1:2]
    tail = (
        f", {percent(others[0][1])} at the {formatting.port_label(others[0][0])} port"
        if others
        else ""
    )
    return f"{percent(share)} of the gap enters at the {formatting.port_label(port)} port{tail}"


def sensor_label(name: str) -> str:
    """ "force_1_n and force_2_n" -> "force 1 and force 2"; "the value at port angle_sensor" -> "...
    angle sensor"."""
    if name.startswith("the "):
        return formatting.port_label(name)
    return formatting.join(map(channel_label, name.split(" and ")))


def split_labels(sensor: Sensor) -> list[str]:
    """Groups of ports that a sensor would separate: ["muscle and joint"]."""
    return [formatting.join(map(formatting.port_label, group)) for group in sensor.splits]


def regime_label(regime: Regime) -> str:
    """ "velocity between -2 and 2 deg/s"."""
    unit_text = formatting.unit_label(regime.unit)
    if regime.low is not None and regime.high is not None:
        place = (
            f"{formatting.port_label(regime.signal)} between {formatting.short(regime.low)} and "
            f"{formatting.short(regime.high)}"
        )
        return place + (f"{formatting.SPACE}{unit_text}" if unit_text else "")
    interval = formatting.span(regime.low, regime.high, unit_text)
    return f"{formatting.port_label(regime.signal)} {interval}".replace(formatting.DASH, "")


def regimes_title(regimes: list[Regime]) -> str:
    """ "70 % of the gap lies in 20 % of the time: velocity between -2 and 2 deg/s"."""
    best = regimes[0]
    return (
        f"{percent(best.share_of_gap)} of the gap lies in {percent(best.share_of_time)} of the "
        f"time: {regime_label(best)}"
    )


def missing_title(port: str, signal: str, share: float) -> str:
    """ "Velocity alone accounts for 31 % of what is missing at the joint port"."""
    at = f" at the {formatting.port_label(port)} port" if port else ""
    name = formatting.port_label(signal)
    text = f"{name} alone accounts for {percent(share)} of what is missing{at}"
    return formatting.sentence(text).removesuffix(".")


def ranking_title(diagnosis: DiagnosisFile) -> str:
    """The best candidate against the runner-up; for verdicts without a cause, how far the best
    falls short."""
    best, second = diagnosis.ranking[0], runner_up(diagnosis)
    if not diagnosis.causes:
        best = closest(diagnosis) or best
        tail = {
            "unknown-effect": "not enough to be named",
            "no-structural-gap": "no effect is needed",
        }.get(diagnosis.verdict, "these recordings do not suffice to confirm it")
        return formatting.sentence(
            f"the most probable candidate, {effect_label(best.effect)}, removes "
            f"{percent(best.shrinkage)} of the held-out error{over_channels(diagnosis)}; {tail}"
        ).removesuffix(".")
    first = effect_label(diagnosis.causes[0].effect)
    text = (
        f"{first} is the only candidate that was refitted"
        if second is None
        else f"{first} is named; the best of the others is {effect_label(second.effect)}"
    )
    return formatting.sentence(text).removesuffix(".")


def added_title(plots: Sequence[AddedVariable], diagnosis: DiagnosisFile) -> str:
    """ "Coulomb friction explains 98 % of the angle residual, slope 1.00 ± 0.04; offset explains
    1 %, slope 6 ± 5"."""
    first, *others = plots
    text = f"{effect_label(first.effect)} {added_line(first)}"
    for other in others:
        of = "" if other.channel == first.channel else f" of that of {channel_label(other.channel)}"
        text += f"; {effect_label(other.effect)} {percent(other.share)}{of}"
    if len(plots) == 1 and first.effect in {cause.effect for cause in diagnosis.causes}:
        text += "; it is named"
    return formatting.sentence(text).removesuffix(".")


def added_line(plot: AddedVariable) -> str:
    """ "explains 98 % of the refitted model's angle residual, slope 1 ± 0.04"."""
    return (
        f"explains {percent(plot.share)} of the refitted model's {channel_label(plot.channel)} "
        f"residual{_next_to(plot)}, {slope_text(plot)}"
    )


def added_words(plot: AddedVariable) -> str:
    """ "98 %, slope 1.00 ± 0.04"."""
    return f"{percent(plot.share)}, {slope_text(plot)}".replace(formatting.SPACE, " ")


def slope_text(plot: AddedVariable) -> str:
    """Slope with half its 95 % interval, and a remark if the interval contains zero."""
    half = 0.5 * (plot.high - plot.low)
    text = f"slope {formatting.short(plot.slope, 2)} ± {formatting.short(half, 1)}"
    return f"{text} (may be 0)" if plot.low <= 0.0 <= plot.high else text


def _next_to(plot: AddedVariable) -> str:
    return f" next to {formatting.join(map(effect_label, plot.beside))}" if plot.beside else ""


def candidate_tip(candidate: Candidate, diagnosis: DiagnosisFile) -> str:
    """Tooltip of a row of the ranking: "Dahl friction removes 53 % of ..."."""
    interval = formatting.interval_tail(formatting.percent_span(candidate.low, candidate.high))
    text = (
        f"{effect_label(candidate.effect)} removes {percent(candidate.shrinkage)} of the held-out "
        "error"
        f"{over_channels(diagnosis)}{interval}"
    )
    text += (
        ""
        if candidate.probability is None
        else f", probability {formatting.chance(candidate.probability)}"
    )
    if not candidate.converged:
        text += f"; {formatting.not_converged('its fit', candidate.why)}"
    return formatting.sentence(text)


def budget_title(rows: tuple[ChannelErrors, ...], diagnosis: DiagnosisFile | None) -> str:
    """ "Coulomb friction takes the held-out angle error from 0.52 to 0.11 deg"."""
    row = headline(rows)
    if row is None or row.refitted is None:
        return "Held-out error of each model"
    what, unit_text = channel_label(row.channel), channel_unit(row.channel)
    known = row.with_cause is not None and row.refitted > 0
    if diagnosis is not None and _together(diagnosis) and known and row.with_cause is not None:
        text = (
            f"{causes_label(diagnosis)} {_changes(diagnosis, row)} the held-out {what} error from "
            + formatting.in_one_unit((row.refitted, row.with_cause), unit_text, " to ")
        )
        if row.noise_floor is not None:
            text += f"; the noise floor is {with_unit_text(row.noise_floor, unit_text)}"
        return formatting.sentence(text).removesuffix(".")
    if row.data_sheet is None:
        return (
            f"The refitted model errs by {with_unit_text(row.refitted, unit_text)} in {what}, "
            "held out"
        )
    both = formatting.in_one_unit((row.data_sheet, row.refitted), unit_text, " to ")
    text = f"Refitting changes the held-out {what} error from {both}"
    return (
        text
        if row.noise_floor is None
        else f"{text}; the noise floor is {with_unit_text(row.noise_floor, unit_text)}"
    )


def window_title(run: RunData, channel: str, window: WorstWindow, kinds: tuple[str, ...]) -> str:
    """ "Worst held-out window: the angle error falls from 1.20 to 0.210 deg with Coulomb
    friction"."""
    part = "held-out" if window.held_out else "fitted"
    what, unit_text = channel_label(channel), channel_unit(channel)
    before = window.mae["refitted"]
    for kind in reversed(kinds):
        if kind in ("cause", "network") and kind in window.mae:
            causes = causes_label(run.diagnosis) if run.diagnosis is not None else "the causes"
            corrected = f"{causes} and the network" if run.network_on_causes(channel) else ""
            added = causes if kind == "cause" else corrected or "the network"
            change = "falls" if window.mae[kind] < before else "grows"
            return (
                f"Worst {part} window: the {what} error {change} from {formatting.short(before)} "
                f"to {with_unit_text(window.mae[kind], unit_text)} with {added}"
            )
    return (
        f"Worst {part} window: the refitted model errs by {with_unit_text(before, unit_text)} "
        f"in {what}"
    )


def free_run_title(channel: str, whole: WorstWindow, diagnosis: DiagnosisFile | None) -> str:
    """ "Free run over the whole recording: the angle error is 1.2 deg on average, 0.21 deg with
    Coulomb friction"."""
    what, unit_text = channel_label(channel), channel_unit(channel)
    text = (
        f"Free run over the whole recording: the {what} error is "
        f"{with_unit_text(whole.mae['free_run'], unit_text)} on average"
    )
    if "cause_free_run" not in whole.mae or diagnosis is None:
        return text
    error = with_unit_text(whole.mae["cause_free_run"], unit_text)
    return f"{text}, {error} with {causes_label(diagnosis)}"


def error_signal_title(
    channel: str,
    signal: str,
    share: float,
    removed: float | None,
    diagnosis: DiagnosisFile | None,
) -> str:
    """ "Velocity alone accounts for 62 % of the variance of the refitted angle error; Coulomb
    friction removes 97 % of that part"."""
    what = f"the variance of the refitted {channel_label(channel)} error"
    if share <= 0.0:
        return f"No recorded signal alone accounts for more of {what} than chance does"
    if share < LEAST_SIGNAL_SHARE:
        return f"No recorded signal alone accounts for more than {percent(share)} of {what}"
    text = f"{formatting.port_label(signal)} alone accounts for {percent(share)} of {what}"
    if removed is not None and removed > 0.0 and diagnosis is not None and diagnosis.causes:
        verb = "removes" if len(diagnosis.causes) == 1 else "remove"
        text += f"; {causes_label(diagnosis)} {verb} {percent(removed)} of that part"
    return formatting.sentence(text).removesuffix(".")


def pulls_title(pulls: dict[str, float]) -> str:
    """Whether the tolerance terms stay within their limits."""
    name, largest = max(pulls.items(), key=lambda item: abs(item[1]))
    worst = f"{formatting.port_label(name)} with {formatting.short(largest, 2)}"
    beyond = sum(abs(pull) > 2.0 for pull in pulls.values())
    if beyond:
        many = "term lies" if beyond == 1 else "terms lie"
        return f"{beyond} tolerance {many} beyond twice the limit, the farthest {worst}"
    return f"The tolerance terms stay within twice their limits; the largest is {worst}"


def training_title(trace: dict[str, FloatArray], network: NetworkFile | None) -> str:
    """End of the training, and number of parameters in use."""
    iteration = formatting.count(float(trace["iteration"][-1]))
    text = f"Training ends at iteration {iteration} with an MSE of "
    text += formatting.short(float(trace["mse"][-1]))
    gamma = trace.get("gamma")
    if gamma is None or not np.isfinite(gamma[-1]):
        return text
    of = (
        f" of {formatting.count(network.n_weights)}"
        if network is not None and network.n_weights is not None
        else ""
    )
    return f"{text}, using {formatting.short(float(gamma[-1]))}{of} parameters"


def timeline_title(
    channel: str, run: RunData, recording: int, curves: dict[str, tuple[FloatArray, FloatArray]]
) -> str:
    """Concentration of the error in time."""
    error = curves["refitted"][1]
    error = error[np.isfinite(error)]
    order = np.sort(error)[::-1]
    half = int(np.searchsorted(np.cumsum(order), 0.5 * order.sum())) + 1
    what = formatting.clean(f"{channel_label(channel)} error{run.recording_words(recording)}")
    if not order.size:
        return f"No refitted {what} is known in the time shown"
    return f"Half of the refitted {what} lies in {percent(half / order.size)} of the time shown"
