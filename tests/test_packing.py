import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpdf_service.packing import pack, unpack

ANY = hnp.arrays(
    st.sampled_from([np.dtype(name) for name in ("?", "u1", "u2", "i4", "i8", "u8", "f4", "f8")]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=40),
)


@settings(max_examples=200, deadline=None)
@given(ANY)
def test_what_was_packed_comes_back_to_the_bit(array):
    back = unpack(*pack(array))
    assert (back.dtype, back.shape) == (array.dtype, array.shape)
    np.testing.assert_array_equal(back, array)
    if array.dtype.kind == "f":
        np.testing.assert_array_equal(np.signbit(back), np.signbit(array))
    assert back.flags.c_contiguous
    assert back.flags.writeable


def points(kind):
    rng = np.random.default_rng(0)
    return (np.cumsum(rng.normal(0.0, 0.02, (100_000, 3)), axis=0) + 30.0).astype(kind).astype(np.float64)


def test_a_scan_in_single_precision_takes_less_than_its_single_bytes():
    packed, raw = pack(points(np.float32))
    assert packed.kept == "<f4"
    assert len(raw) < 0.8 * 12 * 100_000


def test_doubles_that_are_no_singles_stay_doubles():
    assert pack(points(np.float64))[0].kept == "<f8"
    assert pack(np.array([1e300]))[0].kept == "<f8"


@pytest.mark.parametrize(("values", "kept"), [([0, 255], "|u1"), ([-5, 299], "<i2"), ([0, 2**40], "<i8")])
def test_whole_numbers_take_as_many_bytes_as_the_largest_needs(values, kept):
    assert pack(np.array(values))[0].kept == kept


@settings(max_examples=200, deadline=None)
@given(
    hnp.arrays(np.int64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(-(2**40), 2**40)),
    st.sampled_from([10, 1000, 100_000]),
    st.sampled_from(["f4", "f8"]),
)
def test_decimals_come_back_to_the_bit_however_large(whole, per, kind):
    array = (whole / per).astype(kind)
    packed, raw = pack(array)
    back = unpack(packed, raw)
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back.view(f"u{array.itemsize}"), array.view(f"u{array.itemsize}"))
    if kind == "f8" or np.abs(whole).max() < 2**24:
        assert 0 < packed.per <= per


def test_a_scan_in_millimetres_takes_less_than_half_of_its_single_bytes_and_one_that_is_not_quite_is_kept():
    exact = np.round(points(np.float64), 3)
    packed, raw = pack(exact)
    assert (packed.per, len(raw) < 6 * 100_000) == (1000, True)
    for odd in (exact[50_000, 0] + 1e-9, -0.0, np.nan, np.inf):  # where the sample does not look, too
        for row in (3, 50_000):
            other = exact.copy()
            other[row, 0] = odd
            back = unpack(*pack(other))
            np.testing.assert_array_equal(back.view(np.uint64), other.view(np.uint64))


def test_equal_rows_are_packed_better_than_by_planes():
    row = np.random.default_rng(0).normal(size=6)
    assert len(pack(np.tile(row, (10_000, 1)))[1]) < 1000


@pytest.mark.parametrize(
    "wrong",
    [
        {"shape": (10**15, 3)},
        {"shape": (99, 3)},
        {"shape": (-100, 3)},
        {"dtype": "O"},
        {"kept": "<f8"},
        {"lengths": (1, 2, 3, 4)},
        {"lengths": (1, 2)},
        {"per": 1000},
        {"per": -1, "rounded": "<f4"},
    ],
)
def test_a_description_that_does_not_fit_the_bytes_is_refused(wrong):
    packed, raw = pack(points(np.float32)[:100])
    with pytest.raises(ValueError, match=r"described|as long|frame"):
        unpack(dataclasses.replace(packed, **wrong), raw)


def test_what_is_no_numbers_is_not_packed():
    with pytest.raises(ValueError, match="object"):
        pack(np.array([object()]))
