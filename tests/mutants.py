"""`make mutants`: small random faults in the modules that keep people safe, and whether a test notices each.

A mutant is one operator, comparison, condition, constant, minimum or maximum that is another. It is written into a copy
of the checkout, where the module's own tests run until one fails. What survives is printed with its line: either a
test is missing, or both behave alike, and then the reason stands in `EQUAL`.

    python tests/mutants.py --each 40 --seed 1 --only certificate limits
"""

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
TREES = ("gpdf_service", "clients", "schemas", "tests", "pyproject.toml")
PLANS = ("tests/planning/test_planner.py", "tests/planning/test_plan_options.py")
MODULES = {
    "gpdf_service/planning/certificate.py": (
        "tests/planning/test_certificate_oracle.py",
        "tests/planning/test_certificate.py",
        "tests/test_noise.py::test_what_wear_can_hide_on_a_flight_is_said",
    ),
    "gpdf_service/planning/endpoints.py": ("tests/planning/test_endpoints.py", *PLANS),
    "gpdf_service/planning/planner.py": (
        "tests/planning/test_planner_parts.py",
        *PLANS,
        "tests/planning/test_others.py",
        "tests/planning/test_footprint.py",
    ),
    "gpdf_service/planning/timing.py": ("tests/planning/test_timing.py",),
    "gpdf_service/search/graph.py": ("tests/search/test_graph.py", "tests/search/test_change.py"),
    "gpdf_service/search/quadtree.py": ("tests/search/test_quadtree.py",),
    "gpdf_service/search/lattice.py": (
        "tests/search/test_pose_grids.py",
        "tests/search/test_wavefront.py",
        "tests/planning/test_footprint.py",
    ),
    "gpdf_service/ground/obstacles.py": (
        "tests/ground/test_obstacles_oracle.py",
        "tests/ground/test_obstacles.py",
    ),
    "gpdf_service/ground/limits.py": ("tests/ground/test_limits.py",),
    "gpdf_service/service/in_use.py": ("tests/service/test_in_use.py",),
    "gpdf_service/service/moving.py": ("tests/service/test_moving.py",),
    "clients/gpdf_guidance/corridor.py": ("tests/clients/test_corridor.py", "tests/clients/test_guidance.py"),
    "clients/gpdf_robot/driver.py": ("tests/clients/test_driver.py", "tests/clients/test_robot.py"),
    "clients/gpdf_robot/controller.py": ("tests/clients/test_robot_parts.py",),
}
"""Each module, and the tests that are its own."""
CONTROLLER, CORRIDOR = "clients/gpdf_robot/controller.py", "clients/gpdf_guidance/corridor.py"
DRIVER = "clients/gpdf_robot/driver.py"
FAST = "abs(self._command.turn) {} 0.1 * self.body.turn_rate"
SHOWN = 150
"""Characters of a change."""
ENDPOINTS, IN_USE = "gpdf_service/planning/endpoints.py", "gpdf_service/service/in_use.py"
SWEPT_AT = "if self._total + size - self._sizes.get(scene, 0) > MAX_IN_ALL and now - self._swept > SWEEP_S:"
AT_A_DISC = "space.levels[level].clearance(disc_places(poses, offset))[0]"
FIRST = "seconds = 0.0 if self._stepped is None else now - self._stepped"
SWEPT = "moved = np.linalg.norm(np.diff(trajectory.ground[:, :2], axis=0), axis=1) + agent.offsets[-1] * turned"
PIECES = "pieces: FloatArray = np.maximum(1, np.ceil(moved / SPACING))"
ASKED = "moves and (asked := self._asked.setdefault(scene, [])) is not None"
HIGH = "(points <= high + np.array([radius, radius, agent.height]))"
RIM = "rim = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])"
CERTIFICATE = "gpdf_service/planning/certificate.py"
LIMITS, OBSTACLES = "gpdf_service/ground/limits.py", "gpdf_service/ground/obstacles.py"
GRAPH, QUADTREE = "gpdf_service/search/graph.py", "gpdf_service/search/quadtree.py"
LOOKED = "looked = np.zeros((max(last[0] - first[0], 0), max(last[1] - first[1], 0)), np.bool_)"
SPARE = "count = max(1, int(np.ceil(length / sample))) if length < np.inf else 1  # NaN: over no known ground"
MERGED = "size, used, f = len(old[0]) + len(fresh[0]), 0, 0"
SNAPPED = "np.linalg.norm({}[:2] - place[:2]) {} snap"
LOOK = "(looks % every == 0 or (i == last and k == count)) and off > deviation"
RING, BIT = "ring < max(state.shape)", "a length to the last bit"
BEYOND = "np.hypot(x - i - 0.5, y - j - 0.5) * width"
ASKEW = "np.abs([wrap(angle - facing) for angle in heading])"
SHUT = "(nearest_of(taken)[0] + np.sqrt(2.0)) * surface.cell_width"
TURNS = "abs(aside) {} (TURN_UNTIL if speed < STANDS else TURN_FIRST)"
UNSET = "self._along, self._best, self._version, self._room = 0.0, -np.inf, 0, np.inf"
PLANNER, FOOTPRINT = "gpdf_service/planning/planner.py", "gpdf_service/planning/footprint.py"
MOVED = "sqrt(dx * dx + dy * dy) + lever * abs(heading[i] - heading[i - 1])"
ONE_DOOR = "at = [Doors(np.array([node]), np.zeros(1)) for node in (start, goal)]"
LATTICE = "gpdf_service/search/lattice.py"
ASLANT = "atan2(j, i) - 2.0 * pi * h / grid.turns"
TIMING = "gpdf_service/planning/timing.py"
BESIDE = "before, next_ = max(i - 1, 0), min(i + 1, count - 1)"
NEVER = "room, was_x, was_y, unknown = -np.inf, 0.0, 0.0, False  # there is at least so much, since that place"
RESTS = "t = TICK * (np.arange(int(np.ceil(times[-1] / TICK)) + 2 * margin + 1) - margin)"
APART = "(i + n) * share <= left - 1 or i * share >= right + 1 or (j + n) * share <= near - 1 or j * share >= far + 1"
BEGUN = "poses, where, off_at, nearest = path.copy(), path[0].copy(), path[0].copy(), np.inf"
ENDED = "place[k] = (total[k + width] - total[k]) / width if k + width <= len(place) else place[k - 1]"
NAMED = 'return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", place, strict=True) if np.isfinite(v)}'
RISES = "field(places.reshape(-1, 3))[0].reshape(places.shape[:2])"
TREADS = "footing_reach(surface) + rings_of(SOLE, width)"
SPARED = "what shuts ground off is nearer than a disc's radius less √2 cells: three cells fewer would do"
STEPS = "steps = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if i * i + j * j in _STEP_COSTS]"
EQUAL: dict[tuple[str, ...], str] = {
    (CERTIFICATE, "0.0 → (0.1)", f"if {LOOK} and spare <= 0.0:"): "the field is asked more often",
    (CERTIFICATE, "0 → (1)", BEGUN): "where nothing is off there is no place of it; the other one is written over",
    (
        CERTIFICATE,
        "max(SAMPLE, CELL_SHARE * ground.width) → (min(SAMPLE, CELL_SHARE * ground.width))",
    ): "it is looked at more often",
    (CERTIFICATE, "seen.clearance < clearance → (seen.clearance <= clearance)"): BIT,
    (CERTIFICATE, "far2 < nearest → (far2 <= nearest)"): BIT,
    (CERTIFICATE, "ring * ring < nearest → (ring * ring <= nearest)"): "rings further out hold none that is nearer",
    (ENDPOINTS, "-1 → (1)", RIM): "the map's rim is wider than a cell",
    (ENDPOINTS, "1 → (2)", RIM): "the map's rim is wider than a cell",
    (PLANNER, "300_000 → (300001)"): "a waypoint more in a second",
    (PLANNER, "True → (False)", NAMED): "a place has three numbers",
    (TIMING, "1 → (2)", ENDED): "what has arrived stays there",
    (
        OBSTACLES,
        "_on_rungs(z - z[0], pitch) or _pitch(z) > 0.0 → (_pitch(z) > 0.0)",
    ): "that all lie on the rungs of the first spares a look at all differences",
    (LIMITS, "around >= np.clip(need, 3, 6) - 0.5 → (around > np.clip(need, 3, 6) - 0.5)"): "a count to the last bit",
    (LIMITS, "0.0 < away <= reach**2 → (0.0 <= away <= reach ** 2)"): "a cell that is asked is not level itself",
    (LATTICE, f"{ASLANT} + pi → ({ASLANT} - pi)"): "half a turn either way",
    (LATTICE, "2 → (3)", STEPS): "no step of the lattice is three cells long",
    (LATTICE, "8 → (9)", "MOST_TRIES = 8"): "a way more is tried",
    (TIMING, "1 → (2)", BESIDE): "headings are means over more places, so they change as much over three as over two",
    (TIMING, "0.0 → (0.1)", NEVER): "less than nothing, wherever from",
    (TIMING, "2 → (3)", RESTS): "who has arrived rests longer, which is cut off",
    (TIMING, "-1 → (1)", "place[len(place) - width + 1 :] = place[-1]"): "what is after the arrival is cut off",
    (FOOTPRINT, f"{MOVED} > STILL → ({MOVED} >= STILL)"[:SHOWN]): "a nanometre to the last bit",
    (PLANNER, "left < 0.0 → (left <= 0.0)"): "a time to the last bit",
    (LATTICE, "30.0 → (60.1)"): "detours that are longer yet are looked at, too",
    (LATTICE, "1.3 → (2.7)"): "longer detours are looked at sooner, and the shortest way is taken",
    (CERTIFICATE, "spare <= 0.0 → (spare < 0.0)"): "what is left of a distance is nothing to the last bit",
    (
        CERTIFICATE,
        "least < reach <= least + RESOLUTION → (least <= reach <= least + RESOLUTION)",
    ): BIT,
    (
        CERTIFICATE,
        "least < reach <= least + RESOLUTION → (least < reach < least + RESOLUTION)",
    ): BIT,
    (CERTIFICATE, "clearance < 0 → (clearance <= 0)"): BIT,
    (CERTIFICATE, f"{RING} → (ring <= max(state.shape))"): "a ring around the whole map holds no cell",
    (CERTIFICATE, f"ring * ring < nearest and {RING} → ({RING})"): "rings further out hold none that is nearer",
    (CERTIFICATE, "1 → (2)", "looks += 1"): "the height is looked at no less often",
    (CERTIFICATE, "i == last and k == count → (i == last or k == count)"): "the height is looked at more often",
    (CERTIFICATE, f"{LOOK} and spare <= 0.0 → ({LOOK})"[:SHOWN]): "the field is asked more often",
    (CERTIFICATE, "0 → (1)", LOOKED): "room for one cell more",
    (CERTIFICATE, "i == last and k == count → (i == last)"): "the height is looked at more often",
    (CERTIFICATE, "1 → (2)", SPARE): "a piece is looked at once more, or is over no known ground",
    (
        LIMITS,
        "np.isfinite(slope) & ~level → (np.isfinite(slope) | ~level)",
    ): "what is unknown is measured, too, and left away at the end",
    (LIMITS, "slope <= STANDABLE → (slope < STANDABLE)"): BIT,
    (LIMITS, "slope > STANDABLE → (slope >= STANDABLE)"): BIT,
    (LIMITS, "0.0 → (0.1)", "total[:] = 0.0"): "whether a sum is NaN is all that is asked",
    (LIMITS, "found | 1 → (found & 1)"): "it looks on, and finds the same values again",
    (LIMITS, "1 → (2)", "lower, found = few[i], found | 1"): "it looks on, and finds the same values again",
    (LIMITS, "found | 2 → (found & 2)"): "it looks on, and finds the same values again",
    (LIMITS, "3 → (4)", "if found == 3:"): "it looks on, and finds the same values again",
    (LIMITS, "np.minimum(up, down) > level → (np.minimum(up, down) >= level)"): BIT,
    (
        LIMITS,
        "0.0 < away <= reach**2 → (0.0 < away < reach ** 2)",
    ): "who is a stride away leaves none for the other side",
    (LIMITS, "3.0 * width > _LIMITS.tread_depth → (3.0 * width >= _LIMITS.tread_depth)"): BIT,
    (LIMITS, "one < other → (one <= other)"): "two that are equal, either way round",
    (LIMITS, "HALF_FOOT / surface.cell_width**2 - 1e-6 → (HALF_FOOT / surface.cell_width ** 2 + 1e-06)"): BIT,
    (
        GRAPH,
        "source_cost[k] < front.known[node].cost_to_come → (source_cost[k] <= front.known[node].cost_to_come)",
    ): "the same place twice",
    (
        GRAPH,
        "low[1] - reach <= center[i, 1] <= high[1] + reach → (low[1] - reach <= center[i, 1] < high[1] + reach)",
    ): BIT,
    (
        GRAPH,
        "node < front.heap[row] → (node <= front.heap[row])",
    ): "a node stands in the heap once, and is not held against itself",
    (
        GRAPH,
        "reached < front.cost_to_come[goal_node] → (reached <= front.cost_to_come[goal_node])",
    ): "another way at the same cost",
    (
        GRAPH,
        "reached < front.cost_to_come[near] → (reached <= front.cost_to_come[near])",
    ): "another way at the same cost",
    (GRAPH, "asked[i] and same[i] → (same[i])"): "more leaves are looked at again",
    (GRAPH, "1 → (2)", ONE_DOOR): "a price more than there are nodes is not read",
    (GRAPH, "y > 0.0 → (y >= 0.0)"): "further than 0 along x, it is not 0",
    (GRAPH, "0 → (1)", MERGED): "there are as many crossings as pairs",
    (GRAPH, "3.0 → (6.1)"): "more leaves are looked at again",
    (GRAPH, "3.0 * half_size[i] → (3.0 / half_size[i])"): "more leaves are looked at again",
    (
        GRAPH,
        "nearest_at(places, place_of(center[i]), scratch)[0] <= reach"
        " → (nearest_at(places, place_of(center[i]), scratch)[0] < reach)",
    ): BIT,
    (
        QUADTREE,
        "nearest > reach + 2.0 * half_diagonal → (nearest >= reach + 2.0 * half_diagonal)",
    ): BIT,
    (
        QUADTREE,
        "(j + n) * share <= near - 1 → ((j + n) * share < near - 1)",
    ): "what ends where the change begins is made anew",
    (QUADTREE, "(i + n) * share <= left - 1 → ((i + n) * share < left - 1)"): "what ends where it begins is made anew",
    (QUADTREE, f"{APART} → ({APART})"[:SHOWN]): "more than the change is made anew",
    (
        QUADTREE,
        f"{APART} → ({APART.partition(' or ')[2]})"[:SHOWN],
    ): "more than the change is made anew",
    (OBSTACLES, f"{TREADS} + 1 → ({TREADS} - 1)"): SPARED,
    (OBSTACLES, "1 → (2)", f"return shut + max(body, {TREADS} + 1), shut"): "more is looked at",
    (OBSTACLES, "1 → (2)", "body = int(np.ceil(agent.cylinder.radius / width)) + 1"): "more is looked at",
    (OBSTACLES, "1 → (2)", "rings = int(radius / width) + 1"): "more cells are looked at, and none is near",
    (OBSTACLES, "cells + row → (cells - row)"): "a disc is the same both ways",
    (OBSTACLES, "foot < height <= ledge - step → (foot < height < ledge - step)"): BIT,
    (OBSTACLES, "limits.value > reach → (limits.value >= reach)"): BIT,
    (
        OBSTACLES,
        "height[i, j] - max_step <= foot <= points[m, 2] - tall"
        " → (height[i, j] - max_step <= foot < points[m, 2] - tall)",
    ): BIT,
    (OBSTACLES, "near >= radius → (near > radius)"): BIT,
    (OBSTACLES, f"{BEYOND} > radius - SOLE → ({BEYOND} >= radius - SOLE)"): BIT,
    (OBSTACLES, f"{SHUT} < agent.disc_radius → ({SHUT} <= agent.disc_radius)"[:SHOWN]): BIT,
    (OBSTACLES, "ledge <= foot + max_step → (ledge < foot + max_step)"): BIT,
    (OBSTACLES, "z <= lowest + scatter → (z < lowest + scatter)"): BIT,
    (IN_USE, f"{ASKED} → ({ASKED.removeprefix('moves and ')})"): "where nothing moves there is nothing to look for",
    (IN_USE, "1 → (2)", "discs = self.discs.reshape(-1, 3)"): "any negative length is the unknown one",
    (
        IN_USE,
        "1 → (2)",
        'above = points[pairs["j"], 2] - swept.discs.reshape(-1, 3)[pairs["i"], 2]',
    ): "any negative length is the unknown one",
    (IN_USE, "1 → (2)", "at = np.arange(knots[-1] + 1)"): "the last place twice",
    (IN_USE, "2 → (3)", SWEPT): "on a slope it is looked at more often",
    (IN_USE, "1 → (2)", PIECES): "what stands still is looked at once more",
    (
        IN_USE,
        "1 → (2)",
        "return self.agent.discs * (1 + int(_pieces(self.trajectory, self.agent).sum()))",
    ): "one place more of four million",
    (IN_USE, "self._places > MOST_PLACES → (self._places >= MOST_PLACES)"): "one place of four million",
    (
        IN_USE,
        f"(points >= low - radius) & {HIGH} → ((points >= low - radius) | {HIGH})"[:SHOWN],
    ): "more points are looked at, and none touches",
    (IN_USE, "4_000_000 → (4000001)"): "one place of four million",
    ("gpdf_service/service/moving.py", "0 → (1)", SWEPT_AT): "one point of all that move",
    (ENDPOINTS, "distance[0] < space.reach → (distance[0] <= space.reach)"): "a distance to the last bit",
    (ENDPOINTS, f"{AT_A_DISC} >= space.reach → ({AT_A_DISC} > space.reach)"[:SHOWN]): "a distance to the last bit",
    (ENDPOINTS, "room >= space.reach → (room > space.reach)"): "a distance to the last bit",
    (ENDPOINTS, "len(heights) > 1 → (len(heights) >= 1)"): "one height differs from no other",
    (
        ENDPOINTS,
        "-width <= x - u <= (nx + 1) * width → (-width < x - u <= (nx + 1) * width)",
    ): "a place to the last bit",
    (ENDPOINTS, "found.nearest is None or snap <= 0.0 → (found.nearest is None)"): "no place is nearer than no way",
    (
        ENDPOINTS,
        "isinstance(reached[0], Refusal) and all(isinstance(goal, Refusal) for goal in reached)"
        " → (all((isinstance(goal, Refusal) for goal in reached)))",
    ): "all of them, so the first",
    (
        ENDPOINTS,
        f"{SNAPPED.format('found.nearest', '>')} → ({SNAPPED.format('found.nearest', '>=')})",
    ): "a distance to the last bit",
    (
        ENDPOINTS,
        f"{SNAPPED.format('near', '>')} → ({SNAPPED.format('near', '>=')})",
    ): "a distance to the last bit",
    (
        ENDPOINTS,
        "room >= space.reach + agent.offsets[-1] → (room > space.reach + agent.offsets[-1])",
    ): "a room to the last bit",
    (ENDPOINTS, "0 → (1)", RIM): "the map's rim is wider than a cell",
    (CONTROLLER, f"{TURNS.format('>')} → ({TURNS.format('>=')})"): "an angle that is the limit to the last bit",
    (CONTROLLER, "speed < STANDS → (speed <= STANDS)"): "a speed that is the limit to the last bit",
    (CONTROLLER, "remaining / APPROACH_S → (remaining * APPROACH_S)"): "it is one second",
    (CONTROLLER, "1e-9 → (0.100000002)"): "a bend of ten metres' radius slows nobody here",
    (DRIVER, "now - self._moved_at > GIVE_UP_S → (now - self._moved_at >= GIVE_UP_S)"): "a time to the last bit",
    (DRIVER, f"{FAST.format('>')} → ({FAST.format('>=')})"): "a turn that is the limit to the last bit",
    (DRIVER, "wanted.speed > 0.0 → (wanted.speed >= 0.0)"): "who turns on the spot has as much room then as now",
    (DRIVER, "2.0 * pose.accuracy > self.margins[0] → (2.0 * pose.accuracy >= self.margins[0])"): "to the last bit",
    (
        DRIVER,
        "result.status is Status.OK and result.trajectory is not None → (result.status is Status.OK)",
    ): "what is OK has a trajectory",
    (
        DRIVER,
        "look.arc < min(look.keep, look.here - 1e-3) → (look.arc <= min(look.keep, look.here - 0.001))",
    ): "a room to the last bit",
    (DRIVER, "0.0 → (0.1)", FIRST): "at the first step there is no route yet",
    (DRIVER, "0 → (1)", "self._agent = body.agent(self.margins[0])"): "the plan sets it before it is read",
    (DRIVER, "route.length - self._along <= ARRIVED_M → (route.length - self._along < ARRIVED_M)"): "to the last bit",
    (DRIVER, "look.line < -KEEP → (look.line <= -KEEP)"): "a room to the last bit",
    (
        DRIVER,
        "look.arc < min(look.keep, look.here - 1e-3) and wanted.speed > 0.0"
        " → (look.arc < min(look.keep, look.here - 0.001))",
    ): "who turns on the spot has as much room then as now",
    (DRIVER, "1 → (2)", "count = max(2, 1 + round(self._reach(velocity) / CHECK_M))"): "one place more is asked about",
    (DRIVER, "0.0 → (0.1)", UNSET): "the plan sets it before it is read",
    (DRIVER, "0 → (1)", UNSET): "the plan sets it before it is read",
    (DRIVER, "0.0 → (0.1)", "self._wait_s = 0.0"): "the last request was never",
    (CORRIDOR, "s >= f.start - SPACING → (s > f.start - SPACING)"): "a sample at the limit to the last bit",
    (CORRIDOR, "s <= f.end + SPACING → (s < f.end + SPACING)"): "a sample at the limit to the last bit",
    (CORRIDOR, "np.minimum(*away) > least[:, None] → (np.minimum(*away) >= least[:, None])"): "the same of a height",
    (
        CORRIDOR,
        "np.abs(edges[:, 2] - z) < 0.5 * step → (np.abs(edges[:, 2] - z) <= 0.5 * step)",
    ): "the same of a height",
    (CORRIDOR, "side < margin[:, None] → (side <= margin[:, None])"): "a room to the last bit",
    (
        CORRIDOR,
        "side < np.maximum(margin, EDGE_SEEN)[:, None] → (side <= np.maximum(margin, EDGE_SEEN)[:, None])",
    ): "a room to the last bit",
    (CORRIDOR, "rise < LEAST_EDGE → (rise <= LEAST_EDGE)"): "a height to the last bit",
    (
        CORRIDOR,
        f"{RISES} > LEAST_EDGE → ({RISES} >= LEAST_EDGE)"[:SHOWN],
    ): "a height to the last bit",
    (
        CORRIDOR,
        f"{ASKEW} <= SQUARE → ({ASKEW} < SQUARE)",
    ): "an angle to the last bit",
    (CORRIDOR, "heading[near] + angle → (heading[near] - angle)"): "the same lines, from their other ends",
    (CORRIDOR, "inward <= INTO_STAIRS → (inward < INTO_STAIRS)"): "a place to the last bit",
    (
        CORRIDOR,
        "1 → (2)",
        "return room(places.reshape(-1, 3)).reshape(places.shape[:2])",
    ): "any negative length is unknown",
    (ENDPOINTS, "room < space.reach + FINEST → (room <= space.reach + FINEST)"): "a room to the last bit",
    (CORRIDOR, "4 → (5)", "DIRECTIONS = 4"): "more lines are looked along",
    (ENDPOINTS, "1.0 → (2.1)", "NEXT = 1.0"): "leaves that are further off are looked at later",
    (ENDPOINTS, "0.1 → (0.30000000000000004)"): "leaves that are further off are tried after the nearer ones",
    (IN_USE, "1 → (2)", "return cKDTree(self.discs.reshape(-1, 3)[:, :2])"): "any negative length is the unknown one",
    (
        IN_USE,
        f"{HIGH[1:-1]} → (points < {HIGH.removeprefix('(points <= ')}",
    ): "what is over the body is left away later",
}
"""Mutants that behave as what they were made of, by module, change and, if that is not enough, line, and why."""
LIMIT_S = 300
"""[s] The tests of a module take a minute at most. A mutant that takes longer hangs: it was noticed."""
MOST_MEMORY = 2**33
"""Bytes of address space for them, three times what they take: a faulty loop may fill the machine."""
SWAPS = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.Is: ast.IsNot, ast.IsNot: ast.Is},
}
REVERSED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """A module's text with one fault in it."""

    module: str
    line: int
    what: str
    text: str

    def __str__(self):
        return f"{self.module}:{self.line}  {self.what}"


