"""Levels of ground, and everything that stops a body on them."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.ground.level import GroundLevel as GroundLevel
from gpdf_service.ground.level import Levels as Levels
from gpdf_service.ground.level import Portal as Portal
from gpdf_service.ground.level import Touched as Touched
from gpdf_service.ground.limits import GroundLimits as GroundLimits
from gpdf_service.ground.limits import ObstacleKind as ObstacleKind
from gpdf_service.ground.obstacles import CLEAN as CLEAN
from gpdf_service.ground.obstacles import Obstacles as Obstacles
from gpdf_service.ground.obstacles import Scan as Scan
from gpdf_service.ground.obstacles import obstacles_of as obstacles_of
from gpdf_service.ground.obstacles import voxel_pitch as voxel_pitch
