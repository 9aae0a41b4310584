"""Compiled steps of everything that compares patches, on several pixels at a time; compilers leave them one by one.

Images, taps and weights are flat, of float32, and indices are not checked. Rows of weights are padded with zeros to a
multiple of `LANES`: so many pixels are read where a row of a patch begins, and a few more where it is interpolated.
Grey levels count from that of a pixel in the middle: squares of less are rounded to less.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numpy.typing import NDArray

from .._jit import inlined, instructions, prefetch

LANES = 16
"""Pixels that are worked on at a time."""
_INDEX = ir.IntType(32)
_WHOLE, _WHOLE_TYPE = types.int64, ir.IntType(64)
_MAY_FUSE = ("contract",)


@inlined
def prefetch_square(flat: NDArray[np.float32], shape: tuple[int, int], u: float, v: float, reach: int) -> None:
    """Ask the processor to bring the pixels around (u, v) near, up to `reach` px away, if all are in the image.

    Patches lie on rows that are pages apart: without this, a third of their time is waiting for memory.
    """
    (height, width), x, y = shape, int(u) - reach, int(v) - reach
    if x >= 0 and y >= 0 and x + 2 * reach < width and y + 2 * reach < height:
        for row in range(y, y + 2 * reach + 1):
            prefetch(flat, row * width + x)
            prefetch(flat, row * width + x + 2 * reach)


@instructions
def sample_cubic(
    _context: Any, image: Any, _start: Any, _stride: Any, taps: Any, _across: Any, _down: Any
) -> Any:  # fmt: skip
    """Interpolate: the sum of ``taps[down + k] taps[across + i] image[start + k stride + i]`` over k, i from 0 to 3."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = _Code(context, builder, signature, arguments, 4)
        _, start, stride, _, across, down = arguments
        rows = [code.load(0, code.sum(start, stride, k)) for k in range(4)]
        columns = code.dot([code.spread(3, code.sum(down, k)) for k in range(4)], rows)
        a, b, c, d = code.parts(code.times(columns, code.load(3, across)))
        return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

    return types.float32(image, _WHOLE, _WHOLE, taps, _WHOLE, _WHOLE), generate