def changes(node):
    """What is put in an expression's place, as new nodes; nothing for most."""
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for table in (SWAPS, REVERSED):
                if type(op) in table:
                    made = copy.deepcopy(node)
                    made.ops[i] = table[type(op)]()
                    yield made
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS:
        made = copy.deepcopy(node)
        made.op = SWAPS[type(node.op)]()
        yield made
    if isinstance(node, ast.BoolOp):
        for i in range(len(node.values)):
            made = copy.deepcopy(node)
            made.values.pop(i)
            yield made
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        yield node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1 if isinstance(node.value, int) else 2.0 * node.value + 0.1)
    if isinstance(node, ast.Call):
        made = copy.deepcopy(node)
        name = made.func
        key = "id" if isinstance(name, ast.Name) else "attr" if isinstance(name, ast.Attribute) else None
        if key and getattr(name, key) in NAMES:
            setattr(name, key, NAMES[getattr(name, key)])
            yield made


def expressions(tree):
    """The expressions that run: neither annotations nor decorators."""
    for node in ast.walk(_stripped(tree)):
        if isinstance(node, ast.If | ast.IfExp | ast.While):
            yield node.test, [ast.UnaryOp(ast.Not(), node.test)]
        if isinstance(node, ast.expr):
            yield node, changes(node)


