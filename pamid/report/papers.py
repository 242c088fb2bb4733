"""The folder of a reproduced paper read into one shape: sections of tables and sentences, and the
pictures beside them.

paper.json is of the first paper (schema pamid.paper/1), arm-paper.json of the second
(pamid.paper-arm/1).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image, UnidentifiedImageError

from pamid.base.errors import FileError
from pamid.base.files import PICTURE, read_data
from pamid.base.result_file import REMEDY
from pamid.base.run_folder import FIGURES
from pamid.report import words
from pamid.report.reading import Node, read_object
from pamid.report.style import WIDE_IN, Drawing
from pamid.report.words import channel_unit, channel_words, effect_words, number, percent, sentence

JOINT_FILE, ARM_FILE = "paper.json", "arm-paper.json"
_MOST_PIXELS = 40_000_000
#: keys of the arm's errors -> heading
_ARM_MODELS = {
    "data_sheet": "data sheet",
    "analytic_alone": "analytic law alone",
    "anfis_alone": "ANFIS law alone",
    "fitted_analytic": "analytic, with corrections",
    "fitted_anfis": "ANFIS, with corrections",
    "noise_floor": "noise",
}
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
class Section:
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
class Paper:
    """lead: what came out, in a sentence."""

    subtitle: str
    lead: str
    warnings: tuple[str, ...]
    sections: tuple[Section, ...]
    stills: tuple[Still, ...]


def read_paper(folder: Path) -> Paper | None:
    """The reproduced paper in a folder; None where there is none, FileError where its file is
    damaged."""
    joint = read_object(folder / JOINT_FILE, "pamid.paper/1")
    if joint is not None:
        return _joint(joint, _stills(folder, ("steps",)))
    arm = read_object(folder / ARM_FILE, "pamid.paper-arm/1")
    return None if arm is None else _arm(arm, _stills(folder, tuple(_TESTS)))


def paper_drawings(paper: Paper) -> list[Drawing]:
    """The pictures as drawings of a PDF."""
    return [_drawing(one) for one in paper.stills]


def _drawing(still: Still) -> Drawing:
    height = WIDE_IN * still.tall_px / still.wide_px

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.set_axis_off()
        with Image.open(io.BytesIO(still.png)) as picture:
            axes.imshow(picture, interpolation="none")

    return Drawing(f"still-{still.name}", "", draw, height, height)


def _stills(folder: Path, names: Iterable[str]) -> tuple[Still, ...]:
    found = []
    for name in names:
        path = folder / FIGURES / f"{name}.png"
        if not path.exists():
            continue
        try:
            png = read_data(path, PICTURE)
            with Image.open(io.BytesIO(png), formats=("PNG",)) as picture:
                wide, tall = picture.size
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
            raise FileError(f"{path} is no picture: {error}.", REMEDY, code="damaged") from None
        if wide * tall > _MOST_PIXELS:
            raise FileError(
                f"{path} is too large a picture: {wide} x {tall}.", REMEDY, code="damaged"
            )
        found.append(Still(name, png, wide, tall))
    return tuple(found)


# ---- the first paper ---------------------------------------------------------------------------


def _joint(node: Node, stills: tuple[Still, ...]) -> Paper:
    rows = node.listed("rows")
    if not rows:
        node.refuse("rows", "a list with at least one model")
    cases = list(rows[0].needed("mae").content)
    diagnosis, published = node.needed("diagnosis"), node.needed("published")
    here = node.needed("training")
    training = [("", *_JOINT_TRAINING.values())]
    for name, one in (("published", published.needed("training")), ("here", here)):
        training.append((name, *(words.short(one.maybe(key)) for key in _JOINT_TRAINING)))
    sections = (
        Section(
            "Errors on the steps",
            tuple(_joint_rows(rows, cases)),
            ("Mean absolute error of the angle in the model's own control loop, deg.",),
            "steps",
        ),
        Section("The network's training", tuple(training), (sentence(here.text("why", "")),)),
        Section(
            "What the diagnosis names",
            _cause_rows(diagnosis),
            (sentence(diagnosis.text("sentence", "")),),
            left=(1, 4),
        ),
        _hidden(node.needed("twin")),
        _notes(node),
    )
    return Paper(
        "The first paper: a joint", _joint_lead(rows, cases), _warnings(node), sections, stills
    )


def _joint_lead(rows: list[Node], cases: list[str]) -> str:
    """The last case is the one that no model was trained at."""
    case = cases[-1]
    told = [(row.text("model"), row.needed("mae").maybe(case)) for row in rows]
    known = [(model, error) for model, error in told if error is not None]
    if len(known) < 2:
        return "The errors of the models on the steps of the first paper."
    first, best = known[0], min(known[1:], key=lambda one: one[1])
    return (
        f"At {words.clean(case)}, the {words.clean(first[0])} is off by {words.short(first[1])} "
        "deg, the "
        f"{words.clean(best[0])} by {words.short(best[1])} deg."
    )


def _joint_rows(rows: list[Node], cases: list[str]) -> Iterable[tuple[str, ...]]:
    yield (
        "model",
        *(
            words.clean(f"{case}, {what}")
            for case in cases
            for what in ("published", "here", "after 1 s", "lower by")
        ),
    )
    for row in rows:
        parts = [row.needed(key) for key in ("published", "mae", "mae_after_1_s")]
        lower = row.needed("improvement")
        yield (
            words.clean(row.text("model")),
            *(
                cell
                for case in cases
                for cell in (
                    *(number(part.maybe(case)) for part in parts),
                    percent(lower.maybe(case)),
                )
            ),
        )


def _cause_rows(diagnosis: Node) -> tuple[tuple[str, ...], ...]:
    found = [
        (
            effect_words(cause.text("effect")),
            channel_words(name),
            number(one.maybe("value")),
            words.span(one.maybe("low"), one.maybe("high")),
            channel_unit(name) or "-",
        )
        for cause in diagnosis.listed("causes")
        for name, one in cause.children("parameters").items()
    ]
    return (("effect", "parameter", "value", words.INTERVAL, "unit"), *found) if found else ()


# ---- the second paper --------------------------------------------------------------------------


def _arm(node: Node, stills: tuple[Still, ...]) -> Paper:
    target, force = node.needed("target"), node.needed("force_law")
    reached = "lie" if target.flag("reached", False) else "do not lie"
    lead = (
        f"The errors of the fitted angles in the gravity tests {reached} within "
        f"{percent(target.number('share'))} of the noise: at most "
        f"{number(target.number('worst'), 4)} times it."
    )
    free, windowed = node.children("mae"), node.children("windowed_mae")
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
        Section("The force law", (), (sentence(force.text("finding", "")),)),
        Section(
            "Inertial data", _known_rows(node.children("combinations"), stages), (_STAR,), left=(1,)
        ),
        Section(
            "Parameters", _known_rows(node.children("parameters"), fitted), (_STAR,), left=(1,)
        ),
        _hidden(node.needed("twin").needed("hidden")),
        _notes(node),
    )
    stuck = [
        f"Not converged: {name}: {one.text('why', '')}"
        for name, one in node.children("fits").items()
        if not one.flag("converged", True)
    ]
    return Paper(
        "The second paper: an arm of two links", lead, (*_warnings(node), *stuck), sections, stills
    )


_STAR = "*: the interval does not hold the truth."


def _arm_errors(title: str, variables: Node, *, only: str = "", still: str = "") -> Section:
    rows = [one for one in variables.nested().items() if not only or one[1].text("unit") == only]
    models = [key for key in _ARM_MODELS if any(one.maybe(key) is not None for _, one in rows)]
    body = [
        (channel_words(name), one.text("unit"), *(number(one.maybe(key)) for key in models))
        for name, one in rows
    ]
    return Section(
        title,
        (("variable", "unit", *(_ARM_MODELS[key] for key in models)), *body),
        ("Mean absolute error on recordings that no fit has seen.",),
        still,
        (1,),
    )


def _known_rows(
    told: Mapping[str, Node], columns: Mapping[str, str]
) -> tuple[tuple[str, ...], ...]:
    """Values with their intervals, a star where the interval does not hold the truth."""
    body = []
    for name, one in told.items():
        cells = []
        for key in columns:
            if isinstance(one.content.get(key), Mapping):
                value = one.needed(key)
                star = "*" if value.maybe_flag("holds") is False else ""
                interval = words.span(value.maybe("low"), value.maybe("high"))
                cells.append(f"{number(value.maybe('value'))} ({interval}){star}")
            else:
                cells.append(number(one.maybe(key)))
        body.append((channel_words(name), words.unit_words(one.text("unit", "")) or "-", *cells))
    return (("", "unit", *columns.values()), *body)


# ---- both --------------------------------------------------------------------------------------


def _hidden(twin: Node) -> Section:
    known = [
        name
        for name, value in twin.content.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    rows = [
        (channel_words(name), number(twin.number(name)), channel_unit(name) or "-")
        for name in known
    ]
    return Section(
        "What the twin hides", (("parameter", "value", "unit"), *rows) if rows else (), left=(2,)
    )


def _notes(node: Node) -> Section:
    return Section("What this is not", (), node.texts("notes"))


def _warnings(node: Node) -> tuple[str, ...]:
    quick = "QUICK: records and trainings are too short; these figures only show that it runs."
    return (quick,) if node.flag("quick", False) else ()
