"""Runs that start from anchors: the states of cold runs, bits that repeat, and where anchors do not help."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm import model as module
from strandline.models.biofilm.anchors import anchored_cell
from strandline.models.biofilm.anchors.anchored_cell import LARGEST_STRAIN, AnchoredCell
from strandline.models.biofilm.anchors.box import Box
from strandline.models.biofilm.anchors.factors import Rescaled, RowsAndColumns
from strandline.models.biofilm.anchors.states import States
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.steady import DIRECT_STRAIN
from strandline.models.biofilm.subdivision import Partition
from strandline.models.fidelities import WithCheaper
from strandline.models.offers import prepare_runs
from strandline.models.protocol import fingerprint
from strandline.runs import InProcess, Ledger, run_campaign

RANGES = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
TOLERANCE = 1e-7
"""mm"""


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of anchors for this module alone."""
    with pytest.MonkeyPatch.context() as patch:
        home = tmp_path_factory.mktemp("cache")
        patch.setenv("XDG_CACHE_HOME", str(home))
        module._anchored_cell.cache_clear()
        yield home / "strandline" / "anchors"
        module._anchored_cell.cache_clear()


@pytest.fixture(scope="module")
def cold() -> Biofilm:
    return Biofilm(mesh="coarse")


@pytest.fixture(scope="module")
def anchored(cache: Path) -> Biofilm:
    return Biofilm.from_options(mesh="coarse", anchors=RANGES)


@pytest.fixture(scope="module")
def small(cache: Path) -> Biofilm:
    """A model whose anchors are solved quickly."""
    return Biofilm.from_options(mesh="coarse", anchors={"E": [400, 700], "nu": 0.3, "V_in": 100})


SMALL = [{"E": E, "nu": 0.3, "V_in": 100.0} for E in (420.0, 500.0, 660.0, 690.0)]


def outcome(model: Biofilm, inputs: Mapping[str, float]) -> Any:
    """Return the points of a run's interfaces and its figures, or how it failed."""
    try:
        result = model(inputs)
    except ForwardModelError as error:
        return error.kind, error.message, dict(error.evidence)
    return {name: one.points.tobytes() for name, one in result.interfaces.items()}, dict(result.diagnostics)


def in_box(number: int) -> list[dict[str, float]]:
    points = qmc.scale(qmc.Sobol(2, scramble=False).random(number), [100, -0.8], [800, 0.5])
    return [{"E": float(E), "nu": float(nu), "V_in": 100.0} for E, nu in points]


def largest_difference(a: Biofilm, b: Biofilm, inputs: Mapping[str, float]) -> float:
    first, second = a(inputs).interfaces, b(inputs).interfaces
    assert first.keys() == second.keys()
    return max(float(np.abs(first[name].points - second[name].points).max()) for name in first)


