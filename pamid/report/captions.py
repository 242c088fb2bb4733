"""Phrases that answers, figures and tables share, built from the numbers. No file content is
trusted here to be more than text; escaping happens where the page is made.
"""

from __future__ import annotations

import re

from pamid.base.errors import join_words
from pamid.base.schemas.added_variables_file import AddedVariable
from pamid.base.schemas.diagnosis_file import (
    Candidate,
    Cause,
    DiagnosisFile,
    FamilyForm,
    NextExperiment,
    Regime,
    Sensor,
    Unknown,
)
from pamid.base.schemas.estimates import Estimate
from pamid.diagnosis.verdict.verdict_words import Spelling, finding_label, findings_of, sentence
from pamid.report import formatting
from pamid.report.channel_errors import MODEL_NAMES, ChannelErrors, headline
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    percent,
    port_label,
    with_unit_text,
)
from pamid.report.load import RunData

#: where the reason for an experiment goes on with its settings, or with what it was weighed by
_WEIGHED = re.compile(r"; (?:with \w+ =|simulated on )")
MOST_LEADERS = 3  # added-variable plots that are shown at once
#: names in the sentence of a verdict
SPELLING = Spelling(effect_label, port_label)


def verdict_sentence(run: RunData, rows: tuple[ChannelErrors, ...]) -> str:
    """The whole page in a sentence."""
    if run.diagnosis is not None:
        return formatting.sentence(set_figures(sentence(run.diagnosis, SPELLING)))
    row = headline(rows)
    if row is None or row.refitted is None:
        return "Fitted, not yet diagnosed."
    error = f"the held-out {channel_label(row.channel)} error"
    refitted = with_unit_text(row.refitted, channel_unit(row.channel))
    if row.data_sheet is None:
        return f"Refitted, not yet diagnosed: {error} is {refitted}."
    data_sheet = formatting.short(row.data_sheet)
    if row.refitted >= row.data_sheet:
        return (
            f"Refitting does not help: {error} is {refitted}, {data_sheet} from the data sheet; "
            "the cause is not yet diagnosed."
        )
    return (
        f"Refitting takes {error} from {data_sheet} to {refitted}; what is left is not yet "
        "diagnosed."
    )


def set_figures(text: str) -> str:
    """A line without a line break between a number and its sign, or the P before it."""
    clean = formatting.clean(text).replace(" %", f"{formatting.SPACE}%")
    return clean.replace("(P ", f"(P{formatting.SPACE}")


def at_port(port: str) -> str:
    """ " at the joint port"; "" without a port."""
    return f" at the {port_label(port)} port" if port else ""


def ports_text(ports: list[str] | tuple[str, ...]) -> str:
    """ "muscle or joint 2"."""
    return join_words(map(port_label, ports), "or")


# ---- models and candidates -----------------------------------------------------------------------


def causes_label(diagnosis: DiagnosisFile) -> str:
    """ "Coulomb friction", "Coulomb friction in the joints and dead time"; for an ambiguous verdict
    joined by "or"."""
    last = "or" if diagnosis.verdict == "ambiguous" else "and"
    findings = findings_of(diagnosis)
    return join_words((finding_label(diagnosis, finding, SPELLING) for finding in findings), last)


def has_joint_model(diagnosis: DiagnosisFile | None) -> bool:
    """Whether a model has all the causes, so that the figures belong to it."""
    return diagnosis is not None and bool(diagnosis.causes) and diagnosis.verdict != "ambiguous"


def model_label(field: str, diagnosis: DiagnosisFile | None) -> str:
    """Legend entry of a model: "refitted", "with Coulomb friction", "with the causes"."""
    if field == "with_cause" and diagnosis is not None and has_joint_model(diagnosis):
        return (
            f"with {causes_label(diagnosis)}" if len(diagnosis.causes) == 1 else "with the causes"
        )
    return MODEL_NAMES[field]


def over_channels(diagnosis: DiagnosisFile) -> str:
    """ " over all channels" where the ranking is about several of them."""
    several = any(len(candidate.held_out) > 1 for candidate in diagnosis.ranking)
    return " over all channels" if several or len(diagnosis.how_far) > 1 else ""


def closest(diagnosis: DiagnosisFile) -> Candidate | None:
    """Where no effect is named: the candidate that is there most probably, the best ranked of those
    that are as probable."""
    return max(diagnosis.ranking, key=lambda item: item.probability or 0.0, default=None)


