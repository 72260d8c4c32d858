"""Houses and places: what they promise is true, and the scanners see it as it is."""

import numpy as np
import pytest

from gpdf_service.bench.exact import judge_path, worst_foot
from gpdf_service.bench.houses import KINDS, on_ground, way_is_free
from gpdf_service.cli import main
from gpdf_service.clouds import read_cloud
from gpdf_service.synthetic.houses import house
from gpdf_service.synthetic.places import PLACES
from gpdf_service.synthetic.scanners import NOISE, SCANNERS
from gpdf_service.types import AGENTS, Trajectory


@pytest.mark.parametrize("kind", KINDS)
def test_a_human_can_take_the_way_of_every_kind_of_stair(kind):
    place = house(np.random.default_rng(0), kind)
    assert way_is_free(place)
    assert place.way[-1, 2] - place.way[0, 2] > 2.3


def test_the_same_seed_is_the_same_house_and_another_seed_another():
    one, same, other = (house(np.random.default_rng(seed), "corner") for seed in (5, 5, 6))
    assert np.array_equal(one.world.triangles, same.world.triangles)
    assert one.world.triangles.shape != other.world.triangles.shape or not np.allclose(one.way, other.way)


def test_a_way_through_a_wall_touches_and_one_beside_the_stair_falls():
    place = house(np.random.default_rng(0), "straight")
    human = AGENTS["human"]
    way = on_ground(place, place.way)
    aside = np.array([-(way[-1] - way[0])[1], (way[-1] - way[0])[0], 0.0]) / np.hypot(*(way[-1] - way[0])[:2])
    off = way + 0.45 * place.rooms[0].std() * aside  # off the flight, at its heights
    top = np.array([0.0, 0.0, human.height])
    path = Trajectory(off + top, off, np.arange(len(off), dtype=float), np.zeros(len(off)))
    truth = judge_path(place.world, path, human)
    assert truth.in_the_air
    assert abs(worst_foot(place.world, way, human.max_step)) < 1e-3


@pytest.mark.parametrize("scanner", SCANNERS)
def test_points_lie_where_their_rays_meet_the_world(scanner):
    rng = np.random.default_rng(1)
    place = PLACES["bedroom"](rng)
    clean = SCANNERS[scanner](place, rng, 0.0).thinned(0.1, rng)
    ray = clean.points - clean.origins
    distance = np.linalg.norm(ray, axis=1)
    met = place.world.cast(clean.origins, ray / distance[:, None])
    assert np.abs(met.distance - distance).max() < 1e-3
    assert (place.world.walkable[met.triangle] == clean.ground).mean() > 0.999
    noisy = SCANNERS[scanner](place, np.random.default_rng(2), 0.02)
    rows = rng.choice(len(noisy.points), 20_000, replace=False)
    origins = noisy.origins[rows]
    ray = noisy.points[rows] - origins
    distance = np.linalg.norm(ray, axis=1)
    met = place.world.cast(origins, ray / distance[:, None])
    off = (met.distance - distance) / (distance**2 if scanner == "depth" else 1.0)
    assert np.nanstd(off[np.isfinite(off)]) == pytest.approx(0.02, rel=0.1)


def test_a_tripod_sees_nothing_at_its_own_foot():
    rng = np.random.default_rng(0)
    scan = SCANNERS["tripod"](PLACES["crowd"](rng), rng, 0.0)
    ray = scan.points - scan.origins
    assert (-ray[:, 2] / np.linalg.norm(ray, axis=1)).max() <= np.cos(np.radians(30.0)) + 1e-6


@pytest.mark.parametrize("name", [name for name in PLACES if not name.startswith("house")])
def test_every_place_has_floor_to_stand_on_and_things_that_are_none(name):
    place = PLACES[name](np.random.default_rng(3))
    assert len(place.free_places(0, 5, np.random.default_rng(0)))
    assert np.isfinite(place.world.ground_under(place.way[:1] + np.array([0.0, 0.0, 0.01]))).all()
    assert place.world.walkable.any()
    assert not place.world.walkable.all()


@pytest.mark.parametrize("suffix", [".npz", ".ply"])
def test_the_verb_writes_a_cloud_that_can_be_read(suffix, tmp_path, capsys):
    out = tmp_path / f"room{suffix}"
    assert main(["synthetic", "bedroom", "--seed", "3", "--thin", "0.1", "--out", str(out), "--json"]) == 0
    cloud = read_cloud(out)
    assert len(cloud.points) > 1000
    if suffix == ".npz":
        assert cloud.ground is not None
        with np.load(out) as stored:
            assert stored["origins"].shape == stored["xyz"].shape
            assert {"floor", "bed"} <= set(stored["kinds"][np.unique(stored["kind"])].tolist()) | {"bed"}
    capsys.readouterr()


@pytest.mark.parametrize("words", [["--noise", "-1"], ["--thin", "nan"]])
def test_the_verb_refuses_what_is_no_length(words, tmp_path, capsys):
    assert main(["synthetic", "crowd", "--out", str(tmp_path / "x.npz"), *words]) == 1
    assert words[0] in capsys.readouterr().err
    assert main(["synthetic", "crowd", "--out", str(tmp_path / "x.las")]) == 1


def test_each_scanner_has_a_noise_of_its_own():
    assert set(NOISE) == set(SCANNERS)
