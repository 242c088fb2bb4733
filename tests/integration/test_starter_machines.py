"""The starter rigs are their machines: recordings of plain equations, each with a known fault, that
share nothing with a rig's file. Among its look-alikes the fault is named, and its size is right.

`python benchmarks/starter_rigs.py` asks for it among the whole catalogue.
"""

import numpy as np
import pytest
from scripts import load_script

import pamid
from pamid.model.registry import effects

SCRIPT = load_script("starter_rigs.py")
MACHINES = SCRIPT.MACHINES

#: machine -> a parameter of the cause (SI) with its planted value, and how far off it may be; the
#: dead zone of the thruster may stand before the gain or behind it
SIZES = {
    "geared-motor-play": ({"half_gap_rad": np.deg2rad(1.0)}, 0.05),
    "geared-motor-friction": ({"torque_n_m": 0.4}, 0.05),
    "static-map": ({"half_width_v": 0.9, "half_width_n": 0.9 * 5.4}, 0.1),
    "free-decay": ({"torque_n_m": 0.012}, 0.05),
    "thermal-two-mass": ({"power": 2.5}, 0.3),
    "servo": ({"limit_rad_per_s": 3.2}, 0.02),
    "pump-tank": ({"level_m": 0.12}, 0.03),
}
#: share of the benchmark's recording that is enough here
SHARE = {"geared-motor-play": 0.4, "geared-motor-friction": 0.4, "servo": 0.5}

LONG = ("geared-motor-friction", "geared-motor-play", "thermal-two-mass", "servo")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in SIZES],
)
def test_the_fault_of_the_machine_is_named(name, tmp_path):
    machine = MACHINES[name]
    SCRIPT.recorded(name, tmp_path / "rec.csv", share=SHARE.get(name, 1.0))
    catalogue = effects()
    rivals = {machine.planted, *catalogue[machine.planted].look_alikes}
    found = pamid.diagnose(
        tmp_path / "rec.csv",
        machine.rig,
        without=catalogue.keys() - rivals,
        jobs=1,
        output=tmp_path / "run",
    )
    assert found.verdict in ("explained", "partly-explained", "ambiguous")
    cause = found.to_dict()["causes"][0]
    assert cause["effect"].partition("@")[0] == machine.planted
    planted, off = SIZES[name]
    (key,) = planted.keys() & cause["parameters"].keys()
    assert cause["parameters"][key]["value"] == pytest.approx(planted[key], rel=off)
