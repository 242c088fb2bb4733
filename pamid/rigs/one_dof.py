"""One joint, two antagonistic 20 mm muscles (first paper), a fill and a vent valve each.

Equations
    contraction  chi1 = chi0 + r beta/L0, chi2 = chi0 - r beta/L0
    muscle       F = max(0, scale F_static(chi, p) - R dchi/dt P), p gauge, P absolute
    joint        J dw/dt = r (F1 - F2) - b w + external torque
    pressure     dP/dt = n (P_atm Q - P dV/dt)/V(chi)
    flow         ISO 6358 through opened valves
    valves       one muscle stays at p0, only the other is vented: u > 0 fills 1 up to p0, then vents 2; u < 0 mirrored
"""

from __future__ import annotations

from typing import Any

from pamid.background import SmoothGain, SplitGain
from pamid.effect import State
from pamid.equations import ZERO, Expr, Number, absolute, clip, maximum, where
from pamid.errors import FileError, nearest
from pamid.parameter import Parameter
from pamid.rig import Loop, Port, Rig
from pamid.rigs.muscle import LAWS, Law
from pamid.rigs.pneumatics import ATMOSPHERE_PA, iso_flow, muscle_volume, muscle_volume_slope

BOTH = ("1", "2")
FILL_BLEND_PA = 10e3  # over which filling hands over to venting as the muscle reaches p0

MUSCLE = {"position": "", "velocity": "1/s", "pressure": "Pa", "side": "", "law": ""}


