"""Edges in small pictures whose truth is known; samples on their normals, their noise, and a random walk."""

import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.special import ndtr
from tests.unit.imaging.pictures import circle, disc, grid, straight
from verification.validation.rendered import Camera, Scan, arch, clicks

from strandline.discrepancy.normal_offset import signed_distances
from strandline.foundations import InvalidInput
from strandline.imaging.edges.edge import find_edge
from strandline.imaging.edges.markov_path import MarkovPath, walk
from strandline.imaging.edges.profile_and_noise import noise_covariance, roughness, scatter_of, sum_to_first_zero
from strandline.imaging.edges.strip import course_through, grey_values, strip_along
from strandline.interface import Interface

LINE = np.array([[5.0, 31.5], [60.0, 29.0], [134.0, 31.0]])


def speckle(mean, seed, *, looks=1):
    """Return uncorrelated speckle of this mean intensity."""
    return mean * np.random.default_rng(seed).gamma(looks, 1 / looks, mean.shape)


def test_a_blurred_step_without_noise_is_found_to_a_thousandth_of_a_pixel():
    for slope, at in ((0.0, 30.0), (0.0, 30.37), (0.1, 25.2)):
        path = LINE + np.outer([1, 1, 1], [0.0, at - 30.0]) + np.outer(LINE[:, 0], [0.0, slope])
        edge = find_edge(straight(at=at, slope=slope, blur=2.0), path)
        off = (edge.points[:, 1] - at - slope * edge.points[:, 0]) / np.hypot(1.0, slope)
        bent = 2e-3 if slope else 1e-3  # bilinear interpolation of a step that crosses rows
        np.testing.assert_allclose(off, 0.0, atol=bent)
        assert edge.errors.blur == pytest.approx(2.0, abs=0.05)
        assert edge.errors.contrast == pytest.approx(-2.0, abs=1e-3)


def test_a_step_by_the_other_methods():
    edge = find_edge(straight(at=30.37), LINE, method="contour")
    np.testing.assert_allclose(edge.points[:, 1], 30.37, atol=5e-3)
    assert edge.errors.blur == pytest.approx(1.5, rel=0.15)
    picture = speckle(2.0 + straight(at=30.37), 1, looks=400)
    edge = find_edge(picture, LINE, method=MarkovPath(step=0.25, drift=0.2))
    assert edge.points[:, 1].mean() == pytest.approx(30.37, abs=0.02)
    np.testing.assert_allclose(edge.points[:, 1], 30.37, atol=0.4)
    with pytest.raises(InvalidInput, match="drift of the path"):  # with which it could not move
        MarkovPath(drift=0.2)


@pytest.mark.parametrize(("solid", "radial"), [("bright", 1.0), ("dark", -1.0)])
def test_the_solid_is_on_the_right_whichever_way_the_edge_was_clicked(solid, radial):
    for path in (circle(), circle()[::-1]):
        edge = find_edge(disc(), path, solid=solid, closed=True)
        away = edge.points - 59.5
        radius = np.linalg.norm(away, axis=1)
        np.testing.assert_allclose(radius, 40.0, atol=0.02)
        np.testing.assert_allclose((edge.normals * away).sum(axis=1) / radius, radial, atol=1e-3)
        turns = np.roll(edge.points, -1, axis=0) - edge.points
        assert np.sign((away[:, 0] * turns[:, 1] - away[:, 1] * turns[:, 0]).mean()) == radial  # clockwise as seen
    edge = find_edge(straight(), LINE[::-1], solid=solid)
    assert (radial * np.diff(edge.points[:, 0]) > 0).all()


def test_pixels_that_are_not_square():
    path = circle(stretch=2.0, middle=(59.5, 29.5))
    edge = find_edge(disc((60, 120), stretch=2.0, blur=2.0), path, closed=True, pixel=(0.005, 0.010))
    square = find_edge(disc(), circle(), closed=True, pixel=(0.005, 0.005))
    away = (edge.points - [59.5, 29.5]) * [0.005, 0.010]
    radius = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(radius, 0.2, atol=0.05 * 0.005)
    np.testing.assert_allclose((edge.normals * away).sum(axis=1) / radius, 1.0, atol=2e-3)
    assert edge.arc[-1] == pytest.approx(2 * np.pi * 0.2, rel=0.02)
    assert edge.errors.spacing == pytest.approx(0.005, rel=0.02)
    assert edge.errors.radius == pytest.approx(0.2, rel=0.1)
    assert edge.errors.offset == pytest.approx(0.1 * 0.005 * np.sqrt(2.5), rel=0.1)  # rms of the sides of a pixel
    assert square.errors.offset == pytest.approx(0.1 * 0.005, rel=0.1)


