"""A field over a height map: one point at most in each cell of a lattice, so who is beside whom needs no search.

α = (K + σ² I)⁻¹ 1 is solved tile by tile, by conjugate gradients. K⁻¹ forgets what is far, so a tile with a halo around
it is enough, and α of a tile follows from the heights within its halo alone: a change solves the tiles it touches, and
gives what a build gives. The kernel's values for one offset between cells lie one after another, over all cells of a
tile; so a product with K is a few dozen sums of whole vectors.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.config import FieldConfig
from gpdf_service.errors import FieldError
from gpdf_service.fields.gpdf import Domain, Gpdf
from gpdf_service.fields.order import morton
from gpdf_service.fields.solve import HALO, TOLERANCE
from gpdf_service.fields.spacing import REACH, make_room, shape_around
from gpdf_service.fields.threads import run_parallel
from gpdf_service.fields.traversal import CUT_RADIUS, STEEPEST, decay
from gpdf_service.fields.tree import LEAF_SIZE, VECTORS, Tree, lesser, tree_of
from gpdf_service.types import FloatArray, IntArray

Row = NDArray[np.float32]
"""Values of the cells of a window, row after row."""
TILE = 64
"""Cells a side of a tile: the halo doubles what is solved, and all of it stays in a core's cache."""
_MOST_STEPS = 1000
"""Of a solve: some ten do."""
_MIDDLE = 1 << 24
"""Far more than there are tiles on either side of the first one."""
_NEAR = 4
"""Cells that the approximate inverse reaches: with it the even lattice has a condition number of 3, without of 124."""


SPACING = 0.5 * float(np.sqrt(np.pi))
"""[-] Cells that a field over a lattice resolves: what `estimate_spacing` tells of one, wherever it is level. Told anew
it would be up to 3 % more by how much of it is steep, and another with each change of that."""


class Lattice(NamedTuple):
    """Points on a lattice, and the kernel of the field over them.

    Attributes:
        height: Of the point in each cell [m], NaN where there is none, shape (nx, ny).
        origin: Lower corner of the lattice [m], shape (2,).
        width: Of a cell [m].
        length_scale: Of the kernel [m].
        noise_variance: σ² [-].
        spacing: That the field resolves [m].
        first: Number of its first tile along each axis: tiles of two lattices with the same number are the same.
    """

    height: NDArray[np.floating]
    origin: FloatArray
    width: float
    length_scale: float
    noise_variance: float
    spacing: float
    first: tuple[int, int] = (0, 0)


def lattice_of(height: NDArray[np.floating], origin: FloatArray, width: float, config: FieldConfig) -> Lattice:
    """A lattice with points wherever the `height` [m] of a cell, (nx, ny), is no NaN; its `origin` is a corner [m].

    Centres of cells lie at multiples of the width, and tiles begin at such of `TILE`: those of each box of a grid.
    """
    spacing = SPACING * width
    own = config.length_scale_factor * spacing, config.noise_variance, spacing
    first, skipped = np.divmod(np.rint(np.asarray(origin) / width + 0.5).astype(np.int64), TILE)
    made = np.full(np.add(height.shape, skipped), np.nan)
    made[skipped[0] :, skipped[1] :] = height
    x, y = first.tolist()
    return Lattice(made, np.asarray(origin, np.float64) - skipped * width, float(width), *own, (x, y))


@lru_cache(maxsize=1)
def _layout() -> IntArray:
    """Cells of a tile in Morton order, shape (`TILE`², 2): 32 that follow one another are a leaf."""
    cells = np.ascontiguousarray(np.indices((TILE, TILE)).reshape(2, -1).T)
    made: IntArray = cells[np.argsort(morton(cells))]
    return made


class _Rows(NamedTuple):
    """Where the points of each tile are among all: tiles in Morton order, and so the points of each.

    Attributes:
        tile: First cell of each tile that holds points, shape (t, 2).
        first: First row of each, and how many there are in all, shape (t + 1,).
    """

    tile: IntArray
    first: IntArray

    def of(self, k: int) -> slice:
        """Rows of a tile."""
        return slice(int(self.first[k]), int(self.first[k + 1]))


