"""Rigs to start from: each is excited, simulated and checked by name alone; `pamid new-rig` makes a
file of one's own of them."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conformance_rules import excitation, plain_run
from conformance_rules import run as run_rig
from pamid_cli import frame

import pamid
from pamid.authoring.column_match import best_match, examples
from pamid.base.errors import FileError, UsageError
from pamid.base.units import from_si, split_column
from pamid.ingest.matcher import recorded_fit
from pamid.model.assembly import Assembly
from pamid.model.determined_signals import unobserved_states
from pamid.model.effect import RIG_SECTIONS
from pamid.model.registry import rig_named
from pamid.model.trace import trace
from pamid.recording.recording import Recording, read_recording, recording_of, write_recording
from pamid.symbolic.expression import symbols

EXAMPLES = sorted(examples())


def test_there_are_these_to_start_from() -> None:
    assert EXAMPLES == [
        "cascaded-tanks",
        "cylinder-bench",
        "damper-bench",
        "dc-motor",
        "free-decay",
        "geared-motor",
        "linear-axis",
        "pump-tank",
        "servo",
        "servo-axis",
        "servo-pendulum",
        "static-map",
        "thermal-block",
        "thermal-two-mass",
        "two-masses",
    ]


def run(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    found = frame.run([*words, "--json"])
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert found == code, said
    return said


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(rig: str, capsys: pytest.CaptureFixture[str]) -> Recording:
    """A virtual recording as a newcomer makes one: nothing said but the rig. A rig without inputs
    is simulated over the length of a recording."""
    kind = rig_named(rig)
    if kind.inputs:
        words = ("--duration", f"{20 * kind.hold_s[1]}", "--output", "u.csv")
        run(capsys, "generate-aprbs", "--rig", rig, *words)
    else:
        time = kind.period_s * np.arange(1000)
        write_recording("u.csv", time, {name: np.cos(time) for name in kind.outputs})
    run(capsys, "simulate", "--rig", rig, "--excitation", "u.csv", "--output", "rec.csv")
    return read_recording("rec.csv")


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_tells_its_story(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    story = run(capsys, "rigs", name)["rig"]["story"]
    assert all(len(story[section]) > 30 for section in RIG_SECTIONS)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_file_like_the_rig_is_the_rig(
    name: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From the rig's own virtual recording: the right rig, every column by its name, the file is
    sound, the recording fits it, and it says what the rig says."""
    recording = record(name, capsys)
    assert recording.sampling_period_s == pytest.approx(rig_named(name).period_s)
    assert run(capsys, "check", "rec.csv", "--rig", name)["ok"]
    said = run(capsys, "new-rig", "rec.csv")
    assert (said["like"], said["rig"], said["unused"]) == (name, "my-rig", [])
    assert {c["by"] for c in said["columns"]} == {"name"}
    assert not any(c["scaled"] for c in said["columns"])
    assert run(capsys, "check", "my_rig.py")["ok"]
    assert run(capsys, "check", "rec.csv", "--rig", "my_rig.py")["ok"]
    for rig in (name, "my_rig.py"):
        run(
            capsys,
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
def test_what_no_recording_shows_is_left_out(name: str, part: tuple[str, ...], here: Path) -> None:
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


def test_a_shaft_with_a_tachometer_gets_no_angle(here: Path) -> None:
    given = small({"torque_nm": held(1), "velocity_deg_per_s": moving(2)})
    made = pamid.new_rig(given, output=here / "shaft.py")
    rig = rig_named(str(here / "shaft.py"))
    assert made.like == "servo-axis" and [s.name for s in rig.states] == ["velocity"]
    assert "encoder" not in rig.ports and "position" not in rig.ports["shaft"].signals
    assert "angle" in made.summary() and made.to_dict()["unobserved"] == ["angle"]
    assert "# state angle: left out" in made.text
    assert pamid.check(here / "shaft.py").ok


@pytest.mark.parametrize("name", EXAMPLES)
def test_numbers_are_written_as_people_write_them(name: str, here: Path) -> None:
    """No 0.15000000000000002: 12 digits are enough for any figure of a data sheet."""
    whole = rig_named(name)
    columns = {c: 1.0 + wave(k) for k, c in enumerate((*whole.inputs, *whole.outputs))}
    text = pamid.new_rig(small(columns), like=name, output=here / "mine.py").text
    numbers = [n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant)]
    assert [x for x in numbers if isinstance(x, float) and x != float(f"{x:.12g}")] == []


def small(columns: dict[str, np.ndarray], period: float = 0.01) -> Recording:
    count = len(next(iter(columns.values())))
    return recording_of(period * np.arange(count), columns, name="small")