def _stripped(tree):
    """The tree without what is no expression that runs; whoever walks it has a node's children before the node."""
    for node in list(ast.walk(tree)):
        for name in ("annotation", "returns", "decorator_list"):
            if hasattr(node, name):
                setattr(node, name, [] if name == "decorator_list" else None)
    return tree


def mutants_of(module, source):
    """Every single fault of a module."""
    lines = source.splitlines(keepends=True)
    begin = [0]
    for line in lines:
        begin.append(begin[-1] + len(line.encode()))
    raw, found = source.encode(), []
    for node, others in expressions(ast.parse(source)):
        a, b = begin[node.lineno - 1] + node.col_offset, begin[node.end_lineno - 1] + node.end_col_offset
        for other in others:
            new = f"({ast.unparse(ast.fix_missing_locations(other))})"
            text = (raw[:a] + new.encode() + raw[b:]).decode()
            what = " ".join(f"{raw[a:b].decode()}  →  {new}".split())
            found.append(Mutant(module, node.lineno, what[:SHOWN], text))
    return found


def check_out(folder):
    """A copy of the checkout, with the kernels that are compiled already."""
    for name in TREES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name)
        else:
            shutil.copy2(source, folder / name)
    _pytest(["--collect-only", *{name for names in MODULES.values() for name in names}], folder, keep=True)