def _rows_of(lattice: Lattice) -> _Rows:
    corner = np.ascontiguousarray(np.indices([-(-size // TILE) for size in lattice.height.shape]).reshape(2, -1).T)
    tile = TILE * corner[np.argsort(morton(corner + np.array(lattice.first) + _MIDDLE))]
    rows, columns = (np.arange(0, size, TILE) for size in lattice.height.shape)
    held = np.add.reduceat(~np.isnan(lattice.height), rows, axis=0, dtype=np.int32)
    count = np.add.reduceat(held, columns, axis=1)[tuple(tile.T // TILE)]
    return _Rows(tile[count > 0], np.concatenate([[0], np.cumsum(count[count > 0])]))


def fit_lattice(lattice: Lattice, domain: Domain, former: tuple[Gpdf, Lattice] | None = None) -> Gpdf:
    """The field over the points of a lattice, of which there must be some, in the order of its tiles.

    What a `former` field said, fitted to such a lattice, of tiles within whose reach nothing is another is taken over:
    what is changed is what is built. So are its discs, if they were told; else they are told on first use.

    Raises:
        FieldError: a solve did not converge.
    """
    rows, solver, ball = _rows_of(lattice), _solver_of(lattice), _ball_of(lattice)
    points = np.empty((int(rows.first[-1]), 3))
    alpha = np.empty(len(points))
    discs = np.empty((len(alpha), 6)) if former is not None and former[0].shaped else None

    def solve(k: int) -> bool:
        cells, own = _cells_of(lattice, rows.tile[k]), rows.of(k)
        points[own] = _points_at(lattice, cells)
        if discs is not None:
            _shape_tile(lattice, ball, cells, discs[own])
        return bool(_solve_tile(lattice, solver, cells, alpha[own]))

    source, before = _sources(lattice, rows, solver.reach, former)
    if former is not None:
        for own, old in _taken_over(rows, before, source):
            points[own], alpha[own] = former[0].points[old], former[0].alpha[old]
            if discs is not None:
                discs[own] = former[0].discs[old]
    if not all(run_parallel(solve, np.flatnonzero(source < 0).tolist())):
        raise FieldError("fit", "the solve did not converge", "Raise fields.noise_variance.")
    return _field(lattice, points, rows, alpha, discs, domain)


def restore_lattice(lattice: Lattice, alpha: FloatArray, domain: Domain) -> Gpdf:
    """The field over a lattice whose α, shape (n,), is known; its discs are told on first use."""
    rows = _rows_of(lattice)
    points = np.concatenate([_points_at(lattice, _cells_of(lattice, tile)) for tile in rows.tile])
    return _field(lattice, points, rows, alpha, None, domain)


def _discs_of(lattice: Lattice, rows: _Rows) -> FloatArray:
    """The discs of all points in their order, shape (n, 6)."""
    discs, ball = np.empty((int(rows.first[-1]), 6)), _ball_of(lattice)

    def tell(k: int) -> None:
        _shape_tile(lattice, ball, _cells_of(lattice, rows.tile[k]), discs[rows.of(k)])

    run_parallel(tell, range(len(rows.tile)))
    return discs


def _ball_of(lattice: Lattice) -> IntArray:
    """Offsets of the cells that a disc is told by, shape (k, 2)."""
    return disc(REACH * lattice.spacing / lattice.width)


def _field(
    lattice: Lattice, points: FloatArray, rows: _Rows, alpha: FloatArray, discs: FloatArray | None, domain: Domain
) -> Gpdf:
    told = partial(_discs_of, lattice, rows) if discs is None else discs
    own = lattice.length_scale, lattice.noise_variance, lattice.spacing
    return Gpdf(_tree_of(points, rows), alpha, told, np.broadcast_to(0.0, len(alpha)), own, domain)


def _sources(lattice: Lattice, rows: _Rows, reach: int, former: tuple[Gpdf, Lattice] | None) -> tuple[IntArray, _Rows]:
    """Of each tile with no change in reach [cells] which one it was in a `former` lattice, else −1; the tiles there."""
    source = np.full(len(rows.tile), -1)
    if former is None or lattice[2:6] != former[1][2:6]:
        return source, rows
    before, by = _rows_of(former[1]), TILE * (np.array(lattice.first) - former[1].first)
    if (former[1].origin + by * lattice.width != lattice.origin).any():
        return source, rows
    number = {tuple(cell): k for k, cell in enumerate((before.tile - by).tolist())}
    other, (left, top) = _other(lattice, former[1])
    for k, (x, y) in enumerate(rows.tile.tolist()):
        i, j = left + x, top + y
        if not other[max(i - reach, 0) : i + TILE + reach, max(j - reach, 0) : j + TILE + reach].any():
            source[k] = number[x, y]
    return source, before


def _other(one: Lattice, former: Lattice) -> tuple[NDArray[np.bool_], IntArray]:
    """Over the cells of both those with other points, and which of these is the first one's first cell."""
    begin = TILE * np.array([one.first, former.first])
    low = begin.min(axis=0)
    shape = (begin + np.array([one.height.shape, former.height.shape])).max(axis=0) - low

    def spread(lattice: Lattice, first: IntArray) -> NDArray[np.uint64]:
        made, (x, y) = lattice.height, first - low
        if made.shape != tuple(shape):
            made = np.full(shape, np.nan)
            made[x : x + lattice.height.shape[0], y : y + lattice.height.shape[1]] = lattice.height
        return made.view(np.uint64)  # NaN is NaN

    return spread(one, begin[0]) != spread(former, begin[1]), begin[0] - low


def _taken_over(rows: _Rows, before: _Rows, source: IntArray) -> list[tuple[slice, slice]]:
    """Rows of the tiles with a source, and theirs before: of tiles that follow one another here and there in one."""
    kept = np.flatnonzero(source >= 0)
    runs = np.split(kept, np.flatnonzero(np.diff(kept) + np.diff(source[kept]) > 2) + 1) if len(kept) else []
    ends = [(run[0], run[-1] + 1, source[run[0]], source[run[-1]] + 1) for run in runs]
    return [(slice(*rows.first[[a, b]].tolist()), slice(*before.first[[c, d]].tolist())) for a, b, c, d in ends]


def _tree_of(points: FloatArray, rows: _Rows) -> Tree:
    """The tree over the points as they lie; each tile begins a leaf."""
    leaves = -(-np.diff(rows.first) // LEAF_SIZE)
    rank = np.arange(leaves.sum()) - np.repeat(np.cumsum(leaves) - leaves, leaves)
    begin = np.append(np.repeat(rows.first[:-1], leaves) + LEAF_SIZE * rank, rows.first[-1])
    return tree_of(points, np.arange(len(points)), begin)


def _cells_of(lattice: Lattice, tile: IntArray) -> IntArray:
    """The cells of a tile that hold a point, in their order, shape (k, 2)."""
    cells: IntArray = _held(lattice.height, _layout(), tile)
    return cells


@njit(cache=True, nogil=True)
def _held(height: NDArray[np.floating], layout: IntArray, tile: IntArray) -> IntArray:
    cells, count = np.empty_like(layout), 0
    for k in range(len(layout)):
        x, y = tile[0] + layout[k, 0], tile[1] + layout[k, 1]
        if x < height.shape[0] and y < height.shape[1] and not np.isnan(height[x, y]):
            cells[count, 0], cells[count, 1], count = x, y, count + 1
    return cells[:count]


def _points_at(lattice: Lattice, cells: IntArray) -> FloatArray:
    """The points in some cells, shape (k, 3)."""
    return np.column_stack([lattice.origin + (cells + 0.5) * lattice.width, lattice.height[tuple(cells.T)]])


def disc(radius: float) -> IntArray:
    """Offsets of the cells within a radius [cells], shape (k, 2)."""
    own = np.arange(-int(radius), int(radius) + 1)
    offsets = np.stack(np.meshgrid(own, own, indexing="ij"), axis=-1).reshape(-1, 2)
    found: IntArray = offsets[(offsets**2).sum(axis=1) <= radius**2]
    return found


def half_disc(radius: float) -> IntArray:
    """The half of the offsets in which each pair of cells is met once, shape (k, 2)."""
    offsets = disc(radius)
    found: IntArray = offsets[(offsets[:, 0] > 0) | ((offsets[:, 0] == 0) & (offsets[:, 1] > 0))]
    return found


@njit(cache=True, nogil=True)
def _shape_tile(lattice: Lattice, ball: IntArray, cells: IntArray, discs: FloatArray) -> None:
    """Write the discs of the points in a tile's `cells`."""
    (nx, ny), room, radius = lattice.height.shape, make_room(), REACH * lattice.spacing
    for row in range(len(cells)):
        x, y = cells[row]
        z, count = lattice.height[x, y], 0
        for k in range(len(ball)):
            u, v = x + ball[k, 0], y + ball[k, 1]
            if not (0 <= u < nx and 0 <= v < ny) or np.isnan(lattice.height[u, v]):
                continue
            a, b, c = ball[k, 0] * lattice.width, ball[k, 1] * lattice.width, float(lattice.height[u, v] - z)
            if a * a + b * b + c * c <= radius * radius:
                room.near[count, 0], room.near[count, 1], room.near[count, 2] = a, b, c
                count += 1
        shape_around(room, count, True, lattice.spacing, 0.0, discs[row])


class _Solver(NamedTuple):
    """What the solves of all tiles share.

    Attributes:
        halo: Cells around a tile that are solved with it.
        offsets: Of the cells that the kernel reaches, each pair once, shape (k, 2).
        apart: ‖offset‖² / 2l², shape (k,).
        near: Offsets that the approximate inverse reaches, shape (m, 2).
        inverse: Its diagonal, and what it is at those, shape (1 + m,).
    """

    halo: int
    offsets: IntArray
    apart: Row
    near: IntArray
    inverse: Row

    @property
    def reach(self) -> int:
        """Cells around a tile within which the points decide on its α, and on its discs."""
        return self.halo + int(self.offsets.max())


def _solver_of(lattice: Lattice) -> _Solver:
    scale = lattice.length_scale / lattice.width
    offsets = half_disc(CUT_RADIUS * scale)
    apart = ((offsets**2).sum(axis=1) * 0.5 / scale**2).astype(np.float32)
    near = _approximate_inverse(scale, lattice.noise_variance, min(_NEAR, int(offsets.max())))
    return _Solver(int(np.ceil(HALO * scale)), offsets, apart, *near)


class _Window(NamedTuple):
    """A tile with its halo, and as many cells around as the kernel reaches, row after row with a gap between two rows.

    Attributes:
        height: Over its first point [m], 0 where there is no point, shape (n,).
        held: 1 where there is a point, shape (n,).
        stride: Cells from a row to the next one.
        reach: Cells that the kernel reaches: as many are around the halo, and in a gap.
        inner: Rows and columns of the tile with its halo.
    """

    height: Row
    held: Row
    stride: int
    reach: int
    inner: tuple[int, int]


@njit(cache=True, nogil=True)
def _window(height: NDArray[np.floating], reach: int, halo: int, box: tuple[int, int, int, int]) -> _Window:
    """The window around a box of cells: first row and behind the last, first column and behind the last."""
    (nx, ny), margin = height.shape, halo + reach
    left, right, near, far = box[0] - margin, box[1] + margin, box[2] - margin, box[3] + margin
    stride, base = far - near + reach, np.nan
    z, held = np.zeros((right - left) * stride, np.float32), np.zeros((right - left) * stride, np.float32)
    for x in range(max(left, 0), min(right, nx)):
        for y in range(max(near, 0), min(far, ny)):
            if not np.isnan(height[x, y]):
                base = height[x, y] if np.isnan(base) else base
                k = (x - left) * stride + y - near
                z[k], held[k] = height[x, y] - base, 1.0
    return _Window(z, held, stride, reach, (right - left - 2 * reach, far - near - 2 * reach))


@njit(cache=True, nogil=True)
def _inner(window: _Window, values: Row, made: Row) -> None:
    """Write the values of the cells of the tile and its halo, row after row with a gap between two rows."""
    rows, columns = window.inner
    for i in range(rows):
        own, here = values[(i + window.reach) * window.stride + window.reach :], made[i * (columns + window.reach) :]
        for j in range(columns):
            here[j] = own[j]


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _kernel(window: _Window, offsets: IntArray, apart: Row, rate: np.float32, total: Row) -> NDArray[np.float32]:
    """What stands in K for each offset, between cells of tile and halo, shape (k, m); adds each row to its `total`.

    The cells of each offset are `apart` as the kernel counts, shape (k,): in its exponent, as is `rate` times m².
    """
    z, held, limit = window.height, window.held, np.float32(0.5 * CUT_RADIUS * CUT_RADIUS)
    stride, values = window.inner[1] + window.reach, np.zeros_like(z)
    inner, mine = np.zeros(window.inner[0] * stride, np.float32), np.zeros(window.inner[0] * stride, np.float32)
    weights = np.zeros((len(offsets), len(inner)), np.float32)
    _inner(window, held, inner)
    for k in range(len(offsets)):
        shift, far = offsets[k, 0] * window.stride + offsets[k, 1], apart[k]
        ahead, there, beyond = z[shift:], held[shift:], total[shift:]
        for i in range(len(ahead)):
            rise = ahead[i] - z[i]
            t = far + rise * rise * rate
            value = held[i] * there[i] * np.float32(decay(lesser(t, STEEPEST)))
            values[i] = value if t <= limit else np.float32(0.0)
            total[i] += values[i]
        for i in range(len(ahead)):
            beyond[i] += values[i]
        _inner(window, values, mine)
        shift, own = offsets[k, 0] * stride + offsets[k, 1], weights[k]
        within = inner[shift:]
        for i in range(len(within)):
            own[i] = mine[i] * within[i]
    return weights


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _multiply(weights: NDArray[np.float32], shift: IntArray, diagonal: np.float32, p: Row, product: Row) -> None:
    """Write (K + σ² I) p."""
    for i in range(len(p)):
        product[i] = diagonal * p[i]
    for k in range(len(shift)):
        own, ahead, beyond = weights[k], p[shift[k] :], product[shift[k] :]
        for i in range(len(ahead)):
            product[i] += own[i] * ahead[i]
        for i in range(len(ahead)):
            beyond[i] += own[i] * p[i]


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _divide(stencil: Row, shift: IntArray, inner: Row, r: Row, z: Row) -> float:
    """Write about (K + σ² I)⁻¹ r: that of an even lattice; gives z · r."""
    for i in range(len(r)):
        z[i] = stencil[0] * r[i]
    for k in range(len(shift)):
        weight, ahead, beyond = stencil[k + 1], r[shift[k] :], z[shift[k] :]
        for i in range(len(ahead)):
            z[i] += weight * ahead[i]
        for i in range(len(ahead)):
            beyond[i] += weight * r[i]
    for i in range(len(r)):
        z[i] *= inner[i]
    return _dot(z, r)


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _dot(a: Row, b: Row) -> float:
    total = 0.0
    for i in range(len(a)):
        total += np.float64(a[i]) * np.float64(b[i])
    return total


@lru_cache(maxsize=8)
def _approximate_inverse(scale: float, noise_variance: float, reach: int) -> tuple[IntArray, Row]:
    """Offsets (k, 2) and weights (1 + k,) of about (K + σ² I)⁻¹ on an even lattice without end, first its diagonal.

    It is the inverse, which has a positive spectrum, times a Gaussian, which has one, too; what the cut at `reach`
    cells takes off is added to the diagonal. So it is positive definite, also where points are missing. The length
    scale is `scale` cells.
    """
    away = np.fft.fftfreq(TILE, 1.0 / TILE)
    square, within = away[:, None] ** 2 + away[None, :] ** 2, np.abs(away) <= reach
    kernel = np.where(square <= (CUT_RADIUS * scale) ** 2, np.exp(-0.5 * square / scale**2), 0.0)
    spectrum = np.fft.fft2(kernel).real + noise_variance
    inverse = np.fft.ifft2(1.0 / spectrum).real * np.exp(-2.0 * square / reach**2) * np.outer(within, within)
    inverse[0, 0] += max(0.0, 1.0 / spectrum.max() - float(np.fft.fft2(inverse).real.min()))
    offsets = half_disc(np.hypot(reach, reach))
    offsets = offsets[np.abs(offsets).max(axis=1) <= reach]
    weights = inverse[offsets[:, 0], offsets[:, 1]]
    return offsets, np.concatenate([inverse[:1, 0], weights]).astype(np.float32)


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _solve_tile(lattice: Lattice, solver: _Solver, cells: IntArray, alpha: FloatArray) -> bool:
    """Write α of a tile's points, in these `cells`; whether the solve converged.

    It begins with α on even ground, one over the sum of the row of K + σ² I; so is α beyond the halo.
    """
    rate, rows, columns = np.float32(0.5 / (lattice.length_scale * lattice.length_scale)), cells[:, 0], cells[:, 1]
    box = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    window = _window(lattice.height, solver.offsets.max(), solver.halo, box)
    stride, diagonal = window.inner[1] + window.reach, np.float32(1.0 + lattice.noise_variance)
    inner, sums = np.zeros(window.inner[0] * stride, np.float32), np.full(len(window.held), diagonal)
    _inner(window, window.held, inner)
    weights = _kernel(window, solver.offsets, solver.apart, rate, sums)
    total, x, r = np.zeros_like(inner), np.zeros_like(inner), np.zeros_like(inner)
    p, z, product = np.zeros_like(inner), np.zeros_like(inner), np.zeros_like(inner)  # one block for all would be slow
    _inner(window, sums, total)
    shift = solver.offsets[:, 0] * stride + solver.offsets[:, 1]
    near = solver.near[:, 0] * stride + solver.near[:, 1]
    _multiply(weights, shift, diagonal, inner, product)  # the sum of each row within tile and halo
    for i in range(len(x)):
        x[i] = inner[i] / max(total[i], diagonal)
        r[i] = inner[i] - (total[i] - product[i]) * x[i]
    _multiply(weights, shift, diagonal, x, product)
    for i in range(len(x)):
        r[i] -= product[i]
    rz, enough = np.inf, TOLERANCE * TOLERANCE * inner.sum()
    for _ in range(_MOST_STEPS):
        if _dot(r, r) <= enough:
            break
        fresh = _divide(solver.inverse, near, inner, r, z)
        more, rz = np.float32(fresh / rz), fresh
        for i in range(len(x)):
            p[i] = z[i] + more * p[i]
        _multiply(weights, shift, diagonal, p, product)
        step = np.float32(rz / _dot(p, product))
        for i in range(len(x)):
            x[i] += step * p[i]
            r[i] -= step * product[i]
    for row in range(len(cells)):
        i, j = cells[row, 0] - box[0] + solver.halo, cells[row, 1] - box[2] + solver.halo
        alpha[row] = x[i * stride + j]
    return bool(_dot(r, r) <= enough)
