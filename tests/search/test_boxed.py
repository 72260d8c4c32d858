"""What a space hands to kernels: as one object, which holds its arrays as long as it lives."""

import gc
import sys
from dataclasses import replace

import numpy as np
from numba import njit

from gpdf_service.search.ways import Fields, Prefer, boxed, fields_of, here


@njit
def total(box):
    numbers, one = box[0]
    return numbers.sum() + one


def test_a_kernel_reads_what_is_in_the_box():
    numbers = np.arange(4.0)
    box = boxed((numbers, 0.5))
    assert total(box) == 6.5
    numbers[0] = 10.0
    assert total(box) == 16.5


def test_its_arrays_live_as_long_as_the_box():
    numbers = np.arange(4.0)
    held = sys.getrefcount(numbers)
    box = boxed((numbers, 0.5))
    assert sys.getrefcount(numbers) > held
    del box
    gc.collect()
    assert sys.getrefcount(numbers) == held


def test_a_space_keeps_a_box_for_each_level_and_preference_and_another_space_has_its_own(office):
    space = office[1].free_space("roomba")
    box = here(space, 0)
    assert here(space, 0) is box
    assert here(space, 0, Prefer.WIDE) is not box
    assert fields_of(space, 0) is space.boxes[Fields, 0, False]
    other = replace(space, reach=space.reach + 0.1)
    assert here(other, 0)[0].about.reach == space.reach + 0.1
    assert here(space, 0)[0].about.reach == space.reach
