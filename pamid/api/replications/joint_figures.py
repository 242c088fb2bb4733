"""The figures of the first paper, drawn of the twin: responses and pressures on the steps, the
record that the network is trained on, its training, and the force law."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pamid.api.replications.joint_twin import (
    ANGLE_COLUMN,
    PERIOD_S,
    PRESSURE_COLUMNS,
    REFERENCE_COLUMN,
    analytic_run,
    clock,
)
from pamid.base.arrays import Array
from pamid.base.metrics import mae, rms
from pamid.networks.correction.force_map import ForceMap, forces
from pamid.networks.scaling import scaling_of
from pamid.recording.recording import Recording
from pamid.report.paper_figure import (
    Panel,
    excitation_picture,
    force_surface_picture,
    pressures_picture,
    responses_picture,
    training_picture,
)
from pamid.rigs.muscle import LAWS

PAPER_LAW, RIG_LAW = "polynomial", "exponential"
SURFACE_CONTRACTION, SURFACE_KPA = np.linspace(0.0, 0.25, 51), np.linspace(0.0, 600.0, 61)
CLOSER_S = 12.0  # of the training record, that are shown closer


def responses_png(
    steps: Mapping[str, Recording], models: Mapping[str, Mapping[str, Array | None]]
) -> bytes:
    """models: by word and inertia, angle (samples,), deg; None: unstable, and not drawn."""
    panels, off = [], dict[str, list[str]]()
    for case, r in steps.items():
        angles = {word: angle for word, by in models.items() if (angle := by.get(case)) is not None}
        reference, measured = r.signal(REFERENCE_COLUMN), r.signal(ANGLE_COLUMN)
        lines = {"reference": reference, "measured": measured, **angles}
        panels.append(Panel(f"{case}\nangle [deg]", clock(reference), lines))
        for word, angle in angles.items():
            off.setdefault(word, []).append(f"{mae(measured, angle):.2f} deg at {case}")
    errors = "; ".join(f"{word} off by {' and '.join(off.get(word, ()))}" for word in models)
    return responses_picture(panels, f"On the steps: {errors}")


def pressures_png(steps: Mapping[str, Recording]) -> bytes:
    """Of the analytic model in its loop, next to the measured motion."""
    cases: dict[str, dict[str, tuple[Array, Array]]] = {}
    for case, r in steps.items():
        model = analytic_run(r)
        cases[case] = {
            f"muscle {k}": (r.signal(name), model[name])
            for k, name in enumerate(PRESSURE_COLUMNS, 1)
        }
    off = ", ".join(
        "by " + " and ".join(f"{mae(*pair):.1f}" for pair in muscles.values()) + f" kPa at {case}"
        for case, muscles in cases.items()
    )
    time = PERIOD_S * np.arange(len(next(iter(steps.values()))), dtype=np.float64)
    return pressures_picture(time, cases, f"The analytic model misses the two pressures {off}")


def excitation_png(training: Recording, model: Array) -> bytes:
    """model: angle of the analytic model in its loop on the same reference (samples,), deg."""
    reference = training.signal(REFERENCE_COLUMN)
    error = training.signal(ANGLE_COLUMN) - model
    time = clock(reference)
    begin = min(0.25 * time[-1], max(time[-1] - CLOSER_S, 0.0))
    title = (
        f"{time[-1]:.0f} s of steps within {np.abs(reference).max():.0f} deg leave an error of "
        f"{rms(error, np.zeros_like(error)):.2f} deg RMS, at most {np.abs(error).max():.1f} deg, "
        "for the network to learn"
    )
    sent, left = (
        scaling_of(samples, ("signal",)).forward(samples) for samples in (reference, error)
    )
    return excitation_picture(time, sent, left, (begin, begin + CLOSER_S), title)


def training_png(trace: Mapping[str, Array], published: Mapping[str, Any]) -> bytes:
    """trace: as `Training.trace`; published: the paper's table I."""
    ends = {name: float(published[name]) for name in ("mse", "gradient", "mu", "gamma")}
    title = (
        f"After {trace['iteration'][-1]:.0f} iterations the MSE is {trace['mse'][-1]:.2g} with "
        f"{trace['gamma'][-1]:.0f} effective weights; the paper's was {ends['mse']:.2g} with "
        f"{ends['gamma']:.0f} after {published['iterations']}"
    )
    return training_picture(trace, ends, int(published["n_weights"]), title)


def force_surface_png() -> bytes:
    """The paper's polynomial, and the law that the rig has without a word."""
    grid = np.stack(np.meshgrid(SURFACE_CONTRACTION, SURFACE_KPA, indexing="ij"), axis=-1)
    flat = grid.reshape(-1, 2)
    points = ForceMap(Path(PAPER_LAW), flat[:, 0], flat[:, 1], np.zeros(len(flat)))
    shape = grid.shape[:2]
    published, other = (forces(LAWS[name], points).reshape(shape) for name in (PAPER_LAW, RIG_LAW))
    pull, others = np.maximum(published, 0.0), np.maximum(other, 0.0)
    pulling = (published > 0.0) | (other > 0.0)
    title = (
        f"The polynomial of fifth order pulls with {published.max():.0f} N at rest and "
        f"{SURFACE_KPA[-1] / 100.0:.0f} bar; the {RIG_LAW} law differs from it by "
        f"{rms(pull[pulling], others[pulling]):.1f} N RMS where a muscle pulls"
    )
    return force_surface_picture(SURFACE_CONTRACTION, SURFACE_KPA, published, other, title)
