"""Two muscles side by side, each lifts a weight on a spring; nothing couples them."""

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

BOTH = ("1", "2")
NOMINAL_PA, STROKE = 6e5, 0.3


class Muscles(Rig):
    """Pressure to contraction, twice, with a port for what only a muscle has."""

    inputs = {"pressure_1_kpa": "Pa", "pressure_2_kpa": "Pa"}
    outputs = {"contraction_1": "", "contraction_2": ""}
    ports = {
        "regulator": Port("command", "Pa", (), BOTH, size={"value": 3e5}),
        "muscle": Port(
            "actuator-force",
            "N",
            {"position": "", "velocity": "1/s", "pressure": "Pa", "law": ""},
            BOTH,
            size={"value": 400.0, "position": 0.1, "velocity": 0.5, "pressure": 3e5},
        ),
    }
    states = tuple(
        State(f"{name}_{i}", unit) for i in BOTH for name, unit in (("chi", ""), ("rate", "1/s"))
    )
    parameters = (
        Parameter("nominal", 1200.0, 300.0, 3000.0, "N", source="data sheet"),
        Parameter("length", 0.2, 0.1, 0.5, "m", fitted=False, source="tape measure"),
        Parameter("mass", 4.0, 1.0, 20.0, "kg", source="kitchen scale"),
        Parameter("spring", 8000.0, 2000.0, 40000.0, "N/m", source="hung with a known weight"),
        Parameter("viscous", 200.0, 20.0, 1000.0, "N s/m", source="run-out"),
    )
    period_s = 0.002

    def rates(self, x, u, p, port):
        def law(contraction, pressure):
            return p.nominal * pressure / NOMINAL_PA * (1.0 - contraction / STROKE)

        out: dict[str, Number] = {}
        for i in BOTH:
            chi, rate = getattr(x, f"chi_{i}"), getattr(x, f"rate_{i}")
            pressure = port("regulator", getattr(u, f"pressure_{i}_kpa"), place=i)
            pull = port(
                "muscle",
                law(chi, pressure),
                place=i,
                position=chi,
                velocity=rate,
                pressure=pressure,
                law=law,
            )
            load = p.length * (p.spring * chi + p.viscous * rate)
            out |= {f"chi_{i}": rate, f"rate_{i}": (pull - load) / (p.mass * p.length)}
        return out

    def measure(self, x, u, p, port):
        return {f"contraction_{i}": getattr(x, f"chi_{i}") for i in BOTH}
