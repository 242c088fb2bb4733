"""Play in the coupling between two masses.

What it is
    Drive and load are both in the model, joined by a spring, a belt, a gear or a coupling whose
    force passes through the port. It has clearance: within the gap it hands on nothing, beyond it
    the same force as the model's, of the stretch that is left. The port offers `stretch`, the
    position of one side less that of the other, 0 in the middle of the gap.
What it looks like
    Both sides move freely against each other for the width of the gap, then meet with a knock; the
    resonance between them falls at small amplitude.
Looks like it
    A softer spring (the same at every amplitude); dry friction at either mass; play ahead of
    a sensor, where no force is missing.
Equation
    value *= 1 - half_gap/|stretch| where |stretch| > half_gap, 0 within the gap
References
    Nordin, Galic, Gutman (1997), New models for backlash and gear play, Int. J. Adaptive Control
    and Signal Processing 11(1), 49-63; Walha, Fakhfakh, Haddar (2009), Nonlinear dynamics of a
    two-stage gear system with mesh stiffness fluctuation, bearing flexibility and backlash,
    Mechanism and Machine Theory 44(5).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, maximum, where
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class CouplingPlay(Effect):
    """A gap in a coupling; `half_gap` is the free stretch to either side."""

    family = "flexible-transmission"
    general_kinds = ("transmission",)
    signals = ("stretch",)
    parameters = (
        Parameter(
            "half_gap", 0.5, 0.0, 30.0, spread=3.0, size="stretch", null=0.0, tries=(3.0,)
        ).with_source("estimate: a stiff coupling stretches less than its gap is wide"),
    )
    symptoms = ("reversals", "rings")
    look_alikes = ("backlash", "play", "coulomb-friction", "cubic-stiffness")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        farther = maximum(absolute(at.stretch), p.half_gap)
        return value - value * where(farther > 0.0, p.half_gap / farther, 0.0)
