"""Results read back, and other posteriors from the same runs."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from tests.study.conftest import Finished

import strandline as sl
from strandline.errors import InvalidInput, InvalidStudy
from strandline.runs import Ledger
from strandline.testing.studies import write_study


@pytest.fixture(scope="module")
def result(beam: Finished) -> sl.Result:
    return sl.load_result(str(beam.folder))


def runs_in(folder: Path) -> int:
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def test_it_is_what_the_study_wrote(result: sl.Result) -> None:
    for name, mean, sd in zip(result.posterior.space.names, result.posterior.mean, result.posterior.sd, strict=True):
        assert result.summary["inputs"][name]["mean"] == pytest.approx(mean)
        assert result.summary["inputs"][name]["sd"] == pytest.approx(sd)
    assert repr(result).startswith("<Result of ")


def test_the_same_noise_gives_the_same_posterior_without_a_run(beam: Finished, result: sl.Result) -> None:
    before = runs_in(beam.folder)
    same = result.with_noise(sd=0.003)
    np.testing.assert_allclose(same.posterior.draws, result.posterior.draws, rtol=1e-9)
    assert runs_in(beam.folder) == before
    for one in (result, result.study, result.posterior, same):
        line, table = repr(one), one._repr_html_()
        assert "\n" not in line
        assert len(line) < 400
        assert table.count("<table>") == table.count("</table>") >= 1
        assert "tilt" in line
        assert "tilt" in table
    assert "E, tilt of PythonModel, 64 runs" in repr(result.study)
    assert "64 of 64 runs ok" in repr(same)


def test_another_measure_without_a_run(beam: Finished, result: sl.Result) -> None:
    before = runs_in(beam.folder)
    found = result.with_measure("closest_point", direction="symmetric")
    assert list(found.problem.discrepancies.values()) == [sl.ClosestPoint(direction="symmetric")]
    assert not np.array_equal(found.posterior.draws, result.posterior.draws)
    by_object = result.with_noise(errors=sl.PointErrors(0.001), measure=sl.NormalOffset())
    assert list(by_object.problem.discrepancies) == ["NormalOffset"]
    assert (by_object.posterior.sd < result.posterior.sd).all()
    assert runs_in(beam.folder) == before


def test_it_draws_into_given_axes(result: sl.Result) -> None:
    figure, axes = plt.subplots(1, 3)
    assert result.plot.joint(ax=axes[0]) is axes[0]
    assert result.plot.marginal("E", ax=axes[1]) is axes[1]
    assert result.plot.particles("tilt", ax=axes[2]) is axes[2]
    assert axes[2].get_xlabel().startswith("tilt")
    plt.close(figure)


def test_what_there_is_not_is_refused(result: sl.Result, beam: Finished, tmp_path: Path) -> None:
    for noise, words in (({}, "none"), ({"sd": 1.0, "variance": 1.0}, "more than one"), ({"sd": 0.0}, "above 0")):
        with pytest.raises(InvalidInput, match=words):
            result.with_noise(**noise)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="Did you mean currents"):
        result.with_measure("current")
    with pytest.raises(InvalidInput, match="unknown option"):
        result.with_measure("currents", widht=1.0)
    with pytest.raises(InvalidInput, match="is an object"):
        result.with_measure(sl.ClosestPoint(), direction="symmetric")
    with pytest.raises(InvalidStudy, match="not finished"):
        sl.load_result(write_study(tmp_path / "new"))


def test_results_without_a_summary_are_to_be_made_again(beam: Finished, copy_of: Callable[[Finished], Path]) -> None:
    folder = copy_of(beam)
    (folder / "summary.json").unlink()
    with pytest.raises(InvalidStudy, match="strandline report"):
        sl.load_result(folder)
