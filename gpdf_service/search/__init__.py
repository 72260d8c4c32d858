"""Quadtree of the free space, connectivity graph, A*."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