def _pytest(words, folder, *, keep=False):
    """Run pytest in the copy; compiled modules are kept only of what has no fault."""
    paths = os.pathsep.join(str(folder / name) for name in (".", "clients", "schemas"))
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "" if keep else "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", *words]
    bounded = ["prlimit", f"--as={MOST_MEMORY}", *command]
    return subprocess.run(bounded, cwd=folder, env=environment, capture_output=True, timeout=LIMIT_S)


def kept_kernels(folder):
    """Every file of a compiled kernel, and when it was written."""
    return {file: file.stat().st_mtime_ns for file in folder.rglob("*.nb[ic]")}


class Kernels:
    """The kernels as they were compiled without a fault; what a fault compiles anew is put back."""

    def __init__(self, folder, spare):
        self.folder, self.spare = folder, spare
        self.kept = kept_kernels(folder)
        for file in self.kept:
            copy_of = spare / file.relative_to(folder)
            copy_of.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, copy_of)

    def restore(self):
        now = kept_kernels(self.folder)
        for file in now.keys() - self.kept.keys():
            file.unlink()
        for file, written in self.kept.items():
            if now.get(file) != written:
                shutil.copy2(self.spare / file.relative_to(self.folder), file)


def who_failed(said):
    """The first test that failed, by its name, if one did."""
    lines = (line for line in said.splitlines() if line.startswith("FAILED "))
    return next((line.removeprefix("FAILED ").partition(" - ")[0] for line in lines), None)


