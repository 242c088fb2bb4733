"""Pulse-width modulation: the duty comes in steps, and the flow comes in pulses.

What it is
    A pulse is a whole number of controller ticks long, so that the duty is rounded to a tick per
    pulse period (10 % for 3 ms in 30 ms). The timer reads the duty once per period, or compares it
    with a ramp all the time, and between the pulses the valve is shut: the mean is right, the
    moment is not.
What it looks like
    Plateaus of pressure rate in a slow ramp of the command; a limit cycle of a step of the duty;
    a line at the pulse frequency (33 Hz for 30 ms) in the pressures, which the angle hardly shows.
Looks like it
    Quantised readings (steps in the reading, none in the pressure rate); switching delays of the
    valve, which leave a gap at zero only. Both halves are kept apart: `step` rounds the duty,
    `ripple` (0 to 1) turns its mean into pulses. Risers of the staircase take a twentieth of a
    step; the pulses are averaged exactly over each step of the integrator.
Equation
    duty = value - q saw(value/q), q = step * full
    value = duty + ripple (pulses(duty at the start of the period, t) - duty), with waits = 1;
    pulses(duty now, t) with waits = 0
References
    van Varseveld, Bone (1997), IEEE/ASME Trans. Mechatronics 2(3); Peterchev, Sanders (2003), IEEE
    Trans. Power Electronics 18(1).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import (
    Expr,
    Number,
    absolute,
    delay,
    expression,
    floor,
    maximum,
    minimum,
    sign,
    where,
)
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

USUAL_PULSE, LONGEST_PULSE = 10.0, 100.0 / 3.0  # sampling periods
# With a phase error of a quarter period, pulses of any height increase the error and the fit
# removes them: hence eight starting phases.
EIGHTHS = tuple(k / 8.0 for k in range(8))
# scan grid of the step: 0.34 / (1 + 0.05 k), k < 320, which is 34 % down to 2 %
SCANNED_TICKS = (0.05, 320)
RISER = 0.05  # share of a step taken by its riser
WHOLE_STEP = 1e-6  # of a step: a pulse that begins with a step belongs to that step


def rounding_error(x: Expr) -> Expr:
    """x minus x rounded to whole numbers, with risers of finite width: continuous, period 1, within
    +-0.5."""
    off = x - floor(x + 0.5)
    beyond = sign(off) * (0.5 - absolute(off)) * ((1.0 - RISER) / RISER)
    return where(absolute(off) < 0.5 * (1.0 - RISER), off, beyond)


def pulses(
    running: Expr, following: Expr, begun_s: Expr, length_s: Number, period_s: Number
) -> Expr:
    """Mean of pulses of height +-1 over the next `length_s` (s).

    running: duty of the present period, which began `begun_s` (s) ago; following: duty of all later
    periods.
    """
    end = begun_s + length_s
    first = absolute(running) * period_s
    inside = minimum(minimum(end, period_s), first) - minimum(begun_s, first)
    after = maximum(end - period_s, 0.0)
    whole = floor(after / period_s)
    each = absolute(following) * period_s
    later = whole * each + minimum(after - whole * period_s, each)
    return (sign(running) * inside + sign(following) * later) / length_s


class PwmQuantisation(Effect):
    """Rounded duty and, on request, the pulses themselves."""

    family = "valve-dead-band"
    kinds = ("command",)
    parameters = (
        Parameter.share(
            "step", 0.1, 0.0, 0.34, spread=0.08, tries=(0.033, 0.06, 0.2), scan=SCANNED_TICKS
        ).with_source("a 3 ms tick in a pulse period of 9-90 ms"),
        Parameter.share("ripple", 0.0, 0.0, 1.0, spread=0.5, tries=(1.0,)).with_source(
            "0: averaged valve, 1: true pulses"
        ),
        Parameter("waits", 1.0, 0.0, 1.0, spread=0.5).with_source(
            "1: read once per period; 0: compared with a ramp all the time"
        ),
        Parameter("phase", 0.0, -1.0, 2.0, spread=0.5).with_source(
            "of the first pulse in the recording, in periods; unknown unless logged"
        ),
        Parameter.width("full", 1.0, 0.3, 10.0, factor=1.3, size="value").with_source(
            "command that opens the valve all the time: the largest that was sent, or more"
        ),
        Parameter.time(
            USUAL_PULSE,
            USUAL_PULSE / 3.0,
            LONGEST_PULSE,
            name="pulse_period",
            factor=USUAL_PULSE,
            size="period",
        ).with_source("ten samples of 3 ms; lines of the residual's spectrum are tried first"),
    )
    symptoms = ("steps",)
    look_alikes = ("valve-switching", "valve-dead-band", "quantisation")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Starts with full pulses.

        The period is the strongest spectral line of the gap within its range. Eight phases are
        tried.
        """
        period = next(q for q in self.parameters if q.name == "pulse_period")
        shown = [
            1.0 / f
            for f in hints.peaks_hz
            if f * period.low * hints.period_s <= 1.0 <= f * period.high * hints.period_s
        ]
        return [
            {"pulse_period": seconds, "ripple": 1.0, "phase": phase}
            for seconds in shown[:1]
            for phase in EIGHTHS
        ]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        step = p.step * p.full
        duty = value - step * rounding_error(value / maximum(step, 1e-6 * p.full))
        turns = expression(at.time) / p.pulse_period + p.phase
        begun = (turns - floor(turns)) * p.pulse_period
        # the duty as it was held when the pulse began: whole steps ago
        held_for = -floor(WHOLE_STEP - begun / at.step) * at.step
        latched = delay(duty, held_for, LONGEST_PULSE * at.rig_period_s)
        step_s, following = expression(at.step), duty / p.full
        late, at_once = (
            pulses(running, following, begun, step_s, p.pulse_period)
            for running in (latched / p.full, following)
        )
        share = at_once + p.waits * (late - at_once)
        return duty + p.ripple * (p.full * share - duty)