def wave(seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 20), 20)


def test_other_units_are_converted(here: Path) -> None:
    """A bench in metres, pascals and kilonewtons, its controller and noise in these units."""
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


def test_what_no_equation_sees_is_said_and_no_line_ends_in_spaces(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = {
        "heater_percent": 60.0 * np.abs(wave(1)),
        "room_degf": 70.0 + wave(2),
        "boiler_degc": 50.0 + 9.0 * wave(3),
    }
    with pytest.raises(FileError) as caught:
        best_match(columns)
    assert "for example --like thermal-block." in str(caught.value)
    write_recording("boiler.csv", 0.01 * np.arange(len(wave(1))), columns)
    run(capsys, "new-rig", "boiler.csv", "--like", "thermal-block", "--output", "boiler.py")
    text = (here / "boiler.py").read_text()
    assert "# heater_percent: the equations see a fraction, 0.6 for 60 %" in text
    assert "# room_degf: the equations see kelvin" in text
    assert not [line for line in text.splitlines() if line != line.rstrip()]
    assert frame.run(["check", "boiler.py"]) == 0
    assert "Next: pamid check boiler.csv --rig boiler.py" in capsys.readouterr().out


def test_a_controller_takes_the_unit_of_its_reading(here: Path) -> None:
    given = small({"voltage_v": 30.0 * wave(1), "angle_rad": wave(2), "reference_rad": wave(3)})
    pamid.new_rig(given, like="servo-pendulum", output=here / "servo.py")
    rig = rig_named(str(here / "servo.py"))
    assert rig.controller["kp_per_rad"] == pytest.approx(0.4 * 180.0 / np.pi, rel=1e-3)
    assert "kp_per_deg" not in rig.controller
    assert rig.controller["command_limit"] >= np.abs(given.columns["voltage_v"]).max()
    assert rig.loops[0].reference == "reference_rad" and rig.loops[0].reading == "angle_rad"


def test_without_a_reference_there_is_no_loop(here: Path) -> None:
    given = small({"voltage_v": wave(1), "angle_deg": wave(2)})
    pamid.new_rig(given, like="servo-pendulum", output=here / "servo.py")
    rig = rig_named(str(here / "servo.py"))
    assert rig.loops == () and rig.controller == {} and set(rig.excited) == {"voltage_v"}


def test_the_temperature_of_a_room_stays_optional_and_is_not_excited(here: Path) -> None:
    """The file keeps what the example states of its inputs, under the recorded names."""
    room = 72.0 + 1.7 * np.sin(np.linspace(0.0, 5.0, 400))
    given = small(
        {"heater_percent": 30.0 + 30.0 * wave(1), "room_degf": room, "block_degc": 60.0 + wave(2)}
    )
    columns = {"temperature_degc": "block_degc"}
    pamid.new_rig(given, like="thermal-block", columns=columns, output=here / "oven.py")
    rig = rig_named(str(here / "oven.py"))
    assert rig.optional == {"room_degf": 293.15}
    assert rig.centre == {"heater_percent": pytest.approx(30.0, abs=2.0)}
    assert rig.excited == {"heater_percent": pytest.approx(28.0, abs=2.0)}


def test_a_raw_signal_gets_a_gain_that_is_fitted(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Levels in volts: the same tanks behind a sensor of 0.2 V/cm are fitted to their noise."""
    recording = record("cascaded-tanks", capsys)
    volts = {
        "pump_v": recording.columns["pump_v"],
        "level_v": 0.2 * recording.columns["level_cm"],
        "comment_n": wave(4)[: len(recording)]
        if len(recording) <= 400
        else np.resize(wave(4), len(recording)),
    }
    write_recording("volts.csv", recording.time, volts)
    said = run(capsys, "new-rig", "volts.csv", "--like", "cascaded-tanks", "--output", "tanks.py")
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


def test_a_duty_in_percent_is_seen_as_a_share(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = small({"duty_percent": 50.0 + wave(1), "temperature_degc": 30.0 + wave(2)})
    write_recording("duty.csv", given.time, given.columns)
    said = run(
        capsys,
        *("new-rig", "duty.csv", "--like", "thermal-block", "--output", "oven.py"),
        *("--column", "power_w=duty_percent", "--column", "temperature_degc=temperature_degc"),
    )
    assert said["like"] == "thermal-block"
    text = Path("oven.py").read_text()
    assert '"duty_percent": ""' in text and '"duty_gain"' in text and '"W"' in text
    assert list(rig_named("./oven.py").inputs.values())[0] == ""


def test_what_is_there_is_kept(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(
        "rec.csv", 0.01 * np.arange(400), {"force_n": wave(1), "position_1_mm": wave(2)}
    )
    Path("my_rig.py").write_text("mine")
    assert run(capsys, "new-rig", "rec.csv", code=3)["code"] == "exists"
    assert Path("my_rig.py").read_text() == "mine"
    assert run(capsys, "new-rig", "rec.csv", "--overwrite")["like"] == "two-masses"
    assert run(capsys, "new-rig", "rec.csv", "--output", "rig.txt", code=3)["code"] == "file"


@pytest.mark.parametrize(
    ("words", "code", "hint"),
    [
        (("--like", "two-mases"), 2, "'two-masses'"),
        (("--like", "one-dof"), 2, "--rig one-dof"),
        (("--like", "thermal-block"), 3, "--column power_w=NAME"),
        (("--like", "two-masses", "--column", "force=force_n"), 2, "'force_n'"),
        (("--like", "two-masses", "--column", "force_n=forse_n"), 2, "'force_n'"),
        (("--column", "force_n"), 2, "force_n=drive_v"),
    ],
)
def test_a_wrong_name_is_met_with_the_right_one(
    words: tuple[str, ...], code: int, hint: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(
        "rec.csv", 0.01 * np.arange(400), {"force_n": wave(1), "position_1_mm": wave(2)}
    )
    assert hint in run(capsys, "new-rig", "rec.csv", *words, code=code)["hint"]
    assert not Path("my_rig.py").exists()


def test_nothing_is_sent_to_a_rig_without_inputs(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = run(capsys, "generate-aprbs", "--rig", "free-decay", "--output", "u.csv", code=2)
    assert said["message"] == "Nothing is sent to rig 'free-decay': it has no input."
    assert "pamid simulate --rig free-decay --excitation" in said["hint"]


def test_a_recording_in_which_nothing_is_sent_is_of_such_a_rig(here: Path) -> None:
    """A further column may be what drives the machine."""
    assert like_of(here, angle_deg=moving(1)) == "free-decay"
    assert like_of(here, angle_deg=moving(1), motor_current_a=held(2)) != "free-decay"
    assert like_of(here, goal_position_deg=held(1), position_deg=moving(2)) == "servo"


def test_what_fits_no_rig_says_what_each_lacks() -> None:
    with pytest.raises(FileError, match="pump-tank: none of its outputs: level_cm") as caught:
        best_match(["drive_v", "response_v"])
    assert "--like" in caught.value.hint
    assert str(caught.value).count("none of its outputs") <= 4  # the nearest ones, not all
    with pytest.raises(FileError, match="columns of rig 'one-dof'") as caught:
        best_match(["command", "angle_deg"])
    assert "--rig one-dof" in caught.value.hint


def test_a_command_in_percent_stands_for_what_it_makes() -> None:
    """A gain stands between a duty and the voltage or the power; the load's angle is the load's in
    any language."""
    axis = best_match(["stellgrosse_percent", "motorstrom_a", "winkel_last_deg"])[0]
    assert axis.rig is examples()["geared-motor"] and axis.unused == ()
    stands = {q.found: (q.wanted, q.scaled) for q in axis.pairs}
    assert stands["stellgrosse_percent"] == ("voltage_v", True)
    assert stands["winkel_last_deg"] == ("load_angle_deg", False)
    with pytest.raises(FileError, match="by their units alone: thermal-block"):
        best_match(["kanal_3_percent", "fuehler_degf"])
    oven = best_match(["heater_pct", "tc_degf"], like="thermal-two-mass")[0]
    assert oven.taken_as("input") == ("heater_pct",)
    assert oven.taken_as("output") == ("tc_degf",)  # not for the room's, which is optional
    # where nothing is applied, a share stands for nothing
    with pytest.raises(FileError, match="free-decay|No rig fits"):
        best_match(["humidity_percent", "ph"])


def test_said_columns_are_taken_as_they_are(here: Path) -> None:
    given = small({"drive_v": wave(1), "response_v": 1e-3 * wave(2)})
    made = pamid.new_rig(
        given,
        like="two-masses",
        columns={"force_n": "drive_v", "position_2_mm": "response_v"},
        output=here / "silver.py",
    )
    said = made.to_dict()
    assert [c["by"] for c in said["columns"]] == ["you", "you"]
    rig = rig_named(str(here / "silver.py"))
    assert {"drive_gain", "response_gain"} <= {p.name for p in rig.parameters}
    assert pamid.check(here / "silver.py").ok


@pytest.mark.parametrize("name", ["x); import os #_n", "lambda", '"""_n', "a\nb_n"])
def test_a_name_that_is_no_word_is_never_code(name: str, here: Path) -> None:
    """As an input it is refused; where it is not used it stands in a comment, quoted. (Names that
    no file can hold are put into a recording by hand.)"""
    plain = small({"force_n": wave(3), "position_1_mm": wave(2)})
    made = replace(plain, columns={name: wave(1), **plain.columns})
    with pytest.raises((FileError, UsageError)):
        pamid.new_rig(
            made,
            like="two-masses",
            columns={"force_n": name},
            output=here / "bad.py",
        )
    text = pamid.new_rig(made, like="two-masses", output=here / "good.py").text
    tree = ast.parse(text)
    assert name not in {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
    assert sum(isinstance(n, ast.Import) for n in ast.walk(tree)) == 0


def test_pairs_are_judged_by_name_and_unit() -> None:
    assert recorded_fit("angle_rad", "angle_deg") == (1.0, "name", False)
    assert recorded_fit("motor_voltage_v", "voltage_v")[1:] == ("word", False)
    assert recorded_fit("drive_v", "voltage_v")[1:] == ("unit", False)
    assert recorded_fit("level_v", "level_cm")[2]
    assert recorded_fit("position_2_mm", "position_1_mm")[0] == 0.0
    assert recorded_fit("reference_deg", "angle_deg")[0] == 0.0
    assert recorded_fit("force_n", "level_cm")[0] == 0.0


def held(seed: int) -> np.ndarray:
    """Levels that are held for times that differ."""
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-1.0, 1.0, 20), random.integers(10, 30, 20))[:200]


def moving(seed: int) -> np.ndarray:
    return np.cumsum(np.cumsum(np.random.default_rng(seed).normal(size=200))) / 200.0


def like_of(folder: Path, **columns: np.ndarray) -> str:
    return pamid.new_rig(small(columns), output=folder / "mine.py", overwrite=True).like


def test_a_pushed_cart_is_no_bench(here: Path) -> None:
    """Names and units are those of a bench, which imposes the position and reads the force: here
    the force is held at levels, or a reference tells of a controller."""
    assert like_of(here, force_n=held(1), position_m=moving(2)) == "linear-axis"
    assert like_of(here, drive_n=held(1), x_m=moving(2)) == "linear-axis"
    loop = {"force_n": moving(1), "position_mm": moving(2), "reference_mm": held(3)}
    assert like_of(here, **loop) == "linear-axis"
    assert like_of(here, position_mm=moving(1), force_n=moving(2)) == "damper-bench"


def test_what_is_taken_as_cause_is_said_and_how_to_turn_it_round(here: Path) -> None:
    """An imposed speed looks like one that a force made: which it is, no recording says."""
    bench = small({"velocity_m_per_s": moving(1), "force_n": moving(2), "voltage_v": held(3)})
    made = pamid.new_rig(bench, output=here / "mine.py")
    assert made.like == "linear-axis" and made.to_dict()["turned"] == ["damper-bench"]
    told = made.summary()
    assert "Taken as cause: force_n; as effect: velocity_m_per_s." in told
    assert "If velocity_m_per_s is imposed on your bench and force_n is what it reads" in told
    assert "--like damper-bench" in told
    damper = small({"position_mm": moving(1), "force_n": moving(2)})
    back = pamid.new_rig(damper, output=here / "back.py")
    assert "Taken as cause: position_mm; as effect: force_n." in back.summary()
    assert "linear-axis" in back.to_dict()["turned"]
    heat = pamid.new_rig(
        small({"power_w": held(1), "temperature_degc": moving(2)}), output=here / "heat.py"
    )
    assert heat.to_dict()["turned"] == [] and "other way round" not in heat.summary()


def test_a_speed_is_no_way_with_a_gain(here: Path) -> None:
    """Said or not, it is refused, and how to add it up is told."""
    bench = small({"velocity_m_per_s": moving(1), "force_n": moving(2)})
    said = {"position_mm": "velocity_m_per_s"}
    with pytest.raises(UsageError, match="is the rate of position_mm") as caught:
        pamid.new_rig(bench, like="damper-bench", columns=said, output=here / "mine.py")
    assert "running sum" in caught.value.hint
    with pytest.raises(FileError, match="of which velocity_m_per_s is the rate") as lacking:
        pamid.new_rig(bench, like="damper-bench", output=here / "mine.py")
    assert "running sum" in lacking.value.hint and not (here / "mine.py").exists()


def test_torque_servos_belts_and_velocities_have_a_rig(here: Path) -> None:
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


def test_units_alone_name_machines_and_take_none(here: Path) -> None:
    with pytest.raises(FileError, match="by their units alone: .*linear-axis") as caught:
        like_of(here, foo_n=moving(1), bar_mm=moving(2))
    assert "--like" in caught.value.hint and not (here / "mine.py").exists()
