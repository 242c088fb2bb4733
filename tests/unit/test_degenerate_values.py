"""Recordings of zeros, repeats, single last digits and extreme sizes end in an answer or a refusal
that says how to mend it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_cart import RIG, cart_evidence, record_cart

from cli.frame import run
from pamid.base.errors import DataError, FileError
from pamid.base.metrics import motion, relative
from pamid.base.run_folder import Run
from pamid.checks.channel_quality import CheckedSignal, shortest_repeat
from pamid.checks.recording_quality import examine
from pamid.correction.residual_data import read_columns
from pamid.engine.program import Stepping
from pamid.excitation.aprbs import coverage
from pamid.model.assembly import Assembly
from pamid.model.registry import effects, rig_named
from pamid.networks.checkpoints import TrainingStep, load_checkpoint
from pamid.recording.noise import NEGLIGIBLE_ERROR, noise_level, plateau_spacing
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.replay import replay_track, spread_of
from pamid.verdict.diagnosis_run import diagnose_into

Array = NDArray[np.float64]
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


def test_the_last_digit_is_no_motion() -> None:
    assert motion(ONE_ULP) == 0.0 and motion(np.zeros(9)) == 0.0
    assert motion([300.0, 300.0 + 1e-6]) == pytest.approx(1e-6, rel=1e-3)
    assert motion(1e-30 * SINE) == np.ptp(1e-30 * SINE), "small numbers are not digits"


def test_a_share_of_nothing_is_finite() -> None:
    assert relative(1.0, 4.0) == 0.25
    assert math.isfinite(relative(1.0, 0.0)) and relative(0.0, 0.0) == 0.0


def test_no_histogram_of_a_single_last_digit() -> None:
    assert plateau_spacing(ONE_ULP) == 0.0
    with pytest.raises(DataError, match="constant"):
        coverage(ONE_ULP, PERIOD_S)
    with pytest.raises(DataError, match="constant"):
        coverage(PUSH, PERIOD_S, span=(1.0, float(np.nextafter(1.0, 2.0))))


def test_noise_below_a_step_repeats_everything() -> None:
    """White noise that is smaller than the grain of the channel makes all repeats likely."""
    values = np.cumsum(np.ones(50))
    signal = CheckedSignal("position_m", TIME[:50], values, False, 49.0, 0.0, 0.2, True, grain=1.0)
    assert shortest_repeat(signal) == math.inf


def test_pulses_on_a_staircase_are_examined(tmp_path: Path) -> None:
    position = np.zeros(SAMPLES)
    position[6::13] = 1.0
    for first, rise in ((180, 100.0), (320, 250.0), (410, 470.0), (500, 800.0)):
        position[first:] += rise
    assert isinstance(examine(read_recording(written(tmp_path, PUSH, position))), tuple)


KINDS = {
    "zeros": np.zeros(SAMPLES),
    "half zero": np.where(np.arange(SAMPLES) < SAMPLES // 2, SINE, 0.0),
    "one last digit": ONE_ULP,
    "creep by last digits": 1.0 + np.cumsum(np.arange(SAMPLES) % 2) * np.spacing(1.0),
    "one sample": np.where(np.arange(SAMPLES) == 300, 1.0, 0.0),
    "repeats": np.repeat(SINE[::30], 30),
    "two values": np.sign(SINE),
    "tiny": 1e-27 * SINE,
    "huge": 1e27 * SINE,
    "large offset": SINE + 1e12,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sent", [False, True], ids=["measured", "sent"])
def test_check_ends_in_an_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, sent: bool
) -> None:
    force, position = (KINDS[kind], SINE) if sent else (PUSH, KINDS[kind])
    code, said = call(capsys, "check", written(tmp_path, force, position), "--rig", RIG)
    assert code in (0, 3, 4), said
    assert said["schema"] == "pamid.check/1"


def test_a_model_that_runs_away_is_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (("force_n", "position_m"), ("position_m and force_n stand still", "Cut")),
        (("position_m",), ("position_m stands still while force_n moves", "Look at the sensor")),
    ],
)
def test_half_a_recording_at_rest_is_reported(
    tmp_path: Path, columns: tuple[str, ...], words: tuple[str, str]
) -> None:
    recording = halved(tmp_path, *columns)
    (issue,) = [i for i in examine(recording) if i.kind == "standstill"]
    assert issue.severity == "advice" and set(issue.columns) == set(columns)
    assert issue.windows_s[0][1] == recording.time[-1]
    assert issue.figures["share"] == pytest.approx(0.5, abs=0.02)
    assert all(word in issue.text for word in words)


@pytest.mark.parametrize("share", [0.15, 0.5, 0.7])
def test_noise_is_read_where_the_channel_moves(share: float) -> None:
    random, sigma = np.random.default_rng(4), 5e-4
    noisy = SINE + sigma * random.standard_normal(SAMPLES)
    resting = np.where(np.arange(SAMPLES) < share * SAMPLES, 0.0, noisy)
    assert noise_level(resting[:, None])[0] == pytest.approx(sigma, rel=0.3)


def test_a_rest_that_leaves_a_few_samples_is_kept() -> None:
    random = np.random.default_rng(4)
    short = np.where(np.arange(60) < 40, 0.0, random.standard_normal(60))
    assert np.isfinite(noise_level(short[:, None])).all()


def test_a_short_rest_is_usual(tmp_path: Path) -> None:
    whole = read_recording(record_cart(tmp_path))
    resting = np.arange(len(whole)) < 0.2 * len(whole)
    columns = {name: np.where(resting, 0.0, x) for name, x in whole.columns.items()}
    write_recording(tmp_path / "late.csv", whole.time, columns)
    issues = examine(read_recording(tmp_path / "late.csv"))
    assert "standstill" not in {issue.kind for issue in issues}


@pytest.mark.parametrize("columns", [("force_n", "position_m"), ("position_m",)])
def test_half_a_recording_of_zeros_is_diagnosed(tmp_path: Path, columns: tuple[str, ...]) -> None:
    """Every figure of diagnosis.json is finite, or it could not be written."""
    evidence = split_recordings(rig_named(RIG), [halved(tmp_path, *columns)], [])
    record = Run.create(tmp_path / "run", command=["test"], seed=0, overwrite=True)
    catalogue = {name: effects()[name] for name in ("coulomb-friction", "quadratic-drag")}
    found = diagnose_into(record, evidence, catalogue, jobs=1)
    assert found["verdict"] and (tmp_path / "run" / "diagnosis.json").exists()


def test_an_exact_model_leaves_the_negligible_error(tmp_path: Path) -> None:
    """A logarithm and a reciprocal of it are finite."""
    evidence = cart_evidence(record_cart(tmp_path))
    assembly = Assembly(evidence.rig, outputs=evidence.channels)
    track = evidence.tracks(assembly, held_out=True)[0]
    done = replay_track(assembly, assembly.values(), track, Stepping(2), evidence.noise)
    exact = replace(done, full_track=replace(done.full_track, y=done.full_outputs))
    assert not exact.residual.any()
    for power in (1, 2):
        least = (NEGLIGIBLE_ERROR * evidence.noise) ** power
        np.testing.assert_allclose(exact.losses(power) / least, 1.0)
    resting = replace(done, full_track=replace(done.full_track, y=np.zeros_like(done.full_outputs)))
    assert spread_of([resting]) == evidence.noise


# ---- known values ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "word"),
    [
        (0.0, "is zero"),
        (-1.0, "wrong sign"),
        (1e-300, "1000 times beyond"),
        (1e300, "1000 times beyond"),
        (math.nan, "not finite"),
        (math.inf, "not finite"),
    ],
)
def test_a_known_value_that_cannot_be_is_refused(mass: float, word: str) -> None:
    plain = Assembly(rig_named(RIG))
    with pytest.raises(FileError, match=word) as caught:
        plain.values({"mass_kg": mass})
    assert caught.value.exit_code == 3 and "mass_kg" in str(caught.value) and caught.value.hint


def test_a_known_value_outside_the_bounds_is_an_objection() -> None:
    plain = Assembly(rig_named(RIG))
    (mass,) = [b for b in plain.parameters if b.name == "mass_kg"]
    assert plain.known_objections({"mass_kg": mass.high}) == []
    (odd,) = plain.known_objections({"mass_kg": 2.0 * mass.high})
    assert not odd.impossible and "outside the bounds" in odd.text
    assert plain.values({"mass_kg": 2.0 * mass.high})[plain.index_of("mass_kg")] == 2.0 * mass.high
    (gram,) = plain.known_objections({"mass_g": 3000.0 * mass.high})
    assert not gram.impossible, "in the unit of the name, 3 times the bound"


def test_every_command_refuses_a_known_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record_cart(tmp_path)
    path.with_suffix(".toml").write_text("[known]\nmass_kg = 0\n", encoding="utf-8")
    code, said = call(capsys, "check", path, "--rig", RIG)
    assert code == 3 and [f["check"] for f in said["findings"] if not f["ok"]][0] == "known"
    for command in ("fit", "diagnose"):
        words = (command, path, "--rig", RIG, "--output", tmp_path / command)
        code, said = call(capsys, *words)
        assert (code, said["code"]) == (3, "known") and str(path) in said["message"]
    target = tmp_path / "simulated.csv"
    words = ("simulate", "--rig", RIG, "--excitation", path, "--output", target)
    code, said = call(capsys, *words)
    assert (code, said["code"]) == (3, "known") and not target.exists()


def test_a_known_value_outside_the_bounds_is_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record_cart(tmp_path)
    high = next(p.high for p in rig_named(RIG).parameters if p.outside_name == "mass_kg")
    path.with_suffix(".toml").write_text(f"[known]\nmass_kg = {2 * high}\n", encoding="utf-8")
    code, said = call(capsys, "check", path, "--rig", RIG)
    noted = {f["check"] for f in said["findings"] if f["advice"]}
    assert code == 0 and "known" in noted
    target = tmp_path / "simulated.csv"
    assert run(["simulate", "--rig", RIG, "--excitation", str(path), "--output", str(target)]) == 0
    assert "outside the bounds" in capsys.readouterr().err


# ---- stamps ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time", "code", "cure"),
    [
        (1e-28 * np.arange(SAMPLES), "stamps-period", "seconds"),
        (1e20 * np.arange(SAMPLES), "stamps-period", "seconds"),
        (1e17 + 16.0 * np.arange(SAMPLES), "stamps-resolution", "Subtract the first stamp"),
    ],
)
def test_stamps_of_no_clock_are_refused(tmp_path: Path, time: Array, code: str, cure: str) -> None:
    with pytest.raises(FileError) as caught:
        read_recording(written(tmp_path, PUSH, SINE, time))
    assert (caught.value.exit_code, caught.value.code) == (3, code)
    assert "time_s" in caught.value.message and cure in caught.value.hint


def test_seconds_since_1970_are_stamps(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, PUSH, SINE, 1.7e9 + TIME))
    assert recording.sampling_period_s == pytest.approx(PERIOD_S, rel=1e-6)


# ---- files that count in fractions -------------------------------------------------------------


@pytest.mark.parametrize("cell", ["nan", "0.5", "inf"])
def test_a_residual_table_counts_in_whole_numbers(tmp_path: Path, cell: str) -> None:
    table = tmp_path / "residual.csv"
    table.write_text(f"time_s,recording,part,window,x_m\n0,{cell},0,0,1\n1,0,0,0,2\n")
    with pytest.raises(FileError) as caught:
        read_columns(table)
    assert caught.value.exit_code == 3 and str(table) in caught.value.message


def test_a_checkpoint_counts_in_finite_numbers(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    arrays = {
        "problem": np.array("p"),
        "weights_0": np.zeros(2),
        "numbers_0": np.full(6, np.nan),
        "steps_0": np.zeros((1, len(TrainingStep._fields))),
        "why_0": np.array(""),
    }
    np.savez(path, **arrays)  # type: ignore[arg-type]
    with pytest.raises(FileError, match="no number"):
        load_checkpoint(path, "p", 2)
