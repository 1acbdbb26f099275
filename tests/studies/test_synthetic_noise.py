"""Noise on a synthetic observation: its size, its seed, where it goes and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.posterior import read
from strandline.runs import InProcess
from strandline.studies import check_posterior, load_study, run_study
from strandline.studies.observed import SyntheticNoise, noisy
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

TRUTH = {"E": 400, "tilt": 0.02, "load": 1e-5}
LINE = Interface.polyline(np.stack([np.linspace(0.0, 100.0, 4001), np.zeros(4001)], axis=1))


SHORT = Interface.polyline(LINE.points[:1201])


def added(noise: SyntheticNoise, condition: str = "", line: Interface = SHORT) -> Any:
    return noisy({condition: line}, noise)[condition].points - line.points


def test_it_is_independent_gaussian_on_both_coordinates() -> None:
    noise = added(SyntheticNoise(0.002, 1), line=LINE)
    assert noise.shape == (4001, 2)
    np.testing.assert_allclose(noise.std(axis=0), 0.002, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 * 0.002 / 4001**0.5)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.06
    assert 0.66 < (np.abs(noise) < 0.002).mean() < 0.71


def test_seed_and_condition_decide_it() -> None:
    first = added(SyntheticNoise(0.002, 1))
    np.testing.assert_array_equal(added(SyntheticNoise(0.002, 1)), first)
    np.testing.assert_allclose(added(SyntheticNoise(0.004, 1)), 2 * first, rtol=1e-6, atol=1e-12)
    for other in (added(SyntheticNoise(0.002, 2)), added(SyntheticNoise(0.002, 1), "slow")):
        assert abs(np.corrcoef(other.ravel(), first.ravel())[0, 1]) < 0.06
    both = noisy({"slow": SHORT, "": SHORT}, SyntheticNoise(0.002, 1))
    np.testing.assert_array_equal(both[""].points - SHORT.points, first)


def test_without_noise_nothing_changes() -> None:
    assert noisy({"": LINE}, None) == {"": LINE}


def test_the_seed_is_the_studys_unless_it_has_its_own(tmp_path: Path) -> None:
    def loaded(name: str, **noise: Any) -> SyntheticNoise | None:
        folder = write_study(tmp_path / name, observation={"synthetic": TRUTH, "noise": noise}, seed=7)
        return load_study(folder).synthetic_noise

    assert loaded("a", sd=0.001) == SyntheticNoise(0.001, 7)
    assert loaded("b", sd=0.001, seed=0) == SyntheticNoise(0.001, 0)
    assert load_study(write_study(tmp_path / "c")).synthetic_noise is None


@pytest.mark.parametrize(
    ("observation", "words"),
    [
        ({"synthetic": TRUTH, "noise": {"sd": -0.001}}, ["observation.noise.sd", "greater than 0"]),
        ({"synthetic": TRUTH, "noise": {"sd": 0}}, ["observation.noise.sd", "greater than 0"]),
        ({"synthetic": TRUTH, "noise": {"sd": "much"}}, ["observation.noise.sd"]),
        ({"synthetic": TRUTH, "noise": {"seed": 1}}, ["observation.noise.sd"]),
        ({"synthetic": TRUTH, "noise": {"sd": 1, "seed": -1}}, ["observation.noise.seed"]),
        ({"synthetic": TRUTH, "noise": {"sd": 1, "variance": 1}}, ["observation.noise.variance"]),
        ({"synthetic": TRUTH, "noise": 0.001}, ["observation.noise"]),
        ({"file": "observed.csv", "unit": "mm", "noise": {"sd": 0.001}}, ["observation", "with `synthetic` only"]),
    ],
)
def test_what_is_refused(tmp_path: Path, observation: Any, words: list[str]) -> None:
    with pytest.raises(InvalidStudy) as caught:
        load_study(write_study(tmp_path / "study", observation=observation))
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_an_interface_that_touches_itself_is_refused() -> None:
    with pytest.raises(InvalidStudy, match=r"observation\.noise: with it.*sd: 1.*0\.025 mm"):
        noisy({"": LINE}, SyntheticNoise(1.0, 1))


def test_the_noisy_interface_is_what_was_observed(tmp_path: Path, without_report: None) -> None:
    observation = {"synthetic": TRUTH, "noise": {"sd": 0.004, "seed": 3}}
    folder = write_study(tmp_path / "noisy", observation=observation)
    outcome = run_study(load_study(folder), executor=InProcess())
    plain = run_study(
        load_study(write_study(tmp_path / "plain", observation={"synthetic": TRUTH})), executor=InProcess()
    )
    (seen,), (true,) = (o.calibration.problem.observations for o in (outcome, plain))
    np.testing.assert_array_equal(
        seen.interface.points, noisy({"": true.interface}, SyntheticNoise(0.004, 3))[""].points
    )
    assert 0.002 < (seen.interface.points - true.interface.points).std() < 0.006
    stored = read(folder / "posterior.nc")["observed_data"]
    assert any(np.array_equal(stored[name].values, seen.interface.points) for name in stored.data_vars)
    assert outcome.summary["synthetic_noise"] == {"sd": 0.004, "seed": 3}
    assert plain.summary["synthetic_noise"] is None
    again = run_study(load_study(folder), executor=InProcess())
    np.testing.assert_array_equal(again.calibration.posterior.draws, outcome.calibration.posterior.draws)
    assert again.summary["runs"]["new"] == 0


def test_the_check_of_the_posterior_sees_the_noise_too(tmp_path: Path, without_report: None) -> None:
    """The surrogate of this problem is nearly exact, so it agrees with the true log-likelihood; without noise in the
    check that would be larger by 34 coordinates · 0.004² / (2 · 0.003²) = 30."""
    folder = write_study(tmp_path / "noisy", observation={"synthetic": TRUTH, "noise": {"sd": 0.004}})
    run_study(load_study(folder), executor=InProcess())
    content = check_posterior(load_study(folder), draws=20, executor=InProcess()).content
    assert abs(content["log_likelihood"]["mean_difference"]) < 1.0


def test_every_condition_has_noise_of_its_own(tmp_path: Path, without_report: None) -> None:
    observation = {**TWO_LOADS_STUDY["observation"], "noise": {"sd": 0.004}}
    folder = write_study(tmp_path / "two", **{**TWO_LOADS_STUDY, "observation": observation})
    observations = run_study(load_study(folder), executor=InProcess()).calibration.problem.observations
    assert len(observations) == 2
