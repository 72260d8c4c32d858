"""Arrays as few bytes, to the bit: each in the narrowest type that holds all its values, by byte planes, by Zstandard.

The first bytes of neighbouring numbers are alike and the last are not: apart, the first nearly vanish. What the middle
of an array shows decides whether its bytes are taken apart; equal rows are packed better together. Scanners write whole
millimetres and the like: such numbers are kept as whole ones, each as its difference to the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from zstandard import ZstdCompressor, ZstdDecompressor, frame_content_size

LEVEL = 1
"""[-] Of Zstandard. Level 3 takes twice the time for a tenth less."""
SAMPLE = 2**17
"""[bytes] From the middle of an array."""
MOST_COLUMNS = 8
"""Of rows of numbers that are packed column by column: a point's x, y and z are not alike."""
DECIMALS = 10, 100, 1000, 10_000, 100_000
"""[1/m] What coordinates are whole numbers of, if of anything: LAS files have millimetres, or ten times finer."""
WHOLE, ROUNDED = ("i4", "i8"), ("<f4", "<f8")
"""Types of whole numbers of them, and of what those are once they are divided."""
KINDS = "biuf"
INTEGERS = "u1", "i1", "u2", "i2", "u4", "i4"


@dataclass(frozen=True, slots=True)
class Packed:
    """How an array lies in its bytes.

    Attributes:
        dtype: Its type.
        shape: Its shape.
        kept: The type that its values have here; "bits" for truth values.
        lengths: Of each frame [bytes]; one a byte plane, or one alone.
        per: Kept are differences of whole numbers of 1/`per`; 0 for the values themselves.
        rounded: What those numbers are rounded to once they are divided: a type.
    """

    dtype: str
    shape: tuple[int, ...]
    kept: str
    lengths: tuple[int, ...]
    per: int = 0
    rounded: str = ""

    @property
    def nbytes(self) -> int:
        """What it takes unpacked."""
        return prod(self.shape) * np.dtype(self.dtype).itemsize


