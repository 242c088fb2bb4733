"""What a diagnosis of a MuJoCo model costs: 60 s of one joint as equations and stepped by MuJoCo
(a wall that the joint never reaches keeps it from becoming equations), and of an arm of seven
joints as equations; each with dry friction that the model lacks and masses 10 to 20 % off, with an
empty cache of compiled models. And of 6 s of gymnasium's hopper, on the floor for most of them,
with dry friction at the thigh and all else as it is. CPU seconds, of the processes together, and
seconds waited.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/mujoco_diagnoses.py \
        [one stepped seven hopper] [--jobs 2]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mujoco_truth import Planted, arm, misjudged, model_text, record

from pamid.simulation.excitation.aprbs import aprbs

SECONDS, SEED = 60.0, 5
CASES = {"one": (1, 0), "stepped": (1, 0), "seven": (7, 3)}  # joints, and the one that rubs
PAMID = Path(sys.executable).with_name("pamid")
HOPPER_SECONDS, HOPPER_PERIOD_S, HOPPER_FRICTION = 6.0, 0.008, 6.0  # N m
WALL = '<geom type="box" pos="{x} 0 0" size="0.01 0.2 1" contype="1" conaffinity="1"/>'
TIP = '<geom type="sphere" pos="0 0 {z}" size="0.01" mass="0" contype="1" conaffinity="1"/>'


def write_case(folder: Path, name: str) -> str:
    """model.xml and rec.csv; the joint that rubs."""
    joints, at = CASES[name]
    random = np.random.default_rng(SEED)
    machine = arm(joints, random)
    while not machine.links[0].kp:  # a servo stays where it is sent
        machine = arm(joints, random)
    link = machine.links[at]
    rubbing = (Planted("frictionloss", link.joint, 0.03 * link.limit),)
    columns, _ = record(machine, rubbing, SECONDS, SEED)
    text = model_text(misjudged(machine, random))
    if name == "stepped":
        tip, wall = TIP.format(z=-link.length), WALL.format(x=0.9 * link.length + 0.02)
        text = text.replace("<inertial", f"{tip}<inertial", 1)
        text = text.replace("<worldbody>", f"<worldbody>{wall}", 1)
    (folder / "model.xml").write_text(text)
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(folder / "rec.csv", table, "%.9g", ",", header=header, comments="")
    return link.joint


def write_hopper(folder: Path) -> str:
    """model.xml and rec.csv of the hopper, its joints read by encoders; the joint that rubs."""
    import gymnasium
    import mujoco

    assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    text = (assets / "hopper.xml").read_text()
    joints = ("rootx", "rootz", "rooty", "thigh_joint", "leg_joint", "foot_joint")
    read = "".join(f'<jointpos name="{j}_pos" joint="{j}"/>' for j in joints)
    text = text.replace("</mujoco>", f"<sensor>{read}</sensor></mujoco>")
    for j in joints[3:]:
        text = text.replace(
            f'gear="200.0" joint="{j}"', f'gear="200.0" joint="{j}" name="{j}_motor"'
        )
    (folder / "model.xml").write_text(text)
    planted = mujoco.MjModel.from_xml_string(text)
    planted.dof_frictionloss[planted.joint("thigh_joint").dofadr[0]] = HOPPER_FRICTION
    data, every = mujoco.MjData(planted), round(HOPPER_PERIOD_S / planted.opt.timestep)
    count = round(HOPPER_SECONDS / HOPPER_PERIOD_S)
    sent = np.stack(
        [aprbs(HOPPER_SECONDS, HOPPER_PERIOD_S, 0.15, (0.2, 0.8), seed=3 + i) for i in range(3)], 1
    )[:count]
    columns, step = np.empty((count, 6)), 2.0 * np.pi / 2**14
    for k in range(count):
        columns[k] = data.qpos
        data.ctrl[:] = sent[k]
        mujoco.mj_step(planted, data, every)
    table = np.column_stack(
        [HOPPER_PERIOD_S * np.arange(count), sent, step * np.round(columns / step)]
    )
    units = ("m", "m", "rad", "rad", "rad", "rad")
    header = ",".join(
        [
            "time_s",
            *(f"{j}_motor_command" for j in joints[3:]),
            *(f"{j}_pos_{u}" for j, u in zip(joints, units, strict=True)),
        ]
    )
    np.savetxt(folder / "rec.csv", table, "%.9g", ",", header=header, comments="")
    return "thigh_joint"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", default=[*CASES, "hopper"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    for name in options.cases:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            joint = write_hopper(folder) if name == "hopper" else write_case(folder, name)
            before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
            words = ["diagnose", "rec.csv", "--rig", "model.xml", "--output", "run", "--jobs"]
            done = subprocess.run(
                [PAMID, *words, str(options.jobs)],
                cwd=folder,
                env={**os.environ, "PAMID_CACHE": str(folder / "cache")},
                capture_output=True,
                text=True,
                check=False,
            )
            after, waited = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - begun
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            said = done.stderr[-300:]
            if done.returncode == 0:
                said = json.loads((folder / "run/diagnosis.json").read_text())["sentence"]
            print(f"{name}, friction at {joint}: {spent:.0f} s CPU, {waited:.0f} s: {said}")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
