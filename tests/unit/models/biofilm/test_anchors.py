"""Runs that start from anchors: the states of cold runs, bits that repeat, and where anchors do not help."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc
from tests.unit.models.biofilm.cells import INPUTS, failure, rough

from strandline.errors import ForwardModelError
from strandline.models.biofilm import model as module
from strandline.models.biofilm.anchors import anchored_cell, on_disk
from strandline.models.biofilm.anchors.anchored_cell import LARGEST_STRAIN, AnchoredCell
from strandline.models.biofilm.anchors.box import Box
from strandline.models.biofilm.anchors.factors import Rescaled, RowsAndColumns
from strandline.models.biofilm.anchors.states import States
from strandline.models.biofilm.steady import DIRECT_STRAIN
from strandline.models.fidelities import WithCheaper
from strandline.models.offers import prepare_runs
from strandline.models.protocol import fingerprint
from strandline.runs import InProcess, Ledger, run_campaign

RANGES = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
TOLERANCE = 1e-7
"""mm"""


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        home = tmp_path_factory.mktemp("cache")
        patch.setenv("XDG_CACHE_HOME", str(home))
        module._anchored_cell.cache_clear()
        yield home / "strandline" / "anchors"
        module._anchored_cell.cache_clear()


@pytest.fixture(scope="module")
def cold():
    return rough()


@pytest.fixture(scope="module")
def anchored(cache):
    return rough(anchors=RANGES)


@pytest.fixture
def along_one_input(cache):
    """A model whose anchors are solved quickly, and are not solved yet."""
    for file in cache.glob("*.npz"):
        file.unlink()
    module._anchored_cell.cache_clear()
    return rough(anchors={"E": [400, 700], "nu": 0.3, "V_in": 100})


POINTS = [{"E": E, "nu": 0.3, "V_in": 100.0} for E in (420.0, 660.0, 690.0)]


def outcome(model, inputs):
    """Return the points of a run's interfaces and its figures, or how it failed."""
    try:
        result = model(inputs)
    except ForwardModelError as error:
        return error.kind, error.message, dict(error.evidence)
    return {name: one.points.tobytes() for name, one in result.interfaces.items()}, dict(result.diagnostics)


def in_box(number):
    points = qmc.scale(qmc.Sobol(2, scramble=False).random_base2(5)[:number], [100, -0.8], [800, 0.5])
    return [{"E": float(E), "nu": float(nu), "V_in": 100.0} for E, nu in points]


def test_they_end_like_cold_runs_and_most_need_no_jacobian(anchored, cold):
    kept, started = 0, 0
    outside = [INPUTS | {"E": 900.0}, INPUTS | {"V_in": 99.0}]
    for inputs in [*in_box(8), *outside]:
        ours, theirs = outcome(anchored, inputs), outcome(cold, inputs)
        assert len(ours) == len(theirs)
        assert anchored.is_prepared(inputs) == (len(ours) == 2 and ours[1]["anchored"] == 1.0)
        if len(ours) == 3:
            assert ours == theirs
            continue
        figures = ours[1]
        if figures["anchored"]:
            assert inputs not in outside
            assert figures["predicted_strain"] <= LARGEST_STRAIN
            started += 1
            kept += figures["newton_jacobians"] == 0
            points = [np.frombuffer(result[0][""]) for result in (ours, theirs)]
            np.testing.assert_allclose(*points, atol=TOLERANCE, rtol=0)
        else:
            assert ours[0] == theirs[0]
        if inputs in outside:
            assert figures == theirs[1] | {"anchored": 0.0}
    assert started > 4
    assert kept >= started - 2
    assert not cold.is_prepared(INPUTS)


SOLIDS = {"E1": 400.0, "E2": 320.0, "E3": 480.0, "nu1": 0.3, "nu2": 0.3, "nu3": 0.3, "V_in": 100.0}
DRIVEN = {"E": 500.0, "nu": 0.2, "exponent": 3.0, "p_drop": 1.1, "viscosity": 1.2e-3}
FUNG = {"material": "fung", "inflow": "pressure", "fluid": {"viscosity": "unknown"}}


