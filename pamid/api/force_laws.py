"""`pamid.force_law`: a force law from a measured map, compared with the analytic laws, and the
files that hold it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.api.given import warn_in_python
from pamid.api.options.exporting import ForceLawArguments
from pamid.api.options.record import verb
from pamid.base.errors import DataError
from pamid.base.files import write_together
from pamid.base.json_file import json_bytes
from pamid.base.metrics import rms
from pamid.base.progress import tell
from pamid.base.run_folder import NETWORK_FILE, WEIGHTS_FILE, Run
from pamid.base.schemas import force_law_file as result
from pamid.base.schemas.network_file import TrainingSummary
from pamid.model.registry import rigs
from pamid.networks.correction.force_map import (
    COLUMNS,
    ForceMap,
    ValidatedMap,
    judge,
    pulls,
    read_map,
)
from pamid.networks.correction.trained_force_law import ForceLaw
from pamid.networks.trained_network import network_files
from pamid.report.force_map_figure import Side, force_map_picture
from pamid.rigs.muscle import LAWS

LAW_FILE, RIG_FILE, MAP_FIGURE_FILE = "force-law.json", "rig.py", "figures/force-map.png"
# pressures and contractions of the curves in the picture
CURVE_PRESSURES, CURVE_CONTRACTIONS = 6, 61


COLUMN_WIDTHS, COLUMN_DIGITS = (9, 9, 14, 8, 24), (1, 1, 1, 3, 1)
HEAD = ("RMS N", "worst N", "RMS scaled N", "scale", "contraction held out N")


@dataclass(frozen=True)
class ForceLawResult:
    """A force law of a measured map, and its errors next to those of the analytic laws.

    folder: of the run; data: content of force-law.json, forces in N.
    """

    folder: Path
    data: result.ForceLawFile

    @property
    def rig_file(self) -> Path:
        """Rig file that takes its muscle force from the law; it is code."""
        return self.folder / RIG_FILE

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command."""
        return self.data.as_json()

    def summary(self) -> str:
        """Table of all laws on held-out points, the check of monotonicity, and advice."""
        anfis, points, monotone = self.data.anfis, self.data.map, self.data.monotone
        assert anfis is not None and points is not None and monotone is not None
        spans = ", ".join(
            f"{name} {span.low:.4g} to {span.high:.4g}"
            for name in COLUMNS
            for span in [getattr(points, name)]
        )
        each = ", ".join(f"{value:.3g}" for value in anfis.rms_n_each_way)
        lines = [
            f"{points.points} points, {points.slack_points} of them slack: {spans}",
            f"{self.data.held_out_every}-fold cross-validation; ANFIS by fold: {each} N RMS",
            "",
            _row("law", HEAD),
        ]
        held_out = anfis.contraction_held_out_rms_n
        rows: list[tuple[str, tuple[float | None, ...]]] = [
            (
                f"ANFIS {anfis.sets}x{anfis.sets}",
                (anfis.rms_n, anfis.worst_n, None, None, held_out),
            )
        ]
        for law in self.data.laws:
            held_out = law.contraction_held_out_scaled_rms_n
            figures = (law.rms_n, law.worst_n, law.scaled_rms_n, law.scale, held_out)
            rows.append((law.law, figures))
        lines += [_row(name, map(_cell, figures, COLUMN_DIGITS)) for name, figures in rows]
        lines += ["", f"{self.data.finding}.", *self.data.advice, monotone.words]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<ForceLawResult {self.folder}>\n{self.summary()}"


def _row(name: str, cells: Iterable[str]) -> str:
    return f"{name:18s}" + "".join(f"{c:>{w}s}" for c, w in zip(cells, COLUMN_WIDTHS, strict=True))


