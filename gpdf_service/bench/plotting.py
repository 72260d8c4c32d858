"""Pictures of rows of measurements: a panel for each unit, a group of bars for each row."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from gpdf_service.bench.report import Row

GROUP = 0.8
"""[-] Of the room of a row that its bars take."""
BAR_INCHES, PANEL_INCHES = 0.24, 4.5
"""Height of a bar and width of a panel on paper."""
Panels = Mapping[str, Sequence[str]]


def add_plot_argument(parser: argparse.ArgumentParser) -> None:
    """Declare `--plot`."""
    parser.add_argument("--plot", type=Path, help="draw the rows as bars into this PNG")


def draw_rows(path: Path, rows: Sequence[Row], panels: Panels, *, by: Sequence[str] = (), title: str = "") -> None:
    """Draw bars with their numbers beside them.

    Args:
        path: The PNG to write.
        rows: Those that lack a column have no bar for it.
        panels: By the label of its axis, with the unit: the columns that a panel shows.
        by: Columns that name a row.
        title: Over the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from gpdf_service.viewer.picture import COLOURS

    most = max(len(columns) for columns in panels.values())
    size = PANEL_INCHES * len(panels), 2.2 + BAR_INCHES * most * len(rows)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(title)
    places = range(len(rows))
    for axes, (label, columns) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        height = GROUP / len(columns)
        for i, column in enumerate(columns):
            middle = [place + (i + 0.5) * height - 0.5 * GROUP for place in places]
            values = [float(row.get(column, "nan")) for row in rows]
            bars = axes.barh(middle, values, height, color=COLOURS[i % len(COLOURS)], label=column)
            axes.bar_label(bars, [f"{value:.3g}" if value == value else "" for value in values], padding=3, fontsize=8)
        axes.set_yticks(places, [", ".join(str(row[name]) for name in by if name in row) for row in rows])
        axes.set_xlabel(label)
        axes.margins(x=0.15)
        axes.invert_yaxis()
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.6 / size[1] - 0.05), ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]
