"""Quadtree of the free space, connectivity graph, A*."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.search.change import change_free_space as change_free_space
from gpdf_service.search.free_space import FreeSpace as FreeSpace
from gpdf_service.search.free_space import Setup as Setup
from gpdf_service.search.free_space import build_free_space as build_free_space
from gpdf_service.search.graph import Doors as Doors
from gpdf_service.search.graph import Graph as Graph
from gpdf_service.search.graph import find_path as find_path
from gpdf_service.search.graph import find_way as find_way
from gpdf_service.search.keep import from_arrays as from_arrays
from gpdf_service.search.keep import to_arrays as to_arrays
from gpdf_service.search.motion import is_clear as is_clear
from gpdf_service.search.moved import add_moving as add_moving
from gpdf_service.search.quadtree import Quadtree as Quadtree
from gpdf_service.search.quadtree import build_quadtree as build_quadtree
from gpdf_service.search.reach import Reach as Reach
from gpdf_service.search.reach import find_reach as find_reach
from gpdf_service.search.ways import Prefer as Prefer
from gpdf_service.search.ways import Ways as Ways
from gpdf_service.search.ways import find_ways as find_ways
from gpdf_service.search.ways import level_body as level_body
from gpdf_service.search.ways import prices as prices
