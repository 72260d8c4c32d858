import numpy as np
import pytest

from gpdf_service.bench.surfaces import SURFACES
from gpdf_service.denoise import denoise, estimate_noise, find_lifted
from gpdf_service.fields import estimate_spacing, fit_gpdf


def noisy(name, sigma, count=20_000):
    rng = np.random.default_rng(1)
    clean = SURFACES[name].sample(count, rng)
    return clean, clean + rng.normal(size=clean.shape) * sigma, rng


def cured_of(points):
    spacing = estimate_spacing(points)
    return denoise(points, estimate_noise(points, spacing), spacing)


@pytest.mark.parametrize("sigma", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("name", ["plane", "corner", "sphere", "pole", "terrain"])
def test_the_noise_is_found_without_being_told(name, sigma):
    _, points, _ = noisy(name, sigma)
    assert estimate_noise(points, estimate_spacing(points)) == pytest.approx(sigma, rel=0.25)


def test_a_quiet_place_is_denoised_with_its_own_noise():
    rng = np.random.default_rng(0)
    x, y = rng.uniform((0.0, 0.0), (8.0, 4.0), (80_000, 2)).T
    lid = (np.abs(x - 1.5) < 0.5) & (np.abs(y - 2.0) < 0.4)
    clean = np.column_stack([x, y, 0.08 * lid])
    sigma = np.where(x < 4.0, 0.01, 0.05)
    made = cured_of(clean + rng.normal(size=clean.shape) * sigma[:, None])
    quiet, loud = x < 3.0, x > 5.0
    assert made.measured == pytest.approx(0.05, rel=0.2)
    assert (made.local[quiet] < 0.03).mean() > 0.95
    assert (made.local[loud] == made.measured).mean() > 0.95
    off = np.abs(made.points[:, 2] - clean[:, 2])
    assert np.quantile(off[quiet & ~lid], 0.95) < 0.01
    assert np.quantile(off[lid], 0.9) < 0.02
    assert made.noise[quiet].mean() < 0.5 * made.noise[loud].mean()


@pytest.mark.parametrize("name", ["pole", "stairs", "sphere"])
def test_a_dense_cloud_is_not_called_clean_because_its_neighbourhoods_are_large(name):
    """200 points of a thin thing in a ball of the noise's size: no neighbourhood small enough to look at shows it."""
    _, points, _ = noisy(name, 0.05, 80_000)
    assert 0.045 < estimate_noise(points, estimate_spacing(points)) < 0.065  # a ramp of treads adds to it


def crowded(spacing, rng):
    """Boxes of 1 m, three on each square metre of a hall of 12 m and through each other; one point every `spacing`²."""
    count = round(3.6 / spacing**2)
    box = rng.uniform(0.0, 1.0, (430, count, 3)) * np.array([1.0, 0.6, 1.2])
    face = rng.integers(0, 4, (430, count))
    for value, axis, place in ((0, 0, 0.0), (1, 1, 0.0), (2, 2, 1.2), (3, 0, 1.0)):
        box[..., axis][face == value] = place
    box[..., :2] += rng.uniform(0.0, 11.0, (430, 1, 2))
    return box.reshape(-1, 3)


@pytest.mark.parametrize("spacing", [0.04, 0.05])
def test_what_is_crowded_is_no_noise(spacing):
    """Most neighbourhoods hold too many points; thinned until they do not, the hall itself is a slab 40 cm thick."""
    rng = np.random.default_rng(0)
    points = crowded(spacing, rng)
    points += rng.normal(0.0, 0.002, points.shape)
    assert estimate_noise(points, estimate_spacing(points)) < 0.25 * spacing


def test_a_room_full_of_things_is_not_noisier_for_being_dense():
    """5 cm of noise, 1 cm between the points: at first one place in eighty tells, thinned to 2 cm one in eight."""
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(0.0, 6.0, (360_000, 2)), np.zeros(360_000)])
    box = rng.uniform(0.0, 1.0, (12, 30_000, 3)) * np.array([1.0, 0.6, 0.7])
    face = rng.integers(0, 5, (12, 30_000))
    for value, axis, place in ((0, 0, 0.0), (1, 1, 0.0), (2, 2, 0.7), (3, 0, 1.0), (4, 1, 0.6)):
        box[..., axis][face == value] = place
    box[..., :2] += rng.uniform(0.0, 5.0, (12, 1, 2))
    points = np.concatenate([floor, box.reshape(-1, 3)])
    points += rng.normal(0.0, 0.05, points.shape)
    assert estimate_noise(points, estimate_spacing(points)) == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(("name", "share"), [("plane", 0.3), ("corner", 0.35), ("sphere", 0.45), ("terrain", 0.4)])
