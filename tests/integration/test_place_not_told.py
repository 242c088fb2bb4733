"""An effect that would do the same at another port: the answer names both places."""

import numpy as np
import pytest

import pamid
from pamid.model.registry import effects
from pamid.recording.recording import read_recording, write_recording
from pamid.report.answers import answers_of
from pamid.report.channel_errors import errors_of
from pamid.report.load import RunData, load_run
from pamid.simulation.virtual_rig import simulate_virtual_rig

RIG = '''
from pamid import Parameter, Port, Rig, State


class Sledge(Rig):
    """A sledge whose drive is told a force."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "drive": Port("command", "N"),
        "rail": Port("motion", "N", signals=("velocity", "position")),
        "ruler": Port("reading", "m"),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass_kg", 1.0, low=0.1, high=10.0, source="kitchen scale"),
        Parameter("damping", 0.8, 0.01, 20.0, "N s/m", spread=2.0, log=True, source="estimate"),
    )

    def rates(self, x, u, p, port):
        force = port("drive", u.force_n) - p.damping * x.velocity
        force = port("rail", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):
        return {"position_m": port("ruler", x.position)}
'''
ASKED = ("offset", "constant-offset", "cubic-drag", "dead-zone")


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> RunData:
    """Of a sledge that is pulled to one side: nothing tells a command that is off from a force."""
    folder, random = tmp_path_factory.mktemp("sledge"), np.random.default_rng(3)
    rig = folder / "sledge.py"
    rig.write_text(RIG)
    push = np.repeat(random.uniform(-6.0, 6.0, 60), 60)
    time = 0.01 * np.arange(len(push))
    write_recording(folder / "sent.csv", time, {"force_n": push})
    made = simulate_virtual_rig(
        str(rig),
        read_recording(folder / "sent.csv"),
        ("constant-offset:force_n=1.5",),
        {},
        {"mass_kg": 1.1},
        1.0,
        1,
    )
    read = made.columns["position_m"] + 1e-3 * random.standard_normal(len(time))
    write_recording(folder / "rec.csv", time, made.columns | {"position_m": read}, made.meta)
    pamid.diagnose(
        folder / "rec.csv",
        rig=str(rig),
        without=[name for name in effects() if name not in ASKED],
        jobs=1,
        output=folder / "run",
    )
    return load_run(folder / "run")


def test_both_places_are_named(found):
    assert found.diagnosis is not None
    (cause,) = found.diagnosis.causes
    assert cause.family == "offset"
    assert {cause.port, *cause.or_at} == {"drive", "rail"}
    assert f" (or equally at the {cause.or_at[0]} port) removes" in found.diagnosis.sentence
    assert "these recordings cannot separate them" in answers_of(found, errors_of(found))[0].lead
