"""A fitted model as fit.json stores it: the rig as it was fitted, the effects, every parameter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.schemas.fit_file import FittedModel, RecordingUsed
from pamid.engine.program import Stepping
from pamid.estimation.grey_box import rig_with_background
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.between_samples import as_fitted, stated
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.sampling import as_sampled
from pamid.networks.correction.residual_data import REFIT_REMEDY

MOST_STORED_SUBSTEPS = 4096  # of a sample, in a file that is to be believed


def stored_model(
    rig: Rig,
    saved: FittedModel,
    recordings: Sequence[RecordingUsed],
    catalogue: dict[str, type[Effect]],
    path: Path,
) -> tuple[Assembly, Array, Stepping]:
    """The model that a file stores, the values of its parameters (SI) in the assembly's order, and
    its steps; FileError, with the path of the file, where it is of another rig."""
    periods = [recording.period_s for recording in recordings if recording.period_s]
    rig = as_fitted(in_form(rig, saved, path), saved.values)
    rig = as_sampled(stated(rig, dict(saved.between or {})), periods)
    rig = rig_with_background(rig, {key.partition(":")[0] for key in saved.values})
    assembly = Assembly(
        rig, tuple(attach(rig, label, catalogue) for label in saved.effects), background=True
    )
    values = saved.values
    if set(values) != set(assembly.keys):
        odd = sorted(set(values) ^ set(assembly.keys))
        refuse(path, f"its model and the rig {rig.name!r} differ in {', '.join(odd[:3])}")
    p = np.array([values[key] for key in assembly.keys])
    step = Stepping(saved.stepping.substeps or 0, saved.stepping.implicit)
    if not 1 <= step.substeps <= MOST_STORED_SUBSTEPS:
        refuse(path, "the number of its steps is out of range")
    return assembly, p, step


def in_form(rig: Rig, saved: FittedModel, path: Path) -> Rig:
    """The rig in the form that the recordings of the run decided; FileError where it has none."""
    if not saved.form or rig.form == saved.form:
        return rig
    if rig.forms is None:
        refuse(path, f"the rig {rig.name!r} cannot be run as {saved.form!r}")
    return rig.forms.named(saved.form)


def refuse(path: Path, fault: str) -> NoReturn:
    """FileError for a file of a run that cannot be used."""
    raise FileError(f"{path} cannot be used: {fault}.", REFIT_REMEDY, code="damaged")
