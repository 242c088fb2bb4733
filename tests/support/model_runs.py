"""Run folders of a model file without the fit: what a diagnosis would have left for an arm whose
causes are known, with a recording that MuJoCo made."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.csv_table import table_bytes
from pamid.base.run_folder import Run
from pamid.base.schemas import fit_file as result
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named

Array = NDArray[np.float64]

PERIOD_S = 0.004
WINDOW = 250  # samples


def fitted_values(
    rig: Path, labels: Sequence[str], values: Mapping[str, float]
) -> result.FittedModel:
    """The model of a rig with effects at these values, SI by key ("label:name"), the others as the
    file and the data sheets have them."""
    made = rig_named(str(rig))
    assembly = Assembly(made, tuple(attach(made, label, effects()) for label in labels), True)
    p = dict(zip(assembly.keys, assembly.values().tolist(), strict=True))
    assert set(values) <= set(p), sorted(p)
    return result.FittedModel(
        effects=tuple(labels), stepping=result.Steps(substeps=1), values={**p, **values}
    )


def make_run(
    folder: Path,
    rig: Path,
    columns: Mapping[str, Array],
    readings: Sequence[str],
    model: result.FittedModel,
    *,
    rivals: Mapping[str, tuple[float, result.FittedModel]] | None = None,
    noise: float = 1e-4,
    stated: float = 1e-3,
) -> Path:
    """A run whose second half is held out. columns: inputs and readings by column, SI; stated: the
    error of every reading that the run states."""
    run = Run.create(folder, command="diagnose", seed=0, inputs=[rig], options={"rig": str(rig)})
    count = len(next(iter(columns.values())))
    fit: dict[str, Any] = result.FitFile(
        rig=rig_named(str(rig)).name,
        recordings=(result.RecordingUsed(name="log", period_s=PERIOD_S, samples=count),),
        channels=tuple(readings),
        inputs=tuple(c for c in columns if c not in readings),
        noise=dict.fromkeys(readings, noise),
        mae={c: {"refitted": stated} for c in readings},
        model=model,
    ).as_json()
    if model.effects:
        fit["cause"] = fit["model"]
    if rivals:
        fit["rivals"] = {
            k: {"probability": p, "model": m.as_json()} for k, (p, m) in rivals.items()
        }
    # the parts that only a fit could fill are left out
    run.path("fit.json").write_text(json.dumps(fit), encoding="utf-8")
    time, part = PERIOD_S * np.arange(count), (np.arange(count) >= count // 2).astype(float)
    place = np.arange(count) % WINDOW
    window = np.where(place < WINDOW // 10, -1.0, np.arange(count) // WINDOW)
    header = ["time_s", "recording", "part", "window", *columns]
    table = np.column_stack([time, np.zeros(count), part, window, *columns.values()])
    run.path("residual.csv").write_bytes(table_bytes(header, table, ["%.12g"] * len(header)))
    run.finish()
    return folder