def rendered(seed, size, way, **options):
    """Return the edge in a rendered picture of an arch, and the distances of its points from the truth."""
    random = np.random.default_rng(seed)
    line, region = arch(size, random)
    edge = find_edge(way(region, size, random), clicks(line, random), **options)
    return edge, signed_distances(edge.points, Interface.polyline(line[::3]))


def ratio(found, *, mean, sd):
    """Return the stated standard deviation over that of the distances from the truth, which are small."""
    s = np.sqrt(np.mean([off.std() ** 2 for _, off in found]))
    assert abs(np.mean([off.mean() for _, off in found])) < mean
    assert s < sd
    return np.mean([edge.errors.sd for edge, _ in found]) / s


@pytest.mark.parametrize("method", ["erf", "contour"])
def test_errors_of_a_camera_are_those_that_the_truth_shows(method):
    found = [rendered((5, seed), (136, 280), Camera(), method=method) for seed in range(4)]
    assert 0.8 < ratio(found, mean=0.05, sd=0.25) < 1.25
    assert np.mean([edge.errors.level for edge, _ in found]) < 0.08
    for edge, off in found:
        assert np.abs(off).max() < 2.0
        assert edge.errors.contrast_to_noise == pytest.approx(9.5, rel=0.15)  # light falls by 10 %


def test_errors_of_a_scan_are_those_that_the_truth_shows():
    """The same picture gives the same edge, bit for bit."""
    found = [rendered((6, seed), (170, 233), Scan(), method="path") for seed in (0, 1, 2, 2)]
    assert 0.7 < ratio(found[:3], mean=0.3, sd=0.9) < 1.3
    for edge, off in found:
        assert np.abs(off).max() < 4.0
        assert edge.errors.offset >= 0.4
    assert (found[2][0].points == found[3][0].points).all()


def steep(slope):
    """Return a picture that is bright (10) right of the line x = 50 + slope (y - 60) and dark (1) left of it."""
    x, y = grid((120, 100))
    return 1.0 + 9.0 * ndtr((x - 50 - slope * (y - 60)) / np.hypot(1.0, slope))


def test_a_shadow_on_a_steep_flank_does_not_move_the_edge():
    """Nor is a vertical flank taken for a shadow."""
    y, shadow = np.array([2.0, 40.0, 80.0, 117.0]), np.exp(-0.5 * ((np.arange(100) - 55.0) / 5.0) ** 2)
    for slope in (0.2, 0.4):
        picture = speckle(steep(slope) * (1 - 0.75 * shadow), 1, looks=4)
        edge = find_edge(picture, np.stack([50 + slope * (y - 60), y], axis=1), method="path")
        off = (edge.points[:, 0] - 50 - slope * (edge.points[:, 1] - 60)) / np.hypot(1.0, slope)
        assert abs(off.mean()) < 0.2
        assert off.std() < 0.5
        assert np.abs(off).max() < 1.2
    edge = find_edge(speckle(steep(0.0), 1, looks=4), np.stack([np.full(4, 52.0), y], axis=1), method="path")
    assert abs(edge.points[:, 0].mean() - 50) < 0.2
    assert edge.errors.contrast == pytest.approx(-9.0, rel=0.1)


def test_excluded_polygons_trimming_and_values_that_are_not_finite_leave_points_out():
    spoilt, missing = straight(), straight()
    spoilt[20:40, 60:80] = 7.0
    missing[:, 40:44] = np.nan
    hole = np.array([[56.0, 10.0], [84.0, 10.0], [84.0, 50.0], [56.0, 50.0]])
    for picture, options, (first, last) in ((spoilt, {"exclude": [hole]}, (56, 84)), (missing, {}, (39, 44))):
        edge = find_edge(picture, LINE, trim=0.1, **options)
        x = edge.points[:, 0]
        assert not ((x > first) & (x < last)).any()
        assert x.min() > 5 + 0.09 * 129
        assert x.max() < 134 - 0.09 * 129
        np.testing.assert_allclose(edge.points[:, 1], 30.3, atol=2e-3)


