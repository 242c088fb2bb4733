"""Calls of compiled functions by their addresses, from inside functions that numba compiles."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic as _intrinsic

# numba's annotation keeps the typing context that a call leaves out
intrinsic: Any = _intrinsic


def _data(context, builder, kind, value):  # type: ignore[no-untyped-def]
    """Address of an array's first element, without touching its reference count."""
    return builder.ptrtoint(context.make_array(kind)(context, builder, value).data, ir.IntType(64))


@intrinsic
def borrowed(typingctx, arrays):  # type: ignore[no-untyped-def]
    """The same array, or tuple of arrays and numbers, without a share in the memory: counting the
    shares would take a third of a loop of short calls. The caller keeps the arrays alive."""

    def without_owner(context, builder, kind, value):  # type: ignore[no-untyped-def]
        if isinstance(kind, types.BaseTuple):
            parts: Any = kind
            for place, part in enumerate(parts):
                field = builder.extract_value(value, place)
                field = without_owner(context, builder, part, field)
                value = builder.insert_value(value, field, place)
        elif isinstance(kind, types.Array):
            view = context.make_array(kind)(context, builder, value)
            for owner in ("meminfo", "parent"):
                setattr(view, owner, ir.Constant(getattr(view, owner).type, None))
            value = view._getvalue()
        return value

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return without_owner(context, builder, sig.args[0], args[0])

    return arrays(arrays), codegen


@intrinsic
def call(typingctx, address, x, c, b, u, k, p, t, out):  # type: ignore[no-untyped-def]
    """Call the compiled function at `address` with seven arrays; the inputs start k numbers into
    u."""
    signature = types.void(types.intp, x, c, b, u, types.intp, p, t, out)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 7)
        words = [_data(context, builder, sig.args[i], args[i]) for i in (1, 2, 3, 4, 6, 7, 8)]
        # A slice of the inputs at every sample would make an array object; an offset costs an
        # addition.
        words[3] = builder.add(words[3], builder.mul(args[5], ir.IntType(64)(8)))
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), words)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def multiply(typingctx, address, partials, skip, S, D, at, n):  # type: ignore[no-untyped-def]
    """Call a compiled sparse product D = P S; partials stand `skip`, the result `at` numbers into
    their arrays."""
    signature = types.void(types.intp, partials, types.intp, S, D, types.intp, types.intp)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [word] * 4)
        first = builder.add(
            _data(context, builder, sig.args[1], args[1]), builder.mul(args[2], word(8))
        )
        result = builder.add(
            _data(context, builder, sig.args[4], args[4]), builder.mul(args[5], word(8))
        )
        builder.call(
            builder.inttoptr(args[0], kind.as_pointer()),
            [first, _data(context, builder, sig.args[3], args[3]), result, args[6]],
        )
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def call_foreign(typingctx, address, *given):  # type: ignore[no-untyped-def]
    """The status (a C int) of a C function at `address`: given integers as 64 bits, floats as
    doubles, arrays as pointers to their first element."""
    kinds = given[0].types if len(given) == 1 and hasattr(given[0], "types") else given
    signature = types.int32(types.intp, types.StarArgTuple(kinds))

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        words = []
        for place, kind in enumerate(kinds):
            value = builder.extract_value(args[1], place)
            if isinstance(kind, types.Array):
                words.append(_data(context, builder, kind, value))
            elif isinstance(kind, types.Float):
                words.append(value)
            else:
                words.append(context.cast(builder, value, kind, types.int64))
        kind = ir.FunctionType(ir.IntType(32), [word.type for word in words])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), words)

    return signature, codegen


@intrinsic
def call_pair(typingctx, address, first, other):  # type: ignore[no-untyped-def]
    """Call the C function at `address` with two addresses, and ignore its result."""
    signature = types.void(types.intp, types.intp, types.intp)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 2)
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), [args[1], args[2]])
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def number_at(typingctx, address):  # type: ignore[no-untyped-def]
    """The float64 that stands at an address."""
    signature = types.float64(types.intp)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.load(builder.inttoptr(args[0], ir.DoubleType().as_pointer()))

    return signature, codegen


@intrinsic
def put_number(typingctx, address, value):  # type: ignore[no-untyped-def]
    """Write a float64 to an address."""
    signature = types.void(types.intp, types.float64)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        builder.store(args[1], builder.inttoptr(args[0], ir.DoubleType().as_pointer()))
        return context.get_dummy_value()

    return signature, codegen
