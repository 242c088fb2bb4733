"""Compiled parts of the trial's machines: valves, air, muscles, friction, sensors, controller.

`m` is the machine (fields of `plant.Specimen` and the known constants), `f` what is planted (fields
of `faults.Planted`), both as records; `x` the state of a joint, `s` that of its two muscles, `z` of
their hystereses; SI throughout. All functions live in this file: the compiler's cache looks
only at the file of the function that is called.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit

ATMOSPHERE = 101325.0  # Pa
REFERENCE_PA = 1.0e5  # Pa, of the conductances (ISO 8778)
ROOM = 293.15  # K
R_AIR, CV_AIR = 287.05, 717.6  # J/(kg K)
TANK = 2.0e-4  # m3, between regulator and valves
TUBE_VOLUME = 6.0e-5  # m3, of a tube that lags by 15 ms: a wide tube, that throttles little
BLEND = 10e3  # Pa, over which filling hands over to venting
HYSTERESIS_ELEMENTS = 12  # of each hysteresis
LAMINAR_RATIO = 0.99  # pressure ratio from which flow is linear
# samples at held pressures before a recording: the arm comes to hang where its muscles balance
HANGING = 333

# of the joint
ANGLE, SPEED, LOAD_ANGLE, LOAD_SPEED, SUPPLY, BRISTLE, LATCHED, ON_FOR, OFF_FOR, OPEN = range(10)
JOINT_STATES = 10
# of each muscle
(
    PRESSURE,
    TUBE,
    WARMTH,
    WALL,
    CONTRACTION,
    RATE,
    PULL,
    CREEP_1,
    CREEP_2,
    LOOP,
    THREAD,
    RELIEF,
    BLOWING,
    WEAR,
) = range(14)
MUSCLE_STATES = 14


@njit(cache=True)
def pulse(x: Array, m: Any, f: Any, command: float, clock: float, h: float, period: float) -> float:
    """Signed share of this step in which the drive is on; clock: s since the first sample."""
    duty, sign = abs(command), np.sign(command)
    # the poppet lifts sooner the harder it is driven: all is regained at full command
    if f.lost_duty > 0.0:
        duty = max(0.0, duty - f.lost_duty) * (1.0 + f.lost_duty * duty / (1.0 - f.lost_duty))
    if f.pulse_period_s <= 0.0:
        carrier = period / m.pulses_per_sample
        # the quarter step keeps rounding from turning the phase over
        begun = (clock + 0.25 * h) % carrier - 0.25 * h
        low, high = 0.5 * (1.0 - duty) * carrier, 0.5 * (1.0 + duty) * carrier
        return sign * max(0.0, min(begun + h, high) - max(begun, low)) / h
    begun = (clock + 0.25 * h) % f.pulse_period_s - 0.25 * h
    if f.tick_s > 0.0:
        if begun < 0.5 * h:
            ticks = np.floor(duty * f.pulse_period_s / f.tick_s + 0.5)
            x[LATCHED] = sign * min(ticks * f.tick_s, f.pulse_period_s)
        drive = begun < abs(x[LATCHED]) - 0.5 * h
        sign = np.sign(x[LATCHED])
    else:
        drive = abs(begun - 0.5 * f.pulse_period_s) < 0.5 * duty * f.pulse_period_s
    x[ON_FOR] = x[ON_FOR] + h if drive else 0.0
    x[OFF_FOR] = 0.0 if drive else x[OFF_FOR] + h
    if drive and x[ON_FOR] > f.opening_s:
        x[OPEN] = 1.0
    elif not drive and x[OFF_FOR] > f.closing_s:
        x[OPEN] = 0.0
    return sign * x[OPEN]


@njit(cache=True)
def through(up: float, down: float, conductance: float, ratio: float) -> float:
    """p V flow (W) of an ISO 6358 orifice, linear near equal pressures; 0 backwards."""
    if down >= up:
        return 0.0
    r = down / up
    if r > LAMINAR_RATIO:
        edge = (LAMINAR_RATIO - ratio) / (1.0 - ratio)
        shape = np.sqrt(1.0 - edge * edge) * (1.0 - r) / (1.0 - LAMINAR_RATIO)
    elif r > ratio:
        shape = np.sqrt(1.0 - ((r - ratio) / (1.0 - ratio)) ** 2)
    else:
        shape = 1.0
    return REFERENCE_PA * conductance * up * shape


@njit(cache=True)
def volume(m: Any, f: Any, contraction: float, pressure: float) -> tuple[float, float]:
    """Air volume (m3) and its slope over contraction: a cylinder of threads of fixed length."""
    length, thread = m.length * (1.0 - contraction), m.length / np.cos(m.braid_angle)
    turns = m.length * np.tan(m.braid_angle) / (np.pi * m.bore)
    swollen = (1.0 + f.bulge * ((pressure - ATMOSPHERE) / 6e5) ** 2) / (4.0 * np.pi * turns * turns)
    slope = swollen * (3.0 * length * length - thread * thread) * m.length
    return swollen * (thread * thread - length * length) * length + m.dead_volume, slope


@njit(cache=True)
def advance_air(
    i: int, x: Array, s: Array, m: Any, f: Any, valves: tuple[float, float], h: float
) -> float:
    """Pressures of muscle i after a step, for the openings of its valves (fill, vent). Returns
    the p V flow from the supply."""
    fill, vent = valves
    mate = (1.0 - 2.0 * i) * 0.5
    share = (1.0 + mate * f.flow_mismatch) * (1.0 - f.wear * s[i, WEAR])
    c_in, c_out = (m.fill_1, m.vent_1) if i == 0 else (m.fill_2, m.vent_2)
    at_valve = s[i, TUBE] if f.tube_s > 0.0 else s[i, PRESSURE]
    drawn = fill * through(x[SUPPLY], at_valve, share * c_in, m.critical_ratio)
    gained = drawn
    lost = vent * through(at_valve, ATMOSPHERE, share * c_out, m.critical_ratio)
    if f.tube_s > 0.0:
        space = TUBE_VOLUME * np.sqrt(f.tube_s / 0.015)
        pressed = s[i, PRESSURE] * h / f.tube_s + s[i, TUBE] + h * (gained - lost) / space
        s[i, TUBE] = pressed / (1.0 + h / f.tube_s)
        passed = (s[i, TUBE] - s[i, PRESSURE]) * space / f.tube_s
        gained, lost = max(passed, 0.0), max(-passed, 0.0)
    # a hole: another critical ratio than the valves', not quite alike in both muscles
    if f.leak > 0.0:
        lost += through(s[i, PRESSURE], ATMOSPHERE, f.leak * (1.0 + 0.4 * mate) * m.vent_1, 0.25)
    if f.relief > 0.0:
        s[i, RELIEF] += h / 0.01 * (s[i, BLOWING] - s[i, RELIEF])
        lost += s[i, RELIEF] * through(
            s[i, PRESSURE], ATMOSPHERE, f.relief * m.vent_1, m.critical_ratio
        )
    inside, slope = volume(m, f, s[i, CONTRACTION], s[i, PRESSURE])
    heating = gained - lost - s[i, PRESSURE] * slope * s[i, RATE]
    change = (1.0 + (m.polytropic - 1.0) * (1.0 - f.heat)) * heating / inside
    if f.heat > 0.0:
        warmth, wall = s[i, WARMTH], s[i, WALL]
        mass = s[i, PRESSURE] * inside / (R_AIR * warmth)
        stored = (
            gained * (1.4 - warmth / ROOM) / 0.4
            - lost * warmth / ROOM
            - s[i, PRESSURE] * slope * s[i, RATE]
        )
        turning = (f.heat * stored - f.wall_w_k * (warmth - wall)) / (mass * CV_AIR)
        s[i, WARMTH] += h * turning
        s[i, WALL] += h * (f.wall_w_k * (warmth - wall) - 0.3 * (wall - ROOM)) / 25.0
        change += s[i, PRESSURE] * turning / warmth
    s[i, PRESSURE] = max(s[i, PRESSURE] + h * change, 0.5 * ATMOSPHERE)
    s[i, WEAR] += h / f.wear_s * (min(1.0, 3.0 * (fill + vent)) - s[i, WEAR])
    return drawn


@njit(cache=True)
def pair_air(x: Array, s: Array, m: Any, f_1: Any, f_2: Any, drive: float, h: float) -> float:
    """Pressures of both muscles after a step: the first is filled up to p0, then the other
    vented. Returns the p V flow from the supply; f_1, f_2: faults of each muscle."""
    share_1 = min(max((m.hold_pressure - s[0, PRESSURE]) / BLEND, 0.0), 1.0)
    share_2 = min(max((m.hold_pressure - s[1, PRESSURE]) / BLEND, 0.0), 1.0)
    up, down = max(drive, 0.0), max(-drive, 0.0)
    drawn = advance_air(0, x, s, m, f_1, (up * share_1, down * (1.0 - share_2)), h)
    return drawn + advance_air(1, x, s, m, f_2, (down * share_2, up * (1.0 - share_1)), h)


@njit(cache=True)
def supply_after(pressure: float, drawn: float, m: Any, f: Any, h: float) -> float:
    """Supply pressure (Pa) a step later, for the p V flow drawn behind the regulator."""
    if f.sag_pa <= 0.0:
        return pressure
    settling = TANK * f.sag_pa / 3e-3 / REFERENCE_PA
    return (pressure + h * (m.supply_pressure / settling - drawn / TANK)) / (1.0 + h / settling)


@njit(cache=True)
def static_pull(
    i: int, contraction: float, pressure: float, m: Any, f: Any, waves: Array, worn: float
) -> float:
    """Force (N) of muscle i at rest; pressure gauge; waves: (amplitude, cycles per unit, phase)
    along contraction."""
    side = 1.0 - 2.0 * i
    chi = 1.0 - (1.0 - contraction) / (1.0 + 0.5 * side * f.length_difference)
    p = pressure
    if f.threshold_pa > 0.0:
        p -= f.threshold_pa * (1.0 - np.exp(-max(pressure, 0.0) / f.threshold_pa))
    if m.law < 0.5:  # threads of fixed length, less rubber; both fitted to the maker's chart
        stretch = 1.0 - chi
        pull = 1.38684e-3 * p * (3.0 * stretch * stretch - 1.15810)
        pull -= m.rubber * (466.146 * chi + 216.997 * chi / (abs(chi) + 0.024169))
    else:  # plain quadratic through the maker's chart
        e, y = 10.0 * chi, p / 6e5
        pull = -19.6749 + 1536.711 * y - (325.0654 + 470.9367 * y) * e + 104.5089 * e * e
    error = waves[i, 0, 0] * np.cos(waves[i, 0, 1] * pressure + waves[i, 0, 2])
    for k in range(1, waves.shape[1]):
        error += waves[i, k, 0] * np.cos(waves[i, k, 1] * chi + waves[i, k, 2])
    stronger = 1.0 + 0.5 * side * f.force_difference * (0.7 + 3.0 * chi)
    return (
        m.scale
        * stronger
        * (1.0 + error)
        * (1.0 + worn * (m.drift_1 if i == 0 else m.drift_2))
        * pull
    )


@njit(cache=True)
def held_back(i: int, chi: float, step: float, rate: float, s: Array, z: Array, f: Any) -> float:
    """Rate-independent friction (N) in a muscle after contracting by `step`; z: elements."""
    pressed = max(s[i, PRESSURE] - ATMOSPHERE, 0.0) / 6e5
    force = 0.0
    if f.slip_n > 0.0:  # widths over a factor 50, ever weaker
        total = weights = 0.0
        for j in range(HYSTERESIS_ELEMENTS):
            width = f.slip_reach * 10.0 ** (-1.2 + 1.7 * j / (HYSTERESIS_ELEMENTS - 1))
            weight = np.exp(-width / f.slip_reach)
            z[i, 0, j] = min(max(z[i, 0, j] + step, -width), width)
            total += weight * z[i, 0, j] / width
            weights += weight
        force += f.slip_n * (0.12 + 0.88 * pressed**0.8) * total / weights
    if f.play_n > 0.0:  # even widths along a bent scale of contraction: the two branches differ
        total = 0.0
        for j in range(HYSTERESIS_ELEMENTS):
            width = f.play_reach * (j + 0.5) / HYSTERESIS_ELEMENTS
            z[i, 1, j] = min(
                max(z[i, 1, j] + step * (1.0 + f.play_bend * (chi - 0.1)), -width), width
            )
            total += z[i, 1, j] / width / HYSTERESIS_ELEMENTS
        force += f.play_n * (0.12 + 0.88 * pressed**0.8) * total
    if f.loop_n > 0.0:
        old = s[i, LOOP]
        bend = f.loop_shape * abs(step) * abs(old) * old + (1.0 - f.loop_shape) * step * old * old
        s[i, LOOP] = min(max(old + (step - bend) / f.loop_reach, -1.0), 1.0)
        force += f.loop_n * (0.12 + 0.88 * pressed**0.8) * s[i, LOOP]
    if f.thread_n > 0.0:
        s[i, THREAD] += (step - abs(step) * s[i, THREAD]) / f.thread_reach
        s[i, THREAD] = min(max(s[i, THREAD], -1.0), 1.0)
        force += f.thread_n * pressed * (1.0 + 0.3 * np.exp(-abs(rate) / 0.01)) * s[i, THREAD]
    return force


@njit(cache=True)
def advance_pull(
    i: int, muscles: Any, m: Any, f: Any, force_map: Any, motion: tuple[float, float], h: float
) -> None:
    """Force of muscle i; an elastic chain lets the muscle run ahead of the angle. muscles: (s, z);
    force_map: (waves, worn); motion: contraction by the angle, and its rate."""
    (s, z), (waves, worn), (at, rate) = muscles, force_map, motion
    absolute = s[i, PRESSURE]
    p = absolute - ATMOSPHERE
    old = s[i, CONTRACTION]
    crept = s[i, CREEP_1] + s[i, CREEP_2]
    if f.chain_m_n > 0.0:
        dry = held_back(i, old, h * s[i, RATE], s[i, RATE], s, z, f)
        surplus = static_pull(i, old + crept, p, m, f, waves, worn) - dry
        stretch = m.length * (old - at)
        hard = (1.0 + abs(stretch) / 0.02) / f.chain_m_n
        moved = (
            h * (surplus - hard * stretch) / (m.damping * absolute + h * (m.length * hard + 5e3))
        )
        if stretch + m.length * moved < 0.0:  # slack: nothing holds the muscle
            moved = h * surplus / (m.damping * absolute + h * 5e3)
        s[i, CONTRACTION], s[i, RATE] = old + moved, moved / h
        pull = hard * (stretch + m.length * moved)
    else:
        dry = held_back(i, at, at - old, rate, s, z, f)
        s[i, CONTRACTION], s[i, RATE] = at, rate
        pull = static_pull(i, at + crept, p, m, f, waves, worn) - m.damping * absolute * rate - dry
        if rate < 0.0:
            pull += f.stretch_drag * rate * rate
    s[i, PULL] = max(pull, 0.0)
    s[i, CREEP_1] += h / f.creep_1_s * (0.5 * f.creep_1_n * s[i, PULL] - s[i, CREEP_1])
    s[i, CREEP_2] += h / f.creep_2_s * (0.5 * f.creep_1_n * s[i, PULL] - s[i, CREEP_2])
    if s[i, PULL] > f.relief_n * m.scale:
        s[i, BLOWING] = 1.0
    elif s[i, PULL] < 0.95 * f.relief_n * m.scale:
        s[i, BLOWING] = 0.0


@njit(cache=True)
def winding(x: Array, m: Any, f: Any) -> tuple[float, float]:
    """Length that a joint's wheel has wound between the two chains, over the length of a
    muscle, and its lever (m)."""
    turn = f.wheel_waves * x[ANGLE] + f.wheel_rad
    wound = (
        m.radius
        * (x[ANGLE] + f.wheel / f.wheel_waves * (np.sin(turn) - np.sin(f.wheel_rad)))
        / m.length
    )
    return wound, m.radius * (1.0 + f.wheel * np.cos(turn))


@njit(cache=True)
def pair_torque(x: Array, muscles: Any, m: Any, f: Any, force_map: Any, h: float) -> float:
    """Torque (N m) of both muscles on the wheel; f: faults of the joint and of each muscle; the
    others as of `advance_pull`."""
    s = muscles[0]
    wound, lever = winding(x, m, f[0])
    rate = lever * x[SPEED] / m.length
    advance_pull(0, muscles, m, f[1], force_map, (m.contraction_0 + wound, rate), h)
    advance_pull(1, muscles, m, f[2], force_map, (m.contraction_0 - wound, -rate), h)
    return lever * (s[0, PULL] - s[1, PULL])


@njit(cache=True)
def place_torque(x: Array, f: Any, clock: float) -> float:
    """Torques (N m) that depend on angle, speed and time alone."""
    angle = x[ANGLE]
    torque = -f.weight_nm * np.sin(angle + f.weight_rad) - f.detent_nm * np.sin(f.detents * angle)
    torque -= f.bent_damping * x[SPEED] * np.sin(1.5 * angle + 0.5) ** 2
    turn = 2.0 * np.pi * f.shake_hz * clock + f.shake_rad
    torque += f.shake_nm * (np.sin(turn) + 0.25 * np.sin(2.0 * turn + 1.0))
    deep = abs(angle) - f.stop_rad
    if f.stop_nm_rad > 0.0 and deep > 0.0:
        torque -= np.sign(angle) * f.stop_nm_rad * max(0.0, deep + 0.01 * np.sign(angle) * x[SPEED])
    return torque


@njit(cache=True)
def bristles(x: Array, f: Any, h: float) -> float:
    """Friction torque (N m) of bending contacts: steep Dahl, elasto-plastic bristle."""
    speed = x[SPEED]
    if f.dahl_nm > 0.0:
        z = x[BRISTLE]
        yielding = 1.0 - z * np.sign(speed)
        x[BRISTLE] = min(
            max(z + h * speed / f.dahl_rad * abs(yielding) ** 1.5 * np.sign(yielding), -1.0), 1.0
        )
        return f.dahl_nm * x[BRISTLE]
    if f.plastic_nm > 0.0:
        level = f.plastic_nm * (1.0 + f.plastic_peak / (1.0 + (speed / f.plastic_rad_s) ** 2))
        stiffness = f.plastic_nm / f.plastic_rad
        z, most = x[BRISTLE], level / stiffness
        slip = 0.0
        if z * speed > 0.0 and abs(z) > 0.7 * most:  # purely elastic below: it does not creep
            slip = 0.5 + 0.5 * np.sin(np.pi * (min(abs(z) / most, 1.0) - 0.85) / 0.3)
        bending = speed * (1.0 - slip * abs(z) / most)
        x[BRISTLE] = min(max(z + h * bending, -most), most)
        return stiffness * (x[BRISTLE] + 0.001 * bending)
    return 0.0


@njit(cache=True)
def link_torque(twist: float, turning: float, load: float, f: Any) -> float:
    """Torque (N m) that spring or play pass on to an inertia (kg m2) hung on behind the joint."""
    beyond = twist - min(max(twist, -f.play_rad), f.play_rad)
    swing = 2.0 * np.pi * f.outboard_hz
    link = load * swing * swing * beyond * (1.0 + (beyond / f.harden_rad) ** 2)
    if beyond != 0.0:
        link += 2.0 * f.outboard_damping * load * swing * turning
    return 0.0 if f.play_rad > 0.0 and link * beyond <= 0.0 else link


@njit(cache=True)
def sticking(speed: float, f: Any) -> float:
    """Level (N m) of the dry friction that stops the joint."""
    return f.stick_nm * (1.0 + f.stick_peak * np.exp(-abs(speed) / f.stick_rad_s))


@njit(cache=True)
def at_rest(s: Array, m: Any) -> None:
    """Both muscles at p0 and at the temperature of the room, the joint in the middle."""
    s[:, PRESSURE] = s[:, TUBE] = m.hold_pressure
    s[:, WARMTH] = s[:, WALL] = ROOM
    s[:, CONTRACTION] = m.contraction_0


@njit(cache=True)
def smoothed(y: Array, value: float, lag: float, h: float) -> None:
    """Second-order filter of a reading y = (value, rate)."""
    corner = 1.6 / lag
    y[1] += h * corner * (corner * (value - y[0]) - 1.6 * y[1])
    y[0] += h * y[1]


@njit(cache=True)
def moved_zero(angle: float, f: Any) -> float:
    """Angle (rad) as read by a sensor with a zero error."""
    return angle + f.zero_rad * (1.0 + 0.05 * np.sin(angle))


@njit(cache=True)
def command_of(
    memory: Array,
    k: int,
    reference: float,
    angle_deg: float,
    m: Any,
    controller: Array,
    period: float,
) -> float:
    """The PD controller's command at sample k for a noisy angle; memory: its last error and the
    slope of it, in deg and s."""
    kp, kd, smoothing, limit = controller
    error = reference - np.floor(angle_deg / m.angle_step + 0.5) * m.angle_step
    if k > 0:
        memory[1] += ((error - memory[0]) / period - memory[1]) * period / (smoothing + period)
    memory[0] = error
    return min(max(kp * error + kd * memory[1], -limit), limit)


@njit(cache=True)
def driven(x: Array, m: Any, f: Any, commands: Array, at: int, steps: int, period: float) -> float:
    """Signed share of step `at` in which the drive is on; commands: a value per sample."""
    h = period / steps
    late = int(np.floor((at - f.delay_s / h + 1e-6) / steps))
    return pulse(x, m, f, commands[late] if late >= 0 else 0.0, at * h, h, period)
