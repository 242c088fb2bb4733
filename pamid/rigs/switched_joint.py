"""The first paper's joint with the valves that its text has: on or off, driven by pulses.

What it is
    The joint `one-dof`, but each valve is a solenoid that is open or shut. A timer holds the duty
    |command| and sends a pulse of duty times T per pulse period T. The solenoid opens `t_on`
    after a pulse has begun and shuts `t_off` after it has ended: a pulse shorter than t_on opens
    nothing, a longer pulse lets air through for duty T - t_on + t_off, and a pause shorter than
    t_off never shuts the valve.

    What is averaged: the opening, over a pulse period. A pulse of 3 ms moves a muscle by
    5-7 kPa, less than its pressure is read to within a period, and the joint (3-8 Hz) does not
    follow pulses at 33 Hz; averaged, the equations need no step at every edge, and the duty has a
    slope to fit the delays by. What is lost with it, the ripple and the moment of a pulse within
    its period, is the effect `pwm-quantisation` (`ripple` = 1). The edges at t_on and t_off are
    spread over 2 % of duty, as a half-lifted armature does.

Equations
    duty         d = min(1, |command|), held over the sample
    opening      0 for d < t_on/T, else d - t_on/T + t_off/T, 1 for d > 1 - t_off/T; signed as the
                 command. With t_on = t_off = 0 it is `one-dof`.
    the rest     as in `pamid.rigs.one_dof`: air through the opened valves, muscles, joint

Typically missing
    A duty in steps of a tick of the timer, or the pulses themselves (command:
    pwm-quantisation); dead time of the bus; dry friction, hysteresis of the muscles, a load behind
    a spring, a supply that sags while a muscle fills.

References
    Hosovsky, Mizakova, Pitel, the first paper of `docs/project/references.md`; van Varseveld, Bone
    (1997), IEEE/ASME Trans. Mechatronics 2(3); Verrelst et al. (2005), Autonomous Robots 18(2).
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, absolute, maximum, minimum, sign, smooth_step
from pamid.model.parameter import Parameter
from pamid.model.rig import Rig
from pamid.rigs.one_dof import OneDof

EDGE = 0.02  # of duty, over which an edge is spread: keeps the fit's derivatives finite


class SwitchedJoint(OneDof, Rig):
    """A joint driven by two antagonistic muscles through on-off valves."""

    name = "switched-joint"
    usual = False
    parameters = (
        *OneDof.parameters,
        Parameter.held("pulse_period", 30.0, 10.0, 100.0, "ms").with_source(
            "estimate: ten samples"
        ),
        Parameter("opening_delay", 2.0, 0.0, 8.0, "ms", spread=1.0).with_source(
            "on-off valves: about 1 ms with speed-up driver, 2-4 ms without"
        ),
        Parameter("closing_delay", 1.0, 0.0, 8.0, "ms", spread=1.0).with_source(
            "on-off valves: about 1 ms with speed-up driver, 2-4 ms without"
        ),
    )

    def opened(self, command: Expr, p: Any) -> Expr:
        """Share of a pulse period during which a valve stands open, signed like the command."""
        duty = minimum(absolute(command), 1.0)
        late, after = p.opening_delay / p.pulse_period, p.closing_delay / p.pulse_period
        begins = after * smooth_step((duty - late) * (1.0 / EDGE))
        stays = late * smooth_step((duty - 1.0 + after) * (1.0 / EDGE) + 1.0)
        return sign(command) * minimum(maximum(0.0, duty - late) + begins + stays, 1.0)