def test_a_thin_part_is_not_looked_at_across():
    """Samples beyond the other side of a thin solid do not spoil the step on this side."""
    picture = straight(at=30.0, blur=1.0) - straight(at=44.0, blur=1.0)
    ring = np.array([[10.0, 30.0], [130.0, 30.0], [130.0, 44.0], [10.0, 44.0]])
    ends = [[-1.0, 10.0], [35.0, 10.0], [35.0, 59.0], [-1.0, 59.0]], [[105.0, 10.0], [141, 10], [141, 59], [105, 59]]
    edge = find_edge(picture, ring, closed=True, exclude=[np.array(one) for one in ends])
    upper = edge.points[:, 1] < 37.0
    assert upper.sum() == pytest.approx(70, abs=8)
    np.testing.assert_allclose(edge.points[:, 1], np.where(upper, 30.0, 44.0), atol=0.01)


NOISE = np.random.default_rng(4).standard_normal((60, 140))
SMALL = circle(radius=11.0, middle=(29.5, 29.5))
CROSSED = np.array([[5.0, 29], [130, 29], [130, 33], [5, 33.0]])
REFUSED = [
    ("number of points", straight(), LINE[:2] * [0.5, 1.0], {}),
    ("contrast over noise", straight() + 2 * NOISE, LINE, {}),
    ("the path crosses or touches itself", straight(), np.array([[5.0, 30], [100, 30], [100, 50], [50, 10]]), {}),
    ("is outside the picture", straight(), LINE + np.array([10.0, 0.0]), {}),
    ("path along the edge: got 1; expected at least 2 points", straight(), LINE[[0, 0]], {}),
    ("the path: point 2 is not finite", straight(), np.array([[5.0, 30], [50, np.nan], [130, 30]]), {}),
    ("normals of the path cross", straight(), CROSSED, {"closed": True}),
    ("method to find an edge", straight(), LINE, {"method": "erff"}),
    ("intensity of the scan", straight() - 2.0, LINE, {"method": "path"}),
    ("do not scatter like the intensity of speckle", straight() + 0.1 * NOISE, LINE, {"method": "path"}),
    ("blur of the edge", disc((60, 60), radius=10.0, blur=4.0), SMALL, {"closed": True}),
]


def test_what_shows_no_edge_is_refused_in_one_line():
    """Where the edge steps out of the strip, at column 100, the message says."""
    for said, picture, path, options in REFUSED:
        with pytest.raises(InvalidInput) as refusal:
            find_edge(picture, path, **options)
        assert said in str(refusal.value)
        assert "\n" not in str(refusal.value)
    found = find_edge(disc((60, 60), radius=10.0, blur=1.0), SMALL, closed=True)
    assert found.errors.blur < 2.0
    picture = np.hstack([straight(shape=(60, 100)), straight(shape=(60, 40), at=50.0)])
    with pytest.raises(InvalidInput, match="at the limit of the strip") as refusal:
        find_edge(picture, np.array([[5.0, 31.0], [60.0, 30.0], [134.0, 31.0]]))
    x, y = map(int, re.search(r"most of all near \((\d+), (\d+)\) px", str(refusal.value)).groups())
    assert 95 <= x <= 134
    assert y > 25


def test_samples_of_a_plane_are_exact_and_those_outside_of_the_picture_do_not_count():
    x, y = grid((50, 80))
    course = course_through(np.array([[10.0, 20], [40, 30], [70, 22]]), closed=False, sigma=3.0)
    strip = strip_along(grey_values(2 * x - 3 * y), course, reach=6.0)
    at = course.at(np.broadcast_to(strip.places, strip.samples.shape))
    np.testing.assert_allclose(strip.samples, 2 * at[..., 0] - 3 * at[..., 1], atol=1e-9)
    assert strip.usable.all()
    course = course_through(np.array([[5.0, 3], [70, 3]]), closed=False, sigma=3.0)
    strip = strip_along(grey_values(np.ones((50, 80))), course, reach=8.0)
    np.testing.assert_array_equal(strip.usable, np.broadcast_to(strip.places <= 3.0, strip.usable.shape))
    assert (strip.samples[~strip.usable] == 0).all()


PLACES = np.linspace(-8, 8, 33)
BASIS = np.stack([np.exp(-0.5 * PLACES**2), PLACES > 0, PLACES <= 0], axis=1).astype(float)


