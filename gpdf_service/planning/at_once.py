"""The planner's stages in one kernel, for a cylinder whose way is one piece on one level. Most ways are.

What is done is what `planner` does stage by stage, by the same functions. But to hand a scene's arrays from Python to
each stage's kernel takes as long as a stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.planning.certificate import Seen, prove
from gpdf_service.planning.chomp import Bending, ChompResult, bend
from gpdf_service.planning.footprint import stand_along
from gpdf_service.planning.timing import time_along, walk
from gpdf_service.search.ways import Fields, Here, way_steps
from gpdf_service.types import FloatArray

MORE_STEPS = 0.05
"""[m] Rise and fall in steps that a bent path may have over its seed's: less than a step, what a diagonal adds."""


class Pace(NamedTuple):
    """Of a cylinder: its radius, speed, acceleration, turn rate; and room beside it with which it goes freely [m]."""

    radius: float
    speed: float
    acceleration: float
    turn_rate: float
    preferred: float


class Made(NamedTuple):
    """What the stages made of a way.

    Attributes:
        run: What the optimiser says, if its path was taken: `is_bent`.
        is_bent: Else the seed is as it was.
        contact: Contact points (n, 3) [m].
        top: The body's top, upright over them (n, 3) [m].
        seen: What is proven of it.
        takes: What it takes, (6,): see `gpdf_service.search.ways`.
        times: Shape (n,) [s].
        headings: Shape (n,) [rad].
    """

    run: ChompResult
    is_bent: bool
    contact: FloatArray
    top: FloatArray
    seen: Seen
    takes: FloatArray
    times: FloatArray
    headings: FloatArray


@njit(cache=True, nogil=True)
def go_at_once(path: FloatArray, here: Sequence[Here], bent_by: Sequence[Fields], bending: Bending, pace: Pace) -> Made:
    """Bend a way in plan, (n, 2) [m], by the fields of its level, stand along it, prove it, and time it."""
    discs, spacing, height = bending.discs, bending.spacing, bending.wants.height
    bent, run = bend(path, here, bent_by, bending)
    is_bent = len(run.xi) > 0
    if len(bent) == 0 or not is_bent:
        bent = path
    stepped, high = way_steps(bent, here)
    if stepped > 0.0:
        most, highest = way_steps(path, here)
        if stepped > most + MORE_STEPS or high > highest + MORE_STEPS:
            bent, is_bent = path, False
    contact, top, headings = stand_along(bent, 0.0, spacing[1], here, bent_by, height)
    body = discs.offsets, here[0].about.reach, pace.radius, height
    seen = prove(here, bent_by, contact, top, headings, body)
    share, takes, times = np.ones(len(contact)), np.zeros(6), np.zeros(len(contact))
    if not seen.unknown:  # what stands nowhere takes no time
        walk(here, contact, headings, discs.offsets, pace.preferred, pace.radius, share, takes)
        top[:, :2], top[:, 2] = contact[:, :2], contact[:, 2] + height
        times, headings = time_along(top, share * pace.speed, pace.speed, pace.acceleration, pace.turn_rate)
    return Made(run, is_bent, contact, top, seen, takes, times, headings)
