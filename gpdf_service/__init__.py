"""Certified 3D trajectories on the ground, from Gaussian-process distance fields.

The names below are loaded on first use, so that the light client's install, which has no SciPy and no Numba, can run
`gpdf client`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gpdf_service.clouds import read_cloud as read_cloud
    from gpdf_service.config import Config as Config
    from gpdf_service.errors import GpdfError as GpdfError
    from gpdf_service.perception import segment_ground
    from gpdf_service.pipeline import build_scene as build_scene
    from gpdf_service.pipeline import plan as plan
    from gpdf_service.scene import Scene as Scene
    from gpdf_service.scene import load_scene as load_scene
    from gpdf_service.types import AGENTS as AGENTS
    from gpdf_service.types import Agent as Agent
    from gpdf_service.types import Certificate as Certificate
    from gpdf_service.types import PlanResult as PlanResult
    from gpdf_service.types import Status as Status
    from gpdf_service.types import Trajectory as Trajectory

__version__ = "0.1.0"

_WHERE = {
    "Config": "config",
    "GpdfError": "errors",
    "read_cloud": "clouds",
    "segment_ground": "perception",
    "build_scene": "pipeline",
    "plan": "pipeline",
    "Scene": "scene",
    "load_scene": "scene",
    **dict.fromkeys(("AGENTS", "Agent", "Certificate", "PlanResult", "Status", "Trajectory"), "types"),
}

__all__ = [
    "AGENTS",
    "Agent",
    "Certificate",
    "Config",
    "GpdfError",
    "PlanResult",
    "Scene",
    "Status",
    "Trajectory",
    "build_scene",
    "load_scene",
    "plan",
    "read_cloud",
    "segment_ground",
]


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    globals()[name] = value
    return value
