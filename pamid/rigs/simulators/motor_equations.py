"""A motor with a winding, as in MuJoCo (XML reference, dcmotor; DC Motor Model, sections 1, 2).

    v = R i + K w,   torque = K i,   R = R0 (1 + alpha (T + ambient - reference))

The controller commands kp (u - l) + ki x + kd (u' - w) + torque. It applies a voltage that
compensates R0 and K w. The actuator's range limits K i. Cogging and bristles add to it without a
limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pamid.engine.symbolic.vocabulary import (
    ZERO,
    Expr,
    absolute,
    clip,
    exp,
    maximum,
    minimum,
    sin,
    where,
)
from pamid.rigs.simulators.mechanism import Actuator, WindingMotor

#: of a parameter: attribute and the number in the file -> the expression
Value = Callable[[str, float], Expr]
LEAST = 1e-15  # divisor, MuJoCo's mjMINVAL


def motor_equations(
    actuator: Actuator,
    motor: WindingMotor,
    value: Value,
    states: Mapping[str, Expr],
    command: Expr,
    travel: tuple[Expr, Expr],
) -> tuple[Expr, dict[str, Expr]]:
    """Torque of a motor with this command, length and velocity, and the rates of its states."""
    length, velocity = travel
    rates: dict[str, Expr] = {}

    def named(word: str) -> str:
        """Name of a state, "" if the motor has none."""
        name = f"{actuator.name}_{word}"
        return name if name in states else ""

    resistance = value("resistance", motor.resistance)
    constant = value("motorconst", motor.constant)
    hot, heat = resistance, named("temperature")
    if heat:
        _, _, ambient, reference, coefficient = motor.heating
        hot = hot * (1.0 + coefficient * (states[heat] + (ambient - reference)))

    voltage = command
    if motor.input not in ("voltage", "none"):
        kp, ki, kd = (
            value(word, stated)
            for word, stated in zip(("kp", "ki", "kd"), motor.controller, strict=True)
        )
        aim = {motor.input: command}
        torque = aim.get("ff", ZERO) + kp * (aim.get("pos", ZERO) - length)
        torque = torque + kd * (aim.get("vel", ZERO) - velocity)
        if name := named("integral"):
            grown, rate = states[name], command - length
            torque = torque + ki * grown
            if (most := motor.integral_limit) > 0.0:
                rate = where(grown >= most, minimum(rate, 0.0), rate)
                rate = where(grown <= -most, maximum(rate, 0.0), rate)
            rates[name] = rate
        voltage = resistance / constant * torque + constant * velocity
        if (most := motor.voltage_limit) > 0.0:
            voltage = clip(voltage, -most, most)

    current = (voltage - constant * velocity) / hot
    if slow := named("current"):
        lag = value("time_constant", actuator.time_constant_s)
        change, most = (current - states[slow]) / lag, motor.current_rate
        rates[slow] = clip(change, -most, most) if most > 0.0 else change
        current = states[slow]
    if heat:
        lost = states[heat] / value("thermal_resistance", motor.heating[0])
        capacitance = value("thermal_capacitance", motor.heating[1])
        rates[heat] = (hot * current * current - lost) / capacitance
    torque = constant * current
    if actuator.force_range is not None:
        torque = clip(torque, *actuator.force_range)

    passive = ZERO
    amplitude, periods, phase = motor.cogging
    if amplitude:
        passive = value("cogging", amplitude) * sin(periods * length + phase)
    if name := named("bristle"):
        words = ("stiffness", "damping", "coulomb", "static", "stribeck")
        stiffness, damping, sliding, static, speed = (
            value(f"lugre_{word}", stated)
            for word, stated in zip(words, motor.bristles, strict=True)
        )
        ratio = velocity / maximum(speed, LEAST)
        level = maximum(sliding + (static - sliding) * exp(-ratio * ratio), LEAST)
        bent = states[name]
        rates[name] = velocity - stiffness * absolute(velocity) / level * bent
        passive = passive - stiffness * bent - damping * rates[name]
    return torque + passive, rates
