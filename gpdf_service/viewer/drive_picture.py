"""A picture of a drive: where it was planned, where it went, and the room beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gpdf_service.types import FloatArray


def draw_drive(
    path: str | os.PathLike[str],
    field: tuple[FloatArray, FloatArray, FloatArray],
    planned: Sequence[FloatArray],
    track: FloatArray,
    radius: float,
    *,
    title: str = "",
) -> None:
    """Draw one drive in plan.

    Args:
        path: The PNG to write.
        field: x (i,), y (j,), and the distance to what stops the body there (i, j) [m]; NaN where unknown.
        planned: The lines that were followed, each (n, ≥ 2) [m].
        track: Where the body truly was, (n, 2) [m].
        radius: Of the body [m].
        title: Over the picture.
    """
    x, y, distance = field
    figure = Figure(figsize=(10, 8), layout="constrained")
    axes = figure.add_subplot()
    image = axes.pcolormesh(x, y, distance.T, cmap="cividis", shading="nearest")
    figure.colorbar(image, ax=axes, label="distance to what stops the body [m]", shrink=0.8)
    axes.contour(x, y, np.nan_to_num(distance).T, levels=[radius], colors="white", linewidths=0.8)
    for i, line in enumerate(planned):
        axes.plot(*line[:, :2].T, color="#E69F00", lw=3, label="planned" if i == 0 else None)
    axes.plot(*track.T, color="#D55E00", lw=1.2, label="driven")
    for place, marker, label in ((track[0], "o", "start"), (track[-1], "*", "end")):
        axes.plot(*place, marker=marker, ms=12, mfc="white", mec="black", ls="", label=label)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=title)
    axes.legend(loc="upper left", fontsize=9)
    FigureCanvasAgg(figure).print_png(os.fspath(path))  # type: ignore[no-untyped-call]