class TestAgainstColdRuns:
    def test_they_end_like_cold_runs_and_most_need_no_jacobian(self, anchored: Biofilm, cold: Biofilm) -> None:
        kept = 0
        for inputs in in_box(32):
            ours, theirs = outcome(anchored, inputs), outcome(cold, inputs)
            assert len(ours) == len(theirs)
            if len(ours) == 3:
                assert ours == theirs
                continue
            figures = ours[1]
            if figures["anchored"]:
                assert figures["predicted_strain"] <= LARGEST_STRAIN
                kept += figures["newton_jacobians"] == 0
                points = [np.frombuffer(result[0][""]) for result in (ours, theirs)]
                np.testing.assert_allclose(*points, atol=TOLERANCE, rtol=0)
            else:
                assert ours[0] == theirs[0]
        assert kept >= 26

    @pytest.mark.parametrize(
        ("options", "ranges", "inputs"),
        [
            ({"material": "neo_hookean"}, {}, {"E": 450.0, "nu": 0.4, "V_in": 100.0}),
            (
                {"inflow": "pressure", "fluid": {"viscosity": "unknown"}},
                {"V_in": None, "p_drop": [0.5, 1.5], "viscosity": [0.9e-3, 1.1e-3]},
                {"E": 500.0, "nu": 0.2, "p_drop": 1.1, "viscosity": 1.02e-3},
            ),
            (
                {"inflow_rates": {"rest": 0.0, "slow": 40.0, "fast": 80.0}},
                {"V_in": None, "E": [300, 800], "nu": [0.0, 0.4]},
                {"E": 500.0, "nu": 0.2},
            ),
            (
                {"partition": "three_parts"},
                {
                    "E": None,
                    "nu": None,
                    **{f"E{k}": [300, 500] for k in (1, 2, 3)},
                    **{f"nu{k}": 0.3 for k in (1, 2, 3)},
                },
                {"E1": 400.0, "E2": 320.0, "E3": 480.0, "nu1": 0.3, "nu2": 0.3, "nu3": 0.3, "V_in": 100.0},
            ),
        ],
        ids=["law", "pressure and viscosity", "two inflow rates", "three parts"],
    )
    def test_other_cells(self, options: dict[str, Any], ranges: dict[str, Any], inputs: dict[str, float]) -> None:
        box = {name: entry for name, entry in (RANGES | ranges).items() if entry is not None}
        ours = Biofilm.from_options(mesh="coarse", anchors=box, **options)
        theirs = Biofilm.from_options(mesh="coarse", **options)
        assert largest_difference(ours, theirs, inputs) < TOLERANCE
        figures = ours(inputs).diagnostics
        names = [name.removeprefix("anchored") for name in figures if name.startswith("anchored")]
        for name in names:
            assert figures[f"anchored{name}"] == (name != "_rest")
            assert figures[f"newton_jacobians{name}"] == (name == "_rest")

    def test_sensitivities_are_those_of_cold_runs(self) -> None:
        inputs = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
        ours = Biofilm.from_options(mesh="coarse", anchors=RANGES, sensitivities=True)(inputs)
        theirs = Biofilm(mesh="coarse", sensitivities=True)(inputs)
        assert ours.diagnostics["newton_jacobians"] == 0
        for name, exact in theirs.sensitivities[""].items():
            found = ours.sensitivities[""][name]
            assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()

    def test_the_flow_field_is_that_of_a_cold_run(self, anchored: Biofilm, cold: Biofilm) -> None:
        inputs = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
        ours, theirs = (model.fields(inputs) for model in (anchored, cold))
        np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=1e-6 * np.abs(theirs.velocity).max())

    def test_outside_the_box_runs_are_cold(self, anchored: Biofilm, cold: Biofilm) -> None:
        for inputs in ({"E": 900.0, "nu": 0.3, "V_in": 100.0}, {"E": 400.0, "nu": 0.3, "V_in": 99.0}):
            ours, theirs = outcome(anchored, inputs), outcome(cold, inputs)
            assert ours[0] == theirs[0]
            assert ours[1] == theirs[1] | {"anchored": 0.0}

    def test_where_newton_does_not_converge_from_the_prediction_the_run_is_cold(
        self, anchored: Biofilm, cold: Biofilm, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        inputs = {"E": 420.0, "nu": 0.25, "V_in": 100.0}
        expected = outcome(cold, inputs)
        far = States.guess
        monkeypatch.setattr(States, "guess", lambda self, at: 40.0 * far(self, at))
        found = outcome(anchored, inputs)
        assert found[0] == expected[0]
        assert found[1]["anchored"] == 0.0
        assert found[1]["predicted_strain"] < LARGEST_STRAIN


class TestBits:
    def test_a_result_depends_on_its_inputs_alone(self, small: Biofilm, cache: Path) -> None:
        points = SMALL
        first = [outcome(small, inputs) for inputs in points]
        assert len(list(cache.glob("*.npz"))) >= 1
        module._anchored_cell.cache_clear()  # from disk now, and in another order
        second = [outcome(small, inputs) for inputs in reversed(points)]
        assert second[::-1] == first
        for file in cache.glob("*.npz"):
            file.unlink()
        module._anchored_cell.cache_clear()  # solved again
        assert outcome(small, points[3]) == first[3]

    @pytest.mark.parametrize("damage", ["empty", "half", "garbage", "other arrays", "one bit", "of another box"])
    def test_a_damaged_file_is_made_again(self, small: Biofilm, cache: Path, damage: str) -> None:
        inputs = SMALL[2]
        whole = outcome(small, inputs)
        module._anchored_cell.cache_clear()
        for file in (known := set(cache.glob("*.npz"))):
            content = file.read_bytes()
            if damage == "other arrays":
                with file.open("wb") as opened:
                    np.savez(opened, states=np.ones(3))
            elif damage == "one bit":
                with np.load(file) as arrays:
                    held = dict(arrays)
                held["unknowns"][0, 0] = np.nextafter(held["unknowns"][0, 0], 1.0)
                with file.open("wb") as opened:
                    np.savez(opened, **held)
            elif damage == "of another box":
                other = Biofilm.from_options(mesh="coarse", anchors={"E": [450, 650], "nu": 0.3, "V_in": 100})
                other.prepare_runs()
                (fresh,) = set(cache.glob("*.npz")) - known
                fresh.replace(file)
                module._anchored_cell.cache_clear()
            else:
                file.write_bytes({"empty": b"", "half": content[: len(content) // 2], "garbage": b"x" * 99}[damage])
        assert outcome(small, inputs) == whole
        module._anchored_cell.cache_clear()
        assert outcome(small, inputs) == whole

    def test_a_cache_that_cannot_be_written_is_done_without(
        self, small: Biofilm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        inputs = SMALL[2]
        whole = outcome(small, inputs)
        (tmp_path / "file").touch()
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
        module._anchored_cell.cache_clear()
        assert outcome(small, inputs) == whole
        module._anchored_cell.cache_clear()

    def test_the_campaign_solves_them_before_its_first_run(
        self, small: Biofilm, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for file in cache.glob("*.npz"):
            file.unlink()
        module._anchored_cell.cache_clear()
        pair = WithCheaper(Biofilm(mesh="default"), small, 0.3)
        told: list[str] = []
        prepare_runs(pair, told.append)
        assert told == ["anchors"]
        assert not pair.is_prepared(SMALL[0])
        assert len(list(cache.glob("*.npz"))) == 1
        monkeypatch.setattr(States, "solve", None)  # a second time would fail
        module._anchored_cell.cache_clear()
        with Ledger.open(tmp_path / "ledger.sqlite", model=fingerprint(small), description="a test") as ledger:
            records = run_campaign(small, SMALL, ledger=ledger, executor=InProcess())
        assert [record.state for record in records].count("ok") == len(SMALL)

    def test_anchors_are_part_of_the_fingerprint(self, anchored: Biofilm, cold: Biofilm) -> None:
        other = Biofilm.from_options(mesh="coarse", anchors=RANGES | {"E": [100, 700]})
        assert len({fingerprint(model) for model in (anchored, cold, other)}) == 3


def test_which_runs_start_from_them(anchored: Biofilm, cold: Biofilm) -> None:
    points = [*in_box(32), {"E": 90.0, "nu": 0.3, "V_in": 100.0}]
    expected = []
    for inputs in points:
        result = outcome(anchored, inputs)
        expected.append(len(result) == 2 and result[1]["anchored"] == 1.0)
    assert [anchored.is_prepared(inputs) for inputs in points] == expected
    assert expected.count(True) > 20
    assert not any(cold.is_prepared(inputs) for inputs in points)


class TestFactors:
    @pytest.mark.parametrize(("soft", "stiff"), [(300.0, 600.0), (600.0, 300.0)])
    def test_rescaled_it_corrects_the_displacement_of_another_stiffness(
        self, cold: Biofilm, soft: float, stiff: float
    ) -> None:
        """Without the rescaling, or with its inverse, the correction is far off."""
        cell, _ = cold._cell()
        found = cell.solve([stiff], [0.3], 100.0).unknowns
        beside = cell.solve([1.05 * stiff], [0.31], 100.0).unknowns
        load = cell.set([soft], [0.3], 100.0)
        anchor = cell.factorise(found, load, own_analysis=True)
        cell.set([stiff], [0.3], 100.0)
        exact = cell.factorise(found, load, own_analysis=True).solve(cell.residual(beside, load))
        displacement, powers = cell.system.block(2), RowsAndColumns.of(cell.system)

        def error(ratio: float) -> float:
            found = Rescaled(anchor, powers, ratio).solve(cell.residual(beside, load))
            return float(np.linalg.norm((found - exact)[displacement]) / np.linalg.norm(exact[displacement]))

        assert error(stiff / soft) < 0.05
        assert error(1.0) > 0.3
        assert error(soft / stiff) > 0.5

    def test_few_are_kept_and_they_are_spread(self, anchored: Biofilm) -> None:
        _, whole = anchored._cell()
        assert whole is not None
        assert len(set(whole._kept)) == anchored_cell.MOST_FACTORS
        kept = whole.states.anchors[whole._kept]
        gaps = [np.delete(whole.box.distances(kept, one), k).min() for k, one in enumerate(kept)]
        assert min(gaps) > 0.1


class TestStates:
    def test_anchors_are_met(self, anchored: Biofilm) -> None:
        _, whole = anchored._cell()
        assert whole is not None
        states = whole.states
        for at, exact in zip(states.anchors[:3], states.unknowns, strict=False):
            np.testing.assert_allclose(states.guess(at), exact, atol=1e-8 * np.abs(exact).max())
        np.testing.assert_allclose([states.strain(at) for at in states.coordinates], states.strains, rtol=1e-6)

    def test_between_them_the_strain_is_predicted(self, anchored: Biofilm) -> None:
        """The branch of a run is decided by it: see `LARGEST_STRAIN`."""
        _, whole = anchored._cell()
        assert whole is not None
        for inputs in in_box(32):
            exact, found = whole._first_order_strain(inputs), whole.states.strain(whole.box.coordinates(inputs))
            if 0.1 < exact < 0.25:
                assert abs(found / exact - 1.0) < 0.05

    def test_where_it_bends_far_nothing_is_solved(self, anchored: Biofilm) -> None:
        _, whole = anchored._cell()
        assert whole is not None
        states = whole.states
        assert states.strains[states.solved].max() <= DIRECT_STRAIN < states.strains.max()

    def test_without_steady_states_all_runs_are_cold(self, cold: Biofilm) -> None:
        box = Box((("E", 20.0, 30.0), ("nu", 0.3, 0.3), ("V_in", 100.0, 100.0)))
        cell, _ = cold._cell()
        whole = AnchoredCell(cell, box, cold._setting)
        assert not whole.states.solved.any()
        assert not whole.states.suffice
        with pytest.raises(ForwardModelError):
            whole.solve({"E": 25.0, "nu": 0.3, "V_in": 100.0}, 3)


class TestBox:
    def test_coordinates_and_inputs_are_inverse(self) -> None:
        box = Box((("E", 100.0, 800.0), ("nu", -0.8, 0.5), ("V_in", 100.0, 100.0), ("viscosity", 9e-4, 11e-4)))
        assert [axis.name for axis in box.axes] == ["E", "nu", "viscosity"]
        points = list(box.points())
        assert len(points) == 8 + 36
        assert len(set(points)) == len(points)
        for point in points:
            inputs = box.inputs(point)
            assert box.holds(inputs)
            np.testing.assert_allclose(box.coordinates(inputs), point, atol=1e-12)

    def test_the_middle_of_a_wide_range_is_the_geometric_mean(self) -> None:
        assert Box((("E", 100.0, 900.0),)).inputs((0.5,)) == {"E": pytest.approx(300.0)}
        assert Box((("V_in", 90.0, 110.0),)).inputs((0.5,)) == {"V_in": pytest.approx(100.0)}

    @pytest.mark.parametrize(
        ("given", "expected"),
        [
            ({}, "lowest and highest value of each input"),
            (RANGES | {"V_in": [0, 100]}, r"\(0, inf\)"),
            (24, "lowest and highest value of each input"),
            ({"E": [100, 800], "nu": 0.3}, "got no V_in;"),
            (RANGES | {"Ee": 3}, "Ee, which is no input"),
            (RANGES | {"E": [800, 100]}, "E in the anchors"),
            (RANGES | {"nu": [0.0, 0.6]}, r"\(-1, 0.5\]"),
            (RANGES | {"E": [0, 800]}, r"\(0, inf\)"),
            (RANGES | {"E": "soft"}, "a number, or lowest and highest"),
            (RANGES | {"E": [100, 300, 800]}, "a number, or lowest and highest"),
            (RANGES | {"E": [100, float("nan")]}, "a number, or lowest and highest"),
            (RANGES | {"E": [100, 10**400]}, "a number, or lowest and highest"),
            (RANGES | {"E": {"low": 1}}, "a number, or lowest and highest"),
            (RANGES | {"E": True}, "a number, or lowest and highest"),
            ({"E": 400, "nu": 0.3, "V_in": 100}, "at least one input that varies"),
        ],
    )
    def test_wrong_ranges_are_refused(self, given: Any, expected: str) -> None:
        with pytest.raises(InvalidInput, match=expected) as caught:
            Biofilm.from_options(mesh="coarse", anchors=given)
        assert "\n" not in str(caught.value)

    def test_a_single_value_is_named_as_it_was_given(self) -> None:
        with pytest.raises(InvalidInput, match=r"got 0\.0;"):
            Biofilm.from_options(mesh="coarse", anchors=RANGES | {"V_in": 0})

    def test_not_with_a_course(self) -> None:
        course = {"inflow": [[0, 0], [1, 1]], "times": {"end": 1.0}}
        with pytest.raises(InvalidInput, match="no course"):
            Biofilm.from_options(mesh="coarse", anchors=RANGES, course=course)


def test_a_fluid_and_a_partition_are_converted_as_before() -> None:
    model = Biofilm.from_options(
        mesh="coarse", anchors=RANGES | {"viscosity": [9e-4, 11e-4]}, fluid={"viscosity": "unknown"}
    )
    assert isinstance(model.fluid, Fluid)
    assert isinstance(model.partition, Partition)
    assert model.anchors[-1] == ("viscosity", 9e-4, 11e-4)
