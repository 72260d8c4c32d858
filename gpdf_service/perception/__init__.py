"""From a cloud to ground, levels and what stops a body on them."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.perception.change import Perceived as Perceived
from gpdf_service.perception.change import Touched as Touched
from gpdf_service.perception.change import change as change
from gpdf_service.perception.cloud import WholeError as WholeError
from gpdf_service.perception.cure import Sampling as Sampling
from gpdf_service.perception.cure import cure_and_segment as cure_and_segment
from gpdf_service.perception.ground_level import GroundLevel as GroundLevel
from gpdf_service.perception.ground_level import Levels as Levels
from gpdf_service.perception.ground_level import Portal as Portal
from gpdf_service.perception.ground_level import count_undecided as count_undecided
from gpdf_service.perception.keep import levels_from_arrays as levels_from_arrays
from gpdf_service.perception.keep import levels_to_arrays as levels_to_arrays
from gpdf_service.perception.levels import survey_levels as survey_levels
from gpdf_service.perception.limits import GroundLimits as GroundLimits
from gpdf_service.perception.limits import ObstacleKind as ObstacleKind
from gpdf_service.perception.obstacles import CLEAN as CLEAN
from gpdf_service.perception.obstacles import Obstacles as Obstacles
from gpdf_service.perception.obstacles import Scan as Scan
from gpdf_service.perception.obstacles import are_voxels as are_voxels
from gpdf_service.perception.obstacles import obstacles_of as obstacles_of
from gpdf_service.perception.rays import Rays as Rays
from gpdf_service.perception.rays import check_origins as check_origins
from gpdf_service.perception.segment import segment_ground as segment_ground
