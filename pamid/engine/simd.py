"""Arithmetic on vectors of doubles inside compiled functions, for loops that a compiler would not
keep in registers."""

from __future__ import annotations

import math
import struct
from typing import Any

from llvmlite import ir
from numba.core import cgutils

# doubles in a vector: a register, or two or four of a narrower machine
LANES = 8
INT64 = ir.IntType(64)
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INT64_LANES = ir.VectorType(INT64, LANES)
# added and taken away again, it leaves a whole number, whose bits stand last
_ROUNDING = 1.5 * 2.0**52
_ROUNDING_BITS = struct.unpack("<q", struct.pack("<d", _ROUNDING))[0]
_BIAS = 1023  # of the exponent of a double
_OFFSET = 2048  # even, and above the size of every exponent
_EXP_RANGE = (-746.0, 710.0)  # beyond, exp is 0 or inf
_TANH_FLAT = 20.0  # tanh is 1 from here on
_TERMS = 13  # of the series of exp within +- ln(2) / 2: error 4e-18
# high and low part
_LN2 = (float.fromhex("0x1.62e42fee00000p-1"), float.fromhex("0x1.a39ef35793c76p-33"))
# pi / 2
_HALF_PI = tuple(
    map(float.fromhex, ("0x1.921fb54400000p+0", "0x1.0b4611a600000p-34", "0x1.3198a2e037073p-69"))
)
_CIRCLE_TERMS = 8  # of the series of sin and cos within +- pi / 4, behind the first: error 2e-18
FAR_ANGLE = 1e6  # rad, up to which k takes no more than 20 bits


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
        """The same double in every lane."""
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
        """1 - 2 / (exp(2 a) + 1): right to round-off of 1, not of a small result."""
        b, unit = self.builder, self.constant(1.0)
        a = self._between(a, -_TANH_FLAT, _TANH_FLAT)
        # exp(2 a): 2^k times a series in 2 a - k ln(2)
        shifted, r = self._reduced(b.fmul(a, self.constant(2.0)))
        exponent = b.add(self._bits(shifted), self._integers(_BIAS))
        e = b.fmul(self._series(r, 0), self._power(exponent))
        return b.fsub(unit, b.fdiv(self.constant(2.0), b.fadd(e, unit)))

    def exp(self, a: Any) -> Any:
        """exp(a) for every a: inf, 0, denormal and NaN where the exact result rounds to these."""
        b = self.builder
        shifted, r = self._reduced(self._between(a, *_EXP_RANGE))
        # 2^k in two factors, since k may leave the range of exponents; the offset makes k positive,
        # because narrow vector units have no shift that keeps a sign
        half = b.lshr(
            b.add(self._bits(shifted), self._integers(_OFFSET - _ROUNDING_BITS)), self._integers(1)
        )
        rest = b.sub(
            b.add(self._bits(shifted), self._integers(_OFFSET // 2 + _BIAS - _ROUNDING_BITS)), half
        )
        first = b.add(half, self._integers(_BIAS - _OFFSET // 2))
        return b.fmul(b.fmul(self._series(r, 0), self._power(first)), self._power(rest))

    def tanh_to_zero(self, a: Any) -> Any:
        """tanh(a) to round-off of the result: e / (e + 2), with e = exp(2 a) - 1."""
        b = self.builder
        shifted, r = self._reduced(
            b.fmul(self._between(a, -_TANH_FLAT, _TANH_FLAT), self.constant(2.0))
        )
        power = self._power(b.add(self._bits(shifted), self._integers(_BIAS)))
        series = b.fmul(self._series(r, 1), r)
        e = self.fma(series, power, b.fsub(power, self.constant(1.0)))
        return b.fdiv(e, b.fadd(e, self.constant(2.0)))

    def sin_and_cos(self, a: Any) -> tuple[Any, Any]:
        """sin(a) and cos(a) for |a| < FAR_ANGLE: series in a - k pi/2, of which k chooses.

        pi/2 is taken off in three parts, of which the first two times k are exact (Cody and Waite
        1980).
        """
        b = self.builder
        shifted = self.fma(a, self.constant(2.0 / math.pi), self.constant(_ROUNDING))
        k, r = b.fsub(shifted, self.constant(_ROUNDING)), a
        for part in _HALF_PI:
            r = self.fma(k, self.constant(-part), r)
        square = b.fmul(r, r)
        odd, even = (self._alternating(square, first) for first in (1, 0))
        odd = b.fmul(odd, r)
        bits, unit = self._bits(shifted), self._integers(1)
        swapped = b.icmp_unsigned("==", b.and_(bits, unit), unit)
        values = b.select(swapped, even, odd), b.select(swapped, odd, even)
        signs = b.shl(bits, self._integers(62)), b.shl(b.add(bits, unit), self._integers(62))
        sign_bit = self._integers(-(2**63))
        sine, cosine = (
            b.bitcast(b.xor(self._bits(v), b.and_(sign, sign_bit)), _VECTOR)
            for v, sign in zip(values, signs, strict=True)
        )
        return sine, cosine

    def _alternating(self, square: Any, first: int) -> Any:
        """The series of sin(r) / r (first = 1) or cos(r) (0) in the square of r."""
        series = self.constant(0.0)
        for n in range(_CIRCLE_TERMS, -1, -1):
            term = (-1.0) ** n / math.factorial(2 * n + first)
            series = (
                self.constant(term)
                if n == _CIRCLE_TERMS
                else self.fma(series, square, self.constant(term))
            )
        return series

    def all_within(self, a: Any, bound: float) -> Any:
        """Whether |a| is below the bound in every lane."""
        b = self.builder
        inside = b.and_(
            b.fcmp_ordered("<", a, self.constant(bound)),
            b.fcmp_ordered(">", a, self.constant(-bound)),
        )
        every = b.bitcast(inside, ir.IntType(LANES))
        return b.icmp_unsigned("==", every, ir.Constant(ir.IntType(LANES), -1))

    def _between(self, a: Any, low: float, high: float) -> Any:
        """a no lower and no higher than these; NaN stays NaN."""
        b = self.builder
        for bound, beyond in ((high, ">"), (low, "<")):
            a = b.select(b.fcmp_ordered(beyond, a, self.constant(bound)), self.constant(bound), a)
        return a

    def _reduced(self, a: Any) -> tuple[Any, Any]:
        """k = a / ln(2), rounded, in the last bits of the first vector; a - k ln(2).

        ln(2) is taken off in two parts, of which the first times k is exact (Cody and Waite 1980,
        Software Manual for the Elementary Functions).
        """
        shifted = self.fma(a, self.constant(1.0 / math.log(2.0)), self.constant(_ROUNDING))
        k = self.builder.fsub(shifted, self.constant(_ROUNDING))
        return shifted, self.fma(
            k, self.constant(-_LN2[1]), self.fma(k, self.constant(-_LN2[0]), a)
        )

    def _series(self, r: Any, first: int) -> Any:
        """The series of exp(r) from this term on, divided by r to the power of `first`."""
        series = self.constant(1.0 / math.factorial(_TERMS))
        for n in range(_TERMS - 1, first - 1, -1):
            series = self.fma(series, r, self.constant(1.0 / math.factorial(n)))
        return series

    def _bits(self, a: Any) -> Any:
        return self.builder.bitcast(a, _INT64_LANES)

    def _integers(self, value: int) -> Any:
        return ir.Constant(_INT64_LANES, [value] * LANES)

    def _power(self, exponent: Any) -> Any:
        """2^(exponent - _BIAS), of which only the last bits count."""
        return self.builder.bitcast(self.builder.shl(exponent, self._integers(52)), _VECTOR)

    def _at(self, base: Any, place: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(base, [place]), _VECTOR.as_pointer())
