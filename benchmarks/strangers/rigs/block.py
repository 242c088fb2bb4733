"""A metal block with a heater, cooling to the room."""

from pamid import Parameter, Port, Rig, State


class Block(Rig):
    """Temperature of a heated block."""

    inputs = {"heater_percent": "", "ambient_degc": "K"}
    outputs = {"block_degc": "K"}
    ports = {
        "heater": Port("command", ""),
        "block": Port("rate", "K/s", signals=("stored",)),
        "thermocouple": Port("reading", "K"),
    }
    states = (State("temperature", "K", 294.0),)
    parameters = (
        Parameter("power_w", 55.0, low=20.0, high=150.0, spread=10.0, source="label"),
        Parameter("capacity_j_per_k", 250.0, low=50.0, high=1000.0, spread=60.0, source="weighed"),
        Parameter("loss_w_per_k", 0.38, low=0.05, high=2.0, spread=1.5, log=True, source="guess"),
    )

    def rates(self, x, u, p, port):
        heat = p.power_w * port("heater", u.heater_percent)
        rate = (heat - p.loss_w_per_k * (x.temperature - u.ambient_degc)) / p.capacity_j_per_k
        return {"temperature": port("block", rate, stored=x.temperature)}

    def measure(self, x, u, p, port):
        return {"block_degc": port("thermocouple", x.temperature)}
