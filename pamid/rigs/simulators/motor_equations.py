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


class MotorEquations:
    """Torque of a motor with this command, length and velocity, and the rates of its states."""

    def __init__(
        self,
        actuator: Actuator,
        motor: WindingMotor,
        value: Value,
        states: Mapping[str, Expr],
        command: Expr,
        travel: tuple[Expr, Expr],
    ) -> None:
        self.actuator, self.motor, self.value, self.command = actuator, motor, value, command
        self.length, self.velocity = travel
        self.rates: dict[str, Expr] = {}
        self._states = states
        wound = self._wound()
        limits = actuator.force_range
        self.torque = (wound if limits is None else clip(wound, *limits)) + self._passive()

    def _name(self, word: str) -> str:
        """Name of a state, "" if the motor has none."""
        name = f"{self.actuator.name}_{word}"
        return name if name in self._states else ""

    def _wound(self) -> Expr:
        """Torque of the winding."""
        motor, value = self.motor, self.value
        resistance = value("resistance", motor.resistance)
        constant = value("motorconst", motor.constant)
        hot, heat = resistance, self._name("temperature")
        if heat:
            _, _, ambient, reference, coefficient = motor.heating
            hot = hot * (1.0 + coefficient * (self._states[heat] + (ambient - reference)))
        current = (self._voltage(resistance, constant) - constant * self.velocity) / hot
        if slow := self._name("current"):
            lag = value("time_constant", self.actuator.time_constant_s)
            change = (current - self._states[slow]) / lag
            most = motor.current_rate
            self.rates[slow] = clip(change, -most, most) if most > 0.0 else change
            current = self._states[slow]
        if heat:
            lost = self._states[heat] / value("thermal_resistance", motor.heating[0])
            capacitance = value("thermal_capacitance", motor.heating[1])
            self.rates[heat] = (hot * current * current - lost) / capacitance
        return constant * current

    def _voltage(self, resistance: Expr, constant: Expr) -> Expr:
        motor = self.motor
        if motor.input in ("voltage", "none"):
            return self.command
        kp, ki, kd = (
            self.value(word, stated)
            for word, stated in zip(("kp", "ki", "kd"), motor.controller, strict=True)
        )
        aim = {motor.input: self.command}
        torque = aim.get("ff", ZERO) + kp * (aim.get("pos", ZERO) - self.length)
        torque = torque + kd * (aim.get("vel", ZERO) - self.velocity)
        if name := self._name("integral"):
            grown, rate = self._states[name], self.command - self.length
            torque = torque + ki * grown
            if (most := motor.integral_limit) > 0.0:
                rate = where(grown >= most, minimum(rate, 0.0), rate)
                rate = where(grown <= -most, maximum(rate, 0.0), rate)
            self.rates[name] = rate
        voltage = resistance / constant * torque + constant * self.velocity
        most = motor.voltage_limit
        return clip(voltage, -most, most) if most > 0.0 else voltage

    def _passive(self) -> Expr:
        """Torque of cogging and bristles."""
        force, value = ZERO, self.value
        amplitude, periods, phase = self.motor.cogging
        if amplitude:
            force = value("cogging", amplitude) * sin(periods * self.length + phase)
        if name := self._name("bristle"):
            words = ("stiffness", "damping", "coulomb", "static", "stribeck")
            stiffness, damping, sliding, static, speed = (
                value(f"lugre_{word}", stated)
                for word, stated in zip(words, self.motor.bristles, strict=True)
            )
            ratio = self.velocity / maximum(speed, LEAST)
            level = maximum(sliding + (static - sliding) * exp(-ratio * ratio), LEAST)
            bent = self._states[name]
            rate = self.velocity - stiffness * absolute(self.velocity) / level * bent
            self.rates[name] = rate
            force = force - stiffness * bent - damping * rate
        return force
