"""Rigs to start from: each is excited, simulated and checked by name alone; `pamid new-rig` makes a
file of one's own of them."""

import ast
import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from conformance_rules import excitation, plain_run
from conformance_rules import run as run_rig
from conftest import Cli
from pamid_cli import frame

import pamid
from pamid.api.authoring.column_match import examples
from pamid.base.errors import FileError, UsageError
from pamid.base.units import from_si, split_column
from pamid.engine.symbolic.expression import symbols
from pamid.model.assembly import Assembly
from pamid.model.determined_signals import unobserved_states
from pamid.model.effect import RIG_SECTIONS
from pamid.model.registry import rig_named
from pamid.model.trace import trace
from pamid.recording.recording import Recording, read_recording, recording_of, write_recording

EXAMPLES = sorted(examples())


def record(rig: str, cli: Cli) -> Recording:
    """A virtual recording as a newcomer makes one: nothing said but the rig. A rig without inputs
    is simulated over the length of a recording."""
    kind = rig_named(rig)
    if kind.inputs:
        words = ("--duration", f"{20 * kind.hold_s[1]}", "--output", "u.csv")
        cli("generate-aprbs", "--rig", rig, *words)
    else:
        time = kind.period_s * np.arange(1000)
        write_recording("u.csv", time, {name: np.cos(time) for name in kind.outputs})
    cli("simulate", "--rig", rig, "--excitation", "u.csv", "--output", "rec.csv")
    return read_recording("rec.csv")


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_tells_its_story(name, cli):
    story = cli("rigs", name)["rig"]["story"]
    assert all(len(story[section]) > 30 for section in RIG_SECTIONS)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_file_like_the_rig_is_the_rig(name, here, cli):
    recording = record(name, cli)
    assert recording.sampling_period_s == pytest.approx(rig_named(name).period_s)
    assert cli("check", "rec.csv", "--rig", name)["ok"]
    said = cli("new-rig", "rec.csv")
    assert (said["like"], said["rig"], said["unused"]) == (name, "my-rig", [])
    assert {c["by"] for c in said["columns"]} == {"name"}
    assert not any(c["scaled"] for c in said["columns"])
    assert cli("check", "my_rig.py")["ok"]
    assert cli("check", "rec.csv", "--rig", "my_rig.py")["ok"]
    for rig in (name, "my_rig.py"):
        cli(
            *("simulate", "--rig", rig, "--excitation", "u.csv", "--noise", "none"),
            *("--output", "again.csv", "--overwrite"),
        )
        found = read_recording("again.csv")
        if rig == name:
            first = found
    for column in rig_named(name).outputs:
        np.testing.assert_allclose(found.columns[column], first.columns[column], rtol=1e-9)


def shown(name: str) -> list[tuple[str, tuple[str, ...]]]:
    """Every part of a rig's outputs but the whole."""
    outputs = tuple(rig_named(name).outputs)
    return [(name, part) for n in range(1, len(outputs)) for part in combinations(outputs, n)]


@pytest.mark.parametrize(
    ("name", "part"), [case for name in EXAMPLES for case in shown(name)], ids=str
)
def test_what_no_recording_shows_is_left_out(name, part, here):
    """No output, state, port or parameter on which no recorded column depends; what is left
    computes what the whole rig does."""
    whole, sent, read = rig_named(name), excitation(name), plain_run(name)
    si = {
        **dict(zip(Assembly(whole).program.inputs, sent.T, strict=True)),
        **{column: read[:, k] for k, column in enumerate(whole.outputs) if column in part},
    }
    columns = {column: from_si(values, split_column(column)[1]) for column, values in si.items()}
    made = pamid.new_rig(small(columns, whole.period_s), like=name, output=here / "mine.py")
    mine = rig_named(str(here / "mine.py"))
    assert tuple(mine.outputs) == part
    assert made.unobserved == tuple(
        s.name for s in whole.states if s.name not in {q.name for q in mine.states}
    )
    traced = trace(mine, lambda port, place: [], {})
    assert not unobserved_states(traced, part)
    assert set(mine.ports) <= set(whole.ports)
    roots = [*traced.rates.values(), *traced.outputs.values()]
    used = {symbol for space, symbol in symbols(roots) if space == "parameter"}
    assert used == {q.name for q in mine.parameters}
    assembly = Assembly(mine)
    given = np.column_stack([si[column] for column in assembly.program.inputs])
    y, _, bad = run_rig(assembly, given, assembly.values())
    assert bad == -1
    for k, column in enumerate(part):
        np.testing.assert_allclose(y[:, k], si[column], rtol=1e-9, atol=1e-12)


