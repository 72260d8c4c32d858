"""Leaves that stay: told by their squares, also where a version has none left."""

from types import SimpleNamespace

import numpy as np

from gpdf_service.search.graph import same_leaves


def tree(code, side=0.1):
    size = np.ones(len(code), np.int64)
    return SimpleNamespace(
        origin=np.zeros(2), side=side, code=np.array(code, np.int64), size=size, free=size > 0, whole=size > 0
    )


def test_leaves_with_the_same_squares_are_the_same_ones():
    old, new = tree([1, 4, 6, 9]), tree([4, 5, 6])
    new.free[2] = False
    now, was = same_leaves(old, new)
    assert now.tolist() == [-1, 0, -1, -1]
    assert was.tolist() == [1, -1, -1]


def test_where_there_are_no_leaves_or_others_cells_none_is_the_same():
    for old, new in ((tree([1, 2]), tree([])), (tree([]), tree([1, 2])), (tree([1, 2]), tree([1, 2], 0.2))):
        now, was = same_leaves(old, new)
        assert now.tolist() == [-1] * len(old.code)
        assert was.tolist() == [-1] * len(new.code)
