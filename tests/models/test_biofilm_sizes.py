"""Element sizes: the study's meshes stay as they are, narrow gaps and sharp bends get smaller elements."""

import dataclasses
import itertools
from typing import Any

import ngsolve as ng
import numpy as np
import pytest

from strandline.models.biofilm import geometry
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import mesh_flow_cell
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.sizes import FINER, MESHES, gap_sizes, is_adapted, segment_sizes
from strandline.models.biofilm.subdivision import Partition

STUDY = Outline().interface()
CHANNEL = Channel()
LAYER = Outline(((0.0, 0.3), (0.8, 0.35), (1.5, 0.6), (2.2, 0.35), (3.0, 0.3)))
LONG = Channel(length=3.0)
CORNERED = Outline(((0.6, 0.0), (0.7, 0.3), (1.0, 0.4), (1.3, 0.0)), spline=False, nodes=None)
SOFT = {"E": 150.0, "nu": 0.3, "V_in": 60.0}


def arrays(mesh: Any) -> bytes:
    points = np.array([vertex.point for vertex in mesh.vertices])
    corners = np.array([[vertex.nr for vertex in element.vertices] for element in mesh.Elements(ng.VOL)])
    return points.tobytes() + corners.tobytes()


@pytest.mark.parametrize("partition", [Partition(), Partition.PRESETS["three_parts"]], ids=["whole", "three parts"])
@pytest.mark.parametrize("name", MESHES)
def test_the_meshes_of_the_study_are_those_of_fixed_sizes(
    name: str, partition: Partition, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit: `posterior.nc` of the published studies depends on it."""
    size = MESHES[name]
    found = arrays(mesh_flow_cell(STUDY, size, CHANNEL, partition))
    fixed = np.full(65, size.interface)
    fixed[[0, -1]] = size.foot
    monkeypatch.setattr(geometry, "segment_sizes", lambda interface, size: fixed)
    monkeypatch.setattr(geometry, "gap_sizes", lambda interface, size, channel: np.empty((0, 3)))
    assert arrays(mesh_flow_cell(STUDY, size, CHANNEL, partition)) == found
    assert not is_adapted(STUDY, size, CHANNEL)


@pytest.mark.parametrize("name", MESHES)
def test_a_narrow_gap_has_elements_across(name: str) -> None:
    """As many as half a millimetre would have without the rule, and four at least."""
    slit = Outline(((0.0, 0.8), (1.0, 0.8), (2.0, 0.8)), spline=False).interface()
    mesh = mesh_flow_cell(slit, MESHES[name], CHANNEL)
    top = sorted({mesh.vertices[v.nr].point[0] for e in mesh.Elements(ng.BND) if e.mat == "top" for v in e.vertices})
    assert np.diff(top).max() <= 1.2 * 0.2 * min(0.25, MESHES[name].far / 0.5)
    wide = Outline(((0.5, 0.0), (1.0, 0.49), (1.5, 0.0)), spline=False).interface()
    assert len(gap_sizes(wide, MESHES[name], CHANNEL)) == 0


def test_a_gap_narrows_elements_nowhere_else() -> None:
    bump = Outline(((0.5, 0.0), (0.7, 0.6), (1.0, 0.8), (1.3, 0.6), (1.5, 0.0))).interface()
    places = gap_sizes(bump, MESHES["coarse"], Channel(length=8.0))
    assert 0.48 < places[:, 0].min() < places[:, 0].max() < 1.52
    long, short = (mesh_flow_cell(bump, MESHES["coarse"], Channel(length=x)).ne for x in (8.0, 2.0))
    assert long - short < 6.0 / (0.43 * 0.18**2)


def test_sharp_bends_have_several_elements_a_segment() -> None:
    outline = CORNERED.interface()
    mesh = mesh_flow_cell(outline, MESHES["coarse"], CHANNEL)
    vertices = np.array([v.point for v in mesh.vertices])
    start, end = outline.points[1:3]
    along = (vertices - start) @ (end - start) / np.sum((end - start) ** 2)
    (dx, dy), (x, y) = end - start, (vertices - start).T
    on = (np.abs(dx * y - dy * x) < 1e-9) & (along > -1e-9) & (along < 1 + 1e-9)
    assert on.sum() >= 5
    smooth = segment_sizes(LAYER.interface(), MESHES["coarse"])
    np.testing.assert_array_equal(smooth[1:-1], MESHES["coarse"].interface)


def test_the_fingerprint_tells_where_the_rule_acts() -> None:
    assert Biofilm().fingerprint == "biofilm:r2:mesh=default"
    other = Biofilm(outline=Outline(((0.5, 0.0), (0.8, 0.12), (1.0, 0.14), (1.5, 0.0))))
    layer = Biofilm(channel=LONG, outline=LAYER)
    rule = "strandline.models.biofilm.model._is_adapted"
    for model, acts in ((other, False), (layer, True)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rule, lambda *_: False)
            without = model.fingerprint
        assert (model.fingerprint != without) == acts


def test_the_next_finer_mesh_is_finer() -> None:
    sizes = [*MESHES.values(), FINER["fine"]]
    assert [FINER[name] for name in MESHES] == sizes[1:]
    for large, small in itertools.pairwise(sizes):
        assert all(getattr(small, f.name) < getattr(large, f.name) for f in dataclasses.fields(small))


@pytest.mark.parametrize("rates", [pytest.param((), marks=pytest.mark.long), (("slow", 20.0), ("fast", 60.0))])
def test_the_error_of_coarse_on_another_flow_cell_is_small_and_known(rates: tuple[tuple[str, float], ...]) -> None:
    """A layer with a gap of 0.4 mm: with elements of fixed size 2.5 µm off, and without a word."""
    model = Biofilm(mesh="coarse", material="neo_hookean", channel=LONG, outline=LAYER, inflow_rates=rates)
    coarse, finer = model(SOFT).interfaces, model.on_finer_mesh(SOFT)
    true = dataclasses.replace(model, mesh="default")(SOFT).interfaces
    assert coarse.keys() == finer.keys() == true.keys()
    for name in coarse:
        np.testing.assert_array_equal(finer[name].points, true[name].points)
        assert 0 < np.linalg.norm(coarse[name].points - true[name].points, axis=1).max() < 0.5e-3
