"""What nodes are told by those around them, after a change as in a build."""

import numpy as np
import pytest

from gpdf_service.tiles.beside import beside, beside_now
from gpdf_service.tiles.layers import build_layers, splice_layers

WIDTH, GAP = 0.1, 0.5


def pairs_beside(layers, *_):
    """Pairs of nodes that are up to two cells apart, one direction after another."""
    found = []
    for far in ((1, 0), (0, 1), (2, 1)):
        at = {tuple(divmod(int(cell), layers.shape[1])): k for k, cell in enumerate(layers.cell)}
        found += [(k, at[u]) for (x, y), k in at.items() if (u := (x + far[0], y + far[1])) in at]
    return tuple(np.array(found, dtype=np.int64).reshape(-1, 2).T)


@pytest.mark.parametrize("seed", range(4))
def test_pairs_that_are_told_in_no_order_are_told_once_after_changes(seed):
    """Answers go through all pairs in one direction, and then in the next."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(0.0, 7.0, (6000, 2)), np.zeros(6000)])
    near = beside(build_layers(points, WIDTH, GAP))
    near.joins("pairs", 3, pairs_beside)
    for _ in range(3):
        low = rng.uniform(0.0, 6.0, 2)
        gone = ((points[:, :2] > low) & (points[:, :2] < low + 0.6)).all(axis=1)
        gone[[0, *points[:, :2].argmin(axis=0), *points[:, :2].argmax(axis=0)]] = False
        layers, points = near.layers, points[~gone]
        fresh = build_layers(points, WIDTH, GAP, like=layers)
        cells = (np.diff(layers.start) != np.diff(fresh.start)).reshape(layers.shape)
        own = np.floor((points[:, :2] - layers.origin) / WIDTH).astype(int)
        part = points[cells[tuple(own.T)]]
        made = build_layers(part, WIDTH, GAP, like=layers) if len(part) else None
        near = beside_now(near.lasting(), splice_layers(layers, cells, made), cells)
        ours = near.joins("pairs", 3, pairs_beside)
        theirs = beside(fresh).joins("pairs", 3, pairs_beside)
        np.testing.assert_array_equal(*(np.array(sorted(zip(*ends, strict=True))) for ends in (ours, theirs)))
