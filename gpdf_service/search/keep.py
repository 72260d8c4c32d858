"""A free space as named arrays, for a file: what was searched for and solved. The rest follows from it at once."""

from __future__ import annotations

from gpdf_service.config import SearchConfig
from gpdf_service.errors import SceneFileError
from gpdf_service.fields import Gpdf, tree_of
from gpdf_service.ground import GroundLevel, Levels, Obstacles
from gpdf_service.search.free_space import FreeSpace, LevelSpace, join_levels, level_space, reach_of
from gpdf_service.search.quadtree import Quadtree
from gpdf_service.store import Arrays, flatten, restore, under
from gpdf_service.types import Agent


def to_arrays(space: FreeSpace) -> Arrays:
    """All that `from_arrays` needs beside the ground."""
    made: Arrays = {}
    for i, level in enumerate(space.levels):
        tree, (ends, via) = level.places.standing, level.edges
        made |= flatten(level.standing, f"{i}/obstacles") | flatten(level.quadtree.standing, f"{i}/quadtree")
        made |= {f"{i}/field/{key}": value for key, value in level.obstacle_field.standing.to_arrays().items()}
        made |= {f"{i}/order": tree.order, f"{i}/begin": tree.begin, f"{i}/ends": ends, f"{i}/via": via}
    return made


def from_arrays(
    arrays: Arrays, agent: Agent, levels: Levels, ground_fields: tuple[Gpdf, ...], config: SearchConfig, noise: float
) -> FreeSpace:
    """The free space that `to_arrays` took apart, over the same ground; nothing is searched for or fitted.

    Raises:
        SceneFileError: an array is missing.
    """
    fields = zip(levels.levels, ground_fields, strict=True)
    try:
        parts = [_level_space(under(f"{i}/", arrays), *ground) for i, ground in enumerate(fields)]
    except KeyError as error:
        found = f"of the free space of {agent.name!r} the part {error} is missing"
        raise SceneFileError("scene file", found, "Build the scene again from its cloud.") from error
    return join_levels(agent, *reach_of(agent, config, noise), parts, levels)


def _level_space(arrays: Arrays, level: GroundLevel, ground_field: Gpdf) -> LevelSpace:
    obstacles, order = restore(Obstacles, arrays, "obstacles"), arrays["order"]
    return level_space(
        level,
        ground_field,
        obstacles,
        tree_of(obstacles.points[order, :2], order, arrays["begin"]),
        Gpdf.from_arrays(under("field/", arrays), domain=level.surface),
        restore(Quadtree, arrays, "quadtree"),
        (arrays["ends"], arrays["via"]),
    )