@pytest.mark.parametrize(
    ("options", "inputs", "ranges"),
    [
        (FUNG, DRIVEN, {"p_drop": [0.5, 1.5]}),
        ({"inflow_rates": {"rest": 0.0, "slow": 40.0, "fast": 80.0}}, {"E": 500.0, "nu": 0.2}, {"E": [300, 800]}),
        ({"partition": "three_parts"}, SOLIDS, {"E1": [300, 500]}),
    ],
)
def test_other_cells(options, inputs, ranges):
    ours, theirs = (rough(**options, **more)(inputs) for more in ({"anchors": inputs | ranges}, {}))
    assert ours.interfaces.keys() == theirs.interfaces.keys()
    for name, one in ours.interfaces.items():
        assert np.abs(one.points - theirs.interfaces[name].points).max() < TOLERANCE
    figures = ours.diagnostics
    for name in [name.removeprefix("anchored") for name in figures if name.startswith("anchored")]:
        assert figures[f"anchored{name}"] == (name != "_rest")
        assert figures[f"newton_jacobians{name}"] == (name == "_rest")


def test_sensitivities_and_the_flow_field_are_those_of_cold_runs(anchored, cold):
    ours, theirs = (replace(model, sensitivities=True)(INPUTS) for model in (anchored, cold))
    assert ours.diagnostics["newton_jacobians"] == 0
    for name, exact in theirs.sensitivities[""].items():
        assert np.abs(ours.sensitivities[""][name] - exact).max() < 1e-6 * np.abs(exact).max()
    speeds = [model.fields(INPUTS).velocity for model in (anchored, cold)]
    np.testing.assert_allclose(*speeds, atol=1e-6 * np.abs(speeds[1]).max())


def test_where_newton_does_not_converge_from_the_prediction_the_run_is_cold(anchored, cold, monkeypatch):
    inputs = {"E": 420.0, "nu": 0.25, "V_in": 100.0}
    far = States.guess
    monkeypatch.setattr(States, "guess", lambda self, at: 40.0 * far(self, at))
    found = outcome(anchored, inputs)
    assert found[0] == outcome(cold, inputs)[0]
    assert found[1]["anchored"] == 0.0
    assert found[1]["predicted_strain"] < LARGEST_STRAIN


def test_anchors_are_met_between_them_the_strain_is_predicted_and_few_factors_are_kept(anchored):
    """The branch of a run is decided by it: see `LARGEST_STRAIN`. Where it bends far nothing is solved."""
    _, whole = anchored._cell()
    states = whole.states
    for at, exact in zip(states.anchors[:3], states.unknowns, strict=False):
        np.testing.assert_allclose(states.guess(at), exact, atol=1e-8 * np.abs(exact).max())
    np.testing.assert_allclose([states.strain(at) for at in states.coordinates], states.strains, rtol=1e-6)
    assert states.strains[states.solved].max() <= DIRECT_STRAIN < states.strains.max()
    for inputs in in_box(16):
        exact, found = whole._first_order_strain(inputs), states.strain(whole.box.coordinates(inputs))
        if 0.1 < exact < 0.25:
            assert abs(found / exact - 1.0) < 0.1
    assert len(set(whole._kept)) == anchored_cell.MOST_FACTORS
    kept = whole.states.anchors[whole._kept]
    assert min(np.delete(whole.box.distances(kept, one), k).min() for k, one in enumerate(kept)) > 0.1


@pytest.mark.parametrize(("soft", "stiff"), [(300.0, 600.0), (600.0, 300.0)])
def test_rescaled_it_corrects_the_displacement_of_another_stiffness(cold, soft, stiff):
    """Without the rescaling, or with its inverse, the correction is far off."""
    cell, _ = cold._cell()
    found = cell.solve([stiff], [0.3], 100.0).unknowns
    beside = cell.solve([1.05 * stiff], [0.31], 100.0).unknowns
    load = cell.set([soft], [0.3], 100.0)
    anchor = cell.factorise(found, load, own_analysis=True)
    cell.set([stiff], [0.3], 100.0)
    exact = cell.factorise(found, load, own_analysis=True).solve(cell.residual(beside, load))
    displacement, powers = cell.system.block(2), RowsAndColumns.of(cell.system)

    for ratio, low, high in ((stiff / soft, 0.0, 0.05), (1.0, 0.3, np.inf), (soft / stiff, 0.5, np.inf)):
        found = Rescaled(anchor, powers, ratio).solve(cell.residual(beside, load))
        error = np.linalg.norm((found - exact)[displacement]) / np.linalg.norm(exact[displacement])
        assert low < error < high


