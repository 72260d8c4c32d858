"""OMPL in the plane: one call for any of its geometric planners, with any test of a motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpdf_service.types import FloatArray

MotionTest = Callable[[FloatArray, FloatArray], bool]
"""Whether the line between two places in plan, shape (2,) [m], is valid; twice the same: whether the place is."""


def sample_path(
    planner: str,
    clear: MotionTest,
    low: FloatArray,
    high: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    seconds: float,
) -> FloatArray | None:
    """Let an OMPL planner find a path, and simplify it as OMPL does.

    Args:
        planner: Name of a planner in `ompl.geometric`, such as "PRM".
        clear: The test of a motion.
        low: Lower corner of the space [m], shape (2,).
        high: Upper corner [m].
        start: In plan [m], shape (2,).
        goal: The same.
        seconds: That the search may take; RRT* and its kind take all of it, the others stop at their first path.

    Returns:
        Places, shape (n, 2) [m], or none if no exact solution was found in time.
    """
    from ompl import base, geometric, util

    class Motion(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: FloatArray, b: FloatArray, *_: object) -> bool:
            return bool(clear(np.array([a[0], a[1]]), np.array([b[0], b[1]])))

    def valid(state: FloatArray) -> bool:
        place = np.array([state[0], state[1]])
        return bool(clear(place, place))

    util.setLogLevel(util.LOG_NONE)
    plane, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, float(low[axis]))
        bounds.setHigh(axis, float(high[axis]))
    plane.setBounds(bounds)
    setup = geometric.SimpleSetup(plane)
    information = setup.getSpaceInformation()
    motion = Motion(information)
    information.setMotionValidator(motion)
    setup.setStateValidityChecker(valid)
    ends = plane.allocState(), plane.allocState()
    for end, place in zip(ends, (start, goal), strict=True):
        end[0], end[1] = float(place[0]), float(place[1])
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(getattr(geometric, planner)(information))
    setup.solve(seconds)
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    return np.array([[state[0], state[1]] for state in setup.getSolutionPath().getStates()])
