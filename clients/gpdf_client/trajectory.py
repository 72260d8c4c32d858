"""A trajectory in the client's hands: sampled by time and by arc length, cut, written to a file and read back."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
COLUMNS = ("time", "x", "y", "z", "ground_x", "ground_y", "ground_z", "heading")
"""Header of the CSV: s, m, rad."""


@dataclass(frozen=True)
class Trajectory:
    """A time-stamped path of a body's top and of its contact with the ground, straight between its waypoints.

    Attributes:
        positions: The body's top [m], shape (n, 3).
        ground: The contact point below it [m], shape (n, 3).
        times: Time since the start [s], strictly increasing, shape (n,).
        headings: Direction of travel, counter-clockwise from +x [rad], shape (n,).
    """

    positions: FloatArray
    ground: FloatArray
    times: FloatArray
    headings: FloatArray

    @property
    def length(self) -> float:
        """Length of the path of the body's top [m]."""
        return float(self.arc_lengths[-1])

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return float(self.times[-1] - self.times[0])

    def __repr__(self) -> str:
        """Short: the arrays of a way are pages long."""
        return f"Trajectory({len(self.times)} waypoints, {self.length:.2f} m, {self.duration:.1f} s)"

    @cached_property
    def arc_lengths(self) -> FloatArray:
        """Length of the path of the body's top up to each waypoint [m], shape (n,)."""
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at_times(self, times: ArrayLike) -> Trajectory:
        """The trajectory at the given times [s], shape (m,); before the start and after the end it stands still."""
        return self._at(self.times, np.asarray(times, dtype=np.float64))

    def at_lengths(self, lengths: ArrayLike) -> Trajectory:
        """The trajectory at the given lengths along the path [m], shape (m,); outside the path, its nearer end."""
        return self._at(self.arc_lengths, np.asarray(lengths, dtype=np.float64))

    def cut(self, first_m: float, last_m: float) -> Trajectory:
        """The piece between two lengths along the path [m]; its times start at 0.

        Raises:
            ValueError: nothing lies between them.
        """
        first_m, last_m = max(first_m, 0.0), min(last_m, self.length)
        if not first_m < last_m:
            raise ValueError(f"nothing lies between {first_m:g} m and {last_m:g} m of a path of {self.length:g} m.")
        inner = self.arc_lengths[(self.arc_lengths > first_m) & (self.arc_lengths < last_m)]
        piece = self.at_lengths(np.concatenate([[first_m], inner, [last_m]]))
        return Trajectory(piece.positions, piece.ground, piece.times - piece.times[0], piece.headings)

    def _at(self, knots: FloatArray, wanted: FloatArray) -> Trajectory:
        heading = np.unwrap(self.headings)
        columns = np.column_stack([self.positions, self.ground, self.times, heading])
        made = np.column_stack([np.interp(wanted, knots, column) for column in columns.T])
        return Trajectory(made[:, :3], made[:, 3:6], made[:, 6], made[:, 7])

    def save(self, path: str | Path) -> None:
        """Write .json, .csv, or .geojson (a feature like GeoJSON's, in metres of the scene's frame, not in degrees).

        Raises:
            ValueError: the suffix is none of these.
        """
        path = Path(path)
        writers = {".json": self._json, ".csv": self._csv, ".geojson": self._geojson}
        if path.suffix not in writers:
            raise ValueError(f"{path.name}: a trajectory is saved as {', '.join(writers)}.")
        path.write_text(writers[path.suffix](), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a .json file that `save` wrote."""
        stored = json.loads(Path(path).read_text(encoding="utf-8"))
        return cls(*(np.array(stored[key], dtype=np.float64) for key in ("positions", "ground", "times", "headings")))

    def _lists(self) -> dict[str, Any]:
        return {key: getattr(self, key).tolist() for key in ("positions", "ground", "times", "headings")}

    def _json(self) -> str:
        return json.dumps(self._lists())

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(np.column_stack([self.times, self.positions, self.ground, self.headings]).tolist())
        return text.getvalue()

    def _geojson(self) -> str:
        lists = self._lists()
        geometry = {"type": "LineString", "coordinates": lists.pop("ground")}
        return json.dumps({"type": "Feature", "geometry": geometry, "properties": lists})