def test_without_steady_states_all_runs_are_cold(cold):
    box = Box((("E", 20.0, 30.0), ("nu", 0.3, 0.3), ("V_in", 100.0, 100.0)))
    cell, _ = cold._cell()
    found = AnchoredCell(cell, box, cold._setting)
    assert not found.states.solved.any()
    assert not found.states.suffice
    failure(found.solve, {"E": 25.0, "nu": 0.3, "V_in": 100.0}, 3)


def test_coordinates_and_inputs_of_a_box_are_inverse():
    """The middle of a wide range is the geometric mean."""
    box = Box((("E", 100.0, 800.0), ("nu", -0.8, 0.5), ("V_in", 100.0, 100.0), ("viscosity", 9e-4, 11e-4)))
    assert [axis.name for axis in box.axes] == ["E", "nu", "viscosity"]
    points = list(box.points())
    assert len(points) == len(set(points)) == 8 + 36
    for point in points:
        inputs = box.inputs(point)
        assert box.holds(inputs)
        np.testing.assert_allclose(box.coordinates(inputs), point, atol=1e-12)
    assert Box((("E", 100.0, 900.0),)).inputs((0.5,)) == {"E": pytest.approx(300.0)}
    assert Box((("V_in", 90.0, 110.0),)).inputs((0.5,)) == {"V_in": pytest.approx(100.0)}


def test_a_result_depends_on_its_inputs_alone_and_a_cache_may_be_broken_or_not_written(
    along_one_input, cache, tmp_path, monkeypatch
):
    first = [outcome(along_one_input, inputs) for inputs in POINTS]
    (file,) = cache.glob("*.npz")
    module._anchored_cell.cache_clear()  # from disk now, and in another order
    assert [outcome(along_one_input, inputs) for inputs in reversed(POINTS)][::-1] == first
    file.write_bytes(b"x" * 99)
    module._anchored_cell.cache_clear()  # solved again
    assert outcome(along_one_input, POINTS[1]) == first[1]
    assert file.stat().st_size > 99
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    module._anchored_cell.cache_clear()
    assert outcome(along_one_input, POINTS[1]) == first[1]


def test_the_campaign_solves_them_before_its_first_run(along_one_input, cache, tmp_path, monkeypatch):
    pair, told = WithCheaper(rough(material="neo_hookean"), along_one_input, 0.3), []
    prepare_runs(pair, told.append)
    assert told == ["anchors"]
    assert not pair.is_prepared(POINTS[0])
    assert len(list(cache.glob("*.npz"))) == 1
    monkeypatch.setattr(States, "solve", None)  # a second time would fail
    module._anchored_cell.cache_clear()
    with Ledger.open(tmp_path / "ledger.sqlite", model=fingerprint(along_one_input), description="a test") as ledger:
        records = run_campaign(along_one_input, POINTS, ledger=ledger, executor=InProcess())
    assert [record.state for record in records] == ["ok"] * len(POINTS)


END = 22
"""Bytes of a zip archive's last record: without it there is no archive, whatever follows."""
STATES = States(np.eye(3), np.arange(1.0, 4.0), np.array([True, True, False]), np.ones((2, 5)))


@settings(max_examples=25)
@given(whole=st.floats(0.0, 1.0, exclude_max=True), rest=st.binary(max_size=40))
def test_a_file_that_is_cut_or_goes_on_as_something_else_is_not_read(tmp_path_factory, whole, rest):
    path = tmp_path_factory.mktemp("anchors") / "whole.npz"
    on_disk.save(STATES, path)
    content = path.read_bytes()
    path.write_bytes(content[: int(whole * (len(content) - END))] + rest)
    assert on_disk.load(path) is None


def test_a_file_with_other_arrays_or_of_another_box_is_not_read(tmp_path):
    path = tmp_path / "whole.npz"
    on_disk.save(STATES, path)
    np.testing.assert_array_equal(on_disk.load(path).unknowns, STATES.unknowns)
    with np.load(path) as arrays:
        held = dict(arrays)
    held["unknowns"][0, 0] = np.nextafter(1.0, 2.0)
    for changed in ({"states": np.ones(3)}, held):
        np.savez(tmp_path / "changed.npz", **changed)
        (tmp_path / "changed.npz").replace(path)
        assert on_disk.load(path) is None
    on_disk.save(STATES, path)
    path.rename(tmp_path / "another.npz")
    assert on_disk.load(tmp_path / "another.npz") is None
