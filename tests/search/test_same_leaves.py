"""Leaves that stay: told by their squares."""

import numpy as np

from gpdf_service.search.graph import same_leaves
from gpdf_service.search.quadtree import Quadtree


def tree(code, origin=0.0):
    size = np.ones(len(code), np.int64)
    corner = np.full((len(code), 2), 3)
    return Quadtree(np.full(2, origin), 0.1, corner, size, np.zeros(len(code)), size > 0, size > 0, np.array(code))


def test_leaves_with_the_same_squares_are_the_same_ones():
    old, new = tree([1, 4, 6, 9]), tree([4, 5, 6])
    new.free[2] = False
    now, was = same_leaves(old, new)
    assert now.tolist() == [-1, 0, -1, -1]
    assert was.tolist() == [1, -1, -1]


def test_where_there_are_other_leaves_or_other_cells_none_is_the_same():
    for old, new in ((tree([1, 2]), tree([3])), (tree([3]), tree([1, 2])), (tree([1, 2]), tree([1, 2], 0.2))):
        now, was = same_leaves(old, new)
        assert now.tolist() == [-1] * len(old.code)
        assert was.tolist() == [-1] * len(new.code)
