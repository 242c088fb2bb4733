"""Faults that can be planted in the trial's joint: every effect of the catalogue in another form,
and some without a name.

Sizes are log-uniform between half and two and a half times the typical size; ranges that are not
marked so are even.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import radians
from typing import Any

import numpy as np

from pamid.base.errors import UsageError

Draw = Callable[[np.random.Generator], float]

NAMELESS = "nameless:"  # leads the name of a fault that is in no catalogue

HIGH_INERTIA = "high-inertia"  # shows with a heavy load only
LONG_HOLDS = "long-holds"  # needs holds of 10 s and more
WIDE_RANGE = "wide-range"  # needs angles of 30 deg and more
PRESSURES = "pressures"  # seen by the pressure readings only


@dataclass(frozen=True)
class Planted:
    """Sizes of all faults, SI; the defaults plant nothing."""

    # command
    delay_s: float = 0.0  # every command comes so much later
    # duty below which the valves stay shut; regained towards full command
    lost_duty: float = 0.0
    pulse_period_s: float = 0.0  # of a slow pulse-width modulation, instead of the fast modulation
    tick_s: float = 0.0  # the slow pulses are whole ticks long; 0: any length
    opening_s: float = 0.0  # from the beginning of a slow pulse to the open valve
    closing_s: float = 0.0  # from its end to the shut valve
    # valve
    # volume times resistance of the tube over the reference pressure
    tube_s: float = 0.0
    sag_pa: float = 0.0  # lost by the regulator at 3 l/s
    flow_mismatch: float = 0.0  # share by which muscle 1 flows better than muscle 2
    wear: float = 0.0  # share of the conductance lost to hot valves in constant use
    wear_s: float = 8.0  # time in which the valves warm and cool
    # pressure
    leak: float = 0.0  # conductance of a hole, in vent valves
    # share of adiabatic heating that reaches the air, 0 (isothermal) to 1
    heat: float = 0.0
    wall_w_k: float = 0.9  # heat passed to the wall
    # share by which the muscle swells at 6 bar, with the square of pressure
    bulge: float = 0.0
    # muscle
    slip_n: float = 0.0  # elasto-slip friction at 6 bar, of many widths
    slip_reach: float = 0.004  # contraction
    play_n: float = 0.0  # friction of stops on a bent scale at 6 bar
    play_reach: float = 0.016  # contraction
    play_bend: float = 0.0  # relative change of that scale per unit of contraction
    loop_n: float = 0.0  # friction of a Bouc-Wen loop of exponent 2 at 6 bar
    loop_reach: float = 0.0048  # contraction
    loop_shape: float = 0.7  # 0.5: unloads with full stiffness; 1: Dahl
    thread_n: float = 0.0  # friction between threads at 6 bar, strictly with pressure
    thread_reach: float = 5e-4  # contraction
    # contraction yielded in the end per newton, in two equal branches
    creep_1_n: float = 0.0
    creep_1_s: float = 3.0  # time of the fast part
    creep_2_s: float = 20.0  # time of the slow part
    threshold_pa: float = 0.0  # pressure lost to the membrane, with a soft knee
    force_difference: float = 0.0  # share by which muscle 1 is stronger than 2
    length_difference: float = 0.0  # share by which muscle 1 is longer than 2
    relief: float = 0.0  # opening of the safety valve, in vent valves
    relief_n: float = 1e9  # force at which it pops open, on a specimen of scale 1
    # N s2, loss with the square of the rate while the muscle is stretched
    stretch_drag: float = 0.0
    # joint
    dahl_nm: float = 0.0  # steep Dahl friction
    dahl_rad: float = 7e-4  # its reach
    stick_nm: float = 0.0  # friction with a true stick and an exponential fall
    stick_peak: float = 0.0  # breakaway above sliding, relative
    stick_rad_s: float = 0.05  # speed of the fall
    plastic_nm: float = 0.0  # elasto-plastic bristle
    plastic_peak: float = 0.0  # breakaway above sliding, relative
    plastic_rad_s: float = 0.05  # speed of the fall
    plastic_rad: float = 1e-3  # elastic reach
    weight_nm: float = 0.0  # m g l sin(tilt)
    weight_rad: float = 0.0  # angle of the arm above its lowest position at zero
    stop_nm_rad: float = 0.0  # stiffness of the buffers
    stop_rad: float = 0.5  # where they stand
    shake_nm: float = 0.0  # outside torque, with a quarter of second harmonic
    shake_hz: float = 5.0
    shake_rad: float = 0.0  # its phase
    bent_damping: float = 0.0  # N m s, damping that depends on the angle
    detent_nm: float = 0.0  # cogging torque
    detents: float = 12.0  # per turn
    # structure
    outboard: float = 0.0  # share of the inertia behind the joint
    outboard_hz: float = 8.0  # its frequency with the joint held, at small amplitude
    outboard_damping: float = 0.02  # damping ratio
    harden_rad: float = 0.05  # twist at which the spring is twice as stiff (secant)
    play_rad: float = 0.0  # half gap before the spring
    chain_m_n: float = 0.0  # stretch of each chain per newton; twice as stiff at 2 cm
    wheel: float = 0.0  # relative change of the wheel's radius round the turn
    wheel_waves: float = 1.0  # times a turn
    wheel_rad: float = 0.0  # phase
    # sensor
    zero_rad: float = 0.0  # zero of the angle
    angle_lag_s: float = 0.0  # of a second-order filter
    pressure_lag_s: float = 0.0
    pressure_zero_pa: float = 0.0  # of sensor 1; nine tenths of it of sensor 2
    pressure_gain: float = 0.0
    # readings stamped early by so much at the start of the recording
    early_s: float = 0.0
    skew_ppm: float = 0.0  # and ever later since


@dataclass(frozen=True)
class Fault:
    """A fault that the joint can have.

    name     catalogue name of the effect that is the truth, or NAMELESS and a word
    exact    catalogue names that are the exact answer
    sizes    fields of `Planted` and how each is drawn
    amounts  those of them that are zero when nothing is planted
    needs    what a recording must have to show it
    """

    name: str
    family: str
    port: str
    sizes: Mapping[str, Draw]
    amounts: tuple[str, ...]
    exact: frozenset[str] = frozenset()
    needs: frozenset[str] = field(default_factory=frozenset)

    @property
    def truth(self) -> dict[str, Any]:
        """Right answer where the fault is planted."""
        return {
            "fault": self.name,
            "family": self.family,
            "port": self.port,
            "exact": sorted(self.exact),
        }

    def draw(self, random: np.random.Generator) -> dict[str, float]:
        """Sizes of a case, SI."""
        return {name: float(size(random)) for name, size in self.sizes.items()}


def planted(faults: Mapping[str, Mapping[str, float]]) -> Planted:
    """Sizes by fault name, put together. UsageError: two faults that set the same size."""
    together: dict[str, float] = {}
    for name, sizes in faults.items():
        for key, value in sizes.items():
            if key in together:
                raise UsageError(
                    f"Fault {name!r} sets {key!r}, which another fault has set.",
                    "Plant only the first or only the second.",
                )
            together[key] = float(value)
    return Planted(**together)


def around(typical: float, low: float = 0.5, high: float = 2.5) -> Draw:
    """Log-uniform between `low` and `high` times the typical size."""
    return lambda random: typical * float(np.exp(random.uniform(np.log(low), np.log(high))))


def either(typical: float) -> Draw:
    """The same with either sign."""
    return lambda random: float(random.choice((-1.0, 1.0))) * around(typical)(random)


def between(low: float, high: float) -> Draw:
    return lambda random: float(random.uniform(low, high))


def fixed(value: float) -> Draw:
    return lambda random: value


def drawn_from(*values: float) -> Draw:
    return lambda random: float(random.choice(values))


def known_fault(
    name: str,
    family: str,
    port: str,
    sizes: Mapping[str, Draw],
    *amounts: str,
    also: tuple[str, ...] = (),
    needs: tuple[str, ...] = (),
) -> Fault:
    """An effect of the catalogue; without `amounts` only the first size is set. also: other
    names of the very same."""
    return Fault(
        name,
        family,
        port,
        sizes,
        amounts or (next(iter(sizes)),),
        frozenset((name, *also)),
        frozenset(needs),
    )


def nameless_fault(word: str, port: str, sizes: Mapping[str, Draw]) -> Fault:
    """A fault that is in no catalogue."""
    return Fault(f"{NAMELESS}{word}", "", port, sizes, (next(iter(sizes)),))


_HYSTERESIS, _FRICTION, _VALVE = "muscle-hysteresis", "friction", "valve-dead-band"
_FLEXIBLE = "flexible-transmission"

_ALL = (
    known_fault("dead-time", "command-timing", "command", {"delay_s": around(0.012)}),
    known_fault("valve-dead-band", _VALVE, "command", {"lost_duty": around(0.05)}),
    known_fault(
        "valve-switching",
        _VALVE,
        "command",
        {"pulse_period_s": fixed(0.03), "opening_s": around(0.002), "closing_s": around(0.001)},
    ),
    known_fault(
        "pwm-quantisation",
        _VALVE,
        "command",
        {"pulse_period_s": fixed(0.03), "tick_s": around(0.003)},
    ),
    known_fault("tube-lag", "tube-lag", "valve", {"tube_s": around(0.015)}),
    known_fault("supply-sag", "supply-sag", "valve", {"sag_pa": around(45e3)}),
    known_fault("flow-mismatch", "flow-mismatch", "valve", {"flow_mismatch": either(0.12)}),
    known_fault("leak", "leak", "pressure", {"leak": around(0.01)}),
    known_fault(
        "heat-transfer",
        "heat-transfer",
        "pressure",
        {"heat": around(0.5, 0.5, 2.0), "wall_w_k": between(0.5, 1.8)},
    ),
    # a sum of stops of any widths: the same operator
    known_fault(
        "maxwell-slip-hysteresis",
        _HYSTERESIS,
        "muscle",
        {"slip_n": around(35.0), "slip_reach": around(0.004)},
        also=("prandtl-ishlinskii-hysteresis",),
    ),
    known_fault(
        "bouc-wen-hysteresis",
        _HYSTERESIS,
        "muscle",
        {"loop_n": around(35.0), "loop_reach": around(0.0048), "loop_shape": between(0.5, 1.0)},
    ),
    known_fault(
        "prandtl-ishlinskii-hysteresis",
        _HYSTERESIS,
        "muscle",
        {"play_n": around(35.0), "play_reach": around(0.016), "play_bend": between(-5.0, 5.0)},
    ),
    known_fault(
        "thread-friction",
        _HYSTERESIS,
        "muscle",
        {"thread_n": around(28.0), "thread_reach": around(5e-4)},
    ),
    known_fault(
        "muscle-creep",
        "muscle-creep",
        "muscle",
        {
            "creep_1_n": around(1e-5),
            "creep_1_s": between(1.0, 5.0),
            "creep_2_s": between(10.0, 40.0),
        },
        needs=(LONG_HOLDS,),
    ),
    known_fault(
        "threshold-pressure", "threshold-pressure", "muscle", {"threshold_pa": around(20e3)}
    ),
    known_fault("force-asymmetry", "asymmetry", "muscle", {"force_difference": either(0.05)}),
    known_fault(
        "length-asymmetry",
        "asymmetry",
        "muscle",
        {"length_difference": either(0.01)},
        also=("angle-sensor-offset",),
    ),
    known_fault(
        "angle-sensor-offset",
        "asymmetry",
        "sensor",
        {"zero_rad": either(radians(1.0))},
        also=("length-asymmetry",),
    ),
    known_fault(
        "force-compensator",
        "force-limit",
        "muscle",
        {"relief": around(0.5), "relief_n": between(680.0, 780.0)},
    ),
    known_fault(
        "coulomb-friction", _FRICTION, "joint", {"dahl_nm": around(0.3), "dahl_rad": around(7e-4)}
    ),
    known_fault(
        "stribeck-friction",
        _FRICTION,
        "joint",
        {"stick_nm": around(0.3), "stick_peak": between(0.3, 1.0), "stick_rad_s": around(0.05)},
    ),
    known_fault(
        "lugre-friction",
        _FRICTION,
        "joint",
        {
            "plastic_nm": around(0.3),
            "plastic_peak": between(0.3, 1.0),
            "plastic_rad_s": around(0.05),
            "plastic_rad": around(1e-3),
        },
    ),
    known_fault(
        "end-stop",
        "end-stop",
        "joint",
        {"stop_nm_rad": around(700.0), "stop_rad": between(radians(22.0), radians(30.0))},
        needs=(WIDE_RANGE,),
    ),
    known_fault(
        "gravity",
        "gravity",
        "joint",
        {"weight_nm": either(0.5), "weight_rad": between(radians(-40.0), radians(40.0))},
    ),
    known_fault(
        "external-vibration",
        "external-disturbance",
        "joint",
        {"shake_nm": around(0.3), "shake_hz": between(1.5, 15.0), "shake_rad": between(0.0, 6.28)},
    ),
    known_fault(
        "two-mass",
        _FLEXIBLE,
        "structure",
        {
            "outboard": between(0.5, 0.9),
            "outboard_hz": around(5.0),
            "outboard_damping": between(0.005, 0.05),
        },
        needs=(HIGH_INERTIA,),
    ),
    known_fault(
        "backlash",
        _FLEXIBLE,
        "structure",
        {
            "outboard": between(0.5, 0.9),
            "outboard_hz": between(5.0, 14.0),
            "outboard_damping": between(0.01, 0.05),
            "harden_rad": fixed(1.0),
            "play_rad": around(0.0042),
        },
        needs=(HIGH_INERTIA,),
    ),
    known_fault("chain-stretch", _FLEXIBLE, "structure", {"chain_m_n": around(5e-6)}),
    known_fault("angle-sensor-lag", "sensor-dynamics", "sensor", {"angle_lag_s": around(0.005)}),
    known_fault(
        "pressure-sensor-lag",
        "sensor-dynamics",
        "sensor",
        {"pressure_lag_s": around(0.008)},
        needs=(PRESSURES,),
    ),
    known_fault(
        "pressure-sensor-offset",
        "sensor-offset",
        "sensor",
        {"pressure_zero_pa": either(5e3)},
        needs=(PRESSURES,),
    ),
    known_fault(
        "pressure-sensor-gain",
        "sensor-gain",
        "sensor",
        {"pressure_gain": either(0.03)},
        needs=(PRESSURES,),
    ),
    known_fault(
        "clock-skew",
        "sensor-timing",
        "sensor",
        {"early_s": around(0.006), "skew_ppm": either(50.0)},
        "early_s",
        "skew_ppm",
    ),
    nameless_fault(
        "eccentric-wheel",
        "structure",
        {
            "wheel": around(0.06),
            "wheel_waves": drawn_from(1.0, 3.0),
            "wheel_rad": between(0.0, 6.28),
        },
    ),
    nameless_fault("bent-damping", "joint", {"bent_damping": around(1.5)}),
    nameless_fault("bulge", "pressure", {"bulge": around(0.15)}),
    nameless_fault("one-sided-drag", "muscle", {"stretch_drag": around(4000.0)}),
    nameless_fault(
        "detent", "joint", {"detent_nm": around(0.5), "detents": drawn_from(12.0, 18.0, 24.0)}
    ),
    nameless_fault(
        "hot-valves", "valve", {"wear": around(0.12, 0.5, 2.5), "wear_s": between(4.0, 15.0)}
    ),
)

FAULTS: dict[str, Fault] = {fault.name: fault for fault in _ALL}
