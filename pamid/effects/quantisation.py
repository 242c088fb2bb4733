"""A value that comes in steps.

What it is
    An encoder with few counts, a converter with few bits, a command sent as a whole number. The
    steps are drawn with a short ramp between them, as noise of a twentieth of a step rounds off
    their corners on the average.
What it looks like
    Plateaus and jumps of equal size; a histogram of the signal shows needles; its derivative is a
    comb. The error looks like noise of even spread, a step wide, once the signal moves through many
    steps.
Looks like it
    Sensor noise (no needles in the histogram); a dead zone (a single flat, about zero); dry
    friction, if the plateaus are where the motion reverses.
Equation
    value := level + quantum * round((value - level) / quantum)
    At a reading the quantum, and where any of the levels is, are taken from the plateaus on which
    the recorded values rest (in kelvin no whole number of steps from zero); at a command zero is a
    level, and the quantum is fitted.
References
    Widrow, Kollar (2008), Quantization Noise: Roundoff Error in Digital Computation, Signal
    Processing, Control, and Communications, Cambridge University Press.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, clip, floor, held, maximum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

# quanta tried: a quarter of a step more in the largest value each time, up to a hundred in it
SCANNED_STEPS = (0.05, 400)
RAMP = 0.1  # of a step: within it the output climbs to the next level


class Quantisation(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter(
            "quantum",
            0.01,
            0.0,
            0.2,
            spread=0.05,
            size="value",
            null=0.0,
            tries=(0.05,),
            scan=SCANNED_STEPS,
        ).with_source("estimate: 8 bits over the range are 0.8 % of its half"),
        Parameter.held("level", 0.0, -2.0, 2.0, size="value").with_source(
            "read off: a plateau on which the recorded values rest"
        ),
    )
    symptoms = ("steps",)
    look_alikes = ("dead-zone",)
    mean_slope_at = ("reading",)

    @classmethod
    def parameters_at(cls, kind: str, offered: Collection[str] = ()) -> tuple[Parameter, ...]:
        """Of a reading the quantum is read off, not fitted: where the levels lie tells it to a
        fraction of their number, and the distance of readings from a model does not show it."""
        parameters, fitted = super().parameters_at(kind, offered), kind not in cls.mean_slope_at
        return tuple(replace(p, fitted=fitted and p.fitted) for p in parameters)

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A rounded reading tells its steps by the plateaus on which it rests."""
        return [{"quantum": spacing, "level": level} for spacing, level in hints.plateaus]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        steps = (value - p.level) / maximum(p.quantum, 1e-12)
        whole = floor(steps)
        part = clip((steps - whole - 0.5) * (1.0 / RAMP) + 0.5, 0.0, 1.0)
        error = p.quantum * (whole + part - steps)
        # a rounded reading follows its value on the average: with the staircase's slope,
        # nothing on the plateaus and much on the risers, no fit finds the states behind it
        return value + (held(error) if at.kind in self.mean_slope_at else error)
