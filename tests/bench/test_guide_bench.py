"""`gpdf bench guide` keeps what it has measured when something fails."""

import json

import numpy as np

from gpdf_service.cli import main
from gpdf_service.synthetic import SCENES


def test_a_scene_that_fails_costs_no_other_scenes_row(tmp_path, capsys):
    scene = SCENES["office"](np.random.default_rng(0), spacing=0.05)
    for name in ("no?name", "office"):  # the service takes no such name for a scene
        np.savez(
            tmp_path / f"{name}.npz", xyz=scene.points, label=scene.ground.astype(int), classes=["other", "ground"]
        )
    words = [word for name in ("no?name", "office") for word in ("--scene", str(tmp_path / f"{name}.npz"))]
    assert main(["bench", "guide", *words, "--count", "1", "--json"]) == 1
    refused, office, everything = json.loads(capsys.readouterr().out)
    assert "no?name" in refused["failed"]
    assert refused["walks"] == 0
    assert (office["walks"], office["arrived"], "failed" in office) == (1, 1, False)
    assert everything["walks"] == 1