def correlations(errors):
    return np.array([np.mean(errors[: len(errors) - k] * errors[k:]) for k in range(12)]) / errors.var()


@pytest.mark.parametrize("blur", [(0.0, 0.0), (1.0, 1.5)])
def test_covariance_and_scatter_are_those_of_the_noise_although_a_fit_took_part_of_it_out(blur):
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((20000, 33)), blur, mode="wrap")
    residuals, row = noise - noise @ (BASIS @ np.linalg.pinv(BASIS)).T, np.linalg.pinv(BASIS)[0]
    found = noise_covariance(residuals, np.ones_like(residuals, dtype=bool), BASIS)
    for along in (0, 1, 3):
        for across in (0, 1, 3):
            expected = np.mean(noise[: len(noise) - along, : 33 - across] * noise[along:, across:])
            assert found[along, across] == pytest.approx(expected, abs=0.03 * found[0, 0])
    places = noise @ row
    scatter = scatter_of(places, found, row)
    assert scatter.sd == pytest.approx(places.std(), rel=0.04)
    if any(blur):
        assert scatter.length == pytest.approx(sum_to_first_zero(correlations(places)), rel=0.1)


def test_roughness_makes_up_for_what_the_smooth_line_follows():
    white = np.random.default_rng(3).standard_normal(20000)
    for errors in (white, gaussian_filter1d(white, 1.5)):
        found = roughness(errors + np.linspace(0, 50, 20000), correlations(errors))
        assert found == pytest.approx(errors.std(), rel=0.05)
    assert sum_to_first_zero(np.array([1.0, 0.0, 0.7])) == 0.5
    assert sum_to_first_zero(np.exp(-np.arange(200) / 10.0)) == pytest.approx(10.0, rel=0.01)


def test_the_posterior_is_that_of_a_gaussian_walk_and_normals_that_show_nothing_are_bridged():
    candidates = np.arange(-8.0, 8.01, 0.25)
    seen, sd, drift = np.sin(np.arange(60) / 8.0) + 0.5, 1.5, 0.5
    table = -0.5 * ((seen[:, None] - candidates) / sd) ** 2
    found = walk(table, candidates, drift, draws=2000, random=np.random.default_rng(1))
    steps = np.diff(np.eye(60), axis=0)
    covariance = np.linalg.inv(np.eye(60) / sd**2 + steps.T @ steps / drift**2)
    np.testing.assert_allclose(found.mean, covariance @ seen / sd**2, atol=2e-3)
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=5e-3)
    np.testing.assert_allclose(found.draws.mean(axis=0), found.mean, atol=0.1)
    np.testing.assert_allclose(np.cov(found.draws.T)[30, 25:36], covariance[30, 25:36], rtol=0.12)
    table = -0.5 * ((candidates - 2.0) / 0.3) ** 2 * np.ones((40, 1))
    table[10:30] = 0.0
    found = walk(table, candidates, 0.3)
    np.testing.assert_allclose(found.mean, 2.0, atol=0.02)
    assert found.sd[20] > 2 * found.sd[5]


def test_a_path_may_have_more_points_than_pixels():
    """Half a pixel apart: none is lost."""
    x = np.arange(0.0, 20.1, 0.5)
    course = course_through(np.stack([x, 0.05 * x**2], axis=1), closed=False, sigma=0.1)
    np.testing.assert_allclose(course.points[:, 1], 0.05 * course.points[:, 0] ** 2, atol=0.01)


def test_the_roughness_of_independent_errors_does_not_count_wrong_points():
    places = 0.3 * np.random.default_rng(1).standard_normal(4000)
    places[::40] = 9.0  # a few wrong points
    assert 0.3 < roughness(places, np.array([1.0])) < 0.6 < np.std(places)


def test_noise_goes_through_the_fit():
    """Planted: the variance for the standard deviation. The edge itself is smooth."""
    found = scatter_of(np.zeros(50), np.array([[4.0, 0.0]]), np.array([0.1, 0.0]))
    assert found.sd == pytest.approx(0.2)


def test_bilinear_samples_lose_noise():
    noise = np.random.default_rng(1).standard_normal((60, 140))
    picture = grey_values(noise)
    course = course_through(np.array([[5.0, 20.3], [134.0, 37.1]]), closed=False, sigma=1.0)
    linear = strip_along(picture, course, reach=3.0, step=1.0)
    assert linear.kept == pytest.approx(linear.samples[linear.usable].var(), rel=0.1)
