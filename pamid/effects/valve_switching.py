"""Opening and closing delays of a pulsed on-off valve, or of a relay.

What it is
    An on-off valve driven by pulses opens t_on after the pulse begins and closes t_off after it
    ends. Pulses shorter than t_on do nothing, longer ones pass as pulse - t_on + t_off, and pauses
    shorter than t_off never close it. A relay that pulses a heater does the same. Here averaged
    over the pulse period; the jumps are spread over 2 % of duty, as a half-lifted armature does.
What it looks like
    No flow below a duty of t_on / period (7 % for 2 ms in 30 ms), then a jump; a steady offset of
    the angle of several tenths of a degree under proportional control, with the pressures flat.
Looks like it
    A valve dead-band or coarse pulse widths (same family); dry friction, where pressures move and
    the arm does not.
Equation
    duty = |value|/full -> 0 below t_on/T, else min(1, duty + (t_off - t_on)/T); T the pulse period
References
    van Varseveld, Bone (1997), IEEE/ASME Trans. Mechatronics 2(3); Verrelst et al. (2005),
    Autonomous Robots 18(2).
"""

from dataclasses import replace
from typing import Any

from pamid.engine.symbolic.vocabulary import (
    Expr,
    Number,
    absolute,
    maximum,
    minimum,
    sign,
    smooth_step,
)
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

JUMP_WIDTH = 0.02  # of duty, over which the jumps are spread: keeps the fit's derivatives finite
SAMPLE_MS = 3.0  # of the rigs whose valves the sources tell of; other rigs are sampled otherwise
OPENING_DELAY = Parameter.time(
    2.0 / SAMPLE_MS,
    0.0,
    8.0 / SAMPLE_MS,
    name="t_on",
    spread=2.0 / SAMPLE_MS,
    size="period",
    hard=True,
    tries=(0.5 / SAMPLE_MS, 4.0 / SAMPLE_MS),
).with_source("fast on-off valves: about 1 ms with speed-up driver, 2-4 ms without")


class ValveSwitching(Effect):
    """Duty of an on-off valve after its switching delays."""

    family = "valve-dead-band"
    kinds = ("command",)
    parameters = (
        OPENING_DELAY,
        replace(OPENING_DELAY, name="t_off", value=1.0 / SAMPLE_MS, tries=()),
        Parameter.held("full", 1.0, 0.1, 10.0, size="value").with_source(
            "command that opens the valve all the time"
        ),
        Parameter.held(
            "pulse_period",
            30.0 / SAMPLE_MS,
            10.0 / SAMPLE_MS,
            100.0 / SAMPLE_MS,
            size="period",
            hard=True,
        ).with_source("estimate: ten samples of 3 ms"),
    )
    symptoms = ("steps",)
    look_alikes = ("valve-dead-band", "pwm-quantisation", "coulomb-friction")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        duty = absolute(value) / p.full
        lost, gained = p.t_on / p.pulse_period, p.t_off / p.pulse_period
        opens = gained * smooth_step((duty - lost) * (1.0 / JUMP_WIDTH))
        stays = lost * smooth_step((duty - 1.0 + gained) * (1.0 / JUMP_WIDTH) + 1.0)
        return (
            sign(value)
            * p.full
            * minimum(maximum(0.0, duty - lost) + opens + stays, maximum(1.0, duty))
        )