class OneDof(Rig):
    """One joint driven by two antagonistic muscles."""

    name = "one-dof"
    inputs = {"command": "", "external_torque_nm": "N m"}
    optional = {"external_torque_nm": 0.0}
    outputs = {"angle_deg": "rad", "pressure_1_kpa": "Pa", "pressure_2_kpa": "Pa", "force_1_n": "N", "force_2_n": "N"}
    ports = {
        "command": Port("command", "", size={"value": 1.0}, general=False),
        "valve": Port("flow", "m3/s", {"pressure": "Pa", "ratio": "", "drawn": "m3/s", "fill": "", "supply": "Pa",
                                       "side": ""}, BOTH,
                      size={"value": 2e-3, "pressure": 6e5, "ratio": 1.0, "supply": 7e5}, general=False),
        "pressure": Port("rate", "Pa/s", {"stored": "Pa", "outflow": "Pa/s"}, BOTH,
                         size={"value": 1e6, "stored": 5e5}, general=False),
        "relief": Port("rate", "Pa/s", {"force": "N", "outflow": "Pa/s"}, BOTH, group="muscle",
                       size={"value": 1e6, "force": 700.0}, general=False),
        "muscle": Port("actuator-force", "N", MUSCLE, BOTH,
                       size={"value": 700.0, "position": 0.08, "velocity": 0.2, "pressure": 4e5}, general=False),
        "chain": Port("transmission", "N", {"position": "", "pressure": "Pa", "law": "", "drag": "N s"}, BOTH,
                      group="structure", size={"value": 700.0}, general=False),
        "joint": Port("motion", "N m", {"position": "rad", "velocity": "rad/s", "load": "N"},
                      size={"value": 10.0, "velocity": 2.0, "position": 0.7, "load": 1000.0}, general=False),
        "arm": Port("transmission", "N m", {"position": "rad", "velocity": "rad/s", "inertia": "kg m2"},
                    group="structure", size={"value": 10.0, "velocity": 2.0, "position": 0.7}, general=False),
        "angle_sensor": Port("reading", "rad", {"rate": "rad/s"}, group="sensor",
                             size={"value": 0.7, "rate": 2.0}, general=False),
        "pressure_sensor": Port("reading", "Pa", {"rate": "Pa/s"}, BOTH, group="sensor",
                                size={"value": 4e5, "rate": 1e6}, general=False),
        "force_sensor": Port("reading", "N", {"rate": "N/s"}, BOTH, group="sensor", size={"value": 700.0},
                             general=False),
    }
    states = (State("angle", "rad"), State("velocity", "rad/s"),
              State("pressure_1", "Pa"), State("pressure_2", "Pa"))
    parameters = (
        Parameter("inertia", 0.014, 0.001, 1.0, "kg m2", fitted=False, source="first paper, Jn"),
        Parameter("radius", 0.030, 0.005, 0.2, "m", fitted=False, source="estimate: +-40 deg at contraction 0.10"),
        Parameter("length", 0.250, 0.05, 2.0, "m", fitted=False, source="data sheet, nominal length"),
        Parameter("supply_pressure", 600.0, 200.0, 900.0, "kPa", fitted=False, source="estimate, gauge"),
        Parameter("initial_pressure", 550.0, 0.0, 850.0, "kPa", fitted=False, source="first paper's scheme, gauge"),
        Parameter("damping", 6e-4, 6e-5, 4e-3, "m2 s", spread=2.0, log=True, source="estimate, R of eq. 2"),
        Parameter("scale", 1.0, 0.5, 1.6, spread=0.15, source="specimens differ from the chart by 10-19 %"),
        Parameter("conductance_in", 3.777e-9, 1e-9, 1e-8, "m3/(s Pa)", spread=1.15, log=True,
                  source="22.66 l/(min bar), fill valve"),
        Parameter("conductance_out", 3.777e-9, 1e-9, 1e-8, "m3/(s Pa)", spread=1.15, log=True,
                  source="22.66 l/(min bar), vent valve"),
        Parameter("critical_ratio", 0.433, 0.1, 0.6, spread=0.08, source="literature on the same valves"),
        Parameter("polytropic", 1.0, 1.0, 1.4, spread=0.2, source="1: isothermal, eq. 3 of the first paper"),
        Parameter("viscous", 0.02, 0.0, 0.5, "N m s", spread=0.1, source="estimate, bearing and chain"),
        Parameter("contraction_0", 0.10, 0.05, 0.15, spread=0.005, source="estimate, both muscles at p0"),
        Parameter("dead_volume", 5.0, 0.0, 20.0, "cm3", spread=4.0, source="estimate, tube and fittings"),
    )
    background = {
        "muscle": SmoothGain("force_map", ("position", 0.0, 0.20), tolerance=0.03, degree=8,
                             along=("pressure", 0.0, 6e5), level=True, drift=True),
        "valve": SplitGain("flow", tolerance=0.05),
    }
    loops = (Loop("command", "reference_deg", "angle_deg"),)
    controller = {"kp_per_deg": 0.10, "kd_s_per_deg": 0.003, "derivative_filter_s": 0.006, "command_limit": 1.0}
    noise = {"angle_deg": 0.05, "pressure_1_kpa": 1.0, "pressure_2_kpa": 1.0, "force_1_n": 3.0, "force_2_n": 3.0}
    variants = tuple(LAWS)

    def __init__(self, law: str = "exponential") -> None:
        if law not in LAWS:
            raise FileError(f"unknown force law {law!r}", nearest(law, list(LAWS)) or f"laws: {', '.join(LAWS)}")
        self.static_force: Law = LAWS[law]  # a rig file may put another here, such as networks.force_law

    def start(self, p: Any) -> dict[str, float]:
        """Both muscles at p0, the arm at rest in the middle."""
        return {"pressure_1": p.initial_pressure + ATMOSPHERE_PA, "pressure_2": p.initial_pressure + ATMOSPHERE_PA}

    def muscle(self, i: str, x: Any, p: Any, port: Any) -> tuple[Expr, Expr, Expr]:
        """Force (N), contraction and contraction rate (1/s) of muscle i."""
        side = 1.0 if i == "1" else -1.0
        arm = side * p.radius / p.length
        chi, rate = p.contraction_0 + arm * x.angle, arm * x.velocity
        absolute_pa = x.pressure_1 if i == "1" else x.pressure_2

        def law(contraction: Expr, pressure: Expr) -> Expr:
            return p.scale * self.static_force(contraction, pressure)

        gauge = absolute_pa - ATMOSPHERE_PA
        drag = p.damping * absolute_pa
        pull = law(chi, gauge) - drag * rate
        pull = port("muscle", pull, place=i, position=chi, velocity=rate, pressure=gauge, side=side, law=law)
        pull = port("chain", pull, place=i, position=chi, pressure=gauge, law=law, drag=drag)
        return maximum(0.0, pull), chi, rate

    def pressure_rates(self, x: Any, u: Any, p: Any, port: Any) -> tuple[Expr, Expr]:
        """dP/dt of both muscles, Pa/s."""
        command = port("command", u.command)
        size = absolute(command)
        supply, hold = p.supply_pressure + ATMOSPHERE_PA, p.initial_pressure + ATMOSPHERE_PA
        share1 = clip((hold - x.pressure_1) / FILL_BLEND_PA, 0.0, 1.0)
        share2 = clip((hold - x.pressure_2) / FILL_BLEND_PA, 0.0, 1.0)
        flows = {}
        for i, pressure, fills, own, other in (("1", x.pressure_1, command > 0.0, share1, share2),
                                               ("2", x.pressure_2, command < 0.0, share2, share1)):
            up, down = where(fills, supply, pressure), where(fills, pressure, ATMOSPHERE_PA)
            opening = where(fills, size * own * p.conductance_in, -size * (1.0 - other) * p.conductance_out)
            flows[i] = (opening * iso_flow(up, down, p.critical_ratio), fills, size * own, pressure, down / up)
        drawn = sum((maximum(f[0], 0.0) for f in flows.values()), start=ZERO)
        rates = []
        for i in BOTH:
            flow, fills, opening, pressure, ratio = flows[i]

            def fill(at_supply: Expr, fills: Expr = fills, opening: Expr = opening, pressure: Expr = pressure) -> Expr:
                through = opening * p.conductance_in * iso_flow(at_supply, pressure, p.critical_ratio)
                return where(fills, through, 0.0)

            flow = port("valve", flow, place=i, pressure=pressure, ratio=ratio, drawn=drawn, fill=fill, supply=supply,
                        side=1.0 if i == "1" else -1.0)
            force, chi, rate = self.muscle(i, x, p, port)
            volume = muscle_volume(chi, p.dead_volume)
            vent = p.polytropic * ATMOSPHERE_PA * p.conductance_out / volume * iso_flow(
                pressure, ATMOSPHERE_PA, p.critical_ratio)
            change = p.polytropic * (ATMOSPHERE_PA * flow - pressure * muscle_volume_slope(chi) * rate) / volume
            change = port("pressure", change, place=i, stored=pressure, outflow=vent)
            rates.append(port("relief", change, place=i, force=force, outflow=vent))
        return rates[0], rates[1]

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        f1, f2 = self.muscle("1", x, p, port)[0], self.muscle("2", x, p, port)[0]
        torque = p.radius * (f1 - f2) - p.viscous * x.velocity + u.external_torque_nm
        torque = port("joint", torque, position=x.angle, velocity=x.velocity, load=f1 + f2)
        torque = port("arm", torque, position=x.angle, velocity=x.velocity, inertia=p.inertia)
        dp1, dp2 = self.pressure_rates(x, u, p, port)
        return {"angle": x.velocity, "velocity": torque / p.inertia, "pressure_1": dp1, "pressure_2": dp2}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        dp = self.pressure_rates(x, u, p, port)
        out = {"angle_deg": port("angle_sensor", x.angle, rate=x.velocity)}
        for i, state, rate in (("1", x.pressure_1, dp[0]), ("2", x.pressure_2, dp[1])):
            out[f"pressure_{i}_kpa"] = port("pressure_sensor", state - ATMOSPHERE_PA, place=i, rate=rate)
        for i in BOTH:
            out[f"force_{i}_n"] = port("force_sensor", self.muscle(i, x, p, port)[0], place=i, rate=0.0)
        return out
