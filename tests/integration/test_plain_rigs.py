"""Rigs without states, and without parameters: they are checked, simulated, fitted, diagnosed and
exported as any other."""

import json
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

import pamid
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.equations import rate_of
from pamid.model.assembly import Assembly
from pamid.recording.recording import read_recording


class StaticMap(pamid.Rig):
    """Twice the voltage: no states, no parameters."""

    inputs = {"drive_v": "V"}
    outputs = {"force_n": "N"}
    ports = {"drive": pamid.Port("command", "V"), "cell": pamid.Port("reading", "N")}
    noise = {"force_n": 0.02}
    period_s = 0.01
    excited = {"drive_v": 2.0}

    def measure(self, x, u, p, port):
        return {"force_n": port("cell", 2.0 * port("drive", u.drive_v))}


class Follower(pamid.Rig):
    """States, but no parameters."""

    inputs = {"drive_v": "V"}
    outputs = {"speed_m_per_s": "m/s"}
    ports = {
        "drive": pamid.Port("command", "V"),
        "push": pamid.Port("motion", "N", {"velocity": "m/s"}),
    }
    states = (pamid.State("speed", "m/s"),)
    noise = {"speed_m_per_s": 0.01}
    period_s = 0.01
    excited = {"drive_v": 2.0}

    def rates(self, x, u, p, port):
        push = 10.0 * (port("drive", u.drive_v) - x.speed)
        return {"speed": port("push", push, velocity=x.speed)}

    def measure(self, x, u, p, port):
        return {"speed_m_per_s": x.speed}


class Imposed(pamid.Rig):
    """The velocity of an imposed position."""

    inputs = {"position_mm": "m"}
    outputs = {"velocity_m_per_s": "m/s"}
    ports = {"reading": pamid.Port("reading", "m/s")}

    def measure(self, x, u, p, port):
        return {"velocity_m_per_s": port("reading", rate_of(u.position_mm))}


@pytest.mark.parametrize("substeps", [1, 2, 5])
def test_rate_of_is_the_difference_of_samples(substeps):
    assembly = Assembly(Imposed())
    u = np.cumsum(np.random.default_rng(0).normal(size=(50, 1)), axis=0)
    step = Stepping(substeps)
    memory = assembly.program.memory(np.zeros(0), stepping=step, period_s=0.1)
    first = assembly.program.run(memory, SampledInputs(u[:20], 0.1), np.zeros(0), stepping=step)[0]
    memory.join = True  # a window that is entered: what is recorded goes on as it is
    then = assembly.program.run(memory, SampledInputs(u[20:], 0.1), np.zeros(0), stepping=step)[0]
    expected = np.diff(u[:, 0], prepend=u[0, 0]) / 0.1
    np.testing.assert_allclose(np.concatenate([first, then])[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("rig", "effect"), [(StaticMap, "offset@cell"), (Follower, "saturation")], ids=["map", "lag"]
)
def test_without_parameters(rig, effect, here):
    assert pamid.check(rig).ok
    u = pamid.aprbs(20.0, 0.01, 2.0, seed=1)
    pamid.write_recording("u.csv", 0.01 * np.arange(len(u)), {"drive_v": u})
    made = pamid.simulate("u.csv", rig, effects=(effect,), seed=2)
    fitted = pamid.fit(made, rig, output="fit")
    assert fitted.converged and not json.loads(Path("fit/fit.json").read_text())["parameters"]
    found = pamid.diagnose(made, rig, output="run")
    family = {"offset@cell": "sensor-offset", "saturation": "saturation"}[effect]
    assert found.verdict in ("explained", "ambiguous")
    assert found.to_dict()["causes"][0]["family"] == family
    pamid.report(found)


def test_a_force_bench_is_diagnosed_and_exported(here, capsys):
    for words in (
        ("generate-aprbs", "--rig", "cylinder-bench", "--duration", "60", "--output", "u.csv"),
        (
            *("simulate", "--rig", "cylinder-bench", "--excitation", "u.csv", "--seed", "1"),
            *("--effect", "coulomb-friction:force_n=8,give_m=2e-5", "--output", "rec.csv"),
        ),
        ("diagnose", "rec.csv", "--rig", "cylinder-bench", "--jobs", "1", "--output", "run"),
        ("export", "run", "--to", "c", "--output", "c"),
        ("simulate", "--model", "run", "--excitation", "u.csv", "--output", "model.csv"),
    ):
        assert frame.run(list(words)) == 0, capsys.readouterr()
    found = json.loads(Path("run/diagnosis.json").read_text())
    assert [c["family"] for c in found["causes"]] == ["friction"]
    level = found["causes"][0]["parameters"]["force_n"]
    assert level["low"] - 0.1 < 8.0 < level["high"] + 0.1
    there = [read_recording(name).columns["force_n"] for name in ("rec.csv", "model.csv")]
    assert float(np.sqrt(np.mean((there[0] - there[1]) ** 2))) < 2.0
