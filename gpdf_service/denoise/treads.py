"""Level treads with straight, parallel edges, fitted to noisy ground that looks like a ramp.

Noise of σ blurs a stair's profile along the slope, but not along its edges: there a tread is known from hundreds of
points. With edges a_k and heights h_k, u along the slope, and Φ the normal distribution, a point's height has the
density

    p(z | u) = Σ_k [Φ((u − a_{k−1}) / σ) − Φ((u − a_k) / σ)] N(z; h_k, σ²).

All edges, heights, the direction and σ are fitted at once, by scoring. Treads are told only if they explain the points
as much better than a smooth slope of any roughness as such treads would, and if every piece of each is level: rubble is
not.
"""

from __future__ import annotations

from itertools import product
from math import cos, erf, exp, log, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

_NEAR = 5.0
"""[-] Standard deviations beyond which an edge is not felt."""
_OUTLIER = 1e-4
"""[-] Density of what is of no tread, in 1 / σ: that of a point 4 σ off its tread."""
_RISES: FloatArray = np.arange(0.12, 0.231, 0.01)
"""[m] Rises that stairs are built with: starts of the fit, which leaves every edge and height free."""
_PHASES = 6
"""Starts a rise: an edge is then within a twelfth of a run."""
_BLUR = 0.05
"""[m] Least σ of the starts, which are off by half of it."""
_TRIED = 400
"""Points that the starts are compared by: regular treads then gain 20 to 80 over a slope, rubble at most -14."""
_REFINED = 3
"""Starts that are refined."""
_ENOUGH = 100
"""Points a tread that they are refined on: an edge is then known to a fifth of the noise, and settled on all points."""
_TURNS = 40
_SETTLED = 2e-4
"""[m] Change of an edge or a height at which the fit has ended."""
_STRIDE = 0.6
"""[-] Largest change of an edge in one turn, in σ: beyond it the curve is not the one that was measured."""
_KNOWN = 0.1
"""[-] How well the noise is known; a fit that needs more is none."""
_NOTHING = 1e-6
"""[1/m²] What is known of a flight without points."""
_LEAST_RUN, _LEAST_RISE = 3.0, 2.0
"""[-] Of a tread over σ: a plateau beyond the blur of both edges, and a step that shows in it."""
_FEWEST_EDGES = 3
"""Two whole treads: one step alone has no run, and the cure of edges finds it."""
_GAIN = 0.5
"""[-] Least share of the log likelihood ratio that such treads would have over a slope: terraces have less."""
_SURELY = 12.0
"""[-] Least log likelihood ratio over a slope, beyond one a number that is fitted."""
EDGE_ERROR = 0.01
"""[m] Largest standard error of an edge: a foot and a cane find it within 3 cm."""
_PIECE = 0.25
"""[m] Length of the pieces along an edge that have to be level: a foot."""
_PIECE_POINTS = 12
"""Points that tell whether a piece is level."""
_LEVEL = 4.5
"""[-] Standard errors by which one of some hundred pieces may be off: one flight in a thousand has such by chance."""
_DRAWS = 8
"""Draws from the model that say what treads would have gained."""


