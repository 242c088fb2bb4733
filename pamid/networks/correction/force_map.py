"""A measured force map of a muscle: an ANFIS is trained on it and compared with the analytic laws.

A map is a CSV file with a header row and a row per point: `contraction` (share of the length at
rest), `pressure_kpa` (gauge) and `force_n`, or other units of these; further columns are left
alone.

Every k-th point is held out, in all k ways, so that every point is predicted once by laws that have
not seen it: the ANFIS, and each analytic law with its factor `scale` fitted to the other
points. Then all points near a contraction are held out at a time: few contractions are measured,
many pressures, and a rig moves between them.

Where a muscle is slack the load cell reads nothing and does not say how slack it is. There the
ANFIS learns the value of the nearest analytic law, moved to the pulling points by a factor and an
offset: a force below zero, which a rig takes for none. Trained to zero it waves about zero instead,
and moves the wrong way: with 3 x 3 sets by 110 N on the map of a 20 mm muscle (Martens, Boblan
2017), taught in this way by none.

Where the ANFIS still falls with pressure or grows with contraction, its consequents are solved
again under the condition that it does not (monotone_law.py). A map that contradicts this stays as
measured: where the constrained law would leave the trained law by more than `CONTRADICTED`, it is
left as trained, and the guard reports it.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError, nearest
from pamid.base.files import MAP, read_lines
from pamid.base.metrics import motion, rms
from pamid.base.progress import Progress, silent
from pamid.base.units import compatible, from_si, split_column, to_si
from pamid.engine.symbolic.expression import expression, substitute, symbol
from pamid.networks.anfis import Anfis
from pamid.networks.correction.monotone_law import constrained
from pamid.networks.correction.trained_force_law import (
    MONOTONE_TOLERANCE,
    ForceLaw,
    check_force_law,
)
from pamid.networks.trained_network import TrainedNetwork, train_on_signals
from pamid.networks.training_problem import TrainingOptions
from pamid.recording.file_checks import check_range, explain_cells, read_header
from pamid.recording.recording import match_column
from pamid.rigs.muscle import LAWS, Law

COLUMNS = ("contraction", "pressure_kpa", "force_n")
CONTRACTION_COLUMN, PRESSURE_COLUMN, FORCE_COLUMN = COLUMNS
SLACK = MONOTONE_TOLERANCE  # of the largest force: readings up to it are those of a slack muscle
MAP_ITERATIONS = 200
# of the largest force: RMS by which a constrained law may leave the trained law where it pulls
CONTRADICTED = MONOTONE_TOLERANCE
# spacings of the contractions that are held out in turn, of the map's range
BANDS = 10
_HEADER = f"The first line names the columns, separated by commas: {','.join(COLUMNS)}."


@dataclass(frozen=True, eq=False)
class ForceMap:
    """Points (points,) of contraction (1), gauge pressure (kPa) and force (N); unused: columns left
    alone."""

    path: Path
    contraction: Array
    pressure_kpa: Array
    force_n: Array
    unused: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.force_n.size

    @property
    def slack(self) -> NDArray[np.bool_]:
        """Where the muscle does not pull."""
        return self.force_n <= SLACK * float(self.force_n.max())

    def part(self, rows: NDArray[np.bool_]) -> ForceMap:
        """These points alone."""
        return ForceMap(
            self.path, self.contraction[rows], self.pressure_kpa[rows], self.force_n[rows]
        )


@dataclass(frozen=True, eq=False)
class HeldOutForces:
    """Forces (points,), N, that the ANFIS and every scaled analytic law give for points they have
    not seen; `rows`: which points have been held out, there are no figures for the others."""

    rows: NDArray[np.bool_]
    anfis: Array
    scaled: dict[str, Array]


@dataclass(frozen=True, eq=False)
class ValidatedMap:
    """The ANFIS trained on all points, what was predicted of points held out, and what the law's
    guard finds.

    by_point: every k-th point held out. by_contraction: all points near a contraction, for each
    but the outermost. printed, scale: each analytic law as it is (points,), N, and its factor
    fitted to all points, the law nearest to the points held out first. wrong_way: largest move (N)
    the wrong way along pressure and along contraction; guard: the same in words; monotone: within
    what is allowed. unconstrained: the ANFIS as trained, where it had to be constrained.
    """

    map: ForceMap
    every: int
    trained: TrainedNetwork
    by_point: HeldOutForces
    by_contraction: HeldOutForces
    printed: dict[str, Array]
    scale: dict[str, float]
    wrong_way: tuple[float, float]
    monotone: bool
    guard: str
    unconstrained: TrainedNetwork | None = None

    @property
    def best(self) -> str:
        """The analytic law nearest to the points held out."""
        return next(iter(self.scale))

    def rms_n(self, held: HeldOutForces, law: str = "") -> float | None:
        """RMS error of a scaled law, or of the ANFIS, on held-out points; None without any."""
        predicted = held.scaled[law] if law else held.anfis
        return rms(self.map.force_n[held.rows], predicted[held.rows]) if held.rows.any() else None

    @property
    def finding(self) -> str:
        """How far the ANFIS and the best analytic law are off on unseen points and contractions."""
        anfis, other = self.rms_n(self.by_point), self.rms_n(self.by_point, self.best)
        text = (
            f"Error on held-out points: ANFIS {anfis:.3g} N RMS; best analytic law, "
            f"{self.best} x {self.scale[self.best]:.3g}, {other:.3g} N RMS"
        )
        anfis, other = self.rms_n(self.by_contraction), self.rms_n(self.by_contraction, self.best)
        return (
            text
            if anfis is None
            else f"{text}. On held-out contractions: {anfis:.3g} and {other:.3g} N RMS"
        )

    @property
    def advice(self) -> list[str]:
        """Advice where the ANFIS is not the better law."""

        def worse(held: HeldOutForces) -> bool:
            return (self.rms_n(held) or 0.0) > (self.rms_n(held, self.best) or 0.0)

        if worse(self.by_point):
            return ["This map needs no network: the scaled analytic law is as accurate."]
        if worse(self.by_contraction):
            return [
                "Between the measured contractions the analytic law is more accurate. Measure more "
                "contractions, or use fewer --sets."
            ]
        return []


# ---- reading -----------------------------------------------------------------------------------


def read_map(path: Path) -> ForceMap:
    """Read a force map; FileError with column or line where the file is wrong, DataError where it
    cannot be learnt."""
    try:
        names = read_header(path)
        used = [_column(path, names, wanted) for wanted in COLUMNS]
        table = _cells(path, names, used)
    except FileError as error:
        if error.code == "empty":
            raise FileError(error.message, _HEADER, code="empty") from None
        raise
    si = [to_si(values, split_column(name)[1]) for name, values in zip(used, table.T, strict=True)]
    contraction, pressure, force = (
        np.ascontiguousarray(from_si(values, split_column(wanted)[1]))
        for values, wanted in zip(si, COLUMNS, strict=True)
    )
    if np.abs(contraction).max() >= 1.0:
        raise FileError(
            f"{path}: {used[0]} reaches {table[np.abs(contraction).argmax(), 0]:g}: no muscle "
            "shortens by its whole length.",
            "It is a share of the length at rest; name per cent contraction_percent.",
            code="unit",
        )
    for name, values in zip(used, (contraction, pressure, force), strict=True):
        if motion(values) == 0.0:
            raise DataError(
                f"{path}: {name} is the same at all {len(values)} points ({values[0]:g}).",
                "A force map covers several contractions and several pressures.",
                code="not-excited",
            )
    return ForceMap(path, contraction, pressure, force, tuple(n for n in names if n not in used))


def _column(path: Path, names: list[str], wanted: str) -> str:
    """The column that holds a quantity, in whatever unit."""
    stem, symbol_ = split_column(wanted)
    same = [
        n for n in names if split_column(n)[0] == stem and compatible(split_column(n)[1], symbol_)
    ]
    if len(same) > 1:
        raise FileError(
            f"{path}, line 1: {stem} occurs twice: {', '.join(same)}.",
            "Delete all but the first.",
            code="header",
        )
    try:
        name = match_column(names, wanted)
    except FileError as error:
        raise FileError(f"{path}, line 1: {error.message}", error.hint, code=error.code) from None
    if name is None:
        raise FileError(
            f"{path}, line 1: there is no column {wanted!r}.",
            nearest(wanted, names) or _HEADER,
            code="missing-column",
        )
    return name


def _cells(path: Path, names: list[str], used: list[str]) -> Array:
    """(points, len(used)); the slow reader of recordings names the wrong cell, if any."""
    try:
        rows = [
            row for row in csv.reader(read_lines(path, MAP)) if any(cell.strip() for cell in row)
        ][1:]
        table = np.array([[float(row[names.index(name)]) for name in used] for row in rows])
        if not rows or not np.isfinite(table).all() or any(len(row) != len(names) for row in rows):
            raise ValueError
    except (ValueError, IndexError, csv.Error) as error:
        explain_cells(path, names)
        raise FileError(
            f"{path} cannot be read as comma-separated numbers: {error}.", _HEADER
        ) from error
    check_range(path, used, table)
    return table


# ---- judging -----------------------------------------------------------------------------------


def forces(law: Law, at: ForceMap) -> Array:
    """Forces of a law at the points of a map (points,), N; negative where the muscle is slack."""
    contraction, pressure = symbol("state", "contraction"), symbol("state", "pressure")
    pull = [law(contraction, pressure)]
    values = [
        substitute(pull, {contraction: expression(e), pressure: expression(1e3 * p)})[0]
        for e, p in zip(at.contraction.tolist(), at.pressure_kpa.tolist(), strict=True)
    ]
    return np.array([float(value) for value in values])  # type: ignore[arg-type]


def pulls(law: Law, at: ForceMap) -> Array:
    """The force (points,), N, that a rig takes from a law: a muscle does not push."""
    return np.maximum(forces(law, at), 0.0)


def scale_of(law_force: Array, measured: Array) -> float:
    """The factor that brings what a rig takes from a law nearest to the measured force."""
    pull = np.maximum(law_force, 0.0)
    return max(float(pull @ measured / (pull @ pull)), 0.0) if pull.any() else 0.0


def judge(
    points: ForceMap,
    *,
    sets: int = 3,
    every: int = 3,
    seed: int = 0,
    progress: Progress = silent,
) -> ValidatedMap:
    """Train and judge on what is held out, then train on all points.

    DataError where the points are too few for the sets, or are not several contractions and
    pressures.
    """
    _check_size(points, sets, every)
    analytic = {name: forces(law, points) for name, law in LAWS.items()}

    ways = [0, every + BANDS]  # trainings done, and in all

    def held_out(group: NDArray[np.intp], names: range) -> HeldOutForces:
        held = HeldOutForces(
            np.isin(group, names),
            np.zeros(len(points)),
            {law: np.zeros(len(points)) for law in LAWS},
        )
        for rows in (group == name for name in names if name in group):
            rest = {law: values[~rows] for law, values in analytic.items()}
            progress(f"training {ways[0]}/{ways[1]}: {rows.sum()} of {len(points)} held out")
            ways[0] += 1
            held.anfis[rows] = pulls(
                ForceLaw(_train(points.part(~rows), rest, sets, seed)[0]), points.part(rows)
            )
            for law, values in rest.items():
                factor = scale_of(values, points.force_n[~rows])
                held.scaled[law][rows] = factor * np.maximum(analytic[law][rows], 0.0)
        return held

    by_point = held_out(np.arange(len(points)) % every, range(every))
    place = (points.contraction - points.contraction.min()) / np.ptp(points.contraction)
    by_contraction = held_out(np.rint(BANDS * place).astype(np.intp), range(1, BANDS))
    trained, unconstrained = _train(points, analytic, sets, seed)
    wrong_way, complaint = check_force_law(trained)
    limits = ""
    if unconstrained is not None:
        fit, other = (
            rms(points.force_n, pulls(ForceLaw(law), points)) for law in (trained, unconstrained)
        )
        limits = (
            " Without this constraint the force moved the wrong way by "
            f"{max(check_force_law(unconstrained)[0]):.3g} N. Error on all points: "
            f"{fit:.3g} N RMS, {other:.3g} N RMS without the constraint."
        )
    order = sorted(LAWS, key=lambda law: rms(points.force_n, by_point.scaled[law]))
    return ValidatedMap(
        points,
        every,
        trained,
        by_point,
        by_contraction,
        {law: np.maximum(analytic[law], 0.0) for law in order},
        {law: scale_of(analytic[law], points.force_n) for law in order},
        wrong_way,
        not complaint,
        complaint
        or "The force grows with pressure and falls with contraction, in the range of the map and "
        f"a tenth beyond, to within {max(wrong_way):.2g} N.{limits}",
        unconstrained,
    )


def _check_size(points: ForceMap, sets: int, every: int) -> None:
    weights = Anfis(2, sets).n_weights
    needed = -(-weights * every // (every - 1))
    if len(points) < needed:
        raise DataError(
            f"{points.path}: {len(points)} points are too few for {sets} x {sets} sets: {weights} "
            f"weights need {needed}, as a share of 1/{every} is held out.",
            "Measure more points, or take fewer --sets (2 is the least).",
            code="too-short",
        )
    for name, values in (
        (CONTRACTION_COLUMN, points.contraction),
        (PRESSURE_COLUMN, points.pressure_kpa),
    ):
        if (different := len(np.unique(values))) < sets:
            raise DataError(
                f"{points.path}: {different} different values of {name} are too few for {sets} "
                "sets.",
                "Measure more of them, or take fewer --sets (2 is the least).",
                code="not-excited",
            )


def _train(
    points: ForceMap, analytic: dict[str, Array], sets: int, seed: int
) -> tuple[TrainedNetwork, TrainedNetwork | None]:
    """An ANFIS of these points, constrained to the right way where it has to be; and then the ANFIS
    as trained. analytic: force of each analytic law at the points, N."""
    # each law with the factor and the offset that suit the pulling points best
    pulling, moved = ~points.slack, []
    for values in analytic.values():
        terms = np.column_stack([values, np.ones_like(values)])
        moved.append(terms @ np.linalg.lstsq(terms[pulling], points.force_n[pulling])[0])
    nearest_law = min(moved, key=lambda values: rms(points.force_n, np.maximum(values, 0.0)))
    taught = np.where(points.slack, np.minimum(points.force_n, nearest_law), points.force_n)
    signals = {CONTRACTION_COLUMN: points.contraction, PRESSURE_COLUMN: points.pressure_kpa}
    trained = train_on_signals(
        Anfis(2, sets),
        signals,
        taught,
        output_name=FORCE_COLUMN,
        period_s=1.0,
        options=TrainingOptions(iterations=MAP_ITERATIONS, seed=seed),
    )[0]
    if not check_force_law(trained)[1]:
        return trained, None
    law = constrained(trained, np.column_stack(list(signals.values())), taught)
    if law is None:
        return trained, None
    bent = rms(pulls(ForceLaw(law), points), pulls(ForceLaw(trained), points))
    if bent > CONTRADICTED * float(points.force_n.max()):
        return trained, None
    return law, trained