@pytest.mark.parametrize("sigma", [0.02, 0.05])
def test_points_come_back_to_their_surface(name, share, sigma):
    _, points, _ = noisy(name, sigma)
    cured = cured_of(points)
    error = SURFACES[name].distance(cured.points[~cured.stray])
    assert np.sqrt((error**2).mean()) < share * sigma
    assert cured.stray.mean() < 0.01


def test_two_metres_over_a_floor_with_5_cm_of_noise_the_bias_is_gone():
    _, points, rng = noisy("plane", 0.05)
    queries = np.column_stack([rng.uniform(-3, 3, (500, 2)), np.full(500, 2.0)])
    raw = fit_gpdf(points).query(queries).distance - 2.0
    cured = cured_of(points)
    ours = fit_gpdf(cured.points[~cured.stray]).query(queries).distance - 2.0
    assert raw.mean() < -0.08  # what the cure is for
    assert abs(ours.mean()) < 0.02


def test_clean_points_stay_where_they_are():
    clean, _, _ = noisy("corner", 0.0)
    cured = cured_of(clean)
    np.testing.assert_array_equal(cured.points, clean)
    assert not cured.stray.any()


@pytest.mark.parametrize("count", [6_000, 30_000])
@pytest.mark.parametrize("name", ["stairs", "board", "pole", "sphere", "terrain"])
def test_what_bends_or_is_thin_is_no_noise_when_it_is_clean(name, count):
    clean, _, _ = noisy(name, 0.0, count)
    assert estimate_noise(clean, estimate_spacing(clean)) < 0.08 * estimate_spacing(clean)
    assert np.abs(cured_of(clean).points - clean).max() < 0.25 * estimate_spacing(clean)


@pytest.mark.parametrize("sigma", [0.01, 0.02])
@pytest.mark.parametrize("name", ["stairs", "step"])
def test_edges_are_not_eaten_however_they_lie(name, sigma):
    from scipy.stats import special_ortho_group  # a second to import

    clean, points, rng = noisy(name, sigma)
    R = special_ortho_group.rvs(3, random_state=4)
    cured = cured_of(points @ R.T)
    field = fit_gpdf(cured.points[~cured.stray], noise=cured.noise[~cured.stray])
    low, high = np.asarray(SURFACES[name].core)
    queries = clean[rng.integers(len(clean), size=6000)] + rng.normal(size=(6000, 3)) * 0.3
    queries = queries[((queries > low) & (queries < high)).all(axis=1)]
    over = field.query(queries @ R.T).distance - SURFACES[name].distance(queries)
    assert len(queries) > 1000
    most = 1.2 if (name, sigma) == ("stairs", 0.02) else 0.7  # riser and tread in one window of 12 cm
    assert np.quantile(over, 0.99) < most * field.spacing


@pytest.mark.xfail(reason="no poles are told: 4 cm off at a radius of 10 cm and 5 cm of noise", strict=True)
def test_a_pole_with_5_cm_of_noise_is_as_thick_as_it_is():
    _, points, rng = noisy("pole", 0.05)
    cured = cured_of(points)
    inner = ~cured.stray & (np.abs(points[:, 2]) < 4.0)
    assert np.sqrt((SURFACES["pole"].distance(cured.points[inner]) ** 2).mean()) < 0.01
    angle = rng.uniform(0, 2 * np.pi, 500)
    queries = np.column_stack([2 * np.cos(angle), 2 * np.sin(angle), rng.uniform(-3, 3, 500)])
    error = fit_gpdf(cured.points[~cured.stray]).query(queries).distance - 1.9
    assert abs(error.mean()) < 0.02  # raw: -10 cm


