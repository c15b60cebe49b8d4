# SPDX-License-Identifier: Apache-2.0
"""How arrays enter and leave compiled code: checked on the way in, without a detour on the way out.

Numba's own wrappers trust the dispatcher in front of them, which looks at every argument of every
call. Without it the wrapper must refuse what it cannot read, or it would read wrong memory. Numba
also asks Python for the class of each array and named tuple that a function returns; here the class
is a constant.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba.core import boxing, cgutils, compiler
from numba.core.pythonapi import NativeValue, _boxers, _unboxers
from numba.core.types.containers import NamedTuple, NamedUniTuple
from numba.core.types.npytypes import Array
from numba.np import numpy_support

from tactile_hand_ros.jit.machine_code import NDARRAY

binding.add_symbol(NDARRAY, id(np.ndarray))
# Where CPython and NumPy keep what describes an array, in bytes from the start of the object.
_TYPE, _DIMENSIONS, _DTYPE, _FLAGS = 8, 24, 56, 64
_BYTE_ORDER, _NUMBER = 26, 28  # in a dtype
_CONTIGUOUS = {"C": 0x1, "F": 0x2, "A": 0x0}
_ALIGNED, _WRITEABLE = 0x100, 0x400


class StrictCompiler(compiler.Compiler):
    """Numba's compiler, with wrappers that can be called without a dispatcher."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        with _strict_wrappers():
            return super().compile_extra(func)


@contextlib.contextmanager
def _strict_wrappers() -> Iterator[None]:
    with _replaced(_unboxers.functions, _UNBOX), _replaced(_boxers.functions, _BOX):
        yield


@contextlib.contextmanager
def _replaced(functions: dict[Any, Any], others: dict[Any, Any]) -> Iterator[None]:
    before = {kind: functions[kind] for kind in others}
    functions.update(others)
    try:
        yield
    finally:
        functions.update(before)


def _unbox_array(typ: Any, obj: Any, c: Any) -> Any:
    """Read an array, or fail with a TypeError where it is of another kind."""
    b = c.builder
    value = cgutils.alloca_once(b, c.context.get_value_type(typ))
    failed = cgutils.alloca_once_value(b, cgutils.true_bit)
    with b.if_then(cgutils.is_not_null(b, obj)):
        expected = c.pyapi.get_c_object(NDARRAY)
        with b.if_then(b.icmp_unsigned("==", _at(b, obj, _TYPE, obj.type), expected)):
            with b.if_then(_fits(typ, obj, b)):
                read = boxing.unbox_array(typ, obj, c)
                b.store(read.value, value)
                b.store(read.is_error, failed)
    with b.if_then(b.load(failed), likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"expected {typ}")
    return NativeValue(b.load(value), is_error=b.load(failed))


def _fits(typ: Any, obj: Any, b: Any) -> Any:
    """Return whether an object, which is an array, has the dimensions, numbers and layout."""
    word, letter = ir.IntType(32), ir.IntType(8)
    wanted, dtype = numpy_support.as_dtype(typ.dtype), _at(b, obj, _DTYPE, obj.type)
    flags = _CONTIGUOUS[typ.layout] | _ALIGNED | (_WRITEABLE if typ.mutable else 0)
    checks = (
        (_at(b, obj, _DIMENSIONS, word), word(typ.ndim)),
        (_at(b, dtype, _NUMBER, word), word(wanted.num)),
        (_at(b, dtype, _BYTE_ORDER, letter), letter(ord(wanted.byteorder))),
        (b.and_(_at(b, obj, _FLAGS, word), word(flags)), word(flags)),
    )
    fits = cgutils.true_bit
    for found, expected in checks:
        fits = b.and_(fits, b.icmp_signed("==", found, expected))
    return fits


def _at(b: Any, obj: Any, offset: int, kind: Any) -> Any:
    """Return what lies so many bytes behind the start of an object."""
    start = b.bitcast(obj, ir.IntType(8).as_pointer())
    place = b.gep(start, [ir.IntType(32)(offset)])
    return b.load(b.bitcast(place, kind.as_pointer()))


def _box_array(typ: Any, val: Any, c: Any) -> Any:
    """Hand an array to Python, which then owns it."""
    b, api = c.builder, c.pyapi
    add, read = c.env_manager.add_const, c.env_manager.read_const
    dtype = read(add(numpy_support.as_dtype(typ.dtype)))
    kind = read(add(np.ndarray))
    word = ir.IntType(32)
    signature = ir.FunctionType(api.pyobj, [api.voidptr, api.pyobj, word, word, api.pyobj])
    adapt = api._get_function(signature, name="NRT_adapt_ndarray_to_python_acqref")
    array = b.bitcast(cgutils.alloca_once_value(b, val), api.voidptr)
    out = b.call(adapt, [array, kind, word(typ.ndim), word(int(typ.mutable)), dtype])
    c.context.nrt.decref(b, typ, val)
    return out


def _box_named_tuple(typ: Any, val: Any, c: Any) -> Any:
    """Hand a named tuple to Python."""
    kind = c.env_manager.read_const(c.env_manager.add_const(typ.instance_class))
    plain = boxing.box_tuple(typ, val, c)
    out = c.pyapi.call(kind, plain)
    c.pyapi.decref(plain)
    return out


_UNBOX = {Array: _unbox_array}
_BOX = {
    Array: _box_array,
    NamedTuple: _box_named_tuple,
    NamedUniTuple: _box_named_tuple,
}
