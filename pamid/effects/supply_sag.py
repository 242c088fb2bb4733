"""A supply that gives way under flow.

What it is
    Hose, regulator and fittings in front of the valves have a resistance: the pressure
    at the valves falls with the total flow drawn. Solved with a single step of the secant rule for
    the flow that drops the supply.
What it looks like
    Fast filling is slower than the valve alone would allow, slow filling is not; muscles filled
    together slow each other down; a gauge at the valve block dips.
Looks like it
    A smaller fill conductance (the larger part is absorbed by it); a lower supply pressure, which
    also lowers the end value. Fill alone and together, at small and large openings, to separate
    them.
Equation
    supply -> supply - (sag / 3 l/s) * drawn, for the flow drawn at that very pressure
References
    Beater (2007), Pneumatic Drives, Springer; ISO 6358-1:2013.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

TYPICAL_FLOW_M3_S = 3e-3  # ANR; both fill valves of the founding rig wide open


class SupplySag(Effect):
    """Supply pressure lost in proportion to the flow drawn; `sag` is what is lost at 3 l/s
    (ANR)."""

    family = "supply-sag"
    kinds = ("flow",)
    signals = ("supply", "drawn", "fill")
    everywhere = True  # all valves draw on the same supply
    parameters = (
        Parameter("sag", 45.0, 0.0, 150.0, "kPa", spread=40.0, null=0.0).with_source(
            "estimate: 0.1-0.6 bar lost at the full flow of 3 l/s"
        ),
    )
    symptoms = ("load",)
    look_alikes = ("tube-lag", "flow-mismatch")
    absorbed_by = ("conductance_in", "supply_pressure")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        resistance = p.sag * (1.0 / TYPICAL_FLOW_M3_S)
        before = at.fill(at.supply)
        after = at.drawn + at.fill(self._lowered(at, resistance * at.drawn)) - before
        settled = at.drawn * at.drawn / maximum(2.0 * at.drawn - after, 1e-9)
        return value + at.fill(self._lowered(at, resistance * settled)) - before

    def _lowered(self, at: Any, lost: Expr) -> Expr:
        return maximum(at.supply - lost, 0.1 * at.supply)
