"""What `pamid check` calls wrong stops a fit, with or without a stated period, and stops nothing
that is right."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.frame import run
from small_cart import RIG, record_cart
from virtual_joint import record

from pamid.api.given import evidence_of
from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.base.progress import silent
from pamid.intake.checks.findings import QualityIssue
from pamid.intake.checks.recording_quality import before_a_fit, examine
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, read_recording, recording_of, write_recording
from pamid.simulation.data_split import split_recordings

Columns = dict[str, Array]
ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT.parent / "shared" / "data"
P1, P2, ANGLE = "pressure_1_kpa", "pressure_2_kpa", "angle_deg"

PISTON = '''"""A piston."""
from pamid import Parameter, Port, Rig, State

class Piston(Rig):
    """A piston that is held at a pressure and pushes."""
    inputs = {"pressure_bar": "Pa"}
    outputs = {"force_n": "N"}
    ports = {"rod": Port("actuator-force", "N", {"pressure": "Pa"}), "cell": Port("reading", "N")}
    states = (State("force", "N"),)
    parameters = (Parameter("area", 5.0, low=0.1, high=100.0, source="calliper"),
                  Parameter("lag", 20.0, 1.0, 50.0, "ms", fitted=False, source="data sheet"))
    def rates(self, x, u, p, port):
        push = port("rod", p.area * u.pressure_bar, pressure=u.pressure_bar)
        return {"force": (push - x.force) / p.lag}
    def measure(self, x, u, p, port):
        return {"force_n": port("cell", x.force)}
'''

TANKS = '''"""Two tanks."""
from pamid import Parameter, Port, Rig, State
from pamid.engine.symbolic.vocabulary import maximum, sqrt

class Tanks(Rig):
    """Two tanks in a row."""
    inputs = {"pump_v": "V"}
    outputs = {"level_v": "V"}
    ports = {"inflow": Port("motion", "V"), "sensor": Port("reading", "V")}
    states = (State("upper", "V", start=5.0), State("lower", "V", start=5.0))
    parameters = tuple(Parameter(k, 0.05, low=0.001, high=1.0, source="guess") for k in ("k1", "k2", "k3"))
    def rates(self, x, u, p, port):
        upper, lower = p.k1 * sqrt(maximum(x.upper, 1e-3)), p.k2 * sqrt(maximum(x.lower, 1e-3))
        return {"upper": port("inflow", p.k3 * u.pump_v) - upper, "lower": upper - lower}
    def measure(self, x, u, p, port):
        return {"level_v": port("sensor", x.lower)}
'''  # noqa: E501


def blocking(recording: Recording, rig: Rig) -> list[QualityIssue]:
    return [i for i in before_a_fit(recording, rig) if i.severity == "wrong"]


@pytest.fixture(scope="module")
def joint(tmp_path_factory) -> Recording:
    return record(
        tmp_path_factory.mktemp("gate") / "joint.csv", 9.0, seed=3, effects=("coulomb-friction",)
    )


@pytest.fixture(scope="module")
def pushed(tmp_path_factory) -> Recording:
    return read_recording(record_cart(tmp_path_factory.mktemp("cart")))


def written(folder: Path, r: Recording, columns: Columns, clock: float = 1.0) -> Path:
    write_recording(
        folder / "bad.csv", r.time * clock, {**r.columns, **columns}, {"known": r.known}
    )
    return folder / "bad.csv"


BAD: dict[str, tuple[Callable[[Columns], Columns], float, int, str, tuple[str, ...]]] = {
    "radians": (lambda c: {ANGLE: np.radians(c[ANGLE])}, 1.0, 3, "check", ("unit", ANGLE, "rad")),
    "exchanged": (lambda c: {P1: c[P2], P2: c[P1]}, 1.0, 3, "check", ("exchanged", P1, P2)),
    "sign": (lambda c: {ANGLE: -c[ANGLE]}, 1.0, 3, "check", ("sign", ANGLE)),
    "two at once": (
        lambda c: {ANGLE: np.radians(c[ANGLE]), P1: c[P2], P2: c[P1]},
        1.0,
        3,
        "check",
        ("exchanged", "unit", ANGLE),
    ),
    "dead": (
        lambda c: {P1: np.full(c[P1].size, 101.0)},
        1.0,
        4,
        "not-excited",
        (P1, "constant (101 kPa)"),
    ),
    "milliseconds": (
        lambda c: {},
        1e3,
        3,
        "check",
        ("clock", "3 s apart", "milliseconds", "divide them by 1000"),
    ),
    "microseconds": (lambda c: {}, 1e6, 3, "check", ("clock", "microseconds")),
    "counted": (lambda c: {}, 1.0 / 0.003, 3, "check", ("clock", "a count of samples")),
}


@pytest.mark.parametrize(
    ("command", "kind"), [*(("fit", kind) for kind in BAD), ("diagnose", "radians")]
)
def test_what_check_calls_wrong_stops_a_fit(command, kind, joint, tmp_path, capsys):
    change, clock, code, word, needles = BAD[kind]
    path, output = written(tmp_path, joint, change(joint.columns), clock), tmp_path / "run"
    got = run([command, str(path), "--rig", "one-dof", "--output", str(output), "--json"])
    said = json.loads(capsys.readouterr().out)
    told = f"{said['message']} {said['hint']}"
    assert (got, said["code"]) == (code, word), said
    assert not [n for n in needles if n not in told], told
    assert "bad.csv" in told and "--no-check" in said["hint"] and not output.exists()
    assert run(["check", str(path), "--rig", "one-dof"]) == 3
    assert evidence_of(path, "one-dof", check=False, warn=silent).evidence.fit, (
        "--no-check takes it"
    )


@pytest.mark.skipif(
    not MEASURED.is_dir(), reason="the measured recordings are not beside the project"
)
def test_measured_recordings_are_taken_and_their_clock_is_known(tmp_path):
    (tmp_path / "tanks.py").write_text(TANKS)
    cases = {
        MEASURED / "emps" / "estimation.csv": str(ROOT / "data/rigs/emps.py"),
        MEASURED / "cascaded_tanks" / "estimation.csv": str(tmp_path / "tanks.py"),
    }
    for path, name in cases.items():
        rig, recording = rig_named(name), read_recording(path)
        assert not blocking(recording, rig), path
        slow = read_recording(written(tmp_path, recording, {}, 1e3))
        assert [i.kind for i in blocking(slow, rig)] == ["clock"], path


# ---- off by powers of ten --------------------


@pytest.fixture(scope="module")
def piston(tmp_path_factory) -> tuple[Recording, str]:
    """5 cm2 that push, and a rig that takes the 5 for square metres."""
    folder, random = tmp_path_factory.mktemp("piston"), np.random.default_rng(1)
    (folder / "piston.py").write_text(PISTON)
    pressure = np.repeat(random.uniform(1.0, 7.0, 40), 50)
    held = np.concatenate([np.full(20, pressure[0]), pressure])
    force = 5e-4 * 1e5 * np.convolve(held, np.full(3, 1 / 3))[20:-2]
    write_recording(
        folder / "rec.csv",
        0.01 * np.arange(pressure.size),
        {"pressure_bar": pressure, "force_n": force + 0.5 * random.standard_normal(force.size)},
    )
    return read_recording(folder / "rec.csv"), str(folder / "piston.py")


def position_times(factor: float, r: Recording) -> Recording:
    columns = {**r.columns, "position_m": factor * r.columns["position_m"]}
    return recording_of(r.time, columns, name="scaled", digits=15)


@pytest.mark.parametrize(
    ("factor", "named"),
    [
        (np.degrees(1.0), "0.0174533 (as between degrees and radians)"),
        (np.radians(1.0), "57.2958 (as between degrees and radians)"),
        (1.0 / 60.0, "60 (as between minutes and seconds)"),
        (1e5, "1e-05"),
    ],
)
def test_another_unit_is_named_in_both_directions(factor, named, pushed):
    rig, recording = rig_named(RIG), position_times(factor, pushed)
    (issue,) = [i for i in examine(recording, rig) if i.kind == "far-off"]
    assert "the column position_m times" in issue.hint and named in issue.hint
    assert not blocking(recording, rig)


def test_an_effect_that_hides_another_unit_is_set_aside(piston, tmp_path, capsys):
    """A dead zone that switches the input off removes most of the error, since nothing at all is
    better than a force that is ten thousand times too large."""
    recording, rig = piston
    few = ("dead-zone", "dead-time", "offset")
    without = [word for name in effects() if name not in few for word in ("--without", name)]
    words = ["--rig", rig, "--jobs", "1", "--json", "--output", str(tmp_path / "run")]
    code = run(["diagnose", str(recording.path), *words, *without])
    said = json.loads(capsys.readouterr().out)
    assert code in (0, 5) and not said["causes"]
    first = said["ranking"][0]
    assert first["effect"] == "dead-zone" and first["removes"]["share"] > 0.5
    assert "recorded inputs" in first["set_aside"][0]
    assert any("dead-zone" in note and "rejected" in note for note in said["notes"])


# ---- what may rest --------------------


def spring(folder: Path, force: Array, position: Array) -> Recording:
    write_recording(
        folder / "rec.csv", 0.01 * np.arange(force.size), {"force_n": force, "position_m": position}
    )
    return read_recording(folder / "rec.csv")


def test_only_where_nothing_can_teach_is_a_recording_refused(tmp_path):
    time, noise = 0.01 * np.arange(1200), 1e-4 * np.random.default_rng(1).standard_normal(1200)
    still, rig = np.zeros(1200), rig_named(RIG)
    rolling = spring(tmp_path, still, np.exp(-0.5 * time) * np.cos(5.0 * time) + noise)
    assert split_recordings(rig, [rolling], []).channels == ("position_m",), (
        "let go, it comes to rest"
    )
    for position in (noise, np.full(1200, 0.3), np.cos(5.0 * time) + noise):
        with pytest.raises(DataError) as refused:
            split_recordings(rig, [spring(tmp_path, still, position)], [])
        assert refused.value.code == "not-excited"
