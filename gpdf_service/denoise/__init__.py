"""Noise: how much of it a cloud has, its points moved onto their surfaces, and what is left of it."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.denoise.cloud import BLOCK as BLOCK
from gpdf_service.denoise.cloud import Denoised as Denoised
from gpdf_service.denoise.cloud import as_measured as as_measured
from gpdf_service.denoise.cloud import denoise as denoise
from gpdf_service.denoise.cloud import halo_of as halo_of
from gpdf_service.denoise.explained import return_explained as return_explained
from gpdf_service.denoise.flights import Flight as Flight
from gpdf_service.denoise.flights import onto_risers as onto_risers
from gpdf_service.denoise.flights import onto_treads as onto_treads
from gpdf_service.denoise.noise import estimate_noise as estimate_noise
from gpdf_service.denoise.rest import FAR as FAR
from gpdf_service.denoise.rest import find_lifted as find_lifted
