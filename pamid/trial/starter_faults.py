"""Faults that can be planted in the machines behind the starter rigs: in a signal path, and against
a motion.

The forms are those of `starter_kernel`, none of them the catalogue's. Left out is what refitted
parameters take up whole (a gain, a linear damper if any): it leaves no gap.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from pamid.trial.faults import Draw, Fault, around, between, either, known_fault

#: effects that need both signs to show, or to differ from another effect
TWO_SIDED = (
    "asymmetric-dead-zone",
    "asymmetric-saturation",
    "rectification",
    "full-wave-rectification",
)
NEVER = 1e30  # where a limit is that is never reached


@dataclass(frozen=True)
class SignalSizes:
    """Changes of a signal on its path; the defaults change nothing.

    full, timescale_s: usual size and time scale of the signal; one_sided: it is never negative; the
    others in its unit.
    """

    full: float
    timescale_s: float
    one_sided: bool = False
    delay_s: float = 0.0
    half_gap: float = 0.0  # before it is taken along
    gap_s: float = 1.0  # in which it is
    swallowed: float = 0.0  # share of every turn, by stops of many widths
    swallowed_reach: float = 1.0
    band_up: float = 0.0  # half widths of a worn band about zero
    band_down: float = 0.0
    cap_up: float = 0.0  # 1 over a soft limit
    cap_down: float = 0.0
    blocked: float = 0.0  # share of what is negative that does not pass
    unsigned: float = 0.0  # share of it that passes with the other sign
    knee: float = 1.0  # of both
    coarse: float = 0.0  # steps
    pulse_s: float = 0.0  # of pulses of the full size, instead of the value
    ticks: float = 10.0  # of which a pulse is a whole number long
    lag_s: float = 0.0  # of a filter of second order
    warming: float = 0.0  # relative change of the gain
    warm_s: float = 1.0  # in which it comes about
    gain: float = 0.0  # off by so much, less at its full size
    zero: float = 0.0  # which moves by a tenth as it warms


@dataclass(frozen=True)
class ForceSizes:
    """Forces against a motion; the defaults are no force.

    force, travel, speed: usual values at the place; load, level: normal load of the surfaces, and a
    current or pressure (0: none); the others in units of force, position and velocity.
    """

    force: float
    travel: float
    speed: float
    load: float = 0.0
    level: float = 0.0
    dahl: float = 0.0  # dry friction of steep bristles
    load_share: float = 0.0  # the same, per unit of load
    level_share: float = 0.0  # the same, per unit of a current or pressure
    level_knee: float = 1.0  # below which it grows slower
    forward: float = 0.0  # the same, in each direction
    backward: float = 0.0
    dahl_reach: float = 1.0
    rounded: float = 0.0  # dry friction of stops of like widths
    rounded_reach: float = 1.0
    spread: float = 0.0  # hysteresis of stops of many widths
    spread_reach: float = 1.0
    loop: float = 0.0  # hysteresis of a loop of exponent 2
    loop_reach: float = 1.0
    loop_shape: float = 0.7
    plastic: float = 0.0  # elasto-plastic bristle
    plastic_peak: float = 0.0
    plastic_speed: float = 1.0
    plastic_reach: float = 1.0
    stick: float = 0.0  # a true stick, with an exponential fall
    stick_peak: float = 0.0
    stick_speed: float = 1.0
    grease: float = 0.0  # damping that thins with speed
    damping_forward: float = 0.0  # in one direction alone
    square_drag: float = 0.0  # at the usual speed, with its power of 1.9
    steep_drag: float = 0.0  # hyperbolic
    harden: float = 0.0  # a spring that hardens, then is straight
    tether: float = 0.0  # a spring that softens
    stop_stiffness: float = 0.0
    stop_at: float = NEVER
    weight: float = 0.0  # of what is out of balance
    weight_at: float = 0.0
    pull: float = 0.0  # constant, but for a tenth
    detent: float = 0.0
    pitch: float = 1.0
    detent_at: float = 0.0
    shake: float = 0.0
    shake_hz: float = 1.0
    shake_at: float = 0.0


@dataclass(frozen=True)
class SpringSizes:
    """A share of the inertia that hangs behind a spring; outboard_hz: its frequency with the shaft
    held; play: half gap before the spring, rad. No share is no spring."""

    outboard: float = 0.0
    outboard_hz: float = 10.0
    play: float = 0.0


@dataclass(frozen=True)
class ClockSizes:
    """The logger's clock: readings stamped early by so much at the start, and ever later since."""

    early_s: float = 0.0
    skew_ppm: float = 0.0


