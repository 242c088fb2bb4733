"""The force compensator of a fluidic muscle: a safety valve that blows off air above a force. Its
data sheet and its equation, for the effect of that name and for rigs whose muscles have it.

Source: operating manual of the maker's fluidic muscle with force compensator (fluidic muscle MAS).
"""

from __future__ import annotations

from pamid.engine.symbolic.vocabulary import Expr, Number, smooth_step
from pamid.model.parameter import Parameter

OPENING = Parameter.share("opening", 2.0, 0.0, 5.0, spread=2.0).with_source(
    "estimate: 1-5 times the conductance of the vent valve"
)
LIMIT = Parameter("limit", 1200.0, 300.0, 1500.0, "N", spread=300.0).with_source(
    "maker: 1200 N at 20 mm bore, 400 N at 10 mm"
)
OPENING_SPAN = Parameter.held("blend", 80.0, 40.0, 200.0, "N").with_source(
    "estimate: 50-100 N from shut to open"
)


def blown_off(
    rate: Expr, force: Number, outflow: Number, opening: Number, limit: Number, blend: Number
) -> Expr:
    """The rate of change of a muscle's pressure (Pa/s) with the valve: it opens to `opening` vent
    valves as the force (N) passes the limit (N) by blend (N). outflow: of a single vent valve,
    Pa/s."""
    return rate - opening * smooth_step((force - limit) / blend) * outflow
