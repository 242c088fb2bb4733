"""The cases with stock robots, on a robot of this test: what is planted is there, nothing gives it
away, and answers are scored as the table in the benchmark has it."""

import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scripts import load_script

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

ROBOT = """<mujoco model="small">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <geom name="base" type="sphere" size="0.05" pos="0 0 0.5"/>
    <body name="upper" pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>
      <geom name="hub" type="sphere" size="0.04" mass="0.1"/>
      <geom type="capsule" fromto="0 0 -0.1 0 0 -0.3" size="0.02" mass="1"/>
      <body name="fore" pos="0 0 -0.35">
        <joint name="elbow" axis="0 1 0" range="-2 2" damping="0.1"/>
        <geom type="capsule" fromto="0 0 -0.08 0 0 -0.25" size="0.02" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive_1" joint="shoulder" ctrlrange="-20 20"/>
    <motor name="drive_2" joint="elbow" ctrlrange="-8 8"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def cases() -> ModuleType:
    return load_script("stock_cases.py")


@pytest.fixture
def small(cases, tmp_path, monkeypatch) -> Path:
    """The folder of stock models, with one."""
    folder = tmp_path / "stock" / "small"
    folder.mkdir(parents=True)
    (folder / "robot.xml").write_text(ROBOT)
    monkeypatch.setattr(cases, "MODELS", {"small": "small/robot.xml"})
    return tmp_path / "stock"


def made(cases: ModuleType, models: Path, output: Path, *effects: tuple[str, int], **more: Any):
    """Folder and label of a case."""
    case = cases.Case(3, "small", False, effects, True, 0.005, 3.0, True)
    case = replace(case, **more)
    file = cases.model_copy(case, models, output)
    cases.make_case(case, file, output, 1)
    return output / "cases" / "003", json.loads((output / "labels" / "003.json").read_text())


def angles(folder: Path) -> np.ndarray:
    with (folder / "rec.csv").open() as log:
        names = log.readline().strip().split(",")
    rows = np.loadtxt(folder / "rec.csv", delimiter=",", skiprows=1)
    return rows[:, [k for k, name in enumerate(names) if name.endswith("position_rad")]]


@pytest.mark.parametrize("kind", ["friction", "delay", "play", "armature", "payload"])
@pytest.mark.parametrize("servo", [False, True])
def test_what_is_planted_shows(cases, small, tmp_path, kind, servo):
    bare, _ = made(cases, small, tmp_path / "bare", servo=servo)
    folder, label = made(cases, small, tmp_path / "made", (kind, 1), servo=servo)
    assert {p["joint"] for p in label["planted"]} == {"elbow"}
    error = np.abs(angles(folder) - angles(bare)).max(axis=0)
    assert error[1] > 0.0015
    assert (np.abs(angles(folder)) < 2.0).all()


def test_a_case_gives_nothing_away(cases, small, tmp_path):
    folder, label = made(cases, small, tmp_path, ("kp", 0), ("friction-all", -1), servo=True)
    assert {p.name for p in folder.iterdir()} == {"rec.csv", "held.csv"}
    text = (tmp_path / "models/small/robot-003.xml").read_text()
    assert "frictionloss" not in text and text.count("<position") == 2
    planted = {p["joint"]: p["size"] for p in label["planted"] if p["kind"] == "kp"}
    stated = float(text.partition('joint="shoulder" kp="')[2].partition('"')[0])
    assert label["parameters"]["drive_1_kp"] == pytest.approx(planted["shoulder"] * stated)


def test_half_of_the_planted_cases_have_two_effects(cases):
    drawn = cases.all_cases(5, 60, 20)
    sizes = [len(case.effects) for case in drawn]
    assert [sizes.count(k) for k in (0, 1, 2)] == [20, 30, 30]
    assert len({case.model for case in drawn}) >= 10
    # a stretch is a fair share of all
    assert 2 <= sizes[:20].count(0) <= 8


def cause(family: str, port: str, *instead: str) -> dict[str, Any]:
    return {"family": family, "port": port, "instead": list(instead), "effect": family}


RUBS = cause("friction", "elbow")
LATE = cause("command-timing", "drive_2_command")
ROUGH = cause("friction", "shoulder")
SOFT = cause("flexible-transmission", "elbow_transmission")


@pytest.mark.parametrize(
    ("kinds", "causes", "verdict", "reached", "expected"),
    [
        ((), (), "no-structural-gap", True, "right"),
        ((), (RUBS,), "explained", True, "wrong"),
        (("friction",), (RUBS,), "explained", True, "right"),
        (("friction",), (ROUGH,), "explained", True, "wrong"),
        (("friction",), (RUBS, ROUGH), "explained", True, "wrong"),
        (("friction",), (), "unknown-effect", True, "open"),
        (("friction",), (RUBS, LATE), "ambiguous", True, "in a set"),
        (("friction",), (RUBS, LATE, SOFT), "ambiguous", True, "open"),
        (("friction",), (LATE, SOFT), "ambiguous", True, "wrong"),
        (("friction",), (cause("command-timing", "elbow", "friction"),), "explained", True,
         "in a set"),
        (("delay",), (LATE,), "explained", True, "right"),
        (("play",), (SOFT,), "explained", True, "right"),
        (("armature",), (), "no-structural-gap", True, "right"),
        (("armature",), (), "no-structural-gap", False, "open"),
        (("armature",), (RUBS,), "explained", True, "wrong"),
        (("friction", "armature"), (RUBS,), "explained", False, "lesser"),
        (("friction", "delay"), (RUBS, LATE), "explained", True, "right"),
        (("friction", "delay"), (RUBS,), "explained", True, "lesser"),
        (("friction-all",), (RUBS,), "explained", True, "right"),
        (("friction-all",), (RUBS, ROUGH), "explained", True, "right"),
    ],
)  # fmt: skip
def test_answers_are_scored(cases, kinds, causes, verdict, reached, expected):
    effects = [
        {"kind": kind, "joints": ["shoulder", "elbow"] if kind == "friction-all" else ["elbow"]}
        for kind in kinds
    ]
    has = {"elbow_armature": 1.0} if "armature" in kinds else {}
    drives = {"shoulder": "drive_1", "elbow": "drive_2"}
    label = {"effects": effects, "parameters": has, "drives": drives, "planted": []}
    answer = {"verdict": verdict, "causes": list(causes), "parameters": {}}
    assert cases.outcome(answer, label, reached) == expected


@pytest.mark.parametrize(
    ("prior", "value", "expected"),
    [
        (1.0, 2.3, "right"),  # 1 + 1.5 is true
        (1.0, 1.5, "open"),
        (8.0, 9.4, "open"),  # the file was near already
    ],
)
def test_friction_that_a_file_has_is_refitted(cases, prior, value, expected):
    label = {
        "effects": [{"kind": "friction", "joints": ["elbow"]}],
        "parameters": {},
        "drives": {"elbow": "drive_2"},
        "planted": [{"kind": "frictionloss", "joint": "elbow", "size": 1.5}],
    }
    estimate = {"value": value, "low": value, "high": value, "prior": prior}
    answer = {
        "verdict": "no-structural-gap",
        "causes": [],
        "parameters": {"elbow_frictionloss_n_m": estimate},
    }
    assert cases.outcome(answer, label, True) == expected


@pytest.mark.parametrize(
    ("value", "low", "high", "expected"),
    [
        (1.1, 1.05, 1.15, True),
        (1.5, 1.4, 1.6, False),
        (1.5, 0.9, 2.0, True),
        (0.0, None, None, False),
    ],
)
def test_a_parameter_near_its_true_value_is_right(cases, value, low, high, expected):
    estimates = {"elbow_armature_kg_m2": {"value": value, "low": low, "high": high}}
    assert cases.near(estimates, "elbow_armature", 1.0) == expected
    assert not cases.near(estimates, "shoulder_armature", 1.0)