def clock_fault(port: str, period_s: float) -> Fault:
    """A separate clock for all readings; port: name under which they are reported."""
    return known_fault(
        "clock-skew",
        "sensor-timing",
        port,
        {"early_s": around(2.0 * period_s), "skew_ppm": either(50.0)},
        "early_s",
        "skew_ppm",
    )


def spring_faults(port: str, frequency_hz: float, play: float) -> tuple[Fault, ...]:
    """Springs behind a shaft, without and with play; frequency_hz, play: usual sizes."""
    family, share = "flexible-transmission", between(0.4, 0.8)
    soft = {"outboard": share, "outboard_hz": around(frequency_hz, 0.6, 1.6)}
    stiff = {
        "outboard": share,
        "outboard_hz": around(2.0 * frequency_hz, 0.7, 1.5),
        "play": around(play),
    }
    return (
        known_fault("two-mass", family, port, soft),
        known_fault("backlash", family, port, stiff, "outboard", "play"),
    )


def signal_faults(
    port: str, s: SignalSizes, seconds: float, sent: bool, leave_out: Iterable[str] = ()
) -> list[Fault]:
    """Faults of a signal path; sent: towards the machine; seconds: duration of a recording."""
    timing = "command-timing" if sent else "sensor-dynamics"
    band = {"band_up": around(0.08 * s.full), "band_down": around(0.08 * s.full)}
    cap = {"cap_up": around(1.6 / s.full, 0.85, 1.25), "cap_down": around(1.6 / s.full, 0.85, 1.25)}
    knee = between(0.01 * s.full, 0.04 * s.full)

    def fault(name: str, family: str, sizes: Mapping[str, Draw], *amounts: str) -> Fault:
        return known_fault(name, family, port, sizes, *amounts)

    faults = [
        fault("dead-time", timing, {"delay_s": around(0.15 * s.timescale_s)}),
        fault("first-order-lag", timing, {"lag_s": around(0.15 * s.timescale_s)}),
        fault("dead-zone", "saturation", band, *band),
        fault("asymmetric-dead-zone", "saturation", {"band_up": around(0.1 * s.full)}),
        fault("saturation", "saturation", cap, *cap),
        fault("asymmetric-saturation", "saturation", {"cap_up": around(2.0 / s.full, 0.8, 1.25)}),
        fault("rectification", "saturation", {"blocked": between(0.3, 1.0), "knee": knee}),
        fault(
            "full-wave-rectification",
            "saturation",
            {"unsigned": between(0.9, 1.0), "knee": knee},
        ),
        fault("quantisation", "saturation", {"coarse": around(0.06 * s.full)}),
        fault(
            "play",
            "flexible-transmission",
            {
                "half_gap": around(0.04 * s.full),
                "gap_s": between(0.02 * s.timescale_s, 0.05 * s.timescale_s),
            },
        ),
        fault(
            "signal-hysteresis",
            "hysteresis",
            {"swallowed": between(0.06, 0.15), "swallowed_reach": around(0.4 * s.full)},
        ),
        fault(
            "gain-drift",
            "gain-drift",
            {"warming": either(0.12), "warm_s": between(0.1 * seconds, 0.5 * seconds)},
        ),
        fault("gain-error", "sensor-gain", {"gain": either(0.08)}),
        fault("offset", "offset" if sent else "sensor-offset", {"zero": either(0.05 * s.full)}),
    ]
    absent = {*leave_out, *(TWO_SIDED if s.one_sided else ())}
    # below zero there is nothing that could tell them apart
    return [
        replace(f, exact=f.exact | {f"asymmetric-{name}" for name in f.exact})
        if s.one_sided and f.name in ("dead-zone", "saturation")
        else f
        for f in faults
        if f.name not in absent
    ]


