"""Measurements: accuracy, speed and safety, each beside a peer or an independent judge in the same run."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
