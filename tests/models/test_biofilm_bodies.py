"""Several bodies on the floor, and feet that are held in part: symmetry, limits, inputs, refusals."""

import numpy as np
import pytest
from verification.validation.analytic import force_imbalance
from verification.validation.generality import sensitivity_errors

from strandline.errors import InvalidInput
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import subdivide
from strandline.models.biofilm.model import Biofilm, _flow_cell
from strandline.models.biofilm.outline import Outline, bodies
from strandline.models.biofilm.subdivision import Partition

INPUTS = {"E": 400.0, "nu": 0.3, "V_in": 50.0}
FIRST = [[0.8, 0.0], [0.9, 0.3], [1.0, 0.3], [1.1, 0.0]]
SECOND = [[2.9, 0.0], [3.0, 0.3], [3.1, 0.3], [3.2, 0.0]]
LONG = {"length": 4.0}


def cell(**options) -> Biofilm:
    return Biofilm.from_options(mesh="coarse", material="neo_hookean", **options)


def pair(second: list[list[float]] = SECOND, **options) -> Biofilm:
    outline = {"points": [*FIRST, *second], "nodes": 60}
    return cell(channel=LONG | options.pop("channel", {}), outline=outline, **options)


def moved(model: Biofilm, inputs: dict[str, float] = INPUTS) -> np.ndarray:
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


def mirrored(points: np.ndarray) -> np.ndarray:
    return points[::-1] * [-1, 1]


def test_an_outline_of_two_bodies_keeps_their_feet_and_shares_its_nodes():
    points = Outline(tuple(map(tuple, FIRST + SECOND)), nodes=60).interface().points
    first, second = (points[body] for body in bodies(points))
    assert len(first) == len(second) == 30
    for body, given in ((first, FIRST), (second, SECOND)):
        np.testing.assert_array_equal(body[[0, -1]], [given[0], given[-1]])
        assert (body[1:-1, 1] > 0).all()
        np.testing.assert_allclose(body[:, 1].max(), 0.3, rtol=0.15)
    kept = Outline(tuple(map(tuple, FIRST + SECOND)), spline=False, nodes=None).interface().points
    np.testing.assert_array_equal(kept, FIRST + SECOND)


def test_bodies_have_their_areas_and_the_fluid_has_the_rest():
    outline = Outline(tuple(map(tuple, FIRST + SECOND)), spline=False, nodes=None).interface()
    figure, parts = subdivide(outline, Channel(length=4.0), Partition())
    assert parts == ["solid"]
    np.testing.assert_allclose([figure.area(name) for name in ("solid", "solid@2")], 0.06)
    np.testing.assert_allclose(figure.area("fluid"), 4.0 - 0.12)


def test_a_second_body_that_is_tiny_and_far_downstream_does_not_matter():
    tiny = [[3.3, 0], [3.34, 0.02], [3.36, 0.02], [3.4, 0]]
    alone = moved(cell(channel=LONG, outline={"points": FIRST, "nodes": 30}))
    found = moved(pair(tiny))
    first, second = (found[body] for body in bodies(pair(tiny).undeformed().points))
    nodes = np.linspace(0, 1, len(first)), np.linspace(0, 1, len(alone))
    again = np.stack([np.interp(nodes[1], nodes[0], column) for column in first.T], axis=1)
    np.testing.assert_allclose(again, alone, atol=2e-2 * np.abs(alone).max())
    assert np.abs(second).max() < 1e-2 * np.abs(alone).max()


def test_two_bodies_in_flow_from_the_right_are_the_mirror_image():
    left, right = (moved(pair(channel={"inlet": inlet})) for inlet in ("left", "right"))
    np.testing.assert_allclose(mirrored(right), left, atol=2e-2 * np.abs(left).max())  # meshes are no mirror images
    assert np.abs(left[:30] - left[30:]).max() > 0.1 * np.abs(left).max()


def test_creeping_flow_past_stiff_twins_is_reversible():
    """Reversed Stokes flow reverses the displacement: the twins mirror each other, but for the pressure's level.

    At ν = ½ a uniform pressure hardly moves the solid, and the channel is symmetric but for its ends.
    """
    stiff = {"E": 1e6, "nu": 0.5, "V_in": 50.0}
    found = moved(pair(fluid={"density": 0.0}), stiff)
    np.testing.assert_allclose(found[30:][::-1] * [1, -1], found[:30], atol=3e-2 * np.abs(found).max())
    inert = moved(pair(), stiff)
    assert np.abs(inert[30:][::-1] * [1, -1] - inert[:30]).max() > 0.1 * np.abs(inert).max()


