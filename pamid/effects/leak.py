"""A leak to the surroundings.

What it is
    Fittings, a worn seat or a small hole let the stored quantity escape all the time. Where the
    port offers the flow through its open outlet (a vent valve), the leak is a share of that;
    elsewhere it follows an orifice: the square root of what is stored, turning laminar near empty.
What it looks like
    The level or pressure falls by itself with everything shut, monotonically and down to the
    surroundings, and the controller keeps topping it up.
Looks like it
    Heat exchange after a fast change, which fades within seconds; creep of the muscle, in which the
    pressure stays. A minute of holding with shut valves settles it.
Equation
    rate -= share * outflow, or share * reference * s / sqrt(s + 0.01) with s = stored / reference
    (share of the reference per unit of time)
References
    ISO 6358-1:2013; Beater (2007), Pneumatic Drives, Springer.
"""

from dataclasses import replace
from typing import Any

from pamid.effects.orifice_loss import REFERENCE, OrificeLoss
from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, sqrt
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Leak(Effect):
    family = "leak"
    kinds = ("rate",)
    signals = ("stored",)
    home_signals = ("outflow",)
    parameters = (
        Parameter.share("share", 0.01, 0.0, 0.2, spread=0.02, tries=(0.05,)).with_source(
            "1e-4 to 2e-2 of an open vent (1e-2 empties a muscle in 30 s)"
        ),
        REFERENCE,
    )
    # a separate outflow: as fast as the store itself is filled and emptied
    general_parameters = (
        replace(OrificeLoss.parameters[0], name="share", size="value/stored"),
        REFERENCE,
    )
    symptoms = ("level", "drifts")
    look_alikes = ("heat-transfer", "muscle-creep", "first-order-loss", "overflow")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        if at.offers("outflow"):
            return value - p.share * at.outflow
        filled = maximum(at.stored, 0.0) / p.reference
        return value - p.share * p.reference * filled / sqrt(filled + 0.01)
