"""Recordings of zeros, repeats, single last digits and extreme sizes end in an answer or a refusal
that says how to mend it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli.frame import run
from small_cart import RIG, record_cart

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.run_folder import Run
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.model.registry import effects, rig_named
from pamid.networks.checkpoints import TrainingStep, load_checkpoint
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.data_split import split_recordings

Call = dict[str, Any]

SAMPLES, PERIOD_S = 600, 0.01
TIME = PERIOD_S * np.arange(SAMPLES)
PUSH = np.repeat(np.random.default_rng(2).uniform(-3.0, 3.0, SAMPLES // 15), 15)
ONE_ULP = np.where(np.arange(SAMPLES) % 2, 1.0, np.nextafter(1.0, 2.0))
SINE = 0.3 * np.sin(2.0 * TIME)


def written(folder: Path, force: Array, position: Array, time: Array = TIME) -> Path:
    """A recording of a cart with every digit that a double has."""
    path = folder / "rec.csv"
    rows = zip(time, force, position, strict=True)
    lines = [",".join(f"{x:.17g}" for x in row) for row in rows]
    path.write_text("\n".join(["time_s,force_n,position_m", *lines]) + "\n", encoding="utf-8")
    return path


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, Call]:
    code = run([*map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)


# ---- ranges that are none ----------------------------------------------------------------------


KINDS = {
    "zeros": np.zeros(SAMPLES),
    "half zero": np.where(np.arange(SAMPLES) < SAMPLES // 2, SINE, 0.0),
    "one last digit": ONE_ULP,
    "creep by last digits": 1.0 + np.cumsum(np.arange(SAMPLES) % 2) * np.spacing(1.0),
    "one value": np.full(SAMPLES, 1e20),
    "a step": np.where(np.arange(SAMPLES) < SAMPLES // 2, 0.0, 1.0),
    "a ramp": TIME,
    "one sample": np.where(np.arange(SAMPLES) == 300, 1.0, 0.0),
    "repeats": np.repeat(SINE[::30], 30),
    "two values": np.sign(SINE),
    "tiny": 1e-27 * SINE,
    "huge": 1e27 * SINE,
    "large offset": SINE + 1e12,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sent", [False, True], ids=["measured", "sent"])
def test_check_ends_in_an_answer(tmp_path, capsys, kind, sent):
    """With a rig and without; warnings are errors here, those of NumPy among them."""
    force, position = (KINDS[kind], SINE) if sent else (PUSH, KINDS[kind])
    for rig in (("--rig", RIG), ()):
        code, said = call(capsys, "check", written(tmp_path, force, position), *rig)
        assert code in (0, 3, 4), said
        assert said["schema"] == "pamid.check/1"


def test_a_model_that_runs_away_is_not_compared(tmp_path, capsys):
    """Held and linear inputs both lead to infinite errors, which no result file holds."""
    random = np.random.default_rng(3)
    columns = {
        "power_w": np.arange(SAMPLES, dtype=float),
        "ambient_degc": 1e29 * random.standard_normal(SAMPLES),
        "temperature_degc": 1e-12 * random.standard_normal(SAMPLES),
    }
    write_recording(tmp_path / "rec.csv", 10.0 * np.arange(SAMPLES), columns)
    code, said = call(capsys, "check", tmp_path / "rec.csv", "--rig", "thermal-block")
    assert code in (0, 3) and said["schema"] == "pamid.check/1"


# ---- a standstill ------------------------------------------------------------------------------


def halved(folder: Path, *columns: str) -> Recording:
    """A recorded cart whose columns are exactly 0 in the second half."""
    whole = read_recording(record_cart(folder))
    half = len(whole) // 2
    zeroed = {
        name: np.where((np.arange(len(whole)) < half) | (name not in columns), values, 0.0)
        for name, values in whole.columns.items()
    }
    write_recording(folder / "half.csv", whole.time, zeroed)
    return read_recording(folder / "half.csv")


@pytest.mark.parametrize("columns", [("force_n", "position_m"), ("position_m",)])
def test_half_a_recording_of_zeros_is_diagnosed(tmp_path, columns):
    """Every figure of diagnosis.json is finite, or it could not be written."""
    evidence = split_recordings(rig_named(RIG), [halved(tmp_path, *columns)], [])
    record = Run.create(tmp_path / "run", command=["test"], seed=0, overwrite=True)
    catalogue = {name: effects()[name] for name in ("coulomb-friction", "quadratic-drag")}
    found = diagnose_into(record, evidence, catalogue)
    assert found["verdict"] and (tmp_path / "run" / "diagnosis.json").exists()


# ---- known values ------------------------------------------------------------------------------


def test_a_known_value_outside_the_bounds_is_a_note(tmp_path, capsys):
    path = record_cart(tmp_path)
    high = next(p.high for p in rig_named(RIG).parameters if p.outside_name == "mass_kg")
    path.with_suffix(".toml").write_text(f"[known]\nmass_kg = {2 * high}\n", encoding="utf-8")
    code, said = call(capsys, "check", path, "--rig", RIG)
    noted = {f["check"] for f in said["findings"] if f["advice"]}
    assert code == 0 and "known" in noted
    target = tmp_path / "simulated.csv"
    assert run(["simulate", "--rig", RIG, "--excitation", str(path), "--output", str(target)]) == 0
    assert "outside the bounds" in capsys.readouterr().err


# ---- files that count in fractions -------------------------------------------------------------


def test_a_checkpoint_counts_in_finite_numbers(tmp_path):
    path = tmp_path / "checkpoint.npz"
    arrays = {
        "problem": np.array("p"),
        "weights_0": np.zeros(2),
        "numbers_0": np.full(6, np.nan),
        "steps_0": np.zeros((1, len(TrainingStep._fields))),
        "why_0": np.array(""),
    }
    np.savez(path, **arrays)  # type: ignore[arg-type]
    with pytest.raises(FileError, match="not finite numbers"):
        load_checkpoint(path, "p", 2)
