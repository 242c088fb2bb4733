"""A servo with a built-in controller: it is sent a goal and turns there.

What it is
    A hobby or smart servo, the positioner of a valve, the actuator of a fin: a goal in, an angle
    out. Its controller is not accessible; from outside its speed is in proportion to the distance
    left, and follows with a lag.

Equations
    wanted   ws = gain (goal - angle - offset)
    speed    lag dw/dt = ws - w, w the speed of the shaft

Typically missing
    A limited speed (`saturation` at speed, in rad/s); a dead band around the goal (`dead-zone` at
    speed); dead time of the bus (bus); play of the gear and steps of the potentiometer (encoder);
    friction, and a load that pulls (shaft, in rad/s2).

References
    Wada, Ishikawa, Kitayoshi, Maruta, Sugie (2009), Practical modeling and system identification of
    R/C servo motors, IEEE Int. Conf. Control Applications; Stevens, Lewis, Johnson (2015), Aircraft
    Control and Simulation, Wiley: actuators with a rate limit.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class Servo(Rig):
    """A servo with a built-in controller: goal in, angle out."""

    inputs = {"goal_deg": "rad"}
    outputs = {"angle_deg": "rad"}
    ports = {
        "bus": Port("command", "rad"),
        "speed": Port("command", "rad/s"),
        "shaft": Port(
            "motion", "rad/s2", {"position": "rad", "velocity": "rad/s", "load": "rad/s2"}
        ),
        "encoder": Port("reading", "rad", {"rate": "rad/s"}),
    }
    background = {"speed": RoughMap("speed_map", tolerance=0.02)}
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter.positive("gain", 12.0, 0.1, 50.0, "1/s", factor=1.5).with_source(
            "estimate: 1/settling time"
        ),
        Parameter.positive("lag", 0.03, 0.005, 2.0, "s", factor=1.5).with_source("estimate: rotor"),
        Parameter("offset_deg", 0.0, -20.0, 20.0, spread=1.0).with_source(
            "estimate: the horn's tooth"
        ),
    )
    noise = {"angle_deg": 0.1}
    period_s = 0.01
    excited = {"goal_deg": 45.0}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        left = port("bus", u.goal_deg) - x.angle - p.offset_deg
        speed = port("speed", p.gain * left)
        pace = (speed - x.velocity) / p.lag
        pace = port("shaft", pace, position=x.angle, velocity=x.velocity, load=speed / p.lag)
        return {"angle": x.velocity, "velocity": pace}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"angle_deg": port("encoder", x.angle, rate=x.velocity)}
