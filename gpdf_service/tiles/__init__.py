"""Columns of points in layers, height maps, and what their nodes and cells are told by those around them.

What is told is remembered strip by strip and box by box: a change asks again only where something is another.
"""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.tiles.surface import HeightMap as HeightMap
