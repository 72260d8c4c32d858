import math

import numpy as np
import pytest
from PIL import Image

from gpdf_service.bench.plotting import draw_rows
from gpdf_service.cli import main
from gpdf_service.viewer.picture import COLOURS

pytestmark = pytest.mark.slow

ROWS = [{"scene": "office", "arrived": 8, "error_m": 0.02}, {"scene": "all", "arrived": 4, "error_m": math.nan}]


def widths(path, colour):
    """Longest run of a colour in each half of a picture [px]: the bars of the first and of the last row."""
    picture = np.asarray(Image.open(path).convert("RGB"))
    wanted = tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
    lengths = (picture == wanted).all(axis=2).sum(axis=1)
    bars = np.flatnonzero(lengths > 60)  # what is shorter is the square in the legend
    return lengths[bars[0]], lengths[bars[-1]]


def test_bars_are_as_long_as_the_numbers_say(tmp_path):
    path = tmp_path / "new" / "rows.png"
    draw_rows(path, ROWS, {"errands": ("arrived",)}, by=("scene",), title="errands")
    first, last = widths(path, COLOURS[0])
    assert abs(first / last - 2.0) < 0.1


def test_what_is_not_known_has_no_bar(tmp_path):
    draw_rows(tmp_path / "rows.png", ROWS, {"m": ("error_m", "not_there")}, by=("scene",))
    picture = np.asarray(Image.open(tmp_path / "rows.png").convert("RGB"))
    orange = tuple(int(COLOURS[1][i : i + 2], 16) for i in (1, 3, 5))
    assert (picture == orange).all(axis=2).sum(axis=1).max() < 60  # only its square in the legend


def test_a_benchmark_draws_its_rows(tmp_path, capsys):
    words = ["bench", "plan", "--scene", "office", "--agent", "human", "--count", "3", "--peers", "0"]
    assert main([*words, "--plot", str(tmp_path / "plan.png")]) == 0
    assert "certified" in capsys.readouterr().out
    assert Image.open(tmp_path / "plan.png").width > 500
