"""Machine instructions of ``lanes``: types and operations of vector registers for numba.

Each function of ``lanes`` and each operator becomes one LLVM instruction on <WIDTH x double>, so that packed
arithmetic does not depend on whether an optimiser finds it.
"""

# mypy: disable-error-code="no-untyped-call,untyped-decorator"
from __future__ import annotations

import operator
from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.datamodel.manager import DataModelManager
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.context import Context
from numba.core.typing.templates import AbstractTemplate, Signature, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

from avrare_mpc.riccati import lanes
from avrare_mpc.riccati.lanes import WIDTH

_DOUBLE, _LONG = ir.DoubleType(), ir.IntType(64)
_VECTOR, _LONGS = ir.VectorType(_DOUBLE, WIDTH), ir.VectorType(_LONG, WIDTH)
_ROW = 8 * WIDTH

Emit = Callable[..., ir.Value]
"""Builder of the instructions of an operation: takes the ``IRBuilder``, then the operands."""


class LanesType(types.Type):
    """Type of numbers of all lanes; a float becomes one with the same number in every lane."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{WIDTH}")

    def can_convert_from(self, context: Context, other: types.Type) -> Conversion | None:
        """Accept scalars."""
        return Conversion.exact if isinstance(other, types.Number) else None

    def unify(self, context: Context, other: types.Type) -> LanesType | None:
        """Let a variable be a scalar first and lanes later."""
        return self if isinstance(other, types.Number) else None


class MaskType(types.Type):
    """Type of truth values of all lanes."""

    def __init__(self) -> None:
        super().__init__(name=f"Mask{WIDTH}")


LANES, MASK, NUMBER, PLACE = LanesType(), MaskType(), types.float64, types.int64


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, _VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), WIDTH))


def _splat(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(_VECTOR, ir.Undefined), zeros)


@lower_cast(types.Number, LanesType)
def _cast(
    context: BaseContext, builder: ir.IRBuilder, kind: types.Type, to: types.Type, value: ir.Value
) -> ir.Value:
    return _splat(builder, context.cast(builder, value, kind, NUMBER))


def _define(
    function: Callable[..., object], result: types.Type, arguments: tuple[types.Type, ...], emit: Emit
) -> None:
    """Let compiled code call ``function``; ``emit(builder, *values)`` builds its instructions."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, given: tuple[types.Type, ...], named: object) -> Signature | None:
            vectors = [kind for kind in given if isinstance(kind, LanesType | MaskType)]
            needed = any(kind in (LANES, MASK) for kind in arguments) and function is not lanes.store
            if len(given) != len(arguments) or (needed and not vectors):
                return None
            for kind, expected in zip(given, arguments, strict=True):
                if kind != expected and not (expected != MASK and isinstance(kind, types.Number)):
                    return None
            taken: Signature = signature(result, *arguments)
            return taken

    infer_global(function)(Template)
    lower_builtin(function, *arguments)(lambda context, builder, sig, values: emit(builder, *values))


def _intrinsic(name: str) -> Emit:
    def emit(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{WIDTH}f64")
        return builder.call(function, [value])

    return emit


def _long(value: int) -> ir.Constant:
    return ir.Constant(_LONGS, [value] * WIDTH)


def _pointer(builder: ir.IRBuilder, memory: ir.Value, place: ir.Value, size: int, kind: ir.Type) -> ir.Value:
    offset = builder.mul(place, ir.Constant(_LONG, size))
    return builder.inttoptr(builder.add(memory, offset), kind.as_pointer())


def _load(builder: ir.IRBuilder, memory: ir.Value, row: ir.Value) -> ir.Value:
    return builder.load(_pointer(builder, memory, row, _ROW, _VECTOR), align=_ROW)


def _store(builder: ir.IRBuilder, memory: ir.Value, row: ir.Value, value: ir.Value) -> ir.Value:
    return builder.store(value, _pointer(builder, memory, row, _ROW, _VECTOR), align=_ROW)


def _peek(builder: ir.IRBuilder, memory: ir.Value, index: ir.Value) -> ir.Value:
    return builder.load(_pointer(builder, memory, index, 8, _DOUBLE))


def _set_entry(builder: ir.IRBuilder, memory: ir.Value, index: ir.Value, value: ir.Value) -> ir.Value:
    return builder.store(value, _pointer(builder, memory, index, 8, _DOUBLE))


def _any(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    whole = builder.bitcast(mask, ir.IntType(WIDTH))
    return builder.icmp_unsigned("!=", whole, ir.Constant(ir.IntType(WIDTH), 0))


def _times_power_of_two(builder: ir.IRBuilder, value: ir.Value, power: ir.Value) -> ir.Value:
    shift = builder.shl(builder.fptosi(power, _LONGS), _long(52))
    return builder.bitcast(builder.add(builder.bitcast(value, _LONGS), shift), _VECTOR)


def _exponent(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    biased = builder.and_(builder.lshr(builder.bitcast(value, _LONGS), _long(52)), _long(0x7FF))
    return builder.sitofp(builder.sub(biased, _long(1023)), _VECTOR)


def _mantissa(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    fraction = builder.and_(builder.bitcast(value, _LONGS), _long((1 << 52) - 1))
    return builder.bitcast(builder.or_(fraction, _long(1023 << 52)), _VECTOR)


def _emit_nothing(emit: Emit) -> Emit:
    def whole(builder: ir.IRBuilder, *values: ir.Value) -> ir.Value:
        emit(builder, *values)
        return ir.Constant(ir.IntType(8).as_pointer(), None)  # numba's None

    return whole


for _function, _name in {
    operator.add: "fadd",
    operator.sub: "fsub",
    operator.mul: "fmul",
    operator.truediv: "fdiv",
}.items():
    _define(_function, LANES, (LANES, LANES), lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
for _function, _name in {operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">="}.items():
    _define(
        _function, MASK, (LANES, LANES), lambda builder, a, b, name=_name: builder.fcmp_ordered(name, a, b)
    )
for _function, _name in {operator.and_: "and_", operator.or_: "or_"}.items():
    _define(_function, MASK, (MASK, MASK), lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
_define(operator.invert, MASK, (MASK,), lambda builder, mask: builder.not_(mask))
_define(operator.neg, LANES, (LANES,), lambda builder, value: builder.fneg(value))
_define(lanes.select, LANES, (MASK, LANES, LANES), lambda builder, *values: builder.select(*values))
_define(lanes.any_of, types.boolean, (MASK,), _any)
_define(lanes.splat, LANES, (NUMBER,), _splat)
_define(lanes.load, LANES, (PLACE, PLACE), _load)
_define(lanes.store, types.none, (PLACE, PLACE, LANES), _emit_nothing(_store))
_define(lanes.peek, NUMBER, (PLACE, PLACE), _peek)
_define(lanes.poke, types.none, (PLACE, PLACE, NUMBER), _emit_nothing(_set_entry))
_define(lanes.root, LANES, (LANES,), _intrinsic("llvm.sqrt"))
_define(lanes.magnitude, LANES, (LANES,), _intrinsic("llvm.fabs"))
_define(lanes.nearest, LANES, (LANES,), _intrinsic("llvm.rint"))
_define(lanes.below, LANES, (LANES,), _intrinsic("llvm.floor"))
_define(lanes.times_power_of_two, LANES, (LANES, LANES), _times_power_of_two)
_define(lanes.exponent, LANES, (LANES,), _exponent)
_define(lanes.mantissa, LANES, (LANES,), _mantissa)
