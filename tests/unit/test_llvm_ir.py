"""A function written in parts is the function written at once, to the last bit."""

import ctypes

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine.jit_cache import addresses
from pamid.engine.llvm_ir import IN_PARTS, LONG_MODULE, declarations, function_text, part_of
from pamid.engine.symbolic.expression import Expr, symbol
from pamid.engine.symbolic.vocabulary import exp, expression, sin, where

PLACES = {"a": 0, "b": 1}
A, B = symbol("state", "a"), symbol("parameter", "b")


def _equations(steps: int) -> list[Expr]:
    """Each value is made of near and of far ones, of comparisons, constants and symbols; some are
    results in the middle, one is a result twice, one is a symbol."""
    found = [A + B, sin(A * B)]
    for k in range(steps):
        near, far = found[-1], found[k // 3]
        below = near < far
        found.append(where(below, near - 0.5 * far, exp(-far * far) + B) + below * 0.25)
    middle = len(found) // 2
    return [found[-1], found[middle], A, found[middle], expression(2.0), found[1]]


def _values(roots: list[Expr], part: int | None) -> Array:
    name = f"parts{part or 0}"
    body = function_text(name, roots, lambda space, what: PLACES[what], part)
    (address,) = addresses(f"{declarations(part)}\n{body}", [name])
    arrays = [np.array([0.3, 0.7]) for _ in range(6)]
    out = np.full(len(roots) + 1, -1.0)
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7)(address)
    call(*[a.ctypes.data for a in arrays], out.ctypes.data)
    assert out[-1] == -1.0
    return out[:-1]


@pytest.mark.parametrize("part", [1, 7, 200, 10**6])
def test_a_function_in_parts_is_the_same(part):
    roots = _equations(150)
    once = _values(roots, None)
    assert np.unique(once).size == len(roots) - 1
    assert np.array_equal(_values(roots, part), once)


def test_long_modules_alone_are_written_in_parts():
    short, long = _equations(10), _equations(LONG_MODULE // 5)
    assert part_of([short]) is None and not declarations(None).startswith(IN_PARTS)
    part = part_of([long])
    assert part is not None and declarations(part).startswith(IN_PARTS)
    text = function_text("f", long, lambda space, what: PLACES[what], part)
    assert text.count("\npart") == sum(line.startswith("br i1") for line in text.split("\n")) > 3
