"""Models as plain data, and back: what a fit has found is written down; tracks and equations are
made again from the evidence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.engine.program import Stepping
from pamid.estimation.baseline_repair import rig_with_background
from pamid.estimation.grey_box import GreyBox, model_with
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

Array = NDArray[np.float64]


def candidate_plain(c: CandidateModel) -> Plain:
    """A model that was fitted to the evidence, all its parameters jointly, and replayed over what
    was held out."""
    return {
        "fit": _fit_plain(c.fit),
        "replays": [_replay_plain(r) for r in c.replays],
        "runs": [] if c.runs is c.replays else [_replay_plain(r) for r in c.runs],
        "ranges": [[key, low, high] for key, (low, high) in c.assembly.ranges.items()],
    }


def candidate_restored(evidence: DataSplit, assembly: Assembly, found: Plain) -> CandidateModel:
    ranges = {key: (low, high) for key, low, high in found["ranges"]}
    assembly = replace(assembly, ranges=ranges) if ranges else assembly
    held = evidence.tracks(assembly, held_out=True)
    return candidate_from(
        assembly,
        _fit_of(evidence, assembly, found["fit"]),
        _replays_of(held, found["replays"], evidence.noise),
        _replays_of(held, found["runs"], evidence.noise) if found["runs"] else (),
    )


def grey_box_plain(g: GreyBox) -> Plain:
    """A model of `fit_model` without effects, bootstrap and earlier fit."""
    return {
        "fit": _fit_plain(g.fit),
        "recheck": g.recheck,
        "held_out": [_replay_plain(r) for r in g.held_out],
        "data_sheet": [_replay_plain(r) for r in g.data_sheet],
        "floor": [{**_replay_plain(r), "measured": r.full_track.y} for r in g.floor],
        "sizes": [[port, signal, size] for (port, signal), size in g.assembly.sizes.items()],
        "background": list(g.assembly.background_terms),
        "remark": g.remark,
    }


def grey_box_restored(evidence: DataSplit, found: Plain) -> GreyBox:
    evidence = replace(evidence, rig=rig_with_background(evidence.rig, found["background"]))
    assembly = model_with(
        evidence, (), {(port, signal): size for port, signal, size in found["sizes"]}
    )
    held = evidence.tracks(assembly, held_out=True)
    replays, sheet, floor = (
        _replays_of(held, found[part], evidence.noise)
        for part in ("held_out", "data_sheet", "floor")
    )
    return GreyBox(
        evidence,
        assembly,
        _fit_of(evidence, assembly, found["fit"]),
        found["recheck"],
        replays,
        sheet,
        floor,
        remark=found["remark"],
    )


def _fit_plain(f: Fit) -> Plain:
    return {
        "p": f.p,
        "starts": f.starts,
        "sigma": f.weights.sigma,
        "correlated": f.weights.correlated,
        "cost": f.cost,
        "covariance": f.covariance,
        "iterations": f.iterations,
        "converged": f.converged,
        "why": f.why,
        "substeps": f.stepping.substeps,
        "implicit": f.stepping.implicit,
        "pulls": f.continuity,
        "residuals": f.residuals,
        "held": f.held,
    }


def _fit_of(evidence: DataSplit, assembly: Assembly, found: dict[str, Any]) -> Fit:
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    return Fit(
        problem,
        found["p"],
        tuple(found["starts"]),
        Weights(found["sigma"], found["correlated"]),
        found["cost"],
        found["covariance"],
        found["iterations"],
        found["converged"],
        found["why"],
        Stepping(found["substeps"], found["implicit"]),
        tuple(found["pulls"]),
        tuple(found["residuals"]),
        found["held"],
    )


def _replay_plain(r: Replay) -> Plain:
    return {
        "whole": r.full_outputs,
        "cuts": np.array([(w.start, w.stop) for w in r.full_windows]),
        "carried": r.carried,
        "starts": r.starts,
        "finite": r.finite,
        "per_run": r.per_run,
    }


def _replays_of(tracks: tuple[Track, ...], found: list[Plain], noise: Array) -> tuple[Replay, ...]:
    return tuple(
        Replay(
            _measured(t, f),
            f["whole"],
            tuple(Window(*w) for w in f["cuts"].tolist()),
            f["carried"],
            f["starts"],
            f["finite"],
            noise,
            f["per_run"],
        )
        for t, f in zip(tracks, found, strict=True)
    )


def _measured(track: Track, found: Plain) -> Track:
    """The track, or the same with the channels that a replay was held against."""
    return replace(track, y=found["measured"]) if "measured" in found else track
