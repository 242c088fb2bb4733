"""A swinging body: its equation sees mass, centre and inertia only together."""

from pathlib import Path

import numpy as np

from pamid.engine.symbolic.vocabulary import sin
from pamid.model.assembly import Assembly
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.free_runs import virtual_recording

TRUTH = {"mass_kg": 0.8, "centre_m": 0.11, "inertia_kg_m2": 0.009, "viscous_n_m_s": 0.004}


class Pendulum(Rig):
    """Angle from hanging straight down; a motor may turn it."""

    inputs = {"torque_nm": "N m"}
    optional = {"torque_nm": 0.0}
    outputs = {"angle_deg": "rad"}
    ports = {
        "joint": Port("motion", "N m", ("velocity", "position")),
        "encoder": Port("reading", "rad"),
    }
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter("mass", 0.7, 0.05, 5.0, "kg", spread=1.3, log=True, source="test"),
        Parameter("centre", 0.13, 0.01, 1.0, "m", spread=1.3, log=True, source="test"),
        Parameter("inertia", 0.0075, 1e-4, 0.1, "kg m2", spread=1.3, log=True, source="test"),
        Parameter("viscous", 0.005, 1e-4, 0.1, "N m s", spread=2.0, log=True, source="test"),
        Parameter("initial_angle", 0.0, -180.0, 180.0, "deg", fitted=False, source="test"),
    )
    noise = {"angle_deg": 0.05}
    period_s = 0.01
    # windows of one length, however many swings are fitted together: what they tell is compared
    timescale_s = 0.6

    def start(self, p):
        return {"angle": p.initial_angle}

    def rates(self, x, u, p, port):
        torque = u.torque_nm - p.viscous * x.velocity - 9.81 * p.mass * p.centre * sin(x.angle)
        torque = port("joint", torque, velocity=x.velocity, position=x.angle)
        return {
            "angle": x.velocity,
            "velocity": torque / (p.inertia + p.mass * p.centre * p.centre),
        }

    def measure(self, x, u, p, port):
        return {"angle_deg": port("encoder", x.angle)}


class Declared(Pendulum):
    """The same, telling what its equation sees."""

    name = "pendulum"

    def combinations(self, p):
        return {
            "first_moment_kg_m": p.mass * p.centre,
            "inertia_about_joint_kg_m2": p.inertia + p.mass * p.centre * p.centre,
        }


def swing(
    path: Path,
    *,
    torque: bool,
    seed: int = 0,
    seconds: float = 12.0,
    initial_deg: float = 60.0,
    **truth: float,
) -> Recording:
    """A recording at `path`, let go from initial_deg; torque: a known one acts, in steps."""
    n = round(seconds / Pendulum.period_s)
    time = np.arange(n) * Pendulum.period_s
    random = np.random.default_rng(seed)
    columns = (
        {"torque_nm": np.repeat(random.uniform(-0.5, 0.5, n // 30 + 1), 30)[:n]} if torque else {}
    )
    known = {"initial_angle_deg": initial_deg}
    meta = {"recording": {"rig": "pendulum", "loop": "open"}, "known": known}
    write_recording(path, time, columns or {"idle": np.zeros(n)}, meta)
    a = Assembly(Pendulum())
    made = virtual_recording(
        a, read_recording(path), a.values({**TRUTH, **truth, **known}), seed=seed
    )
    write_recording(
        path, time, {**columns, **{k: v for k, v in made.items() if k in Pendulum.outputs}}, meta
    )
    return read_recording(path)