def is_noticed(mutant, folder, likely):
    """Whether a test of the module fails with the mutant in it; those that have failed before are asked first."""
    file = folder / mutant.module
    was = file.read_text()
    file.write_text(mutant.text)
    first = [name for name, _ in likely[mutant.module].most_common()]
    try:
        return _fails((*first, *MODULES[mutant.module]), folder, likely[mutant.module])
    except subprocess.TimeoutExpired:
        return True
    finally:
        file.write_text(was)


def _fails(tests, folder, likely):
    """Whether one of them fails, or the process dies of the fault."""
    done = _pytest(["-x", "-m", "not slow", *tests], folder)
    if done.returncode not in (0, 1, 2) and done.returncode > 0 and b"while loading conftest" not in done.stderr:
        raise RuntimeError((done.stdout + done.stderr).decode()[-2000:])
    if name := who_failed(done.stdout.decode()):
        likely[name] += 1
    return done.returncode != 0


def _is_equal(mutant):
    line = (ROOT / mutant.module).read_text().splitlines()[mutant.line - 1].strip()
    return (mutant.module, mutant.what) in EQUAL or (mutant.module, mutant.what, line) in EQUAL


def drawn_from(module, each, seed):
    """So many of a module's mutants; which ones depends on the seed and on the module alone."""
    found = mutants_of(module, (ROOT / module).read_text())
    return random.Random(f"{seed} {module}").sample(found, min(each, len(found)))


