"""Arithmetic on vectors of doubles inside compiled functions, for loops that a compiler would not
keep in registers."""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba.core import cgutils

# doubles in a vector: one register, or two or four of a narrower machine
LANES = 8
INT64 = ir.IntType(64)
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INT64_LANES = ir.VectorType(INT64, LANES)
# added and taken away again, it leaves a whole number, whose bits stand last
_ROUNDING = 1.5 * 2.0**52
_BIAS = 1023  # of the exponent of a double
_TANH_FLAT = 20.0  # tanh is 1 from here on
_TERMS = 13  # of the series of exp within +- ln(2) / 2: error 4e-18
# high and low part
_LN2 = (float.fromhex("0x1.62e42fee00000p-1"), float.fromhex("0x1.a39ef35793c76p-33"))


class Vectors:
    """Writes vector instructions through an llvmlite `builder`; places count doubles from a base
    address."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder

    def constant(self, value: float) -> Any:
        return ir.Constant(_VECTOR, [value] * LANES)

    def load(self, base: Any, place: Any) -> Any:
        return self.builder.load(self._at(base, place), align=8)

    def store(self, value: Any, base: Any, place: Any) -> None:
        self.builder.store(value, self._at(base, place), align=8)

    def spread(self, base: Any, place: Any) -> Any:
        """One double in every lane."""
        nothing, number = (
            ir.Constant(_VECTOR, ir.Undefined),
            self.builder.load(self.builder.gep(base, [place])),
        )
        lane = self.builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
        same = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return self.builder.shuffle_vector(lane, nothing, same)

    def held(self, value: Any) -> Any:
        """A variable that holds a vector across the turns of a loop."""
        place = cgutils.alloca_once(self.builder, _VECTOR)
        self.builder.store(value, place)
        return place

    def add(self, held: Any, factor: Any, value: Any) -> None:
        """held += factor * value."""
        self.builder.store(self.fma(factor, value, self.builder.load(held)), held)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        return self.builder.call(
            cgutils.get_or_insert_function(self.builder.module, kind, f"llvm.fmuladd.v{LANES}f64"),
            [a, b, c],
        )

    def tanh(self, a: Any) -> Any:
        b, one = self.builder, self.constant(1.0)
        # what is not a number stays as it is
        for bound, beyond in ((_TANH_FLAT, ">"), (-_TANH_FLAT, "<")):
            a = b.select(b.fcmp_ordered(beyond, a, self.constant(bound)), self.constant(bound), a)
        e = self._exp(b.fmul(a, self.constant(2.0)))
        return b.fsub(one, b.fdiv(self.constant(2.0), b.fadd(e, one)))

    def _exp(self, a: Any) -> Any:
        """exp(a) for |a| < 700: 2^k times a series in a - k ln(2)."""
        b = self.builder
        shifted = self.fma(a, self.constant(1.0 / math.log(2.0)), self.constant(_ROUNDING))
        k = b.fsub(shifted, self.constant(_ROUNDING))
        r = self.fma(k, self.constant(-_LN2[1]), self.fma(k, self.constant(-_LN2[0]), a))
        series = self.constant(1.0 / math.factorial(_TERMS))
        for n in range(_TERMS - 1, -1, -1):
            series = self.fma(series, r, self.constant(1.0 / math.factorial(n)))
        exponent = b.add(
            b.bitcast(shifted, _INT64_LANES), ir.Constant(_INT64_LANES, [_BIAS] * LANES)
        )
        power = b.bitcast(b.shl(exponent, ir.Constant(_INT64_LANES, [52] * LANES)), _VECTOR)
        return b.fmul(series, power)

    def _at(self, base: Any, place: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(base, [place]), _VECTOR.as_pointer())