@instructions
def window_moments(
    _context: Any, image: Any, _start: Any, _stride: Any, taps: Any, factors: Any, _side: Any, _blocks: Any,
    _middle: Any,
) -> Any:  # fmt: skip
    """Weighted moments of a window that is interpolated by 4 x 4 points, the first at `start`.

    Taps across come first, then those down. Factors are w, a, b, c, each `side` rows of `blocks` · `LANES`; with r the
    samples, the sums of w r, w r r, w r a, w r b, w r c are returned.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = _Code(context, builder, signature, arguments, LANES)
        _, start, stride, _, _, side, blocks, level = arguments
        middle = code.fill(level)
        across, down = ([code.spread(3, _WHOLE_TYPE(first + k)) for k in range(4)] for first in (0, 4))
        size = builder.mul(builder.mul(side, blocks), _WHOLE_TYPE(LANES))
        sums = code.sums(5)
        with code.blocks(side, blocks, stride) as (offset, at):
            first, lines = builder.add(start, offset), []
            for k in range(4):
                line = code.sum(first, stride, k)
                lines.append(code.dot(across, [code.load(0, code.sum(line, i)) for i in range(4)]))
            value = builder.fsub(code.dot(down, lines), middle)
            weight, *others = (code.load(4, code.sum(at, size, k)) for k in range(4))
            weighted = code.times(weight, value)
            sums.add([weighted, *(code.times(weighted, other) for other in (value, *others))])
        return context.make_tuple(builder, signature.return_type, sums.totals())

    given = image, _WHOLE, _WHOLE, taps, factors, _WHOLE, _WHOLE, types.float32
    return types.containers.UniTuple(types.float32, 5)(*given), generate


@instructions
def row_moments(
    _context: Any, left: Any, _first: Any, right: Any, _second: Any, _stride: Any, taps: Any, weight: Any, _side: Any,
    _blocks: Any, _middle: Any,
) -> Any:  # fmt: skip
    """Weighted sums of l, r, g, ll, lr, lg, rr, rg, gg over a patch, as ``sums``.

    l are the pixels of the left image from one after `first` on; r those of the right one interpolated along rows by 6
    points, the first of them one after `second`; g is the mean of both gradients along rows.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = _Code(context, builder, signature, arguments, LANES)
        _, first, _, second, stride, _, _, side, blocks, level = arguments
        middle = code.fill(level)
        tap = [code.spread(5, _WHOLE_TYPE(k)) for k in range(6)]
        quarter, sums = code.constant(0.25), code.sums(9)  # half of two central differences, averaged
        with code.blocks(side, blocks, stride) as (offset, at):
            here = [code.load(0, code.sum(builder.add(first, offset), i)) for i in range(3)]
            near = [code.load(2, code.sum(builder.add(second, offset), i)) for i in range(8)]
            before, r, after = (code.dot(tap, near[i : i + 6]) for i in range(3))
            rise = builder.fadd(builder.fsub(after, before), builder.fsub(here[2], here[0]))
            g, w = code.times(quarter, rise), code.load(6, at)
            l, r = builder.fsub(here[1], middle), builder.fsub(r, middle)  # noqa: E741 - the equation's name
            wl, wr, wg = (code.times(w, each) for each in (l, r, g))
            products = (wl, l), (wl, r), (wl, g), (wr, r), (wr, g), (wg, g)
            sums.add([wl, wr, wg, *(code.times(*each) for each in products)])
        return context.make_tuple(builder, signature.return_type, sums.totals())

    given = left, _WHOLE, right, _WHOLE, _WHOLE, taps, weight, _WHOLE, _WHOLE, types.float32
    return types.containers.UniTuple(types.float32, 9)(*given), generate


