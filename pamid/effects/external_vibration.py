"""A periodic force from outside.

What it is
    A motor, a pump or a shaking base pushes on the mechanism at a fixed frequency, whatever the
    command does. Sine and cosine amplitudes hold size and phase with respect to the start of the
    recording.
What it looks like
    A line in the spectrum of the residual that does not move with reference, speed or pressure and
    is there at rest.
Looks like it
    Ringing of a flexible mode (starts with the motion and fades); the line of a pulsed valve (in
    the pressures first); a chain that runs rough (periodic in position, not in time).
Equation
    value += sine sin(2 pi frequency t) + cosine cos(2 pi frequency t)
References
    Bodson, Douglas (1997), Automatica 33(12), 2213-2221.
"""

import math
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, cos, expression, sin
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

TRIED_PEAKS = 4


class ExternalVibration(Effect):
    """Force at a single frequency; its phase belongs to the recording."""

    family = "external-disturbance"
    kinds = ("motion",)
    parameters = (
        Parameter.level(0.03, -0.4, 0.4, name="sine", spread=0.05).with_source(
            "0.1-2 N m on a 10 N m joint"
        ),
        Parameter.level(0.0, -0.4, 0.4, name="cosine", spread=0.05).with_source(
            "0.1-2 N m on a 10 N m joint"
        ),
        # slower ones follow the motion as friction does: on EMPS a vibration of 0.48 Hz would rival
        # it
        Parameter.positive(
            "frequency", 3.0, 0.6, 36.0, factor=3.0, size="1/timescale", tries=(0.9, 7.2, 15.0)
        ).with_source("1-50 Hz on a joint; the peaks of the residual's spectrum are tried first"),
    )
    symptoms = ("one-frequency",)
    look_alikes = ("two-mass", "pwm-quantisation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        turn = (2.0 * math.pi) * p.frequency * expression(at.time)
        return value + p.sine * sin(turn) + p.cosine * cos(turn)

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A start per peak of the gap's spectrum: a frequency off by more than 1/duration never
        finds its way."""
        frequency = next(q for q in self.parameters if q.name == "frequency")
        low, high = frequency.low / hints.timescale_s, frequency.high / hints.timescale_s
        # not known how long the recordings remember: nothing lies outside
        inside = [f for f in hints.peaks_hz if not (f < low or f > high)]
        return [{"frequency": f} for f in inside[:TRIED_PEAKS]]
