"""A house of two storeys with a stair between them, for the tests of levels."""

import numpy as np

from gpdf_service.synthetic.scenes import table
from gpdf_service.synthetic.world import Box, World

STOREY = 2.8
PAINTED = (190, 40, 170)
"""What its floors look like in its scan."""
TREADS, DEPTH, WIDTH = 15, 0.28, 1.2
HEAD = 1.0 + TREADS * DEPTH


def sample_house(spacing=0.08, seed=0):
    """Points (n, 3) and ground labels (n,): 7 × 5 m, a stair along the southern wall, a hole over it."""
    rise = STOREY / (TREADS + 1)
    shapes = [
        Box((1.0 + i * DEPTH, 0.0, 0.0), (1.0 + (i + 1) * DEPTH, WIDTH, (i + 1) * rise), walkable=True)
        for i in range(TREADS)
    ]
    slabs = [((0.0, WIDTH), (7.0, 5.0)), ((0.0, 0.0), (1.0, WIDTH)), ((HEAD, 0.0), (7.0, WIDTH))]
    shapes += [Box((*low, STOREY - 0.2), (*high, STOREY), walkable=True) for low, high in slabs]
    shapes += [*table(4.5, 3.5, 1.6, 0.8), Box((1.0, 3.0, STOREY), (2.0, 4.0, STOREY + 1.0))]
    return World((7.0, 5.0, 2 * STOREY - 0.2), tuple(shapes), ceiling=False).sample(
        spacing, np.random.default_rng(seed)
    )