def first_parameter(cause: Cause) -> tuple[str, Estimate] | None:
    """The most informative parameter of an effect: the first that is not 0."""
    every = list(cause.parameters.items())
    return next((item for item in every if item[1].value), every[0] if every else None)


def added_leaders(run: RunData) -> list[AddedVariable]:
    """The plots shown at once: of the causes, then of the best of each further family."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return []
    plots = {(plot.effect, bool(plot.beside)): plot for plot in reversed(usable_plots(run))}
    together = any(company for _, company in plots) and diagnosis.verdict != "ambiguous"
    leaders, families = [], set[str]()
    for cause in diagnosis.causes:
        if plot := plots.get((cause.effect, together)):
            leaders.append(plot)
            families.add(cause.family)
    for candidate in diagnosis.ranking:
        plot = plots.get((candidate.effect, False))
        if plot is not None and candidate.family not in families:
            leaders.append(plot)
            families.add(candidate.family)
    return leaders[:MOST_LEADERS]


def usable_plots(run: RunData) -> list[AddedVariable]:
    """Plots of a run with two points or more."""
    plots = run.added.plots if run.added is not None else ()
    return [
        plot for plot in plots if len(plot.added) == len(plot.residual) >= 2 and any(plot.added)
    ]


def added_line(plot: AddedVariable) -> str:
    """ "explains 98 % of the refitted model's angle residual, slope 1 ± 0.04"."""
    next_to = f" next to {join_words(map(effect_label, plot.beside))}" if plot.beside else ""
    return (
        f"explains {percent(plot.share)} of the refitted model's {channel_label(plot.channel)} "
        f"residual{next_to}, {slope_text(plot)}"
    )


def slope_text(plot: AddedVariable) -> str:
    """Slope with half its 95 % interval, and a remark if the interval contains zero."""
    half = 0.5 * (plot.high - plot.low)
    text = f"slope {formatting.short(plot.slope, 2)} ± {formatting.short(half, 1)}"
    return f"{text} (may be 0)" if plot.low <= 0.0 <= plot.high else text


# ---- places --------------------------------------------------------------------------------------


def sensor_label(name: str) -> str:
    """ "force_1_n and force_2_n" -> "force 1 and force 2"; "the value at port angle_sensor" -> "...
    angle sensor"."""
    if name.startswith("the "):
        return port_label(name)
    return join_words(map(channel_label, name.split(" and ")))


def split_labels(sensor: Sensor) -> list[str]:
    """Groups of ports that a sensor would separate: ["muscle and joint"]."""
    return [join_words(map(port_label, group)) for group in sensor.splits]


def regime_label(regime: Regime) -> str:
    """ "velocity between -2 and 2 deg/s"."""
    name, unit_text = port_label(regime.signal), formatting.unit_label(regime.unit)
    if regime.low is not None and regime.high is not None:
        low, high = formatting.short(regime.low), formatting.short(regime.high)
        place = f"{name} between {low} and {high}"
        return place + (f"{formatting.SPACE}{unit_text}" if unit_text else "")
    interval = formatting.span(regime.low, regime.high, unit_text)
    return f"{name} {interval}".replace(formatting.DASH, "")


def reason_text(experiment: NextExperiment) -> str:
    """Kind and purpose of an experiment; its settings and scores are listed separately."""
    return _WEIGHED.split(formatting.clean(experiment.why), maxsplit=1)[0].rstrip(".")


# ---- effects outside the catalogue ---------------------------------------------------------------


def taken_up(form: FamilyForm) -> str:
    """ "a function of the velocity at the guide port removes 87 % of the gap"; of the held-out
    error where the file is of an older version."""
    what = formatting.clean(form.known_by) or effect_label(form.effect)
    share, of = (
        (form.shrinkage, "held-out error") if form.removes is None else (form.removes.share, "gap")
    )
    return f"{what}{at_port(form.port)} removes {percent(share)} of the {of}"


def missing_term(diagnosis: DiagnosisFile | None) -> Unknown | None:
    """Description of the missing term: the whole gap, or the remainder after the causes."""
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is None or diagnosis.unknown is not None:
        return diagnosis.unknown if diagnosis is not None else None
    if rest is None or not (rest.real and diagnosis.causes):
        return None
    return Unknown.model_validate({"port": rest.port, "formula": rest.formula})
