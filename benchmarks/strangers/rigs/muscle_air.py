"""The air in a pneumatic muscle, filled and emptied by a valve."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import maximum


class MuscleAir(Rig):
    """Pressure in a muscle: the valve fills it from the supply (1) or empties it (-1)."""

    inputs = {"valve": ""}
    outputs = {"pressure_kpa": "Pa"}
    ports = {
        "muscle": Port("rate", "Pa/s", signals=("stored",)),
        "gauge": Port("reading", "Pa"),
    }
    states = (State("pressure", "Pa"),)
    parameters = (
        Parameter("supply_kpa", 600.0, low=400.0, high=700.0, spread=15.0, source="regulator"),
        Parameter("fill_s", 1.1, low=0.1, high=10.0, spread=1.5, log=True, source="a watch"),
        Parameter("empty_s", 1.9, low=0.1, high=20.0, spread=1.5, log=True, source="a watch"),
    )

    def rates(self, x, u, p, port):
        into = maximum(u.valve, 0.0) * (p.supply_kpa - x.pressure) / p.fill_s
        out = maximum(-u.valve, 0.0) * x.pressure / p.empty_s
        return {"pressure": port("muscle", into - out, stored=x.pressure)}

    def measure(self, x, u, p, port):
        return {"pressure_kpa": port("gauge", x.pressure)}
