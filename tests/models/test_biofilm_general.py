"""Geometry, materials, parts, several inflow rates and sensitivities of the biofilm model."""

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.biofilm.channel import Channel, check_outline
from strandline.models.biofilm.geometry import subdivide
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition, Subdivision

ONE = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
THREE = {"E1": 500.0, "nu1": 0.2, "E2": 200.0, "nu2": 0.1, "E3": 1000.0, "nu3": 0.3, "V_in": 100.0}
BUMP = ((0.5, 0.0), (0.8, 0.35), (1.1, 0.35), (1.4, 0.0))


def moved(model: Biofilm, inputs: dict[str, float]) -> np.ndarray:
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


def test_defaults_keep_their_fingerprint():
    assert Biofilm().fingerprint == "biofilm:r2:mesh=default"
    assert Biofilm(sensitivities=True).fingerprint == Biofilm().fingerprint
    others = [
        Biofilm(material="neo_hookean"),
        Biofilm.from_options(partition="three_parts"),
        Biofilm.from_options(channel={"length": 2.5}),
    ]
    assert len({model.fingerprint for model in [Biofilm(), *others]}) == 4


def test_parts_of_equal_material_are_one_body():
    parts = Biofilm.from_options(mesh="coarse", partition="three_parts")
    equal = {f"{name}{k}": ONE[name] for k in (1, 2, 3) for name in ("E", "nu")} | {"V_in": 100.0}
    difference = moved(parts, equal) - moved(Biofilm(mesh="coarse"), ONE)
    assert np.abs(difference).max() < 3e-4  # two coarse meshes, each 0.15 µm from the truth


def test_heterogeneous_specimen_of_the_study():
    reference, partition = Outline().interface(), Partition.PRESETS["three_parts"]
    figure, parts = subdivide(reference, Channel(), partition)
    areas = [figure.area(name) for name in parts]
    assert parts == ["solid1", "solid2", "solid3"]
    assert np.argmax(areas) == 1
    np.testing.assert_allclose(sum(areas) + figure.area("fluid"), 2.0)
    model = Biofilm.from_options(mesh="coarse", partition="three_parts")
    assert [item.name for item in model.inputs] == list(THREE)
    assert 0.03 < np.abs(moved(model, THREE)).max() < 0.06


def test_a_softer_largest_part_bends_more():
    model = Biofilm.from_options(mesh="coarse", partition="three_parts")
    largest = [np.abs(moved(model, THREE | {name: 0.8 * THREE[name]})).max() for name in ("E1", "E2", "E3")]
    base = np.abs(moved(model, THREE)).max()
    assert min(largest) > base
    assert np.argmax(largest) == 1


def test_both_laws_agree_for_small_strain_and_differ_for_large():
    svk, neo = (Biofilm(mesh="coarse", material=name) for name in ("saint_venant_kirchhoff", "neo_hookean"))
    stiff = ONE | {"E": 1e6}
    np.testing.assert_allclose(moved(svk, stiff), moved(neo, stiff), atol=1e-8)
    assert np.abs(moved(svk, ONE) - moved(neo, ONE)).max() > 5e-4


def test_neo_hookean_goes_where_saint_venant_kirchhoff_collapses():
    soft = ONE | {"E": 150.0}
    assert np.abs(moved(Biofilm(mesh="coarse", material="neo_hookean"), soft)).max() > 0.1


@pytest.mark.parametrize("nu", [-0.99, 0.0, 0.5])
def test_neo_hookean_takes_every_poisson_ratio(nu):
    assert np.abs(moved(Biofilm(mesh="coarse", material="neo_hookean"), ONE | {"nu": nu})).max() > 1e-4


def test_flow_from_the_right_over_the_mirrored_outline_is_the_mirror_image():
    mirrored = tuple((2.0 - x, y) for x, y in reversed(BUMP))
    left = Biofilm(mesh="coarse", outline=Outline(BUMP))
    right = Biofilm(mesh="coarse", outline=Outline(mirrored), channel=Channel(inlet="right"))
    image = moved(right, ONE)[::-1] * [-1, 1]
    np.testing.assert_allclose(image, moved(left, ONE), atol=3e-4)  # the meshes are no mirror images
    assert moved(left, ONE)[:, 0].mean() > 0


def test_layer_on_the_floor_is_dragged_along():
    x = np.linspace(0.0, 2.0, 60)
    layer = Outline.of(Interface.polyline(np.stack([x, 0.2 + 0.04 * np.sin(6 * x)], axis=1)), nodes=None)
    for inlet, sign in (("left", 1), ("right", -1)):
        model = Biofilm(mesh="coarse", outline=layer, channel=Channel(inlet=inlet, outlet="traction_free"))
        shift = moved(model, {"E": 50.0, "nu": 0.4, "V_in": 100.0})
        assert sign * shift[:, 0].mean() > 1e-3
        np.testing.assert_allclose(shift[[0, -1]], 0.0)


def test_larger_channel_less_load():
    high = Biofilm.from_options(mesh="coarse", channel={"height": 1.5, "length": 3.0})
    assert np.abs(moved(high, ONE)).max() < 0.5 * np.abs(moved(Biofilm(mesh="coarse"), ONE)).max()


def test_several_inflow_rates_are_the_single_runs():
    both = Biofilm.from_options(mesh="coarse", inflow_rates={"slow": 50, "fast": 100})
    assert both.conditions == ("slow", "fast")
    assert [item.name for item in both.inputs] == ["E", "nu"]
    result = both({"E": 400.0, "nu": 0.3})
    for name, rate in both.inflow_rates:
        single = Biofilm(mesh="coarse")(ONE | {"V_in": rate}).interface
        np.testing.assert_array_equal(result.interfaces[name].points, single.points)


