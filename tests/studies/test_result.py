"""Results read back, and other posteriors from the same runs."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import strandline as sl
from strandline.errors import InvalidInput, InvalidStudy
from strandline.runs import Ledger
from strandline.testing.studies import write_study

SMALL = {"design": {"sobol": {"runs": 24}}, "sampler": {"smc": {"particles": 400, "rejuvenation_steps": 4}}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        folder = write_study(tmp_path_factory.mktemp("result") / "beam", **SMALL)
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return folder


@pytest.fixture(scope="module")
def result(folder: Path) -> sl.Result:
    return sl.load_result(str(folder))


def runs_in(folder: Path) -> int:
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def test_it_is_what_the_study_wrote(folder: Path, result: sl.Result) -> None:
    for name, mean, sd in zip(result.posterior.space.names, result.posterior.mean, result.posterior.sd, strict=True):
        assert result.summary["inputs"][name]["mean"] == pytest.approx(mean)
        assert result.summary["inputs"][name]["sd"] == pytest.approx(sd)
    assert repr(result).startswith("<Result of ")
    assert "\n" not in repr(result)
    assert result._repr_html_().startswith("<table>")


def test_everything_prints_in_one_line_and_as_a_table(result: sl.Result) -> None:
    calibration = result.with_noise(variance=result.study.noise.scale)
    for one in (result, result.study, result.posterior, calibration):
        line, table = repr(one), one._repr_html_()
        assert "\n" not in line
        assert len(line) < 400
        assert table.count("<table>") == table.count("</table>") >= 1
        assert "tilt" in line
        assert "tilt" in table
    assert "E, tilt of PythonModel, 24 runs" in repr(result.study)
    assert "24 of 24 runs ok" in repr(calibration)


def test_the_same_noise_gives_the_same_posterior_without_a_run(folder: Path, result: sl.Result) -> None:
    before = runs_in(folder)
    same = result.with_noise(variance=result.study.noise.scale)
    np.testing.assert_allclose(same.posterior.draws, result.posterior.draws, rtol=1e-12)
    wider = result.with_noise(sd=3 * result.study.noise.scale**0.5)
    assert (wider.posterior.sd > 1.1 * result.posterior.sd).any()
    assert runs_in(folder) == before


def test_another_measure_without_a_run(folder: Path, result: sl.Result) -> None:
    before = runs_in(folder)
    by_name = result.with_measure("closest_point", direction="symmetric")
    by_object = result.with_measure(sl.ClosestPoint(direction="symmetric"))
    np.testing.assert_array_equal(by_name.posterior.draws, by_object.posterior.draws)
    assert not np.array_equal(by_name.posterior.draws, result.posterior.draws)
    assert runs_in(folder) == before


def test_it_draws_into_given_axes(result: sl.Result) -> None:
    figure, axes = plt.subplots(1, 3)
    assert result.plot.joint(ax=axes[0]) is axes[0]
    assert result.plot.marginal("E", ax=axes[1]) is axes[1]
    assert result.plot.particles("tilt", ax=axes[2]) is axes[2]
    assert axes[2].get_xlabel().startswith("tilt")
    plt.close(figure)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "none"),
        ({"sd": 1.0, "variance": 1.0}, "more than one"),
        ({"sd": 0.0}, "a finite number above 0"),
    ],
)
def test_noise_that_is_none_is_refused(result: sl.Result, given: dict[str, float], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        result.with_noise(**given)


def test_measures_that_there_are_not_are_refused(result: sl.Result) -> None:
    with pytest.raises(InvalidInput, match="Did you mean currents"):
        result.with_measure("current")
    with pytest.raises(InvalidInput, match="unknown option"):
        result.with_measure("currents", widht=1.0)
    with pytest.raises(InvalidInput, match="is an object"):
        result.with_measure(sl.ClosestPoint(), direction="symmetric")


def test_a_study_without_results_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match="not finished"):
        sl.load_result(write_study(tmp_path / "new", **SMALL))
    saved = (folder / "summary.json").read_bytes()
    try:
        (folder / "summary.json").unlink()
        with pytest.raises(InvalidStudy, match="strandline report"):
            sl.load_result(folder)
    finally:
        (folder / "summary.json").write_bytes(saved)


def test_errors_of_the_points_with_the_measure_that_knows_them(result: sl.Result) -> None:
    narrow = result.with_noise(errors=sl.PointErrors(0.001), measure=sl.NormalOffset())
    wide = result.with_noise(errors=sl.PointErrors(0.003), measure=sl.NormalOffset())
    assert list(narrow.problem.discrepancies) == ["NormalOffset"]
    assert (narrow.posterior.sd < wide.posterior.sd).all()