def test_a_pole_beside_a_noisy_wall_is_not_moved_into_it_nor_taken_for_a_stray():
    rng = np.random.default_rng(2)
    wall = np.column_stack([np.zeros(30_000), rng.uniform(-3, 3, 30_000), rng.uniform(0, 2.5, 30_000)])
    pole = np.column_stack([np.full(400, 0.6), np.zeros(400), rng.uniform(0, 2, 400)])
    points = np.concatenate([wall, pole]) + rng.normal(size=(30_400, 3)) * 0.03
    cured = cured_of(points)
    kept = cured.points[30_000:][~cured.stray[30_000:]]
    assert len(kept) > 390
    assert np.abs(kept[:, 0] - 0.6).max() < 0.15


def test_a_reflection_above_a_floor_is_a_stray_and_a_thin_region_is_not():
    rng = np.random.default_rng(3)
    floor = np.column_stack([rng.uniform(0, 4, (20_000, 2)), np.zeros(20_000)])
    far = np.column_stack([rng.uniform(10, 20, 40), rng.uniform(0, 4, 40), np.zeros(40)])
    points = np.concatenate([floor, far]) + rng.normal(size=(20_040, 3)) * 0.02
    cured = cured_of(np.concatenate([points, [[2.0, 2.0, 0.15]]]))
    assert cured.stray[-1]
    assert not cured.stray[20_000:-1].any()


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.0, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("name", sorted(SURFACES))
def test_the_truth_lies_within_two_standard_deviations(name, sigma):
    if (name, sigma) == ("pole", 0.05):
        pytest.xfail("no poles are told: 0.83 of the places")
    if (name, sigma) == ("sphere", 0.05):
        pytest.xfail("its field is 5 cm too near, for planes go on past where it bends: 0.92 of the places")
    _, points, rng = noisy(name, sigma)
    cured = cured_of(points)
    field = fit_gpdf(cured.points[~cured.stray], noise=cured.noise[~cured.stray])
    low, high = np.asarray(SURFACES[name].core)
    queries = rng.uniform(np.maximum(low, -3), np.minimum(high, 3), (3000, 3))
    sample = field.query(queries)
    error = np.abs(sample.distance - SURFACES[name].distance(queries))
    assert (error <= 2 * sample.deviation)[sample.valid].mean() > 0.95


def test_a_pole_thinner_than_the_noise_is_not_cured_into_its_axis():
    rng = np.random.default_rng(1)
    radius, noise, count = 0.04, 0.05, 400
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    pole = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.0, 1.5, count)])
    points = pole + rng.normal(0.0, noise, pole.shape)
    moved = denoise(points, noise, estimate_spacing(points)).points
    inner = (moved[:, 2] > 0.3) & (moved[:, 2] < 1.2)
    assert np.quantile(np.linalg.norm(moved[inner, :2], axis=1), 0.1) > radius - noise / 2  # what plans keep away
    assert np.median(np.linalg.norm(moved[inner, :2], axis=1)) > radius


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_what_noise_lifted_off_a_floor_is_told_from_a_low_thing(noise):
    rng = np.random.default_rng(0)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 6, 0.03), np.arange(0, 6, 0.03)))
    floor = np.column_stack([x, y, np.zeros(len(x))])
    outliers = floor[rng.choice(len(floor), 400, replace=False)]
    outliers[:, 2] = rng.choice([-1, 1], 400) * rng.uniform(1.0, 4.0, 400) * noise
    thing = np.column_stack([rng.uniform(2.0, 2.2, (30, 2)), rng.normal(2.0, 1.0, 30) * noise])
    points = np.concatenate([floor, outliers, thing])
    far = np.linalg.norm(outliers[:, :2] - 2.1, axis=1) > 0.5
    lifted = find_lifted(points, np.arange(len(points)) < len(floor), noise, 0.03)
    assert not lifted[: len(floor)].any()
    assert lifted[len(floor) : -30][far].mean() > 0.95
    assert lifted[-30:].mean() < 0.5  # the thing is there, if without some of its rim
    none, all_of_them = np.zeros(len(points), dtype=bool), np.ones(len(points), dtype=bool)
    assert not find_lifted(points, none, noise, 0.03).any()
    assert not find_lifted(points, all_of_them, noise, 0.03).any()