def pack(array: NDArray[Any]) -> tuple[Packed, bytes]:
    """The bytes of an array of numbers, and how it lies in them.

    Raises:
        ValueError: it holds no numbers.
    """
    if array.dtype.kind not in KINDS:
        raise ValueError(f"an array of {array.dtype} cannot be kept")
    narrow = _narrow(array)
    kept = "bits" if array.dtype == bool else narrow.dtype.str
    flat = _columns(narrow)
    if kept in ROUNDED and (whole := _whole(flat)) is not None:
        numbers, per = whole
        apart = _differences(numbers)
        frames = _frames(apart, planes=True)
        return Packed(array.dtype.str, array.shape, apart.dtype.str, _lengths(frames), per, kept), b"".join(frames)
    some = _middle(flat, SAMPLE // flat.itemsize)
    as_one, by_planes = (sum(map(len, _frames(some, planes))) for planes in (False, True))
    frames = _frames(flat, by_planes < as_one)
    return Packed(array.dtype.str, array.shape, kept, _lengths(frames)), b"".join(frames)


def unpack(packed: Packed, raw: bytes) -> NDArray[Any]:
    """The array that was packed.

    Raises:
        ValueError: the bytes are not those that are described.
    """
    dtype, kept = np.dtype(packed.dtype), np.dtype("u1" if packed.kept == "bits" else packed.kept)
    count, planes = prod(packed.shape), len(packed.lengths)
    numbers = -(-count // 8) if packed.kept == "bits" else count
    if (
        not {dtype.kind, kept.kind} <= set(KINDS)
        or planes not in (1, kept.itemsize)
        or min(packed.shape, default=0) < 0
        or not _is_decimal(packed)
    ):
        raise ValueError("an array is described that cannot be")
    ends = list(accumulate(packed.lengths, initial=0))
    frames = [raw[a:b] for a, b in pairwise(ends)]
    if ends[-1] != len(raw) or any(frame_content_size(frame) * planes != numbers * kept.itemsize for frame in frames):
        raise ValueError("a part is not as long as it should be")  # told before memory is taken for it
    made = np.empty((numbers, planes), f"u{kept.itemsize // planes}")
    for i, frame in enumerate(frames):
        made[:, i] = np.frombuffer(ZstdDecompressor().decompress(frame), made.dtype)
    flat = made.reshape(-1).view(kept)
    if packed.kept == "bits":
        return np.unpackbits(flat, count=count).view(bool).reshape(packed.shape)
    if packed.per:
        flat = (_summed(flat) / packed.per).astype(packed.rounded, copy=False)
    if _has_columns(packed.shape):
        return flat.reshape(packed.shape[::-1]).T.astype(dtype, order="C")
    return flat.astype(dtype, copy=False).reshape(packed.shape)


def _narrow(array: NDArray[Any]) -> NDArray[Any]:
    """The same values in the narrowest type that holds them all."""
    if array.dtype == bool:
        return np.packbits(array)
    if array.dtype == np.float64:
        with np.errstate(over="ignore"):
            single = array.astype(np.float32)
        return single if np.array_equal(single, array, equal_nan=True) else array
    if array.dtype.kind in "iu" and array.size:
        low, high = array.min(), array.max()
        fits = (kind for kind in INTEGERS if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max)
        return array.astype(next(fits, array.dtype))
    return array


def _middle(flat: NDArray[Any], count: int) -> NDArray[Any]:
    return flat[max((len(flat) - count) // 2, 0) :][:count]


def _lengths(frames: list[bytes]) -> tuple[int, ...]:
    return tuple(map(len, frames))


def _whole(flat: NDArray[np.floating]) -> tuple[NDArray[np.signedinteger], int] | None:
    """All values as whole numbers of 1/`per`, if they are such to the bit; the coarsest that does."""
    some = _middle(flat, SAMPLE // flat.itemsize)
    for per in DECIMALS:
        if _whole_of(some, per) is not None:
            found = _whole_of(flat, per)
            return None if found is None else (found, per)
    return None


def _whole_of(flat: NDArray[np.floating], per: int) -> NDArray[np.signedinteger] | None:
    with np.errstate(over="ignore"):  # what is so large is no decimal
        scaled = np.rint(flat.astype(np.float64) * per)
    most = np.abs(scaled).max(initial=0.0)
    if not most < 2.0**53:  # beyond, and where something is infinite or no number, no double is exact
        return None
    whole = scaled.astype(WHOLE[int(most >= 2.0**31)])
    bits = f"u{flat.itemsize}"  # −0 is another number than 0
    same = np.array_equal((whole / per).astype(flat.dtype).view(bits), flat.view(bits))
    return whole if same else None


def _differences(whole: NDArray[np.signedinteger]) -> NDArray[np.unsignedinteger]:
    """Each number less the one before, signs last, so that small ones have empty first bytes; it wraps around."""
    apart = np.diff(whole, prepend=whole.dtype.type(0))
    bits = 8 * whole.itemsize
    return ((apart << 1) ^ (apart >> (bits - 1))).view(f"u{whole.itemsize}")


def _summed(apart: NDArray[np.unsignedinteger]) -> NDArray[np.signedinteger]:
    """What `_differences` were made of."""
    signed: NDArray[np.signedinteger] = (apart >> 1).view(f"i{apart.itemsize}")
    signed ^= -(apart & 1).view(signed.dtype)
    return np.cumsum(signed, dtype=signed.dtype)


def _is_decimal(packed: Packed) -> bool:
    """Whether a description of differences can be one; of the values themselves it is."""
    if not packed.per:
        return True
    return packed.per > 0 and packed.rounded in ROUNDED and packed.kept in ("<u4", "<u8")


def _has_columns(shape: tuple[int, ...]) -> bool:
    return len(shape) == 2 and 1 < shape[1] <= MOST_COLUMNS


def _columns(array: NDArray[Any]) -> NDArray[Any]:
    """All values in a row, column by column where there are few."""
    return np.ascontiguousarray(array.T if _has_columns(array.shape) else array).reshape(-1)


def _frames(flat: NDArray[Any], planes: bool) -> list[bytes]:
    packer = ZstdCompressor(level=LEVEL)
    if not planes:
        return [packer.compress(flat.data)]
    return [
        packer.compress(plane.data) for plane in np.ascontiguousarray(flat.view(np.uint8).reshape(-1, flat.itemsize).T)
    ]
