"""Undamped arms that plain MuJoCo drives about any pose, as MJCF text and as recordings.

The inertias have the sizes of common robots: a small arm of four hinges, a UR5e, a Kinova Gen3.
"""

from pathlib import Path
from typing import Any, NamedTuple

import mechanisms
import numpy as np

from pamid.base.arrays import Array
from pamid.recording.recording import Recording, read_recording

PERIOD_S, STEP_S, NOISE = 0.005, 0.001, 1e-4
STEERED_HZ, DAMPED = 2.0, 0.7  # of the loop that leads the arm along its way


class Link(NamedTuple):
    """A hinge about `axis` and its body: frame in that before (m), centre (m), mass (kg), principal
    inertia about the centre (kg m2)."""

    joint: str
    axis: str
    at: tuple[float, float, float]
    centre: tuple[float, float, float]
    mass: float
    inertia: tuple[float, float, float]


FOUR_HINGES = (
    Link("yaw", "0 0 1", (0, 0, 0.3), (0.02, 0, 0.05), 3.0, (0.01, 0.01, 0.008)),
    Link("shoulder", "0 1 0", (0, 0, 0.1), (0.17, 0, 0), 2.4, (0.004, 0.03, 0.03)),
    Link("elbow", "0 1 0", (0.35, 0, 0), (0.14, 0, 0), 1.5, (0.002, 0.014, 0.014)),
    Link("wrist", "0 1 0", (0.3, 0, 0), (0.07, 0, 0.01), 0.6, (0.001, 0.002, 0.002)),
)
# masses and lengths of the UR5e
SIX_HINGES = (
    Link("pan", "0 0 1", (0, 0, 0.163), (0, 0.02, 0), 3.761, (0.0067, 0.0067, 0.0067)),
    Link("lift", "0 1 0", (0, 0.138, 0), (0.02, 0, 0.213), 8.058, (0.133, 0.133, 0.0149)),
    Link("elbow", "0 1 0", (0, -0.131, 0.425), (0, 0.01, 0.242), 2.846, (0.031, 0.031, 0.0042)),
    Link("wrist_1", "0 1 0", (0, 0, 0.392), (0.01, 0.127, 0), 1.37, (0.0026, 0.0026, 0.0021)),
    Link("wrist_2", "0 0 1", (0, 0.127, 0), (0, 0.01, 0.1), 1.3, (0.0026, 0.0026, 0.0021)),
    Link("wrist_3", "0 1 0", (0, 0, 0.1), (0.03, 0.07, 0), 0.365, (0.0004, 0.0004, 0.0003)),
)
# masses and lengths of the Kinova Gen3
SEVEN_HINGES = (
    Link("joint_1", "0 0 1", (0, 0, 0.156), (0, 0.01, 0.073), 1.3773, (0.0049, 0.0046, 0.0014)),
    Link("joint_2", "0 1 0", (0, 0, 0.128), (0, 0.013, 0.1), 1.1636, (0.0113, 0.0111, 0.001)),
    Link("joint_3", "0 0 1", (0, 0, 0.21), (0, 0.007, 0.118), 1.1636, (0.0112, 0.0109, 0.001)),
    Link("joint_4", "0 1 0", (0, 0, 0.21), (0, 0.015, 0.075), 0.9302, (0.0083, 0.0081, 0.0006)),
    Link("joint_5", "0 0 1", (0, 0, 0.208), (0, 0.009, 0.064), 0.6781, (0.0017, 0.0016, 0.0004)),
    Link("joint_6", "0 1 0", (0, 0, 0.106), (0, 0.01, 0.046), 0.6781, (0.0017, 0.0016, 0.0004)),
    Link("joint_7", "0 0 1", (0, 0, 0.106), (0.01, 0, 0.03), 0.364, (0.0002, 0.0002, 0.0002)),
)


def arm_text(links: tuple[Link, ...], factors: Array | None = None) -> str:
    """MJCF of an arm; factors: of masses and inertias, (links,)."""
    lines = ['<mujoco model="arm">', '<compiler angle="radian"/>']
    lines += [f'<option timestep="{STEP_S:g}" integrator="RK4"/>', "<worldbody>"]
    for k, link in enumerate(links):
        factor = 1.0 if factors is None else float(factors[k])
        inertia = " ".join(f"{factor * v:.9g}" for v in link.inertia)
        lines += [
            f'<body name="{link.joint}_link" pos="{" ".join(map(str, link.at))}">',
            f'<joint name="{link.joint}" axis="{link.axis}"/>',
            f'<inertial pos="{" ".join(map(str, link.centre))}" mass="{factor * link.mass:.9g}" '
            f'diaginertia="{inertia}"/>',
        ]
    lines += ["</body>" * len(links), "</worldbody>", "<actuator>"]
    lines += [f'<motor name="{k.joint}_motor" joint="{k.joint}"/>' for k in links]
    lines += ["</actuator>", "<sensor>"]
    lines += [f'<jointpos name="{k.joint}_angle" joint="{k.joint}"/>' for k in links]
    return "\n".join([*lines, "</sensor>", "</mujoco>"]) + "\n"


def record_about(
    links: tuple[Link, ...],
    pose: Array,
    seconds: float,
    seed: int,
    file: Path,
    swing: float = 0.6,
    text: str = "",
) -> Recording:
    """The recording of an arm that a controller leads about a pose (rad) on sums of sines of up to
    `swing` rad: torques as sent, angles with noise. text: of the machine's MJCF where it is not the
    plain arm."""
    mujoco: Any = mechanisms.needs_mujoco()
    model = mujoco.MjModel.from_xml_string(text or arm_text(links))
    data, random, n = mujoco.MjData(model), np.random.default_rng(seed), len(links)
    w = 2.0 * np.pi * random.uniform(0.2, 1.0, (n, 3))
    phase = random.uniform(0.0, 2.0 * np.pi, (n, 3))
    size = swing / 3.0 * random.uniform(0.5, 1.0, (n, 3))
    stiff = 2.0 * np.pi * STEERED_HZ
    data.qpos[:] = pose
    time = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    torques, angles, torque = [], [], np.zeros(n)
    for t in time:
        mujoco.mj_forward(model, data)
        way = pose + (size * (np.sin(w * t + phase) - np.sin(phase))).sum(axis=1)
        rate = (size * w * np.cos(w * t + phase)).sum(axis=1)
        pulled = stiff**2 * (way - data.qpos) + 2.0 * DAMPED * stiff * (rate - data.qvel)
        mujoco.mj_mulM(model, data, torque, pulled)
        data.ctrl[:] = torque + data.qfrc_bias
        torques.append(data.ctrl.copy())
        angles.append(data.qpos.copy())
        mujoco.mj_step(model, data, round(PERIOD_S / STEP_S))
    read = np.array(angles) + NOISE * random.standard_normal((len(time), n))
    names = ["time_s", *(f"{k.joint}_motor_command" for k in links)]
    names += [f"{k.joint}_angle_rad" for k in links]
    table = np.column_stack([time, np.array(torques), read])
    np.savetxt(file, table, "%.9g", ",", header=",".join(names), comments="")
    return read_recording(file)
