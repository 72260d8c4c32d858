import dataclasses
from itertools import pairwise

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.plan import random_places
from gpdf_service.errors import RequestError
from gpdf_service.planning.certificate import min_distance
from gpdf_service.planning.costs import Discs, obstacle_cost
from gpdf_service.planning.footprint import disc_places
from gpdf_service.synthetic import Box, Pillar, World, random_room
from gpdf_service.types import AGENTS

SPOT = dataclasses.replace(AGENTS["spot"], discs=6)


def random_flat(rng):
    """Rooms side by side, with a door in each wall between them that Spot's cylinder does not pass, and furniture."""
    depth, walls, x = rng.uniform(3.0, 5.0), [], 0.0
    for _ in range(3):
        x += rng.uniform(1.4, 2.6)
        door, width = rng.uniform(0.1, depth - 1.0), rng.uniform(0.4, 0.9)
        walls += [Box((x, 0.0, 0.0), (x + 0.12, door, 2.6)), Box((x, door + width, 0.0), (x + 0.12, depth, 2.6))]
    size = (x + 2.0, depth, 2.6)
    pillars = [Pillar((*rng.uniform([0.2, 0.2], [size[0] - 0.2, depth - 0.2]), 0.0), 0.1, 1.0) for _ in range(4)]
    return World(size, (*walls, *pillars))


def judged(world_or_room, agent, pairs, rng):
    ...
