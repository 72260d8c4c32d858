"""CHOMP, certificate, time stamps."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.planning.certificate import certify as certify
from gpdf_service.planning.chomp import ChompResult as ChompResult
from gpdf_service.planning.chomp import optimize as optimize
from gpdf_service.planning.planner import plan_path as plan_path
from gpdf_service.planning.timing import time_path as time_path