class Treads(NamedTuple):
    """A flight: u = x cos(angle) + y sin(angle).

    Attributes:
        angle: Of the way up, across the edges [rad].
        edges: Where each riser is, along the way up [m], shape (k,), rising.
        heights: Of the treads [m], shape (k + 1,), from below the first edge to beyond the last.
        sigma: Standard deviation of the points about it [m].
    """

    angle: float
    edges: FloatArray
    heights: FloatArray
    sigma: float

    def along(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places along the way up and along the edges [m], each of shape (n,), of `points` (n, 2) or (n, 3)."""
        c, s = cos(self.angle), sin(self.angle)
        return c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]

    def height_at(self, u: FloatArray) -> FloatArray:
        """Height of the tread [m] at places `u` along the way up, shape (n,)."""
        height: FloatArray = self.heights[np.searchsorted(self.edges, u)]
        return height


def look_for_treads(points: FloatArray, noise: float, slope: FloatArray, floor: float, ceiling: float) -> Treads | None:
    """Treads that may explain `points`, shape (n, 3) [m], about the origin; none where a regular flight is no likelier.

    They are ground, as it was measured with that `noise` [m], of one flight with some of the level ground at its ends,
    and look like the ramp z = a x + b y + c of this `slope`, shape (3,), from about the `floor` to the `ceiling` [m].
    """
    mixed = np.random.default_rng(0).permutation(len(points))
    some = points[mixed[:_TRIED]]
    blur = max(noise, _BLUR)
    starts = _starts(some, blur, slope, floor, ceiling)
    if not starts or _gain_over_slope(some, starts[0]) <= 0.0:
        return None
    most = _ENOUGH * max(len(start.heights) for start in starts)
    points, likely, best = points[mixed[:most]], None, -np.inf
    for start in starts:
        treads = _resolved(_refined(points, start, blur)[0], blur)
        treads, likelihood = _refined(points, _resolved(_refined(points, treads, noise)[0], noise), noise)
        likelihood -= len(treads.edges) * log(len(points))  # half of it for each of two numbers: Schwarz 1978
        if likelihood > best:
            likely, best = treads, likelihood
    return likely


def settle_treads(points: FloatArray, treads: Treads, noise: float) -> Treads | None:
    """The treads near these that explain all of `points`; none if anything smooth or rough may be.

    They must be resolved, known well, a clearly better explanation than a slope, and level in every piece.
    """
    treads, likelihood = _refined(points, treads, noise)
    if likelihood == -np.inf:
        return None
    if np.diff(treads.edges).min() < _LEAST_RUN * noise or np.diff(treads.heights).min() < _LEAST_RISE * noise:
        return None
    error = np.sqrt(np.diag(np.linalg.inv(_regular(_score(points, *treads)[1]))))[: len(treads.edges)]
    sound = bool(error.max() <= EDGE_ERROR) and _clearly(points, treads) and _uneven(points, treads) <= _LEVEL
    return treads if sound else None


def log_density(points: FloatArray, treads: Treads) -> FloatArray:
    """Log density of the height of each of the `points`, shape (n, 3), about the origin."""
    return _likelihood(points, *treads)[0]


def _starts(points: FloatArray, noise: float, slope: FloatArray, floor: float, ceiling: float) -> list[Treads]:
    """The likeliest of the regular flights along the ramp."""
    steep, angle = float(np.hypot(slope[0], slope[1])), float(np.arctan2(slope[1], slope[0]))
    tried = []
    for rise, phase in product(_RISES, range(_PHASES)):
        share = phase / _PHASES
        steps = np.arange(np.ceil(floor / rise - share - 1.0), np.floor(ceiling / rise - share) + 1.0)
        heights = (steps + share + 0.5) * rise
        treads = Treads(angle, (heights[1:] - 0.5 * rise - slope[2]) / steep, heights, noise)
        if len(treads.edges) >= _FEWEST_EDGES:
            tried.append((float(log_density(points, treads).sum()), treads))
    return [treads for _, treads in sorted(tried, key=lambda one: -one[0])[:_REFINED]]


def _refined(points: FloatArray, treads: Treads, noise: float) -> tuple[Treads, float]:
    """The likeliest treads near these, and their log likelihood; -inf if edges cross."""
    edges, heights, angle, sigma = treads.edges.copy(), treads.heights.copy(), treads.angle, treads.sigma
    k = len(edges)
    for _ in range(_TURNS):
        score, fisher = _score(points, angle, edges, heights, sigma)
        step = np.linalg.solve(_regular(fisher), score)
        step *= min(1.0, _STRIDE * noise / max(float(np.abs(step[:-1]).max()), 1e-12))
        edges, heights, angle = edges + step[:k], heights + step[k : 2 * k + 1], angle + float(step[-2])
        sigma = float(np.clip(sigma * exp(step[-1]), noise / (1.0 + _KNOWN), noise * (1.0 + _KNOWN)))
        if (np.diff(edges) <= 0.0).any():
            return treads, -np.inf
        if float(np.abs(step[:-1]).max()) < _SETTLED:
            break
    made = Treads(angle, edges, heights, sigma)
    return made, float(_likelihood(points, *made)[0].sum())


def _resolved(treads: Treads, noise: float) -> Treads:
    """The same without steps that are too low and treads that are too short to be seen in the noise."""
    edges, heights = treads.edges.copy(), treads.heights.copy()
    while len(edges) > _FEWEST_EDGES:
        step, tread = int(np.diff(heights).argmin()), int(np.diff(edges).argmin())
        if heights[step + 1] - heights[step] < _LEAST_RISE * noise:
            heights[step] = 0.5 * (heights[step] + heights[step + 1])
            edges, heights = np.delete(edges, step), np.delete(heights, step + 1)
        elif edges[tread + 1] - edges[tread] < _LEAST_RUN * noise:
            edges[tread] = 0.5 * (edges[tread] + edges[tread + 1])
            edges, heights = np.delete(edges, tread + 1), np.delete(heights, tread + 1)
        else:
            break
    return Treads(treads.angle, edges, heights, treads.sigma)


def _regular(fisher: FloatArray) -> FloatArray:
    """A matrix that has an inverse, in which what no point tells of is not known at all."""
    made: FloatArray = fisher + (1e-9 * float(np.trace(fisher)) + _NOTHING) * np.eye(len(fisher))
    return made


def _clearly(points: FloatArray, treads: Treads) -> bool:
    """Whether they gain over a slope what such treads would."""
    u, _ = treads.along(points)
    rng, gains = np.random.default_rng(0), []
    for _ in range(_DRAWS):
        off, error = rng.normal(0.0, treads.sigma, len(u)), rng.normal(0.0, treads.sigma, len(u))
        gains.append(_gain_over_slope(np.column_stack([points[:, :2], treads.height_at(u + off) + error]), treads))
    least = max(_GAIN * float(np.mean(gains)), _SURELY + 2.0 * len(treads.edges))
    return _gain_over_slope(points, treads) >= least


def _gain_over_slope(points: FloatArray, treads: Treads) -> float:
    """Log likelihood of the treads over that of a smooth slope of any roughness, between the outer edges."""
    u, v = treads.along(points)
    inner = (u > treads.edges[0]) & (u < treads.edges[-1])
    points, u, v = points[inner], u[inner], v[inner]
    if len(points) <= 2 * _PIECE_POINTS:
        return -np.inf
    a, b = ((w - w.mean()) / max(float(np.ptp(w)), 1e-9) for w in (u, v))
    terms = np.stack([a**0, a, b, a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3], axis=1)
    z = points[:, 2]
    smooth = terms @ np.linalg.solve(_regular(terms.T @ terms), terms.T @ z)  # by QR it took 300 times as long
    rest = float(((z - smooth) ** 2).mean())
    return float(log_density(points, treads).sum()) + 0.5 * len(z) * (log(2.0 * pi * rest) + 1.0)


def _uneven(points: FloatArray, treads: Treads) -> float:
    """The most that a piece of a tread or an edge is off it, or that the edges turn, in standard errors.

    A piece is half a tread long and a foot wide along its edge. Edges turn as χ² with one degree of freedom each.
    """
    u, v = treads.along(points)
    _, off, push = _likelihood(points, *treads)
    middles = 0.5 * (treads.edges[1:] + treads.edges[:-1])
    half, edge = np.searchsorted(np.sort(np.concatenate([treads.edges, middles])), u), np.searchsorted(middles, u)
    column = np.floor((v - v.min()) / _PIECE).astype(np.int64)
    pieces = [_errors(row * (column.max() + 1) + column, value) for row, value in ((half, off), (edge, push))]
    turns = _errors(edge, push * (v - v.mean()))
    turned = float((turns**2).sum() - len(turns)) / sqrt(2.0 * len(turns))
    return max(turned, *(float(np.abs(errors).max(initial=0.0)) for errors in pieces))


def _errors(group: IntArray, values: FloatArray) -> FloatArray:
    """Sums over the groups of at least `_PIECE_POINTS` of values that are 0 on average, in standard errors."""
    _, group = np.unique(group, return_inverse=True)
    number, total, square = (np.bincount(group, weights) for weights in (None, values, values * values))
    told = number >= _PIECE_POINTS
    errors: FloatArray = total[told] / np.sqrt(np.maximum(square[told], _NOTHING))
    return errors


@lean()
def _phi(t: float) -> float:
    return 0.5 * (1.0 + erf(t * 0.7071067811865476))


@njit(cache=True, nogil=True)
def _likelihood(
    points: FloatArray, angle: float, edges: FloatArray, heights: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log density of each point's height, what it is over its treads in σ, and how it pulls at edges; (n,) each."""
    density, off, push = np.empty(len(points)), np.empty(len(points)), np.empty(len(points))
    c, s, peak = cos(angle), sin(angle), 1.0 / (sqrt(2.0 * pi) * sigma)
    for i in range(len(points)):
        u, z = c * points[i, 0] + s * points[i, 1], points[i, 2]
        p, mean, slope, before, last = _OUTLIER / sigma, 0.0, 0.0, 1.0, 0.0
        for k in range(np.searchsorted(edges, u - _NEAR * sigma), len(heights)):
            beyond = k == len(edges) or edges[k] >= u + _NEAR * sigma
            r = 0.0 if beyond else (u - edges[k]) / sigma
            after, bell = (0.0, 0.0) if beyond else (_phi(r), exp(-0.5 * r * r))
            t = (z - heights[k]) / sigma
            g = peak * exp(-0.5 * t * t)
            p, mean = p + (before - after) * g, mean + (before - after) * g * t
            slope += (last - bell) * g
            if beyond:
                break
            before, last = after, bell
        density[i], off[i], push[i] = log(p), mean / p, slope / p
    return density, off, push


@njit(cache=True, nogil=True)
def _score(
    points: FloatArray, angle: float, edges: FloatArray, heights: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the log likelihood by edges, heights, angle and log σ, and the sum of their products."""
    k, n = len(edges), 2 * len(edges) + 3
    score, fisher, mine, used = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros(n, np.int64)
    c, s, peak = cos(angle), sin(angle), 1.0 / (sqrt(2.0 * pi) * sigma)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u, v = c * x + s * y, c * y - s * x
        p, before, turn, widen, count = _OUTLIER / sigma, 1.0, 0.0, 0.0, 0
        for j in range(np.searchsorted(edges, u - _NEAR * sigma), k + 1):
            t = (z - heights[j]) / sigma
            g = peak * exp(-0.5 * t * t)
            beyond = j == k or edges[j] >= u + _NEAR * sigma
            r = 0.0 if beyond else (u - edges[j]) / sigma
            after = 0.0 if beyond else _phi(r)
            part = (before - after) * g
            p, before = p + part, after
            mine[k + j], used[count] = part * t / sigma, k + j
            widen, count = widen + part * (t * t - 1.0), count + 1
            if beyond:
                break
            over = (z - heights[j + 1]) / sigma
            rise = exp(-0.5 * r * r) / sqrt(2.0 * pi) * (peak * exp(-0.5 * over * over) - g)
            mine[j], used[count] = -rise / sigma, j
            turn, widen, count = turn + v * rise / sigma, widen - r * rise, count + 1
        mine[n - 2], used[count], mine[n - 1], used[count + 1] = turn, n - 2, widen, n - 1
        for a in range(count + 2):
            score[used[a]] += mine[used[a]] / p
            for b in range(count + 2):
                fisher[used[a], used[b]] += mine[used[a]] * mine[used[b]] / (p * p)
    return score, fisher
