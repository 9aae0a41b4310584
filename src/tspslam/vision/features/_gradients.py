"""Sums of products of gradients around a corner, eight columns at a time; the compiler goes one by one."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from ..._jit import instructions

_LANES, _SIDE = 8, 7  # columns that are worked on, and those that count
_BYTE, _WORD = ir.IntType(8), ir.IntType(32)
_BYTES, _WORDS = ir.VectorType(_BYTE, _LANES), ir.VectorType(_WORD, _LANES)


@instructions
def gradient_products(_context: Any, image: Any, _start: Any, _stride: Any) -> Any:
    """Sum gx gx, gx gy, gy gy over 7 x 7 pixels of which the first is ``image[start]``; exact.

    gx and gy are differences of the pixels on both sides. `image` is flat, of bytes; indices are not checked: a pixel
    more is read at the end of each row, and a row above and below.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        start, stride = arguments[1:]

        def load(row: int, column: int) -> Any:
            index = builder.add(start, builder.add(builder.mul(stride, stride.type(row)), stride.type(column)))
            loaded = builder.load(builder.bitcast(builder.gep(data, [index]), _BYTES.as_pointer()))
            loaded.align = 1
            return builder.zext(loaded, _WORDS)

        sums = [ir.Constant(_WORDS, [_WORD(0)] * _LANES)] * 3
        for row in range(_SIDE):
            gx, gy = builder.sub(load(row, 1), load(row, -1)), builder.sub(load(row + 1, 0), load(row - 1, 0))
            products = builder.mul(gx, gx), builder.mul(gx, gy), builder.mul(gy, gy)
            sums = [builder.add(total, product) for total, product in zip(sums, products, strict=True)]
        return context.make_tuple(builder, signature.return_type, [_total(builder, each) for each in sums])

    return types.containers.UniTuple(types.int32, 3)(image, types.int64, types.int64), generate


def _total(builder: Any, lanes: Any) -> Any:
    """Sum of the columns that count."""
    parts = [builder.extract_element(lanes, _WORD(k)) for k in range(_SIDE)]
    total = parts[0]
    for part in parts[1:]:
        total = builder.add(total, part)
    return total
