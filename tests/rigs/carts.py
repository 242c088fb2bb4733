"""Two carts side by side, each pushed along a guide by its own drive; nothing couples them."""

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

BOTH = ("1", "2")


class Carts(Rig):
    """Force to position, twice, with a port of every mechanical kind."""

    inputs = {"force_1_n": "N", "force_2_n": "N"}
    outputs = {"position_1_m": "m", "position_2_m": "m"}
    ports = {
        "amplifier": Port("command", "N", (), BOTH, size={"value": 20.0}),
        "drive": Port(
            "actuator-force",
            "N",
            ("position", "velocity"),
            BOTH,
            size={"value": 20.0, "position": 0.3, "velocity": 1.0},
        ),
        "guide": Port(
            "motion",
            "N",
            ("position", "velocity", "load"),
            BOTH,
            size={"value": 20.0, "position": 0.3, "velocity": 1.0, "load": 20.0},
        ),
        "cord": Port(
            "transmission", "N", {"stretch": "m"}, BOTH, size={"value": 10.0, "stretch": 0.3}
        ),
        "mast": Port(
            "transmission", "N", {"inertia": "kg"}, BOTH, size={"value": 20.0, "position": 0.3}
        ),
        "ruler": Port("reading", "m", (), BOTH, size={"value": 0.3}),
    }
    states = tuple(
        State(f"{name}_{i}", unit)
        for i in BOTH
        for name, unit in (("position", "m"), ("velocity", "m/s"))
    )
    parameters = (
        Parameter("mass", 2.0, 0.1, 20.0, "kg", source="kitchen scale"),
        Parameter("viscous", 4.0, 0.0, 50.0, "N s/m", source="run-out"),
        Parameter(
            "stiffness", 40.0, 0.0, 500.0, "N/m", source="rubber cord that keeps the cart in range"
        ),
        Parameter("offset", 0.0, -5.0, 5.0, "N", source="guide not quite level"),
    )
    period_s = 0.002

    def rates(self, x, u, p, port):
        out: dict[str, Number] = {}
        for i in BOTH:
            position, velocity = getattr(x, f"position_{i}"), getattr(x, f"velocity_{i}")
            force = port("amplifier", getattr(u, f"force_{i}_n"), place=i)
            force = port("drive", force, place=i, position=position, velocity=velocity)
            cord = port("cord", p.stiffness * position, place=i, stretch=position)
            force = force - p.viscous * velocity - cord + p.offset
            force = port(
                "guide", force, place=i, position=position, velocity=velocity, load=9.81 * p.mass
            )
            force = port("mast", force, place=i, inertia=p.mass)
            out |= {f"position_{i}": velocity, f"velocity_{i}": force / p.mass}
        return out

    def measure(self, x, u, p, port):
        return {
            f"position_{i}_m": port("ruler", getattr(x, f"position_{i}"), place=i) for i in BOTH
        }