@pytest.mark.parametrize(
    ("options", "inputs"),
    [
        ({}, ONE),
        ({"material": "neo_hookean"}, ONE | {"nu": 0.499}),
        pytest.param({"partition": "three_parts"}, THREE, marks=pytest.mark.long),
        ({"channel": {"inlet": "right"}}, ONE | {"nu": -0.4}),
    ],
)
def test_sensitivities_agree_with_central_differences(options, inputs):
    model = Biofilm.from_options(mesh="coarse", sensitivities=True, **options)
    exact = model(inputs).sensitivities[""]
    assert set(exact) == set(inputs)
    for name, value in inputs.items():
        h = 1e-3 * max(abs(value), 0.1)
        slopes = []
        for step in (h, h / 2):
            shapes = [model(inputs | {name: value + sign * step}).interface.points for sign in (1, -1)]
            slopes.append((shapes[0] - shapes[1]) / (2 * step))
        extrapolated = (4 * slopes[1] - slopes[0]) / 3
        np.testing.assert_allclose(exact[name], extrapolated, atol=1e-6 * np.abs(extrapolated).max())


def test_sensitivities_at_several_rates_belong_to_them():
    model = Biofilm.from_options(mesh="coarse", inflow_rates={"slow": 50, "fast": 100}, sensitivities=True)
    slopes = model({"E": 400.0, "nu": 0.3}).sensitivities
    assert {name: set(by_input) for name, by_input in slopes.items()} == {"slow": {"E", "nu"}, "fast": {"E", "nu"}}
    single = Biofilm(mesh="coarse", sensitivities=True)(ONE).sensitivities[""]
    np.testing.assert_array_equal(slopes["fast"]["E"], single["E"])


@pytest.mark.parametrize(
    ("points", "place"),
    [
        (((0.5, 0.1), (1.0, 0.5), (1.5, 0.0)), "(0.5, 0.1)"),
        (((0.5, 0.0), (1.0, 1.2), (1.5, 0.0)), "(1, 1.2)"),
        (((0.5, 0.0), (1.2, 0.5), (1.2, 0.2), (0.7, 0.4), (1.5, 0.0)), "(0.930769, 0.307692)"),
        (((1.5, 0.0), (1.0, 0.5), (0.5, 0.0)), "(1.5, 0)"),
        (((0.5, 0.0), (1.0, -0.1), (1.5, 0.0)), "(1, -0.1)"),
        (((0.5, 0.0), (1.0, 0.5), (2.0, 0.0)), "(2, 0)"),
    ],
)
def test_degenerate_outlines_are_refused_with_the_place(points, place):
    with pytest.raises(InvalidInput) as caught:
        Biofilm(outline=Outline(points, spline=False, nodes=None))
    assert place in str(caught.value)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"material": "ogden"}, "neo_hookean"),
        ({"channel": {"len": 2}}, "length"),
        ({"channel": {"inlet": "top"}}, "left, right"),
        ({"channel": {"height": -1}}, "above 0"),
        ({"channel": {"height": "1.5 mm"}}, "height of the channel: got 1.5 mm"),
        ({"channel": {"heigth": 1.5}}, "Did you mean height"),
        ({"outline": {"points": [[0.9, 0], [1, 0.5], [1.5, 0.05], [1.9, 0]]}}, "spline may overshoot"),
        ({"outline": {"points": [[0.9, 0], [1, 1.0], [1.9, 0]], "spline": False, "nodes": 4}}, r"\(1, 1\) mm"),
        ({"outline": "hill.csv"}, "also file with its unit"),
        ({"partition": {"lines": [[0.4, 0.1], [1.5, 0.1]], "markers": [[0.9, 0.3]]}}, "pairs of points in mm"),
        ({"partition": {"lines": [], "markers": [0.9, 0.3]}}, "markers of the partition"),
        ({"partition": "three_parts", "outline": {"points": [[0.2, 0], [0.4, 0.5], [0.7, 0]]}}, "the study's outline"),
        ({"outline": {"points": [[0.5, 0], [1, 0.5]]}}, "three pairs"),
        ({"outline": {"nodes": 2}}, "at least 4"),
        ({"partition": "four"}, "lines, markers"),
        ({"partition": {"lines": [[[0.4, 0.1], [1.5, 0.1]]], "markers": [[0.9, 0.3]]}}, "one in each part"),
        ({"partition": {"lines": [[[0.4, 0.1], [1.5, 0.1]]], "markers": [[0.9, 0.3], [0.9, 0.31]]}}, "of its own"),
        ({"inflow_rates": {"fast": -1}}, "with its inflow rate in mm"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options, word):
    with pytest.raises(InvalidInput, match=word):
        Biofilm.from_options(**options)


def test_cut_shares_its_new_vertices_with_the_neighbours():
    figure = Subdivision(
        [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0), (2.0, 2.0), (0.0, 2.0)], {"a": [0, 1, 2, 3], "b": [3, 2, 4, 5]}
    )
    pieces = figure.cut(["a"], ((1.0, -1.0), (1.0, 1.5)))
    assert len(pieces) == 2
    assert sorted(figure.area(name) for name in pieces) == [1.0, 1.0]
    assert len(figure.rings["b"]) == 5
    shared = [e for e in figure.edges() if e.right is not None]
    assert len(shared) == 3


def test_line_that_does_not_cross_a_part_leaves_it_whole():
    figure = Subdivision([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)], {"a": [0, 1, 2, 3]})
    assert figure.cut(["a"], ((1.0, 0.5), (1.0, 2.0))) == ["a"]


def test_study_outline_fits_the_channel():
    check_outline(Outline().interface(), Channel())
