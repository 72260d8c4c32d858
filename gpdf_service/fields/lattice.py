"""A field over a height map: one point at most in each cell of a lattice, so who is beside whom needs no search.

α = (K + σ² I)⁻¹ 1 is solved tile by tile, by conjugate gradients. K⁻¹ forgets what is far, so a tile with a halo around
it is enough, and α of a tile follows from the heights within its halo alone: a change solves the tiles it touches, and
gives what a build gives. The kernel's values for one offset between cells lie one after another, over all cells of a
tile; so a product with K is a few dozen sums of whole vectors.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.config import FieldConfig
from gpdf_service.errors import FieldError
from gpdf_service.fields.gpdf import Domain, Gpdf
from gpdf_service.fields.solve import HALO, TOLERANCE
from gpdf_service.fields.spacing import REACH, make_room, shape_around
from gpdf_service.fields.threads import run_parallel
from gpdf_service.fields.traversal import CUT_RADIUS, STEEPEST, decay
from gpdf_service.fields.tree import VECTORS, Tree, build_tree, change_tree, lesser
from gpdf_service.types import BoolArray, FloatArray, IntArray

Row = NDArray[np.float32]
"""Values of the cells of a window, row after row."""
TILE = 64
"""Cells a side of a tile: the halo doubles what is solved, and all of it stays in a core's cache."""
_MOST_STEPS = 1000
"""Of a solve: some ten do."""
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
    """

    height: NDArray[np.floating]
    origin: FloatArray
    width: float
    length_scale: float
    noise_variance: float
    spacing: float


def lattice_of(height: NDArray[np.floating], origin: FloatArray, width: float, config: FieldConfig) -> Lattice:
    """A lattice with points wherever the `height` [m] of a cell, (nx, ny), is no NaN; its `origin` is a corner [m]."""
    spacing = SPACING * width
    own = config.length_scale_factor * spacing, config.noise_variance, spacing
    return Lattice(np.asarray(height, np.float64), np.asarray(origin, np.float64), float(width), *own)


def fit_lattice(lattice: Lattice, domain: Domain) -> Gpdf:
    """The field over the points of a lattice, of which there must be some.

    Raises:
        FieldError: the solve did not converge.
    """
    points = _points_in(lattice, ~np.isnan(lattice.height))
    return _field(build_tree(points), lattice, solve_lattice(lattice), domain)


def change_lattice(field: Gpdf, lattice: Lattice, cells: BoolArray, domain: Domain) -> Gpdf:
    """The field over a lattice that held other points in some `cells`, shape (nx, ny), when `field` was fitted."""
    x, y = _cells_of(field.points, lattice)
    before = Solved(np.full(lattice.height.shape, np.nan), np.zeros((*lattice.height.shape, 6)))
    before.alpha[x, y], before.discs[x, y] = field.alpha, field.discs
    tree, _ = change_tree(field.tree, ~cells[x, y], _points_in(lattice, cells & ~np.isnan(lattice.height)))
    return _field(tree, lattice, solve_lattice(lattice, before, cells), domain)


def _field(tree: Tree, lattice: Lattice, solved: Solved, domain: Domain) -> Gpdf:
    cells, noise = _cells_of(tree.points, lattice), np.zeros(len(tree.points))
    own = lattice.length_scale, lattice.noise_variance, lattice.spacing
    return Gpdf(tree, solved.alpha[cells], solved.discs[cells], noise, *own, domain)


def _points_in(lattice: Lattice, cells: BoolArray) -> FloatArray:
    """Points of the `cells`, shape (k, 3)."""
    plan = lattice.origin + (np.argwhere(cells) + 0.5) * lattice.width
    return np.column_stack([plan, lattice.height[cells]])


def _cells_of(points: FloatArray, lattice: Lattice) -> tuple[IntArray, IntArray]:
    x, y = np.floor((points[:, :2] - lattice.origin) / lattice.width).astype(np.int64).T
    return x, y


class Solved(NamedTuple):
    """What a field is made of, cell by cell.

    Attributes:
        alpha: (K + σ² I)⁻¹ 1, NaN where there is no point, shape (nx, ny).
        discs: The surface that each point stands for, as `spacing.local_shape` says, shape (nx, ny, 6).
    """

    alpha: FloatArray
    discs: FloatArray


def solve_lattice(lattice: Lattice, before: Solved | None = None, cells: BoolArray | None = None) -> Solved:
    """α and discs of all points of a lattice.

    Args:
        lattice: The points.
        before: What they were of other heights on the same lattice; nothing in a build.
        cells: Which cells held another point then, shape (nx, ny).

    Raises:
        FieldError: a solve did not converge.
    """
    shape = lattice.height.shape
    if before is None or cells is None:
        made, cells = Solved(np.full(shape, np.nan), np.zeros((*shape, 6))), np.ones(shape, dtype=bool)
    else:
        made = Solved(before.alpha.copy(), before.discs.copy())
    cut, near = (radius / lattice.width for radius in (CUT_RADIUS * lattice.length_scale, REACH * lattice.spacing))
    solver, ball = _solver_of(lattice), disc(near)

    def solve(tile: tuple[int, int]) -> bool:
        return bool(_solve_tile(lattice, solver, *tile, made.alpha))

    def shape_out(tile: tuple[int, int]) -> None:
        _shape_tile(lattice, ball, *tile, made.discs)

    run_parallel(shape_out, _tiles(cells, int(near)))
    if not all(run_parallel(solve, _tiles(cells, solver.halo + int(cut)))):
        raise FieldError("fit", "the solve did not converge", "Raise fields.noise_variance.")
    return made


def _tiles(cells: BoolArray, reach: int) -> list[tuple[int, int]]:
    """First cell of each tile within whose reach any of the `cells` are."""
    (nx, ny), found = cells.shape, []
    for x in range(0, nx, TILE):
        for y in range(0, ny, TILE):
            if cells[max(x - reach, 0) : x + TILE + reach, max(y - reach, 0) : y + TILE + reach].any():
                found.append((x, y))
    return found


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
def _shape_tile(lattice: Lattice, ball: IntArray, x0: int, y0: int, discs: FloatArray) -> None:
    """Write the discs of a tile's points."""
    (nx, ny), room, radius = lattice.height.shape, make_room(), REACH * lattice.spacing
    for x in range(x0, min(x0 + TILE, nx)):
        for y in range(y0, min(y0 + TILE, ny)):
            z, count = lattice.height[x, y], 0
            if np.isnan(z):
                discs[x, y] = 0.0
                continue
            for k in range(len(ball)):
                u, v = x + ball[k, 0], y + ball[k, 1]
                if not (0 <= u < nx and 0 <= v < ny) or np.isnan(lattice.height[u, v]):
                    continue
                a, b, c = ball[k, 0] * lattice.width, ball[k, 1] * lattice.width, float(lattice.height[u, v] - z)
                if a * a + b * b + c * c <= radius * radius:
                    room.near[count, 0], room.near[count, 1], room.near[count, 2] = a, b, c
                    count += 1
            shape_around(room, count, True, radius, lattice.spacing, 0.0, discs[x, y])


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
def _box_of(height: NDArray[np.floating], x0: int, y0: int) -> tuple[int, int, int, int]:
    """The least box of cells that holds all points of a tile, empty where there are none."""
    (nx, ny), left, right, near, far = height.shape, x0 + TILE, x0, y0 + TILE, y0
    for x in range(x0, min(x0 + TILE, nx)):
        for y in range(y0, min(y0 + TILE, ny)):
            if not np.isnan(height[x, y]):
                left, right, near, far = min(left, x), x + 1, min(near, y), max(far, y + 1)
    return left, right, near, far


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
def _solve_tile(lattice: Lattice, solver: _Solver, x0: int, y0: int, alpha: FloatArray) -> bool:
    """Write α of a tile's points; whether the solve converged.

    It begins with α on even ground, one over the sum of the row of K + σ² I; so is α beyond the halo.
    """
    rate, box = np.float32(0.5 / (lattice.length_scale * lattice.length_scale)), _box_of(lattice.height, x0, y0)
    alpha[x0 : x0 + TILE, y0 : y0 + TILE] = np.nan
    if box[1] <= box[0]:
        return True
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
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            k = (i - box[0] + solver.halo) * stride + j - box[2] + solver.halo
            if inner[k] > 0.0:
                alpha[i, j] = x[k]
    return bool(_dot(r, r) <= enough)