def force_faults(port: str, s: ForceSizes, leave_out: Iterable[str] = ()) -> list[Fault]:
    """Forces that can act against a motion."""
    force, travel, speed = s.force, s.travel, s.speed
    steep = {"dahl_reach": around(1e-3 * travel)}
    peak = between(0.3, 1.0)

    def fault(name: str, family: str, sizes: Mapping[str, Draw], *amounts: str) -> Fault:
        return known_fault(name, family, port, sizes, *amounts)

    faults = [
        fault("coulomb-friction", "friction", {"dahl": around(0.06 * force), **steep}),
        fault(
            "stribeck-friction",
            "friction",
            {
                "stick": around(0.06 * force),
                "stick_peak": peak,
                "stick_speed": around(0.03 * speed),
            },
        ),
        fault(
            "lugre-friction",
            "friction",
            {
                "plastic": around(0.06 * force),
                "plastic_peak": peak,
                "plastic_speed": around(0.03 * speed),
                "plastic_reach": around(1e-3 * travel),
            },
        ),
        fault(
            "dahl-friction",
            "friction",
            {"rounded": around(0.06 * force), "rounded_reach": around(0.02 * travel)},
        ),
        fault(
            "directional-friction",
            "friction",
            {"forward": around(0.09 * force), "backward": around(0.03 * force), **steep},
            "forward",
            "backward",
        ),
        fault(
            "directional-damping",
            "friction",
            {"damping_forward": around(0.2 * force / speed)},
        ),
        fault(
            "maxwell-slip-hysteresis",
            "hysteresis",
            {"spread": around(0.08 * force), "spread_reach": around(0.1 * travel)},
        ),
        fault(
            "bouc-wen-hysteresis",
            "hysteresis",
            {
                "loop": around(0.08 * force),
                "loop_reach": around(0.05 * travel),
                "loop_shape": between(0.5, 1.0),
            },
        ),
        fault("viscous-friction", "friction", {"grease": around(0.15 * force / speed)}),
        fault(
            "load-dependent-friction",
            "friction",
            {"load_share": around(0.08 * force / s.load if s.load else 0.0), **steep},
        ),
        fault(
            "signal-dependent-friction",
            "friction",
            {
                "level_share": around(0.1 * force / s.level if s.level else 0.0),
                "level_knee": between(0.05 * s.level, 0.2 * s.level),
                **steep,
            },
        ),
        fault("quadratic-drag", "drag", {"square_drag": around(0.15 * force)}),
        fault("cubic-drag", "drag", {"steep_drag": around(0.1 * force)}),
        fault("cubic-stiffness", "stiffness", {"harden": around(0.2 * force)}),
        fault("linear-stiffness", "stiffness", {"tether": around(0.2 * force)}),
        fault(
            "end-stop",
            "end-stop",
            {
                "stop_stiffness": around(8.0 * force / travel),
                "stop_at": between(0.25 * travel, 0.35 * travel),
            },
        ),
        fault(
            "gravity",
            "gravity",
            {"weight": around(0.12 * force), "weight_at": between(-0.7, 0.7)},
        ),
        fault("constant-offset", "offset", {"pull": either(0.06 * force)}),
        fault(
            "cogging",
            "cogging",
            {
                "detent": around(0.08 * force),
                "pitch": around(0.08 * travel),
                "detent_at": between(0.0, 6.28),
            },
        ),
        fault(
            "external-vibration",
            "external-disturbance",
            {
                "shake": around(0.08 * force),
                "shake_hz": around(0.8 * speed / travel),
                "shake_at": between(0.0, 6.28),
            },
        ),
    ]
    lacking = {"load-dependent-friction": s.load, "signal-dependent-friction": s.level}
    return [f for f in faults if f.name not in leave_out and lacking.get(f.name, 1.0)]
