"""From a cloud to ground and levels."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.perception.change import Perceived as Perceived
from gpdf_service.perception.change import change as change
from gpdf_service.perception.cloud import WholeError as WholeError
from gpdf_service.perception.cure import Sampling as Sampling
from gpdf_service.perception.cure import cure_and_segment as cure_and_segment
from gpdf_service.perception.keep import levels_from_arrays as levels_from_arrays
from gpdf_service.perception.keep import levels_to_arrays as levels_to_arrays
from gpdf_service.perception.levels import count_undecided as count_undecided
from gpdf_service.perception.levels import survey_levels as survey_levels
from gpdf_service.perception.rays import Rays as Rays
from gpdf_service.perception.rays import check_origins as check_origins
from gpdf_service.perception.rays import rays_of as rays_of
from gpdf_service.perception.segment import segment_ground as segment_ground
