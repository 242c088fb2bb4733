"""The vocabulary of equations: written once as plain Python, run on symbols, then printed,
differentiated, compiled.

Memory is part of the language. `play`, `stop`, `bristle`, `lag`, `delay`, `integral` and `rate_of`
remember their past; the engine gives each operator the cells or buffers it needs (see
`pamid.engine.symbolic.memory_cells`). All of them are exactly the identity (or zero, for `stop`) at
their null.

No Python `if` on an expression: use `where(condition, a, b)`.
"""

from __future__ import annotations

from pamid.engine.symbolic.expression import (
    ZERO,
    EquationError,
    Expr,
    Number,
    apply,
    expression,
    sub,
    tangent,
    where,
)

__all__ = [
    "EquationError",
    "Expr",
    "Number",
    "ZERO",
    "absolute",
    "bristle",
    "clip",
    "cos",
    "delay",
    "exp",
    "expression",
    "floor",
    "held",
    "integral",
    "lag",
    "log",
    "maximum",
    "minimum",
    "play",
    "rate_of",
    "sign",
    "sin",
    "smooth_step",
    "sqrt",
    "stop",
    "tangent",
    "tanh",
    "where",
]

#: the functions that rig and effect files may apply to signals
FUNCTIONS = tuple(name for name in __all__ if name.islower() and name != "expression")
FUNCTIONS_HINT = "On signals work + - * / and the functions of `pamid.equations`: " + ", ".join(
    FUNCTIONS
)


def sqrt(x: Number) -> Expr:
    """Square root."""
    return apply("sqrt", x)


def exp(x: Number) -> Expr:
    """Exponential function."""
    return apply("exp", x)


def log(x: Number) -> Expr:
    """Natural logarithm."""
    return apply("log", x)


def tanh(x: Number) -> Expr:
    """Hyperbolic tangent."""
    return apply("tanh", x)


def sin(x: Number) -> Expr:
    """Sine of an angle in radians."""
    return apply("sin", x)


def cos(x: Number) -> Expr:
    """Cosine of an angle in radians."""
    return apply("cos", x)


def floor(x: Number) -> Expr:
    """Largest whole number below or at a value."""
    return apply("floor", x)


def absolute(x: Number) -> Expr:
    """Absolute value."""
    return apply("abs", x)


def minimum(a: Number, b: Number) -> Expr:
    """Smaller of two values."""
    return apply("min", a, b)


def maximum(a: Number, b: Number) -> Expr:
    """Larger of two values."""
    return apply("max", a, b)


def clip(x: Number, low: Number, high: Number) -> Expr:
    """Value held between a lowest and a highest value."""
    return minimum(maximum(x, low), high)


def sign(x: Number) -> Expr:
    """-1, 0 or 1."""
    return where(expression(x) > 0.0, 1.0, where(expression(x) < 0.0, -1.0, 0.0))


def smooth_step(x: Number) -> Expr:
    """0 below 0, 1 above 1, a cubic with flat ends between."""
    s = clip(x, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def held(x: Number) -> Expr:
    """x, taken for a constant where derivatives are formed."""
    return tangent(x, ZERO)


# ---- memory ------------------------------------------------------------------------------------


def play(x: Number, half_width: Number) -> Expr:
    """Backlash operator: follows `x` with a clearance of +-half_width; equals x at half_width =
    0."""
    return Expr("play", (expression(x), expression(half_width)))


def stop(x: Number, half_width: Number) -> Expr:
    """Elastic-perfectly-plastic operator x - play(x): rises 1:1 with x, saturates at +-half_width;
    0 at its null."""
    return sub(x, play(x, half_width))


def bristle(x: Number, reach: Number) -> Expr:
    """Dahl's bristle deflection: dz/dx = 1 - z sign(dx)/reach, in the unit of x, exact for steps
    in a constant direction."""
    return Expr("bristle", (expression(x), maximum(reach, 1e-12)))


def lag(x: Number, time_constant_s: Number) -> Expr:
    """First-order lag of x; equals x at time constant 0."""
    return Expr("lag", (expression(x), expression(time_constant_s)))


def delay(x: Number, seconds: Number, longest_s: float) -> Expr:
    """Transport delay of x by `seconds` (0 .. longest_s), linear between samples; equals x at delay
    0. Of an input that is held over a sample, and comes within a sample, a rate sees both values in
    turn, not their mean."""
    if not longest_s > 0.0:
        raise EquationError(f"a delay needs a longest value above 0 s, got {longest_s}")
    return Expr("delay", (expression(x), expression(seconds)), float(longest_s))


def integral(x: Number) -> Expr:
    """Time integral of x, zero at the start of a recording."""
    return Expr("integral", (expression(x),))


def rate_of(x: Number) -> Expr:
    """Rate of change of x (per s) over the last sample, 0 in the first sample: the velocity of a
    position that is imposed and recorded, not a state."""
    return Expr("rate", (expression(x),))
