"""A filter, an amplifier stage and a second filter."""

from pamid import Parameter, Port, Rig, State

TURN = 6.283185307179586


class Circuit(Rig):
    """Two filters in a row, with a stage between them."""

    inputs = {"drive_v": "V"}
    between = {"drive_v": "linear"}
    outputs = {"output_v": "V"}
    ports = {
        "generator": Port("command", "V"),
        "stage": Port("command", "V"),
        "scope": Port("reading", "V", signals=("rate",)),
    }
    period_s = 1.0 / 51200.0
    states = (State("first", "V"), State("second", "V"), State("slope", "V/s"))
    parameters = (
        Parameter("first_khz", 5.0, low=0.5, high=20.0, spread=1.3, log=True, source="parts"),
        Parameter("second_khz", 4.0, low=0.5, high=20.0, spread=1.3, log=True, source="parts"),
        Parameter("damping", 0.5, low=0.05, high=2.0, spread=1.5, log=True, source="parts"),
        Parameter("gain", 1.0, low=0.2, high=5.0, spread=0.1, source="parts"),
    )

    def rates(self, x, u, p, port):
        w1, w2 = TURN * p.first_khz, TURN * p.second_khz
        stage = port("stage", p.gain * x.first)
        return {
            "first": w1 * (port("generator", u.drive_v) - x.first),
            "second": x.slope,
            "slope": w2 * w2 * (stage - x.second) - 2.0 * p.damping * w2 * x.slope,
        }

    def measure(self, x, u, p, port):
        return {"output_v": port("scope", x.second, rate=x.slope)}
