"""A lag of no known order.

What it is
    A value that follows what goes in with a delay of whatever shape: filters of first and second
    order with three time constants, from a hundredth to a fifth of what the recordings remember,
    mixed in shares that the recordings say.
What it looks like
    Fast motion comes late and smaller, or late and larger; slow motion is untouched.
Looks like it
    Dead time; a lag of first order; inertia and damping of the mechanism, which the parameters of
    most rigs take up.
Equation
    value += sum_j a_j (lag(value, T_j) - value) + b_j (lag(lag(value, T_j), T_j) - value),
    T = (0.01, 0.05, 0.2) correlation times of the recordings
References
    Wahlberg (1991), System identification using Laguerre models, IEEE Trans. Automatic Control
    36(5), 551-562; Doebelin (2004), Measurement Systems: Application and Design, 5th edition,
    McGraw-Hill, chapter 3.
"""

from typing import Any, ClassVar

import numpy as np

from pamid.engine.symbolic.vocabulary import Expr, lag
from pamid.model.free_form import CURVE_POINTS, FormShapes, FreeFormEffect, coefficient
from pamid.model.parameter import Parameter

PACES = (0.01, 0.05, 0.2)  # time constants, correlation times
SHOWN = 4.0  # of the longest time constant, in a step response


class FreeLag(FreeFormEffect):
    """A mixture of filters; its curve is the response to a step."""

    family = "sensor-dynamics"
    families: ClassVar[dict[str, str]] = {"command": "command-timing", "flow": "tube-lag"}
    kinds = ("command", "reading", "flow")
    parameters = (
        *(
            coefficient(f"{order}_{pace}", 0.3, 1.5, "")
            for order in ("single", "double")
            for pace in ("fast", "medium", "slow")
        ),
        Parameter.held("span", 1.0, 0.1, 10.0, size="timescale").with_source(
            "what the recordings remember"
        ),
    )
    look_alikes = ("first-order-lag", "dead-time")
    along = "time"
    shown = "response to a step"
    known_by = "a delay that blurs"
    subtracted = False

    @classmethod
    def placed(cls, low: float, high: float) -> dict[str, float]:
        return {}

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        """Shapes of the value itself."""
        single = [lag(x, pace * p.span) for pace in PACES]
        double = [lag(s, pace * p.span) for s, pace in zip(single, PACES, strict=True)]
        return [s - x for s in (*single, *double)]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Any:
        return self.added_up(self.shapes(value, p), value, p)

    def curve(self, p: Any, low: float, high: float) -> FormShapes:
        """Response to a unit step, over the time since: 1 - exp(-t/T) and 1 - (1 + t/T)
        exp(-t/T)."""
        longest = PACES[-1] * p.span
        t = np.linspace(0.0, SHOWN * longest, CURVE_POINTS)
        shares = t[:, None] / (p.span * np.array(PACES))
        left = np.exp(-shares)
        columns = np.hstack([-left, -(1.0 + shares) * left])
        return FormShapes(t, np.ones_like(t), columns)
