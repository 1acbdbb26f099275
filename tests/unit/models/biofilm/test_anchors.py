"""Runs that start from anchors: the states of cold runs, bits that repeat, and where anchors do not help."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc
from tests.unit.models.biofilm.cells import INPUTS, rough

from strandline.foundations import ForwardModelError
from strandline.models.biofilm import model as module
from strandline.models.biofilm.cells.anchors import LARGEST_STRAIN, States, load_anchors, save_anchors
from strandline.models.biofilm.cells.steady import DIRECT_STRAIN
from strandline.models.protocol import prepare_runs

RANGES = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
TOLERANCE = 1e-7  # mm


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
    jacobians = []
    for inputs in in_box(8):
        ours, theirs = outcome(anchored, inputs), outcome(cold, inputs)
        starts = len(ours) == 2 and ours[1]["anchored"] == 1.0
        assert anchored.is_prepared(inputs) == starts
        if not starts:
            assert ours[0] == theirs[0]
            continue
        assert ours[1]["predicted_strain"] <= LARGEST_STRAIN
        jacobians.append(ours[1]["newton_jacobians"])
        points = [np.frombuffer(result[0][""]) for result in (ours, theirs)]
        np.testing.assert_allclose(*points, atol=TOLERANCE, rtol=0)
    assert len(jacobians) > 4
    assert jacobians.count(0) >= len(jacobians) - 2
    for outside in (INPUTS | {"E": 900.0}, INPUTS | {"V_in": 99.0}):
        points, figures = outcome(cold, outside)
        assert outcome(anchored, outside) == (points, figures | {"anchored": 0.0})


DRIVEN = {"E": 500.0, "nu": 0.2, "exponent": 3.0, "p_drop": 1.1, "viscosity": 1.2e-3}
FUNG = {"material": "fung", "inflow": "pressure", "fluid": {"viscosity": "unknown"}}


@pytest.mark.parametrize(
    ("options", "inputs", "ranges"),
    [
        (FUNG, DRIVEN, {"p_drop": [0.5, 1.5]}),
        ({"inflow_rates": {"rest": 0.0, "fast": 80.0}}, {"E": 500.0, "nu": 0.2}, {"E": [300, 800]}),
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


def test_anchors_are_met_and_between_them_the_strain_is_predicted(anchored):
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


def test_a_result_depends_on_its_inputs_alone_and_a_cache_may_be_broken_or_not_written(cache, tmp_path, monkeypatch):
    before, told, model = set(cache.glob("*.npz")), [], rough(anchors={"E": [400, 700], "nu": 0.3, "V_in": 100})
    points = [INPUTS | {"E": E} for E in (420.0, 660.0, 690.0)]
    prepare_runs(model, told.append)
    assert told == ["anchors"]
    (file,) = set(cache.glob("*.npz")) - before
    first = [outcome(model, inputs) for inputs in points]
    module._anchored_cell.cache_clear()  # from disk now, and in another order
    assert [outcome(model, inputs) for inputs in reversed(points)][::-1] == first
    file.write_bytes(b"x" * 99)
    module._anchored_cell.cache_clear()  # solved again
    assert outcome(model, points[1]) == first[1]
    assert file.stat().st_size > 99
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    module._anchored_cell.cache_clear()
    assert outcome(model, points[1]) == first[1]


def test_a_file_that_is_damaged_or_has_other_arrays_is_not_read(tmp_path):
    path, other = tmp_path / "whole.npz", tmp_path / "another.npz"
    states = States(np.eye(3), np.arange(1.0, 4.0), np.array([True, True, False]), np.ones((2, 5)))
    save_anchors(states, path)
    np.testing.assert_array_equal(load_anchors(path).unknowns, states.unknowns)
    content = path.read_bytes()
    for kept in (0, 100, len(content) // 2, len(content) - 22):  # the last record has 22 bytes
        other.write_bytes(content[:kept] + b"x" * 30)
        assert load_anchors(other) is None
    number = np.ones(5).tobytes()
    other.write_bytes(content.replace(number, np.full(5, np.nextafter(1.0, 2.0)).tobytes(), 1))
    assert content.count(number) > 0
    assert load_anchors(other) is None
    np.savez(path, states=np.ones(3))
    assert load_anchors(path) is None


def test_where_newton_does_not_converge_from_the_prediction_the_run_is_cold(anchored, cold, monkeypatch):
    inputs = {"E": 420.0, "nu": 0.25, "V_in": 100.0}
    far = States.guess
    monkeypatch.setattr(States, "guess", lambda self, at: 40.0 * far(self, at))
    found = outcome(anchored, inputs)
    assert found[0] == outcome(cold, inputs)[0]
    assert found[1]["anchored"] == 0.0
    assert found[1]["predicted_strain"] < LARGEST_STRAIN
