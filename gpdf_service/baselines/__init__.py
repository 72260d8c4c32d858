"""The paper's three baselines, for comparison: A* and PRM on one plane, and CHOMP with one field over all points."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.baselines.plan import plan_baseline as plan_baseline
