"""Gaussian-process distance fields: distance and gradient for the price of a nearest-neighbour query."""

import gpdf_service.kernel_cache  # noqa: F401  # before any kernel
from gpdf_service.fields.gpdf import Domain as Domain
from gpdf_service.fields.gpdf import Gpdf as Gpdf
from gpdf_service.fields.gpdf import Nearer as Nearer
from gpdf_service.fields.gpdf import check_queries as check_queries
from gpdf_service.fields.gpdf import find_nearest as find_nearest
from gpdf_service.fields.gpdf import fit_gpdf as fit_gpdf
from gpdf_service.fields.order import morton as morton
from gpdf_service.fields.spacing import estimate_spacing as estimate_spacing
from gpdf_service.fields.spacing import thin as thin
from gpdf_service.fields.traversal import NearerArrays as NearerArrays
from gpdf_service.fields.traversal import sample_at as sample_at
from gpdf_service.fields.tree import Tree as Tree
from gpdf_service.fields.tree import build_tree as build_tree
from gpdf_service.fields.tree import change_tree as change_tree
from gpdf_service.fields.tree import tree_of as tree_of
