"""Random bodies, long and round, with all that a request may ask for, in random rooms: an answer, whatever is asked."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.houses import free_places
from gpdf_service.synthetic import ramp, random_room
from gpdf_service.synthetic.solids import turn_and_shift


def random_body(rng):
    width, step = rng.uniform(0.08, 0.8), rng.choice([0.012, 0.05, 0.15, 0.37])
    return gpdf.Agent(
        name="random",
        height=rng.uniform(0.1, 2.2),
        width=width,
        length=width * rng.uniform(1.0, 3.0),
        max_step=step,
        comfortable_step=min(step, 0.2),
        max_slope=rng.uniform(0.1, 0.7),
        speed=rng.uniform(0.3, 1.5),
        acceleration=rng.uniform(0.3, 1.5),
        turn_rate=rng.uniform(0.5, 2.0),
        discs=int(rng.integers(1, 5)),
    )


def random_options(rng, places):
    pick = [lambda: places[rng.integers(len(places))], lambda: rng.uniform(-4.0, 4.0)]
    every = {
        "snap": lambda: rng.uniform(0.0, 1.0),
        "via": lambda: [pick[0]() for _ in range(rng.integers(1, 3))],
        "other_goals": lambda: [pick[0]()],
        "alternatives": lambda: 1,
        "prefer": lambda: str(rng.choice(["quickest", "level", "wide"])),
        "start_heading": pick[1],
        "goal_heading": pick[1],
    }
    return {name: make() for name, make in every.items() if rng.random() < 0.2}


def check(result):
    assert (result.trajectory is not None) == (result.status is gpdf.Status.OK)
    if result.trajectory is not None:
        assert result.certificate.holds
        assert (np.diff(result.trajectory.times) > 0.0).all()
        assert np.isfinite(result.trajectory.ground).all()
        assert np.isfinite(result.trajectory.headings).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_whatever_a_random_body_asks_for_it_gets_an_answer(seed):
    rng = np.random.default_rng(seed)
    points = (ramp if seed % 3 == 0 else random_room)(rng, float(rng.choice([0.0, 0.01, 0.02]))).points
    T = turn_and_shift(rng.uniform(0.0, 2.0 * np.pi), [*rng.uniform(-5.0, 5.0, 2), 0.0])
    scene, said = gpdf.build_scene(points @ T[:3, :3].T + T[:3, 3]), []
    for body in (random_body(rng) for _ in range(3)):
        anywhere = rng.uniform(scene.points.min(axis=0) - 1.0, scene.points.max(axis=0) + 1.0, (4, 3))
        places = np.concatenate([free_places(scene, body, 16, rng), anywhere])
        for _ in range(10):
            ends = places[rng.integers(len(places), size=2)]
            said.append(gpdf.plan(scene, *ends, body, **random_options(rng, places)))
            check(said[-1])
    assert sum(result.status is gpdf.Status.OK for result in said) >= 8
    assert not any(result.status is gpdf.Status.UNCERTIFIED for result in said)
