"""Two motors on one belt, a pulley on a spring between them; the pulley's speed is read."""

from pamid import Parameter, Port, Rig, State

TURN = 6.283185307179586


class Belt(Rig):
    """Voltage of both motors in, speed of the pulley out (V)."""

    inputs = {"drive_v": "V"}
    outputs = {"speed_v": "V"}
    ports = {
        "drive": Port("command", "V"),
        "pulley": Port("motion", "V", signals=("position", "velocity")),
        "sensor": Port("reading", "V", signals=("rate",)),
    }
    states = (State("motor", "V"), State("pulley", "V"), State("pull", "V/s"))
    parameters = (
        Parameter("gain", 1.1, low=0.1, high=5.0, spread=0.3, source="by hand"),
        Parameter("motor_s", 0.3, low=0.02, high=3.0, spread=1.5, log=True, source="a step"),
        Parameter("resonance_hz", 2.3, low=0.5, high=8.0, spread=0.6, source="plucked"),
        Parameter("damping", 0.25, low=0.01, high=1.0, spread=2.0, log=True, source="plucked"),
    )

    def rates(self, x, u, p, port):
        w = TURN * p.resonance_hz
        drive = p.gain * port("drive", u.drive_v)
        stretch = port("pulley", x.motor - x.pulley, position=x.pulley, velocity=x.pull)
        return {
            "motor": (drive - x.motor) / p.motor_s,
            "pulley": x.pull,
            "pull": w * w * stretch - 2.0 * p.damping * w * x.pull,
        }

    def measure(self, x, u, p, port):
        return {"speed_v": port("sensor", x.pulley, rate=x.pull)}
