"""A damper on a test bench: moved, its force read, a voltage at its coil."""

from pamid import Parameter, Port, Rig


class Damper(Rig):
    """Displacement and velocity in, force of the load cell out."""

    inputs = {"displacement_mm": "m", "velocity_mm_per_s": "m/s", "coil_v": "V"}
    between = {"displacement_mm": "linear", "velocity_mm_per_s": "linear"}
    outputs = {"force_n": "N"}
    ports = {
        "damper": Port("motion", "N", signals=("position", "velocity", "voltage")),
        "cell": Port("reading", "N"),
    }
    parameters = (
        Parameter("drag_n_s_per_mm", 1.6, low=0.1, high=20.0, spread=2.0, log=True, source="oil"),
        Parameter("spring_n_per_mm", 2.3, low=0.1, high=10.0, spread=0.6, source="gas spring"),
        Parameter("zero_n", 0.0, low=-100.0, high=100.0, spread=20.0, source="cell"),
    )

    def measure(self, x, u, p, port):
        v, s = u.velocity_mm_per_s, u.displacement_mm
        # what acts on the rod, along its displacement; the cell reads the opposite
        along = -p.drag_n_s_per_mm * v - p.spring_n_per_mm * s - p.zero_n
        along = port("damper", along, position=s, velocity=v, voltage=u.coil_v)
        return {"force_n": port("cell", -along)}
