"""The folder of a reproduced paper read into one shape: sections of tables and sentences, and the
pictures beside them.

paper.json is of the first paper (schema pamid.paper/1), arm-paper.json of the second
(pamid.paper-arm/1).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from pamid.base.errors import FileError
from pamid.base.files import PICTURE, read_data
from pamid.base.result_file import REMEDY, read_result
from pamid.base.run_folder import FIGURES_FOLDER
from pamid.report import formatting
from pamid.report.formatting import (
    channel_label,
    channel_unit,
    effect_label,
    number,
    percent,
    sentence,
)
from pamid.schemas.diagnosis_file import Cause
from pamid.schemas.paper_files import (
    ArmCoupling,
    ArmErrors,
    ArmEstimate,
    ArmPaperFile,
    PaperFile,
    PaperRow,
    StageEstimate,
)

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
#: the first paper's own figures: heading, picture, what it shows
_JOINT_FIGURES = (
    (
        "Responses to the steps",
        "responses",
        "The angle over its reference in the control loop, at the inertia that the network was "
        "trained at and at one that it has never seen (figures 5, 6 and 9 of the paper).",
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
        "beside the law that the rig has where none is named.",
    ),
)
_TRAINING_STILL = "network-training"
_JOINT_STILLS = ("steps", _TRAINING_STILL, *(name for _, name, _ in _JOINT_FIGURES))
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


@dataclass(frozen=True)
class Topic:
    """A heading, a table (its head first, or none), sentences below, a picture (its name); left:
    columns that are set left although they follow the first."""

    title: str
    rows: tuple[tuple[str, ...], ...] = ()
    sentences: tuple[str, ...] = ()
    still: str = ""
    left: tuple[int, ...] = ()


@dataclass(frozen=True)
class Still:
    """A picture that the run has already drawn."""

    name: str
    png: bytes
    wide_px: int
    tall_px: int


@dataclass(frozen=True)
class PaperStory:
    """A topic of a paper; lead: the result, in a sentence."""

    subtitle: str
    lead: str
    warnings: tuple[str, ...]
    topics: tuple[Topic, ...]
    stills: tuple[Still, ...]


def read_paper(folder: Path) -> PaperStory | None:
    """The reproduced paper in a folder; None if there is none, FileError if its file is
    damaged."""
    joint = read_result(folder / JOINT_FILE, PaperFile)
    if joint is not None:
        return _joint(joint, _stills(folder, _JOINT_STILLS))
    arm = read_result(folder / ARM_FILE, ArmPaperFile)
    return None if arm is None else _arm(arm, _stills(folder, (*_TESTS, _COUPLING)))


def _stills(folder: Path, names: Iterable[str]) -> tuple[Still, ...]:
    stills = []
    for name in names:
        path = folder / FIGURES_FOLDER / f"{name}.png"
        if not path.exists():
            continue
        try:
            png = read_data(path, PICTURE)
            with Image.open(io.BytesIO(png), formats=("PNG",)) as picture:
                wide, tall = picture.size
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
            raise FileError(f"{path} is not a picture: {error}.", REMEDY, code="damaged") from None
        if wide * tall > _MOST_PIXELS:
            raise FileError(f"{path} is too large: {wide} x {tall} pixels.", REMEDY, code="damaged")
        stills.append(Still(name, png, wide, tall))
    return tuple(stills)


# ---- the first paper ---------------------------------------------------------------------------


def _joint(paper: PaperFile, stills: tuple[Still, ...]) -> PaperStory:
    rows, cases = paper.rows, list(paper.rows[0].mae)
    training = [("", *_JOINT_TRAINING.values())]
    for name, training_row in (("published", paper.published.training), ("here", paper.training)):
        training.append(
            (name, *(formatting.short(getattr(training_row, key)) for key in _JOINT_TRAINING))
        )
    sections = (
        Topic(
            "Errors on the steps",
            tuple(_joint_rows(rows, cases)),
            ("Mean absolute error of the angle in the model's own control loop, deg.",),
            "steps",
        ),
        *(
            Topic(title, (), (words,), name)
            for title, name, words in _JOINT_FIGURES
            if name in {still.name for still in stills}
        ),
        Topic(
            "The network's training",
            tuple(training),
            (sentence(paper.training.why),),
            _TRAINING_STILL,
        ),
        Topic(
            "What the diagnosis names",
            _cause_rows(paper.diagnosis.causes),
            (sentence(paper.diagnosis.sentence),),
            left=(1, 4),
        ),
        _hidden(paper.twin.model_extra or {}),
        _notes(paper),
    )
    return PaperStory(
        "The first paper: a joint", _joint_lead(rows, cases), _warnings(paper), sections, stills
    )


def _joint_lead(rows: Sequence[PaperRow], cases: list[str]) -> str:
    """The last case is the one that no model was trained at."""
    case = cases[-1]
    known = [(row.model, error) for row in rows if (error := row.mae.get(case)) is not None]
    if len(known) < 2:
        return "The errors of the models on the steps of the first paper."
    first, best = known[0], min(known[1:], key=lambda item: item[1])
    return (
        f"At {formatting.clean(case)}, the {formatting.clean(first[0])} is off by "
        f"{formatting.short(first[1])} deg, the "
        f"{formatting.clean(best[0])} by {formatting.short(best[1])} deg."
    )


def _joint_rows(rows: Sequence[PaperRow], cases: list[str]) -> Iterable[tuple[str, ...]]:
    yield (
        "model",
        *(
            formatting.clean(f"{case}, {what}")
            for case in cases
            for what in ("published", "here", "after 1 s", "lower by")
        ),
    )
    for row in rows:
        yield (
            formatting.clean(row.model),
            *(
                cell
                for case in cases
                for cell in (
                    number(row.published.get(case)),
                    number(row.mae.get(case)),
                    number(row.mae_after_1_s.get(case)),
                    percent(row.improvement.get(case)),
                )
            ),
        )


def _cause_rows(causes: Sequence[Cause]) -> tuple[tuple[str, ...], ...]:
    rows = [
        (
            effect_label(cause.effect),
            channel_label(name),
            number(parameter.value),
            formatting.span(parameter.low, parameter.high),
            channel_unit(name) or "-",
        )
        for cause in causes
        for name, parameter in cause.parameters.items()
    ]
    return (("effect", "parameter", "value", formatting.INTERVAL, "unit"), *rows) if rows else ()


# ---- the second paper --------------------------------------------------------------------------


def _arm(paper: ArmPaperFile, stills: tuple[Still, ...]) -> PaperStory:
    target = paper.target
    reached = "lie" if target.reached else "do not lie"
    lead = (
        f"The errors of the fitted angles in the gravity tests {reached} within "
        f"{percent(target.share)} of the noise: at most "
        f"{number(target.worst, 4)} times it."
    )
    free, windowed = paper.mae, paper.windowed_mae
    errors = [
        _arm_errors(f"{title}, free runs", free[key], still=key)
        for key, title in _TESTS.items()
        if key in free
    ]
    angles = [
        _arm_errors(f"{title}, windows set anew", windowed[key], only="deg")
        for key, title in _TESTS.items()
        if key in windowed
    ]
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
    sections = (
        *errors,
        *angles,
        _coupling_topic(paper.coupling),
        Topic("The force law", (), (sentence(paper.force_law.finding),)),
        Topic("Inertial data", _known_rows(paper.combinations, stages), (_STAR,), left=(1,)),
        Topic("Parameters", _known_rows(paper.parameters, fitted), (_STAR,), left=(1,)),
        _hidden(paper.twin.hidden),
        _notes(paper),
    )
    stuck = [
        f"Not converged: {name}: {fit.why}" for name, fit in paper.fits.items() if not fit.converged
    ]
    return PaperStory(
        "The second paper: an arm of two links", lead, (*_warnings(paper), *stuck), sections, stills
    )


def _coupling_topic(each: Sequence[ArmCoupling]) -> Topic:
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
        "Mean absolute error of the angle of a joint while only the valves of the other one are "
        "pulsed, on a recording that no fit has seen. Left out are M12 and the terms of the "
        "velocities; gravity stays."
    )
    return Topic(
        "Coupling between the joints",
        (head, *body) if body else (),
        (words,) if body else (),
        _COUPLING,
    )


_STAR = "*: the interval does not hold the truth."


def _arm_errors(
    title: str, variables: Mapping[str, ArmErrors], *, only: str = "", still: str = ""
) -> Topic:
    rows = [item for item in variables.items() if not only or item[1].unit == only]
    models = [
        key for key in _ARM_MODELS if any(getattr(errors, key) is not None for _, errors in rows)
    ]
    body = [
        (channel_label(name), errors.unit, *(number(getattr(errors, key)) for key in models))
        for name, errors in rows
    ]
    return Topic(
        title,
        (("variable", "unit", *(_ARM_MODELS[key] for key in models)), *body),
        ("Mean absolute error on recordings that no fit has seen.",),
        still,
        (1,),
    )


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


def _hidden(twin: Mapping[str, float]) -> Topic:
    rows = [
        (channel_label(name), number(value), channel_unit(name) or "-")
        for name, value in twin.items()
    ]
    return Topic(
        "What the twin hides", (("parameter", "value", "unit"), *rows) if rows else (), left=(2,)
    )


def _notes(paper: PaperFile | ArmPaperFile) -> Topic:
    return Topic("What this is not", (), paper.notes)


def _warnings(paper: PaperFile | ArmPaperFile) -> tuple[str, ...]:
    quick = "QUICK: records and trainings are too short; these figures only show that it runs."
    return (quick,) if paper.quick else ()