def test_markers_give_each_body_its_own_material():
    model = pair(partition={"lines": [], "markers": [[0.95, 0.1], [3.05, 0.1]]})
    names = [item.name for item in model.inputs]
    assert names == ["E1", "nu1", "E2", "nu2", "V_in"]
    equal = dict(zip(names, (400.0, 0.3, 400.0, 0.3, 50.0), strict=True))
    np.testing.assert_allclose(moved(model, equal), moved(pair()), atol=1e-9)
    softer = moved(model, equal | {"E2": 200.0})
    assert np.abs(softer[30:]).max() > 1.5 * np.abs(moved(pair())[30:]).max()
    errors = sensitivity_errors(model, equal | {"E2": 300.0})
    assert max(errors[name] for name in ("E1", "E2", "V_in")) < 1e-6


def test_forces_on_two_bodies_balance():
    model = pair()
    found = _flow_cell(model._geometry)
    found.solve([400.0], [0.3], 50.0)
    assert max(force_imbalance(found)) < 1e-8


WHOLE = [[0.54, 1.391]]
TOUCHING = [[0.3, 0], [0.5, 0.3], [0.7, 0]]
TWO = {"channel": LONG, "outline": {"points": FIRST + SECOND}}


def test_a_foot_that_is_held_everywhere_is_the_usual_one():
    usual = moved(cell())
    np.testing.assert_allclose(moved(cell(clamped=WHOLE)), usual, atol=1e-3 * np.abs(usual).max())
    nearly = moved(cell(clamped=[[0.541, 1.39]]))
    np.testing.assert_allclose(nearly, usual, atol=2e-2 * np.abs(usual).max())


def test_the_less_is_held_the_more_it_moves_and_a_free_foot_slides_along_the_floor():
    stretches = (WHOLE, [[0.6, 1.3]], [[0.7, 1.2]], [[0.85, 1.05]])
    shapes = [moved(cell(clamped=one)) for one in stretches]
    largest = [np.abs(shape).max() for shape in shapes]
    assert largest == sorted(largest)
    assert largest[-1] > 1.3 * largest[0]
    feet = shapes[-1][[0, -1]]
    np.testing.assert_allclose(feet[:, 1], 0.0, atol=1e-15)
    assert (feet[:, 0] > 1e-3).all()
    np.testing.assert_allclose(shapes[0][[0, -1]], 0.0, atol=1e-15)


def test_a_partly_held_foot_in_flow_from_the_right_is_the_mirror_image():
    points = [[0.5, 0], [0.8, 0.35], [1.2, 0.35], [1.5, 0]]
    left = moved(cell(outline={"points": points}, clamped=[[0.6, 0.9]]))
    right = moved(cell(outline={"points": points}, clamped=[[1.1, 1.4]], channel={"inlet": "right"}))
    np.testing.assert_allclose(mirrored(right), left, atol=2e-2 * np.abs(left).max())


def test_sensitivities_with_a_partly_held_foot():
    assert max(sensitivity_errors(cell(clamped=[[0.7, 1.2]]), INPUTS).values()) < 1e-6


def test_stretches_count_in_the_fingerprint():
    assert len({model.fingerprint for model in (cell(), cell(clamped=WHOLE), cell(clamped=[[0.7, 1.2]]))}) == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"outline": {"points": [*TOUCHING, [1, 0.3], [1.3, 0]]}}, "two neighbouring points on the floor"),
        ({"outline": {"points": [*TOUCHING, [0.8, 0], [0.9, 0], [1.3, 0]]}}, r"got 1 point\(s\) from \(0.8, 0\) mm"),
        ({"clamped": 0.5}, "stretches \\[from, to\\] of the floor"),
        ({"clamped": [0.5, 0.9]}, "stretches"),
        ({"clamped": [[0.9, 0.6]]}, "from left to right"),
        ({"clamped": [[0.6, 0.9], [0.8, 1.0]]}, "from left to right"),
        ({"clamped": [[1.5, 1.9]]}, "got 1.5 to 1.9 mm.*stands from 0.54 to 1.391 mm"),
        ({**TWO, "clamped": [[0.8, 1.1]]}, "stands from 2.9 to 3.2 mm"),
        (
            {**TWO, "partition": {"lines": [], "markers": [[0.95, 0.1]]}},
            "expected 2",
        ),
    ],
)  # fmt: skip
def test_what_cannot_stand_is_refused_in_one_line(options, words):
    with pytest.raises(InvalidInput, match=words) as caught:
        cell(**options)
    assert "\n" not in str(caught.value)