def run(mutants, begin):
    """Put each of them into one copy of the checkout, print what came of it, and yield it with the word for that."""
    likely, began = defaultdict(Counter), time.monotonic()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory() as spare:
        check_out(Path(name))
        kernels = Kernels(Path(name), Path(spare))
        for number, mutant in enumerate(mutants, 1):
            if number < begin:
                continue
            noticed = is_noticed(mutant, Path(name), likely)
            kernels.restore()
            word = "noticed" if noticed else "equal" if _is_equal(mutant) else "SURVIVED"
            print(f"{number}/{len(mutants)} {time.monotonic() - began:.0f} s  {word:<8}  {mutant}", flush=True)
            yield mutant, word


def table(counts):
    """What came of each module's mutants, as Markdown."""
    words = ("noticed", "equal", "SURVIVED")
    rows = [(module, *(count[word] for word in words)) for module, count in counts.items()]
    rows.append(("all", *(sum(row[i] for row in rows) for i in (1, 2, 3))))
    head = "| module | drawn | noticed | equal | open |\n|---|--:|--:|--:|--:|"
    return "\n".join([head, *(f"| {name} | {sum(n)} | {n[0]} | {n[1]} | {n[2]} |" for name, *n in rows)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--each", type=int, default=30, help="mutants drawn from each module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[""], help="modules whose path holds one of these")
    parser.add_argument("--begin", type=int, default=1, help="the first of those drawn that is run")
    parser.add_argument("--end", type=int, help="the last of those drawn that is run")
    parser.add_argument("--line", type=int, help="of one module, all mutants of this line")
    args = parser.parse_args()
    chosen = [module for module in MODULES if any(part in module for part in args.only)]
    each = args.each if args.line is None else sys.maxsize
    drawn = [mutant for module in chosen for mutant in drawn_from(module, each, args.seed)]
    drawn = [mutant for mutant in drawn if args.line in (None, mutant.line)][: args.end]
    counts = defaultdict(Counter)
    for mutant, word in run(drawn, args.begin):
        counts[mutant.module][word] += 1
    print(table(counts))
    total = sum(counts.values(), Counter())
    return 1 if total["SURVIVED"] > 0.1 * total.total() else 0


if __name__ == "__main__":
    sys.exit(main())