def small(columns: dict[str, np.ndarray], period: float = 0.01) -> Recording:
    count = len(next(iter(columns.values())))
    return recording_of(period * np.arange(count), columns, name="small")


def wave(seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 20), 20)


def test_other_units_are_converted(here):
    given = small({"position_m": wave(1), "pressure_kpa": 300.0 + wave(2), "force_kn": wave(3)})
    made = pamid.new_rig(given, output=here / "bench.py")
    assert made.like == "cylinder-bench" and made.name == "bench"
    rig = rig_named(str(here / "bench.py"))
    assert rig.inputs == {"position_m": "m", "pressure_kpa": "Pa"}
    assert rig.outputs == {"force_kn": "N"} and rig.ramped == ("position_m",)
    assert rig.excited["position_m"] == pytest.approx(1.0, abs=0.1)
    assert rig.centre == {"pressure_kpa": 300.0}
    sheet = {p.name: p for p in rig.parameters}
    assert sheet["area"].spread == 3.0 and sheet["area"].source.startswith("GUESS")
    assert sheet["preload"].spread == 60.0


def test_a_raw_signal_gets_a_gain_that_is_fitted(here, cli):
    recording = record("cascaded-tanks", cli)
    volts = {
        "pump_v": recording.columns["pump_v"],
        "level_v": 0.2 * recording.columns["level_cm"],
        "comment_n": wave(4)[: len(recording)]
        if len(recording) <= 400
        else np.resize(wave(4), len(recording)),
    }
    write_recording("volts.csv", recording.time, volts)
    said = cli("new-rig", "volts.csv", "--like", "cascaded-tanks", "--output", "tanks.py")
    assert said["like"] == "cascaded-tanks" and said["unrecorded"] == ["upper_level_cm"]
    assert said["unused"] == ["comment_n"]
    assert [c["scaled"] for c in said["columns"]] == [False, True]
    text = Path("tanks.py").read_text()
    assert "# 'comment_n': " in text and "# upper_level_cm: not recorded" in text
    # nobody knows these tanks' areas, so the fit may end somewhere along a valley, and says so
    assert frame.run(["fit", "volts.csv", "--rig", "tanks.py", "--output", "run"]) in (0, 5)
    found = json.loads(Path("run/fit.json").read_text())
    assert "level_gain_v_per_m" in found["parameters"]
    assert found["mae"]["level_v"]["refitted"] < 1.5 * found["mae"]["level_v"]["noise_floor"]


@pytest.mark.parametrize("name", ["x); import os #_n", "lambda", '"""_n', "a\nb_n"])
def test_a_name_that_is_no_word_is_never_code(name, here):
    """As an input it is refused; where it is not used it stands in a comment, quoted. (Names that
    no file can hold are put into a recording by hand.)"""
    plain = small({"force_n": wave(3), "position_1_mm": wave(2)})
    made = replace(plain, columns={name: wave(1), **plain.columns})
    with pytest.raises((FileError, UsageError)):
        pamid.new_rig(made, like="two-masses", columns={"force_n": name}, output=here / "bad.py")
    text = pamid.new_rig(made, like="two-masses", output=here / "good.py").text
    tree = ast.parse(text)
    assert name not in {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
    assert sum(isinstance(n, ast.Import) for n in ast.walk(tree)) == 0


def held(seed: int) -> np.ndarray:
    """Levels that are held for times that differ."""
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-1.0, 1.0, 20), random.integers(10, 30, 20))[:200]


def moving(seed: int) -> np.ndarray:
    return np.cumsum(np.cumsum(np.random.default_rng(seed).normal(size=200))) / 200.0


def like_of(folder: Path, **columns: np.ndarray) -> str:
    return pamid.new_rig(small(columns), output=folder / "mine.py", overwrite=True).like


def test_torque_servos_belts_and_velocities_have_a_rig(here):
    servo = {"torque_nm": held(1), "angle_rad": moving(2), "velocity_rad_per_s": moving(3)}
    assert like_of(here, **servo) == "servo-axis"
    assert like_of(here, motor_torque_nm=held(1), speed_rpm=moving(2)) == "servo-axis"
    belt = {"motor_torque_nm": held(1), "pulley_angle_deg": moving(2)}
    assert like_of(here, **belt) == "servo-axis"
    given = small({"motor_current_a": held(1), "angle_deg": moving(2)})
    made = pamid.new_rig(given, output=here / "drive.py")
    assert [(c["stands_for"], c["scaled"]) for c in made.to_dict()["columns"]] == [
        ("torque_nm", True),
        ("angle_deg", False),
    ]
    assert pamid.check(here / "drive.py").ok
