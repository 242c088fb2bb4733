"""Answers to what people ask first: the functions of equations, the effects of a family, a table as
a recording, a rig that was forgotten, and what to do after a check."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pamid_cli.frame import run

import pamid
from pamid.base.errors import UsageError

PENDULUM = '''
from pamid.equations import sin
from pamid import Parameter, Port, Rig, State


class Pendulum(Rig):
    """A pendulum."""

    inputs = {"drive_n_m": "N m"}
    outputs = {"angle_rad": "rad"}
    ports = {"axle": Port("motion", "N m", ("position", "velocity"))}
    states = (State("angle", "rad"), State("speed", "rad/s"))
    parameters = (Parameter("inertia_kg_m2", 0.1, low=0.01, high=1.0, source="drawing"),)

    def rates(self, x, u, p, port):
        torque = port("axle", u.drive_n_m - sin(x.angle), position=x.angle, velocity=x.speed)
        return {"angle": x.speed, "speed": torque / p.inertia_kg_m2}

    def measure(self, x, u, p, port):
        return {"angle_rad": x.angle}
'''


def table() -> pd.DataFrame:
    """A pendulum that is driven."""
    drive = np.repeat(np.random.default_rng(1).uniform(-0.5, 0.5, 20), 30)
    angle, speed = np.zeros(601), 0.0
    for k, torque in enumerate(drive):
        speed += 0.01 * (torque - np.sin(angle[k])) / 0.11
        angle[k + 1] = angle[k] + 0.01 * speed
    time = 0.01 * np.arange(600)
    return pd.DataFrame({"time_s": time, "drive_n_m": drive, "angle_rad": angle[:-1]})


def test_a_rig_that_was_forgotten_is_one_error(tmp_path, capsys):
    path = tmp_path / "rec.csv"
    table().to_csv(path, index=False)
    assert run(["diagnose", str(path), "--output", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "No rig is named" in said and "--rig" in said and "pamid new-rig" in said
    assert "Warning" not in said and "command" not in said
    with warnings.catch_warnings(), pytest.raises(UsageError, match="No rig is named"):
        warnings.simplefilter("error")
        pamid.fit(table(), progress=False)


@pytest.mark.parametrize(
    ("rig", "spoil", "follow"),
    [
        (None, 1.0, "pamid new-rig"),
        ("pendulum.py", 1.0, "pamid diagnose"),
        ("pendulum.py", 0.0, "repair it, then pamid check"),
    ],
)
def test_a_check_ends_with_what_is_next(rig, spoil, follow, here, capsys):
    Path("pendulum.py").write_text(PENDULUM)
    made = table()
    if not spoil:
        made = made.drop(columns="drive_n_m")
    made.to_csv("rec.csv", index=False)
    words = ["check", "rec.csv", *(("--rig", rig) if rig else ())]
    assert run(words) == (3 if not spoil else 0)
    last = capsys.readouterr().out.rstrip().splitlines()[-1]
    assert last.startswith(f"Next: {follow}") and "rec.csv" in last
    assert ("--rig pendulum.py" in last) == (rig is not None)
