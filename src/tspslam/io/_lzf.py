"""The compiled loop that unpacks LZF, the compression of PCD files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import kernel

Bytes = NDArray[np.uint8]


@kernel
def unpack(packed: Bytes, out: Bytes) -> bool:
    """Unpack `packed` into `out`; tell whether it is sound and fills `out` to the last byte.

    A byte below 32 says how many bytes, less one, stand as they are; any other, with one or two bytes after it, how
    many bytes to copy from how far back in `out`.
    """
    at, filled = 0, 0
    while at < packed.size:
        control = int(packed[at])
        at += 1
        if control < 32:
            count = control + 1
            if at + count > packed.size or filled + count > out.size:
                return False
            for k in range(count):
                out[filled + k] = packed[at + k]
            at += count
        else:
            count = (control >> 5) + 2
            if count == 9:
                if at >= packed.size:
                    return False
                count += int(packed[at])
                at += 1
            if at >= packed.size:
                return False
            source = filled - ((control & 31) << 8) - int(packed[at]) - 1
            at += 1
            if source < 0 or filled + count > out.size:
                return False
            for k in range(count):  # one after another: what is copied may be what was copied just now
                out[filled + k] = out[source + k]
        filled += count
    return bool(filled == out.size)
