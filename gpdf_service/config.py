"""Configuration: one frozen dataclass a stage, nested once. Every default has its unit and its reason under it."""

from __future__ import annotations

import dataclasses
import tomllib
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gpdf_service.errors import ConfigError

SERVICE_TABLE = "serve"
"""The table of a configuration file that says how to serve; the others say how to build and plan."""


@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """Ground, levels and the limits of the ground."""

    max_step: float = 0.37
    """[m] Highest step that joins two pieces of ground: what the most able body takes; a seat is 0.40 to 0.45 high."""
    stair_step: float = 0.25
    """[m] Highest riser of a stair: building codes say 0.19 to 0.22; treads too narrow to stand on must keep to it."""
    tread_depth: float = 0.2
    """[m] Shallowest tread: building codes say 0.22 to 0.28; a scan loses an edge."""
    standing_width: float = 0.5
    """[m] Narrowest platform that is ground: the width of a person, Uttsha et al. 2024, Table 1."""
    steepest: float = 0.7
    """[rad] Steepest slope within a piece of ground: 40°, beyond what any body here stands on (30°)."""
    standable_slope: float = 0.524
    """[rad] Steepest slope that a body stands on: 30°, what a quadruped's data sheet says."""
    min_headroom: float = 0.1
    """[m] Least room over a piece of ground that is worth keeping: the height of the lowest body, a Roomba."""
    negligible_noise: float = 0.005
    """[m] Noise below which a cloud is taken as it is: what a good scanner has, and a foot or a wheel does not feel."""
    storey_headroom: float = 1.9
    """[m] Least room under a storey's ceiling: a low cellar; between a slab's two faces, or over a table, is less."""
    widest_gap: float = 0.25
    """[m] Widest gap between samples of the ground that a foot bridges: the length of a shoe, which no wheel here has.
    Ground further than this from every sample is unobserved, unless seen floor all around explains it."""
    memory_budget: float = 3e8
    """[bytes] That grids may take beyond what the number of points explains: 55 × 55 m of the finest cells. A cloud
    in millimetres, or with an outlier, asks for a thousand times as much."""
    step_headroom: float = 0.7
    """[m] Room over a step that joins two pieces of ground: the height of the lowest body that steps, a Spot."""


@dataclass(frozen=True, slots=True)
class FieldConfig:
    """Gaussian-process distance fields."""

    length_scale_factor: float = 1.5
    """[-] Length scale over point spacing: 1 to 1.7 is the sweet spot measured for the squared exponential kernel."""
    noise_variance: float = 0.09
    """[-] Observation noise of the occupancy: keeps the kernel matrix well conditioned and its sums positive."""


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """Quadtree, connectivity graph and A*."""

    noise_margin: float = 0.5
    """[-] Room kept beyond the radius over the noise of the cloud: what a cured corner or edge is off by."""
    margin: float = 0.002
    """[m] Kept beyond the radius while searching, so that rounding and smoothing leave something to certify."""
    field_spacing: float = 0.125
    """[-] Spacing of the Obstacle GPDF's points over the body's radius: 2 cm for a Roomba, 3 cm for a human."""


@dataclass(frozen=True, slots=True)
class PlanningConfig:
    """CHOMP, certificate and time parametrisation."""

    preferred_clearance: float = 1.0
    """[-] Room that a path wants beside the body, over its radius: as much again as it needs."""
    corner_room: float = 0.5
    """[-] Share of the preferred clearance that a path keeps round a sharp corner; nearer to 1, it goes wider there and
    bends more where it passes between things."""
    max_iterations: int = 100
    """[-] Steps of CHOMP, refused ones too; most paths rest after 5 to 10."""
    tolerance: float = 3e-4
    """[-] Share of the cost that a step must win for CHOMP to go on; a tenth of it wins another 0.03 %."""
    waypoint_spacing: float = 0.05
    """[m] Between waypoints of the result: a walker's sway, and the finest cell of the ground."""

    def __post_init__(self) -> None:
        if not self.corner_room < 1.0:
            raise ConfigError("config.planning.corner_room", f"{self.corner_room!r}", "It must be less than 1.")

    def smoothness_weight(self, radius: float) -> float:
        """λ_s [m] of a body of that radius [m]; λ_o = λ_g = 1.

        Round a corner the path is an arc that its tension λ_s / (radius + d) pulls in, and the obstacle cost pushes
        out with 1 − d / ε, at the room d; ε is the preferred clearance. They are equal where d is `corner_room` of ε.
        """
        return (1.0 - self.corner_room) * radius * (1.0 + self.corner_room * self.preferred_clearance)


@dataclass(frozen=True, slots=True)
class Config:
    """Everything that can be set; works as it is."""

    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    fields: FieldConfig = field(default_factory=FieldConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    planning: PlanningConfig = field(default_factory=PlanningConfig)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Config:
        """Build from nested mappings, for example a parsed TOML file.

        Raises:
            ConfigError: an unknown key, a wrong type or a value out of range.
        """
        return _build(cls, values, "config")

    @classmethod
    def from_kept(cls, values: Mapping[str, Mapping[str, Any]]) -> Config:
        """What a scene's file holds: as `from_mapping`, without what is asked for no more."""
        now = dataclasses.asdict(cls())
        kept = {table: {key: each[key] for key in each if key in now[table]} for table, each in values.items()}
        return cls.from_mapping(kept)


def read_tables(file: Path) -> dict[str, Any]:
    """What a TOML file holds, for `Config.from_mapping`.

    Raises:
        ConfigError: it is not there, cannot be read, or is no TOML.
    """
    try:
        return tomllib.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"configuration {file}", str(error), "Give a readable TOML file.") from error


T = typing.TypeVar("T")


def _build(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    if not isinstance(values, Mapping):
        raise ConfigError(where, f"{values!r}", "It must be a table of keys and values.")
    hints = typing.get_type_hints(cls)
    unknown = sorted(set(values) - set(hints))
    if unknown:
        raise ConfigError(f"{where}.{unknown[0]}", "there is no such key", f"Keys here: {', '.join(hints)}.")
    made: dict[str, Any] = {}
    for key, value in values.items():
        kind = hints[key]
        if dataclasses.is_dataclass(kind):
            made[key] = _build(typing.cast("type[Any]", kind), value, f"{where}.{key}")
        elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
            made[key] = float(value)
        elif isinstance(kind, type) and isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
            made[key] = value
        else:
            raise ConfigError(f"{where}.{key}", f"{value!r}", f"It must be of type {getattr(kind, '__name__', kind)}.")
    for key, value in made.items():
        if isinstance(value, int | float) and not 0 < value < float("inf"):
            raise ConfigError(f"{where}.{key}", f"{value!r}", "It must be a positive, finite number.")
    return cls(**made)
