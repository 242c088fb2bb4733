"""Report of a reproduced paper: sections of tables and sentences, and the pictures of its folder.

paper.json is of the first paper (schema pamid.paper/1), arm-paper.json of the second
(pamid.paper-arm/1).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from markupsafe import Markup
from PIL import Image, UnidentifiedImageError

from pamid.base.errors import FileError
from pamid.base.files import PICTURE, read_data
from pamid.base.result_file import REMEDY, read_result
from pamid.base.run_folder import FIGURES_FOLDER
from pamid.base.schemas.paper_files import (
    ArmCoupling,
    ArmErrors,
    ArmEstimate,
    ArmPaperFile,
    PaperFile,
    StageEstimate,
)
from pamid.base.schemas.run_file import Step
from pamid.report import formatting
from pamid.report.channel_errors import ChannelErrors
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    clean,
    effect_label,
    number,
    percent,
    sentence,
)
from pamid.report.load import RunData
from pamid.report.markup import paragraphs
from pamid.report.page import Page, Section, image, note, table
from pamid.report.provenance import provenance
from pamid.report.run_page import answer_sections
from pamid.report.style import Picture

JOINT_FILE, ARM_FILE = "paper.json", "arm-paper.json"
_MOST_PIXELS = 40_000_000
#: keys of the arm's errors -> heading
_ARM_MODELS = {
    "data_sheet": "data sheet",
    "without_dry_friction": "without dry friction",
    "analytic_alone": "analytic law alone",
    "anfis_alone": "ANFIS law alone",
    "fitted_analytic": "analytic, with corrections",
    "fitted_anfis": "ANFIS, with corrections",
    "noise_floor": "noise",
}
_COUPLING = "coupling"
_STAR = "*: the interval does not hold the truth."
_UNSEEN = "Mean absolute error on recordings that no fit has seen."
#: the first paper's figures: heading, picture, what it shows
_JOINT_FIGURES = (
    (
        "Responses to the steps",
        "responses",
        "The angle over its reference in the control loop, at the inertia that the network was "
        "trained at and at an inertia that it has never seen (figures 5, 6 and 9 of the paper).",
    ),
    (
        "Pressures on the steps",
        "pressures",
        "Gauge pressures of both muscles, of which the network learns nothing.",
    ),
    (
        "The record that the network is trained on",
        "excitation",
        "An APRBS and what the analytic model leaves of the angle, each scaled into [-1, 1] "
        "(figure 7 of the paper).",
    ),
    (
        "The force law",
        "force-surface",
        "The polynomial of fifth order that the paper fits to the maker's chart (its figure 2), "
        "and the default law of the rig.",
    ),
)
_TRAINING_STILL = "network-training"
_TESTS = {"gravity": "Gravity tests", "pulses": "Valve pulses"}
_JOINT_TRAINING = {
    "iterations": "iterations",
    "seconds": "seconds",
    "mse": "MSE",
    "rmse_of_range": "RMSE, of the range",
    "gradient": "gradient",
    "mu": "mu",
    "gamma": "effective parameters",
    "n_weights": "parameters",
}


def paper_page(
    paper: Page,
    steps: tuple[Step, ...],
    run: RunData | None,
    rows: tuple[ChannelErrors, ...],
    pictures: Mapping[str, Picture],
) -> Page:
    """The report of a paper with provenance and, if any, the answers of its diagnosis."""
    sections = [*paper.sections, provenance(steps)]
    if run is not None:
        answers = answer_sections(run, rows, pictures)
        sections.insert(-1, Section("The diagnosis of the training record", answers))
    return replace(paper, sections=tuple(sections))


def read_paper(folder: Path) -> Page | None:
    """The reproduced paper in a folder, or None; FileError if its file is damaged."""
    joint = read_result(folder / JOINT_FILE, PaperFile)
    if joint is not None:
        return _joint(joint, folder)
    arm = read_result(folder / ARM_FILE, ArmPaperFile)
    return None if arm is None else _arm(arm, folder)


def _still(folder: Path, name: str, title: str) -> Markup | None:
    """A picture that the run has already drawn."""
    path = folder / FIGURES_FOLDER / f"{name}.png"
    if not path.exists():
        return None
    try:
        png = read_data(path, PICTURE)
        with Image.open(io.BytesIO(png), formats=("PNG",)) as picture:
            wide, tall = picture.size
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise FileError(f"{path} is not a picture: {error}.", REMEDY, code="damaged") from None
    if wide * tall > _MOST_PIXELS:
        raise FileError(f"{path} is too large: {wide} x {tall} pixels.", REMEDY, code="damaged")
    return image(name, title, png, wide, tall)


def _topic(
    title: str,
    rows: Sequence[Sequence[str]] = (),
    words: str | Sequence[str] = "",
    still: Markup | None = None,
    left: Sequence[int] = (),
) -> Section | None:
    """A heading, a table (its head first, or none), sentences below, a picture; None where there
    is neither a table nor a sentence. left: columns that are set left although they follow the
    first."""
    sentences = [words] if isinstance(words, str) else list(words)
    if not rows and not any(sentences):
        return None
    head, *body = rows or ((),)
    numeric = [column for column in range(1, len(head)) if column not in left]
    content = [table(head, body, numeric)] if body else []
    content += [note(*map(clean, sentences)), *([still] if still is not None else [])]
    return Section(title, tuple(content))


# ---- the first paper ---------------------------------------------------------------------------


def _joint(paper: PaperFile, folder: Path) -> Page:
    rows, cases = paper.rows, list(paper.rows[0].mae)
    training = [("", *_JOINT_TRAINING.values())]
    for name, row in (("published", paper.published.training), ("here", paper.training)):
        training.append((name, *(formatting.short(getattr(row, key)) for key in _JOINT_TRAINING)))
    stills = [(title, words, _still(folder, name, title)) for title, name, words in _JOINT_FIGURES]
    columns = ("published", "here", "after 1 s", "lower by")
    body = [("model", *(clean(f"{case}, {what}") for case in cases for what in columns))]
    for model in rows:
        cells = [clean(model.model)]
        for case in cases:
            errors = (model.published.get(case), model.mae.get(case), model.mae_after_1_s.get(case))
            cells += [*map(number, errors), percent(model.improvement.get(case))]
        body.append(tuple(cells))
    effects = [
        (
            effect_label(cause.effect),
            channel_label(name),
            number(parameter.value),
            formatting.span(parameter.low, parameter.high),
            channel_unit(name) or "-",
        )
        for cause in paper.diagnosis.causes
        for name, parameter in cause.parameters.items()
    ]
    head = ("effect", "parameter", "value", formatting.INTERVAL, "unit")
    words = "Mean absolute error of the angle in the model's control loop, deg."
    title = "Errors on the steps"
    sections = [
        _topic(title, body, words, _still(folder, "steps", title)),
        *(_topic(title, (), words, still) for title, words, still in stills if still is not None),
    ]
    title, why = "The network's training", sentence(paper.training.why)
    sections += [
        _topic(title, training, why, _still(folder, _TRAINING_STILL, title)),
        _topic(
            "What the diagnosis names",
            (head, *effects) if effects else (),
            sentence(paper.diagnosis.sentence),
            left=(1, 4),
        ),
        *_twin_and_notes(paper.twin.model_extra or {}, paper),
    ]
    case = cases[-1]  # that no model was trained at
    known = [(row.model, error) for row in rows if (error := row.mae.get(case)) is not None]
    lead = "The errors of the models on the steps of the first paper."
    if len(known) > 1:
        first, best = known[0], min(known[1:], key=lambda item: item[1])
        lead = (
            f"At {clean(case)}, the {clean(first[0])} is off by {formatting.short(first[1])} deg, "
            f"the {clean(best[0])} by {formatting.short(best[1])} deg."
        )
    return _page(lead, "The first paper: a joint", _quick(paper), sections)


# ---- the second paper --------------------------------------------------------------------------


def _arm(paper: ArmPaperFile, folder: Path) -> Page:
    target = paper.target
    reached = "lie" if target.reached else "do not lie"
    lead = (
        f"The errors of the fitted angles in the gravity tests {reached} within "
        f"{percent(target.share)} of the noise: at most {number(target.worst, 4)} times it."
    )
    stages = {
        "data_sheet": "data sheet",
        "truth": "truth",
        "without_payload": "without the payload test",
        "gravity": "all gravity tests",
    }
    fitted = {
        "data_sheet": "data sheet",
        "truth": "truth",
        "fitted_analytic": "fitted, analytic law",
        "fitted_anfis": "fitted, ANFIS law",
    }
    free, angles = [], []
    for key, title in _TESTS.items():
        if key in paper.mae:
            name = f"{title}, free runs"
            still = _still(folder, key, name)
            free.append(_topic(name, _arm_rows(paper.mae[key]), _UNSEEN, still, (1,)))
        if key in paper.windowed_mae:
            of_angles = {k: e for k, e in paper.windowed_mae[key].items() if e.unit == "deg"}
            rows = _arm_rows(of_angles)
            angles.append(_topic(f"{title}, windows set anew", rows, _UNSEEN, left=(1,)))
    sections = (
        *free,
        *angles,
        _coupling_topic(paper.coupling, folder),
        _topic("The force law", (), sentence(paper.force_law.finding)),
        _topic("Inertial data", _known_rows(paper.combinations, stages), _STAR, left=(1,)),
        _topic("Parameters", _known_rows(paper.parameters, fitted), _STAR, left=(1,)),
        *_twin_and_notes(paper.twin.hidden, paper),
    )
    stuck = [
        f"Not converged: {name}: {fit.why}" for name, fit in paper.fits.items() if not fit.converged
    ]
    warnings = [*_quick(paper), *stuck]
    return _page(lead, "The second paper: an arm of two links", warnings, sections)


def _coupling_topic(each: Sequence[ArmCoupling], folder: Path) -> Section | None:
    columns = {
        "data_sheet": "data sheet",
        "without_coupling": "fitted, without coupling terms",
        "fitted": "fitted",
        "noise_floor": "noise",
    }
    body = [
        (
            f"{channel_label(coupling.moved)}, joint {coupling.pulsed} pulsed",
            number(coupling.swing_deg),
            *(number(coupling.mae.get(key)) for key in columns),
        )
        for coupling in each
    ]
    head = ("angle, deg", "moves by", *columns.values())
    words = (
        "Mean absolute error of the angle of a joint while only the valves of the other joint are "
        "pulsed, on a recording that no fit has seen. Left out are M12 and the terms of the "
        "velocities; gravity stays."
    )
    title = "Coupling between the joints"
    still = _still(folder, _COUPLING, title)
    return _topic(title, (head, *body), words, still) if body else None


def _arm_rows(variables: Mapping[str, ArmErrors]) -> tuple[tuple[str, ...], ...]:
    models = [
        key
        for key in _ARM_MODELS
        if any(getattr(errors, key) is not None for errors in variables.values())
    ]
    body = [
        (channel_label(name), errors.unit, *(number(getattr(errors, key)) for key in models))
        for name, errors in variables.items()
    ]
    return (("variable", "unit", *(_ARM_MODELS[key] for key in models)), *body)


def _known_rows(
    parameters: Mapping[str, ArmEstimate], columns: Mapping[str, str]
) -> tuple[tuple[str, ...], ...]:
    """Values with their intervals, and a star if the interval does not contain the true value."""
    body = []
    for name, parameter in parameters.items():
        cells = []
        for key in columns:
            value = getattr(parameter, key)
            if isinstance(value, StageEstimate):
                star = "*" if value.holds is False else ""
                interval = formatting.span(value.low, value.high)
                cells.append(f"{number(value.value)} ({interval}){star}")
            else:
                cells.append(number(value))
        body.append((channel_label(name), formatting.unit_label(parameter.unit) or "-", *cells))
    return (("", "unit", *columns.values()), *body)


# ---- both --------------------------------------------------------------------------------------


def _twin_and_notes(
    twin: Mapping[str, float], paper: PaperFile | ArmPaperFile
) -> tuple[Section | None, ...]:
    rows = [
        (channel_label(name), number(value), channel_unit(name) or "-")
        for name, value in twin.items()
    ]
    heads = ("parameter", "value", "unit")
    return (
        _topic("What the twin hides", (heads, *rows) if rows else (), left=(2,)),
        _topic("What this is not", (), paper.notes),
    )


def _quick(paper: PaperFile | ArmPaperFile) -> list[str]:
    quick = "QUICK: records and trainings are too short; these figures only show that it runs."
    return [quick] if paper.quick else []


def _page(
    lead: str, subtitle: str, warnings: Iterable[str], sections: Iterable[Section | None]
) -> Page:
    shown = tuple(section for section in sections if section is not None)
    return Page(lead, subtitle, shown, paragraphs(map(clean, warnings), "warning"))
