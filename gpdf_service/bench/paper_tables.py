"""The paper's Tables 2 to 4 beside ours, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from gpdf_service.bench.report import Row
from gpdf_service.pipeline import Method

METHODS: tuple[Method, ...] = ("prm", "astar", "single_gpdf", "dual_gpdf")
"""In the order of the paper's columns."""
TITLES = {"prm": "PRM", "astar": "A*", "single_gpdf": "CHOMP, one GPDF", "dual_gpdf": "ours"}
DATASETS = {
    "cow_and_lady": "Cow and lady",
    "cluttered_office": "Office 10",
    "office": "Office 1",
    "cave": "Cave circuit",
}
"""The paper's data sets, by the name of the scene that stands in for each."""
COLLISION_FREE: dict[tuple[str, str], Sequence[float]] = {
    ("human", "cow_and_lady"): (54, 62, 96, 96),
    ("human", "cluttered_office"): (28, 54, 93, 96),
    ("human", "office"): (60, 71, 98, 100),
    ("human", "cave"): (87, 96, 99, 100),
    ("roomba", "cow_and_lady"): (72, 76, 100, 100),
    ("roomba", "cluttered_office"): (58, 68, 98, 100),
    ("roomba", "office"): (81, 76, 100, 100),
}
"""[%] Uttsha et al. 2024, Table 2, in the order of `METHODS`."""
FEASIBLE: dict[tuple[str, str], Sequence[float]] = {
    ("human", "cow_and_lady"): (100, 100, 47, 100),
    ("human", "cluttered_office"): (100, 100, 19, 100),
    ("human", "office"): (83, 78, 28, 99),
    ("human", "cave"): (13, 8, 7, 97),
    ("roomba", "cow_and_lady"): (100, 100, 23, 100),
    ("roomba", "cluttered_office"): (100, 100, 20, 100),
    ("roomba", "office"): (86, 83, 6, 100),
}
"""[%] Table 3."""
GROUND: dict[tuple[str, str], Sequence[float]] = {
    ("human", "office"): (1.71, 1.72, 2.38, 1.98),
    ("human", "cave"): (1.68, 4.7, 4.7, 2.012),
}
"""[m] Table 4, mean distance of the body's top to the ground."""
OBSTACLES: dict[tuple[str, str], Sequence[float]] = {
    ("human", "office"): (0.286, 0.187, 0.2, 0.315),
    ("human", "cave"): (9.13, 8.63, 8.63, 9.48),
}
"""[m] Table 4, mean distance to the nearest obstacle."""
TABLES = (
    ("Collision-free [%]", "collision_free", COLLISION_FREE, "{:.0f}"),
    ("Feasible: within ±10 % of the body's height from the ground [%]", "feasible", FEASIBLE, "{:.0f}"),
    ("Mean distance to the ground [m]", "ground_m", GROUND, "{:.3f}"),
    ("Mean distance to obstacles [m]", "obstacles_m", OBSTACLES, "{:.3f}"),
)
JUDGED = {"waypoints": "as the paper judges, at the waypoints", "strict": "strictly, the whole path, the body standing"}


def to_markdown(rows: Sequence[Row], noise: float) -> str:
    """Three tables, each cell `ours (paper's)`, once by waypoints and once strictly; then what was answered."""
    lines = [
        f"Input with {100 * noise:.0f} cm of noise, judged against the clean cloud. The first rate is of the queries",
        "that a brute-force search on the true geometry solves, a refusal being a failure; the second is of those",
        "that got a path. In brackets, the paper's. PRM and A* keep the body's radius here, and the one field sees all",
        "of the body, which lifts them over the paper's; scenes stand in for its data sets. As in the paper, the",
        "ground is given: labels, or our segmentation of the clean cloud; with `--ignore-labels`, of the noisy one.",
        "`low_in_ok`: collisions in OK answers with nothing higher than the certificate's `hidden_height`.",
    ]
    for title, key, printed, form in TABLES:
        for how, words in JUDGED.items():
            lines += ["", f"**{title}**, {words}", "", _line("body", "scene", *TITLES.values()), "|---" * 6 + "|"]
            lines += [
                _line(*cells) for cells in _cells(rows, f"{how}_{key}", printed if how == "waypoints" else {}, form)
            ]
    names = [name for name in ANSWERS if any(name in row for row in rows)]
    lines += ["", "**Answers**", "", _line(*names), "|---" * len(names) + "|"]
    lines += [_line(*(_text(row.get(name)) for name in names)) for row in rows]
    return "\n".join(lines) + "\n"


ANSWERS = (
    "agent", "scene", "method", "queries", "solvable", "answered", "ok", "ok_of_solvable",
    "collisions_in_ok", "low_in_ok", "infeasible_in_ok", "deepest_in_ok_m", "p50_cpu_ms", "p99_cpu_ms",
)  # fmt: skip


def _cells(
    rows: Sequence[Row], key: str, printed: dict[tuple[str, str], Sequence[float]], form: str
) -> list[tuple[str, ...]]:
    """One line for each body and scene: what each method has, and the paper's in brackets."""
    lines = []
    for agent, scene in dict.fromkeys((row["agent"], row["scene"]) for row in rows):
        by_method = {row["method"]: row for row in rows if (row["agent"], row["scene"]) == (agent, scene)}
        paper = printed.get((agent, scene))
        cells = []
        for i, method in enumerate(METHODS):
            row = by_method.get(method, {})
            values = [row[name] for name in (key, f"{key}_of_paths") if row.get(name) is not None]
            value = " · ".join(form.format(value) for value in values) or "–"
            cells.append(f"{value} ({paper[i]:g})" if paper else value)
        lines.append((agent, f"{scene} ({DATASETS[scene]})" if printed and scene in DATASETS else scene, *cells))
    return lines


def _line(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _text(value: object) -> str:
    return "–" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