def _cell(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


@verb(ForceLawArguments)
def force_law(arguments: ForceLawArguments) -> ForceLawResult:
    """Train a muscle's force law on a measured map and compare the analytic laws.

    Raises
    ------
    DataError
        The map is no force map, or its force falls with pressure or grows with contraction
        (with strict).
    FileError
        The folder holds something else, or a run (without overwrite).
    """
    a, path, output = arguments, Path(arguments.map_file), Path(arguments.output)
    points = read_map(path)
    warn = a.warn or warn_in_python
    for name in points.unused:
        warn(f"{path}: the column {name!r} is not used.")
    run = Run.create(
        output,
        command=a.command or ["pamid.force_law", str(path)],
        seed=a.seed,
        inputs=[path],
        overwrite=a.overwrite,
        options={"sets": a.sets, "rig": a.rig, "held_out": a.every, "strict": a.strict},
    )
    try:
        validated = judge(points, sets=a.sets, every=a.every, seed=a.seed, progress=tell)
        if a.strict and not validated.monotone:
            remedies = [
                *["use fewer --sets"] * (a.sets > 2),
                "measure more points there",
                "or accept the law with --no-strict (and --overwrite: the folder exists now)",
            ]
            raise DataError(
                validated.guard, f"{', '.join(remedies).capitalize()}.", code="not-monotone"
            )
        law = write_law(run, validated, a.rig, a.strict)
    except DataError:
        run.finish("failed")
        raise
    run.finish()
    return ForceLawResult(output, law)


def judged_law(validated: ValidatedMap, rig: str, strict: bool) -> result.ForceLawFile:
    """force-law.json: forces in N, errors on held-out points unless the key states otherwise."""
    points, network = validated.map, validated.trained.network
    off = validated.by_point.anfis - points.force_n
    ranges = zip(COLUMNS, (points.contraction, points.pressure_kpa, points.force_n), strict=True)
    return result.ForceLawFile(
        finding=validated.finding,
        advice=tuple(validated.advice),
        map=result.MapUsed(
            path=str(points.path),
            points=len(points),
            slack_points=points.slack.sum(),
            **{name: result.MeasuredRange(low=v.min(), high=v.max()) for name, v in ranges},
        ),
        held_out_every=validated.every,
        anfis=result.AnfisErrors(
            sets=getattr(network, "sets", None),
            n_weights=network.n_weights,
            rms_n=rms(off),
            worst_n=np.abs(off).max(),
            rms_n_each_way=tuple(
                rms(off[way :: validated.every]) for way in range(validated.every)
            ),
            contraction_held_out_rms_n=validated.rms_n(validated.by_contraction),
            rms_n_trained_on_all=rms(points.force_n, pulls(ForceLaw(validated.trained), points)),
        ),
        laws=tuple(
            result.LawErrors(
                law=law,
                scale=scale,
                rms_n=rms(points.force_n, validated.printed[law]),
                worst_n=np.abs(points.force_n - validated.printed[law]).max(),
                scaled_rms_n=validated.rms_n(validated.by_point, law),
                scaled_worst_n=np.abs(points.force_n - validated.by_point.scaled[law]).max(),
                contraction_held_out_scaled_rms_n=validated.rms_n(validated.by_contraction, law),
            )
            for law, scale in validated.scale.items()
        ),
        monotone=result.Monotone(
            ok=validated.monotone,
            wrong_way_along_pressure_n=validated.wrong_way[0],
            wrong_way_along_contraction_n=validated.wrong_way[1],
            constrained=validated.unconstrained is not None,
            words=validated.guard,
        ),
        training=TrainingSummary(**validated.trained.summary),
        rig=result.WrittenRig(
            file=RIG_FILE, name=f"{rig}-measured", derives_from=rig, strict=strict
        ),
    )


def write_law(run: Run, validated: ValidatedMap, rig: str, strict: bool) -> result.ForceLawFile:
    """Write network, figures, picture and rig file into the run folder; returns the content of
    force-law.json."""
    law = judged_law(validated, rig, strict)
    content, network = network_files(validated.trained)
    names = (WEIGHTS_FILE, NETWORK_FILE, MAP_FIGURE_FILE, RIG_FILE, LAW_FILE)
    contents = (
        content,
        json_bytes(network, NETWORK_FILE),
        _picture(validated),
        rig_text(rig, strict).encode(),
        json_bytes(law.as_json(), LAW_FILE),
    )
    write_together(dict(zip(run.claim(*names), contents, strict=True)))
    return law


def rig_text(rig: str, strict: bool) -> str:
    """A rig file that derives from a rig of the catalogue and takes its muscle force from the
    network next to it."""
    base = rigs()[rig]
    return f'''"""The rig {rig} with the muscle force of a measured map: the network next to this file."""

from pathlib import Path

from pamid import force_law_of
from {base.__module__} import {base.__name__}


class {base.__name__}Measured({base.__name__}):
    """Every muscle pulls as the measured muscle, up to the fitted factor `scale`."""

    name = "{rig}-measured"

    def __init__(self) -> None:
        super().__init__()
        self.static_force = force_law_of(Path(__file__).parent, strict={strict})
'''  # noqa: E501


def _picture(validated: ValidatedMap) -> bytes:
    points, best, scale = validated.map, validated.best, validated.scale[validated.best]
    pressures = np.unique(points.pressure_kpa)
    # at the lowest there is little to see
    wanted = np.linspace(pressures[0], pressures[-1], CURVE_PRESSURES + 1)[1:]
    levels = np.unique(pressures[np.abs(pressures - wanted[:, None]).argmin(axis=1)])
    along = np.linspace(points.contraction.min(), points.contraction.max(), CURVE_CONTRACTIONS)
    shape = (len(levels), CURVE_CONTRACTIONS)
    lines = ForceMap(
        points.path,
        np.tile(along, len(levels)),
        np.repeat(levels, CURVE_CONTRACTIONS),
        np.zeros(len(levels) * CURVE_CONTRACTIONS),
    )
    network, held = ForceLaw(validated.trained), validated.by_point
    sides = (
        Side("ANFIS", pulls(network, lines).reshape(shape), held.anfis - points.force_n),
        Side(
            f"{best} x {scale:.3g}",
            scale * pulls(LAWS[best], lines).reshape(shape),
            held.scaled[best] - points.force_n,
        ),
    )
    return force_map_picture(
        points.contraction,
        points.pressure_kpa,
        points.force_n,
        along,
        levels,
        sides,
        validated.finding,
    )
