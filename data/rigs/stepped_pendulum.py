"""A cart with a pendulum, as somebody's simulation steps it: the smallest whole rig without
equations.

Copy it to begin one of your own: `step` may call any simulator that can be set to given states.
"""

from math import cos, sin

from pamid import Parameter, Port, State, StepRig

GRAVITY = 9.81  # m/s2


class SteppedPendulum(StepRig):
    """A pendulum on a driven cart."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m", "angle_rad": "rad"}
    ports = {
        "rail": Port("motion", "N", ("position", "velocity")),
        "hinge": Port("motion", "N m", ("position", "velocity"), size={"value": 0.5}),
        "ruler": Port("reading", "m"),
        "encoder": Port("reading", "rad"),
    }
    states = (
        State("position", "m"),
        State("velocity", "m/s"),
        State("angle", "rad"),
        State("turning", "rad/s"),
    )
    parameters = (
        Parameter("cart_kg", 1.0, 0.3, 3.0, source="scale"),
        Parameter("bob_kg", 0.2, 0.05, 0.8, source="scale"),
        Parameter("rod_m", 0.4, 0.2, 0.8, source="ruler"),
        Parameter("rail_n_s_per_m", 2.0, 0.2, 20.0, source="guess"),
        Parameter("hinge_n_m_s", 0.01, 0.001, 0.1, source="guess"),
    )
    noise = {"position_m": 2e-4, "angle_rad": 1e-3}
    excited = {"force_n": 6.0}
    period_s = 0.01

    def drive(self, x, u, p, port):
        rail = port("rail", u.force_n, position=x.position, velocity=x.velocity)
        hinge = port("hinge", 0.0, position=x.angle, velocity=x.turning)
        return {"rail": rail, "hinge": hinge}

    def step(self, x, f, p, h):
        state = [x.position, x.velocity, x.angle, x.turning]
        for part in (h / 2, h / 2):  # twice the midpoint rule
            half = [a + part / 2 * b for a, b in zip(state, slopes(state, f, p), strict=True)]
            state = [a + part * b for a, b in zip(state, slopes(half, f, p), strict=True)]
        return state

    def measure(self, x, u, p, port):
        return {
            "position_m": port("ruler", x.position),
            "angle_rad": port("encoder", x.angle),
        }


def slopes(state, f, p):
    """Rates of the four states, hanging down at an angle of 0."""
    _, velocity, angle, turning = state
    moment = p.bob_kg * p.rod_m
    rail = f.rail - p.rail_n_s_per_m * velocity + moment * turning**2 * sin(angle)
    hinge = f.hinge - p.hinge_n_m_s * turning - moment * GRAVITY * sin(angle)
    both, inertia, link = p.cart_kg + p.bob_kg, moment * p.rod_m, moment * cos(angle)
    free = both * inertia - link**2
    return (
        velocity,
        (inertia * rail - link * hinge) / free,
        turning,
        (both * hinge - link * rail) / free,
    )