@instructions
def add_correlations(
    _context: Any, image: Any, _first: Any, other: Any, _second: Any, _stride: Any, weight: Any, _side: Any,
    _pitch: Any, sums: Any, _at: Any, _length: Any, _middle: Any,
) -> Any:  # fmt: skip
    """Compare a patch with `LANES` neighbouring ones of the other image: weighted sums of l r, r and r r.

    They go to `sums` from `at` on, `length` apart. Rows of weights are `pitch` apart.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = _Code(context, builder, signature, arguments, LANES)
        _, first, _, second, stride, _, side, pitch, _, at, length, level = arguments
        middle, found = code.fill(level), code.sums(3)
        with cgutils.for_range(builder, side) as row, cgutils.for_range(builder, side) as column:
            offset = builder.add(builder.mul(row.index, stride), column.index)
            near = builder.fsub(code.load(2, builder.add(second, offset)), middle)
            w = code.spread(5, builder.add(builder.mul(row.index, pitch), column.index))
            weighted = code.times(w, near)
            here = builder.fsub(code.spread(0, builder.add(first, offset)), middle)
            found.add([code.times(weighted, here), weighted, code.times(weighted, near)])
        for k, vector in enumerate(found.vectors()):
            code.store(8, code.sum(at, length, k), vector)
        return context.get_dummy_value()

    given = image, _WHOLE, other, _WHOLE, _WHOLE, weight, _WHOLE, _WHOLE, sums, _WHOLE, _WHOLE, types.float32
    return types.void(*given), generate


class _Code:
    """Instructions on vectors of float32, with the arguments of an intrinsic by their places."""

    def __init__(self, context: Any, builder: Any, signature: Any, arguments: Sequence[Any], lanes: int) -> None:
        self._context, self._builder, self._types, self._given = context, builder, signature.args, arguments
        self._lanes, self._kind = lanes, ir.VectorType(ir.FloatType(), lanes)

    def sum(self, start: Any, step: Any, times: int = 1) -> Any:
        """``start + times · step``."""
        step = start.type(step) if isinstance(step, int) else self._builder.mul(step, step.type(times))
        return self._builder.add(start, step)

    def load(self, place: int, index: Any) -> Any:
        """Numbers of array `place` from an index on."""
        loaded = self._builder.load(self._pointer(place, index, self._kind))
        loaded.align = 4
        return loaded

    def store(self, place: int, index: Any, vector: Any) -> None:
        """Put numbers into array `place` from an index on."""
        stored = self._builder.store(vector, self._pointer(place, index, self._kind))
        stored.align = 4

    def spread(self, place: int, index: Any) -> Any:
        """One number of array `place` in all lanes."""
        return self.fill(self._builder.load(self._pointer(place, index, ir.FloatType())))

    def fill(self, one: Any) -> Any:
        """A number in all lanes."""
        nothing = ir.Constant(self._kind, ir.Undefined)
        single = self._builder.insert_element(nothing, one, _INDEX(0))
        where = ir.Constant(ir.VectorType(_INDEX, self._lanes), [_INDEX(0)] * self._lanes)
        return self._builder.shuffle_vector(single, nothing, where)

    def constant(self, value: float) -> Any:
        """The same number in all lanes."""
        return ir.Constant(self._kind, [ir.FloatType()(value)] * self._lanes)

    def times(self, first: Any, second: Any) -> Any:
        """Products."""
        return self._builder.fmul(first, second, flags=_MAY_FUSE)

    def plus(self, first: Any, second: Any) -> Any:
        """Sums."""
        return self._builder.fadd(first, second, flags=_MAY_FUSE)

    def dot(self, factors: Sequence[Any], vectors: Sequence[Any]) -> Any:
        """Sum of products, in order."""
        total = self.times(factors[0], vectors[0])
        for factor, vector in zip(factors[1:], vectors[1:], strict=True):
            total = self.plus(total, self.times(factor, vector))
        return total

    def parts(self, vector: Any) -> list[Any]:
        """The numbers of a vector."""
        return [self._builder.extract_element(vector, _INDEX(k)) for k in range(self._lanes)]

    @contextmanager
    def blocks(self, side: Any, blocks: Any, stride: Any) -> Iterator[tuple[Any, Any]]:
        """Go over the rows of a patch, and along each: offset in the image, and place among the weights."""
        builder, lanes = self._builder, _WHOLE_TYPE(LANES)
        with cgutils.for_range(builder, side) as row, cgutils.for_range(builder, blocks) as block:
            along = builder.mul(block.index, lanes)
            at = builder.add(builder.mul(builder.mul(row.index, blocks), lanes), along)
            yield builder.add(builder.mul(row.index, stride), along), at

    def sums(self, count: int) -> _Sums:
        """So many sums of vectors, zero at first."""
        return _Sums(self, self._builder, count)

    def _pointer(self, place: int, index: Any, kind: Any) -> Any:
        data = self._context.make_array(self._types[place])(self._context, self._builder, self._given[place]).data
        return self._builder.bitcast(self._builder.gep(data, [index]), kind.as_pointer())


class _Sums:
    """Sums of vectors over a loop."""

    def __init__(self, code: _Code, builder: Any, count: int) -> None:
        self._code, self._builder = code, builder
        self._held = [cgutils.alloca_once_value(builder, code.constant(0.0)) for _ in range(count)]

    def add(self, vectors: Sequence[Any]) -> None:
        """Add to each."""
        for held, vector in zip(self._held, vectors, strict=True):
            self._builder.store(self._code.plus(self._builder.load(held), vector), held)

    def vectors(self) -> list[Any]:
        """The sums, lane by lane."""
        return [self._builder.load(held) for held in self._held]

    def totals(self) -> list[Any]:
        """The sum of the lanes of each, in pairs of pairs."""
        return [self._total(self._code.parts(vector)) for vector in self.vectors()]

    def _total(self, parts: list[Any]) -> Any:
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [self._builder.fadd(parts[k], parts[half + k]) for k in range(half)]
        return parts[0]
