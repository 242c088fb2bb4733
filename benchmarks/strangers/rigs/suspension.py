"""A quarter of a car: body, wheel, strut and tyre."""

from pamid import Parameter, Port, Rig, State


class Suspension(Rig):
    """Road height in, travel of the strut and acceleration of the body out."""

    inputs = {"road_mm": "m"}
    between = {"road_mm": "linear"}
    outputs = {"travel_mm": "m", "body_m_per_s2": "m/s2"}
    ports = {
        "strut": Port("motion", "N", signals=("position", "velocity")),
        "tyre": Port("motion", "N", signals=("position", "velocity")),
        "potentiometer": Port("reading", "m", signals=("rate",)),
        "accelerometer": Port("reading", "m/s2"),
    }
    states = (
        State("body", "m"),
        State("body_rate", "m/s"),
        State("wheel", "m"),
        State("wheel_rate", "m/s"),
    )
    parameters = (
        Parameter("body_kg", 310.0, low=200.0, high=450.0, spread=25.0, source="scales"),
        Parameter("wheel_kg", 35.0, low=20.0, high=70.0, spread=5.0, source="scales"),
        Parameter("spring_n_per_m", 16000.0, low=8e3, high=4e4, spread=2e3, source="data sheet"),
        Parameter("damper_n_s_per_m", 1500.0, low=200.0, high=5000.0, spread=400.0, source="sheet"),
        Parameter("tyre_n_per_m", 190000.0, low=8e4, high=4e5, spread=3e4, source="table"),
    )

    def strut(self, x, p, port):
        travel, rate = x.body - x.wheel, x.body_rate - x.wheel_rate
        force = -p.spring_n_per_m * travel - p.damper_n_s_per_m * rate
        return port("strut", force, position=travel, velocity=rate)

    def rates(self, x, u, p, port):
        strut = self.strut(x, p, port)
        tyre = port(
            "tyre",
            -p.tyre_n_per_m * (x.wheel - u.road_mm),
            position=x.wheel,
            velocity=x.wheel_rate,
        )
        return {
            "body": x.body_rate,
            "body_rate": strut / p.body_kg,
            "wheel": x.wheel_rate,
            "wheel_rate": (tyre - strut) / p.wheel_kg,
        }

    def measure(self, x, u, p, port):
        return {
            "travel_mm": port("potentiometer", x.body - x.wheel, rate=x.body_rate - x.wheel_rate),
            "body_m_per_s2": port("accelerometer", self.strut(x, p, port) / p.body_kg),
        }
