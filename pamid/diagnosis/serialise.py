"""Models as plain data, and back. The data hold the results of a fit; tracks and equations are
rebuilt from the evidence."""

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
    """Plain data of a model that was fitted to the evidence, all its parameters jointly, and
    replayed over the held-out part."""
    return {
        "fit": _fit_plain(c.fit),
        "replays": [_replay_plain(r) for r in c.replays],
        "runs": [] if c.runs is c.replays else [_replay_plain(r) for r in c.runs],
        "ranges": [[key, low, high] for key, (low, high) in c.assembly.ranges.items()],
    }


def candidate_restored(evidence: DataSplit, assembly: Assembly, plain: Plain) -> CandidateModel:
    ranges = {key: (low, high) for key, low, high in plain["ranges"]}
    assembly = replace(assembly, ranges=ranges) if ranges else assembly
    # Tracks are rebuilt from the evidence: they are large and hold nothing that a job computed.
    held = evidence.tracks(assembly, held_out=True)
    return candidate_from(
        assembly,
        _fit_of(evidence, assembly, plain["fit"]),
        _replays_of(held, plain["replays"], evidence.noise),
        _replays_of(held, plain["runs"], evidence.noise) if plain["runs"] else (),
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


def grey_box_restored(evidence: DataSplit, plain: Plain) -> GreyBox:
    evidence = replace(evidence, rig=rig_with_background(evidence.rig, plain["background"]))
    assembly = model_with(
        evidence, (), {(port, signal): size for port, signal, size in plain["sizes"]}
    )
    held = evidence.tracks(assembly, held_out=True)
    replays, sheet, floor = (
        _replays_of(held, plain[part], evidence.noise)
        for part in ("held_out", "data_sheet", "floor")
    )
    return GreyBox(
        evidence,
        assembly,
        _fit_of(evidence, assembly, plain["fit"]),
        plain["recheck"],
        replays,
        sheet,
        floor,
        remark=plain["remark"],
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


def _fit_of(evidence: DataSplit, assembly: Assembly, plain: dict[str, Any]) -> Fit:
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    return Fit(
        problem,
        plain["p"],
        tuple(plain["starts"]),
        Weights(plain["sigma"], plain["correlated"]),
        plain["cost"],
        plain["covariance"],
        plain["iterations"],
        plain["converged"],
        plain["why"],
        Stepping(plain["substeps"], plain["implicit"]),
        tuple(plain["pulls"]),
        tuple(plain["residuals"]),
        plain["held"],
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


def _replays_of(tracks: tuple[Track, ...], plain: list[Plain], noise: Array) -> tuple[Replay, ...]:
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
        for t, f in zip(tracks, plain, strict=True)
    )


def _measured(track: Track, plain: Plain) -> Track:
    """The track, or the same with the channels that a replay was held against."""
    return replace(track, y=plain["measured"]) if "measured" in plain else track
