"""Files of `pamid force-law`: the judged law of a measured force map as figures, a picture and a
rig file."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.files import write_together
from pamid.base.json_file import json_bytes
from pamid.base.metrics import rms
from pamid.base.run_folder import NETWORK_FILE, WEIGHTS_FILE, Run
from pamid.base.schemas import force_law_file as result
from pamid.base.schemas.network_file import TrainingSummary
from pamid.model.registry import rigs
from pamid.networks.correction.force_map import COLUMNS, ForceMap, ValidatedMap, pulls
from pamid.networks.correction.trained_force_law import ForceLaw
from pamid.networks.trained_network import network_files
from pamid.report.force_map_figure import Side, force_map_picture
from pamid.rigs.muscle import LAWS

LAW_FILE, RIG_FILE, MAP_FIGURE_FILE = "force-law.json", "rig.py", "figures/force-map.png"
# pressures and contractions of the curves in the picture
CURVE_PRESSURES, CURVE_CONTRACTIONS = 6, 61


def judged_law(validated: ValidatedMap, rig: str, strict: bool) -> result.ForceLawFile:
    """force-law.json: all forces in N, errors on points held out unless the key states
    otherwise."""
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


def write_law(run: Run, validated: ValidatedMap, rig: str, strict: bool) -> dict[str, Any]:
    """Network, figures, picture and rig file into the run folder; returns what force-law.json
    holds."""
    about = judged_law(validated, rig, strict).as_json()
    content, network = network_files(validated.trained)
    names = (WEIGHTS_FILE, NETWORK_FILE, MAP_FIGURE_FILE, RIG_FILE, LAW_FILE)
    contents = (
        content,
        json_bytes(network, NETWORK_FILE),
        _picture(validated),
        rig_text(rig, strict).encode(),
        json_bytes(about, LAW_FILE),
    )
    write_together(dict(zip(run.claim(*names), contents, strict=True)))
    return about


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
    ).png
