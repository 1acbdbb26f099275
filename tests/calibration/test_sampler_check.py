"""Two halves of the particles agree where the sampler is right, and tell where it is not."""

import html
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tests.calibration.hard_targets import RIGHT, WRONG, Target, posterior_of

from strandline.calibration.sampler_check import LEVEL, compare_halves
from strandline.cli.results import show
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.report import figures
from strandline.runs import InProcess
from strandline.smc import SMCResult, StepInfo, halves, in_halves
from strandline.smc.halves import joined
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study

PARTICLES = 5000
BOX = Target(lambda x: 0.0 * x[:, 0], np.full(4, -10.0), np.full(4, 10.0))
STEPS = (StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0),)


def normal(seed: int, *, mean: float = 0.0, sd: float = 1.0, log_evidence: float = -3.0) -> SMCResult:
    """A thousand equal particles of a normal distribution in four inputs, which has log L = -½|x|²."""
    x = np.random.default_rng(seed).standard_normal((1000, 4))
    x[:, 0] = mean + sd * x[:, 0]
    values = -0.5 * (x**2).sum(axis=1)
    equal = np.full(1000, -np.log(1000))
    return SMCResult(x, equal, values, np.full(1000, -4 * np.log(20)), log_evidence, 1000.0, STEPS, 16_000)


def compared(one: SMCResult, other: SMCResult) -> Any:
    found = joined(one, other)
    return compare_halves(found, posterior_of(BOX.space, found))


def test_the_union_is_weighted_by_evidence() -> None:
    one, other = normal(1, log_evidence=-3.0), normal(2, log_evidence=-3.0 + np.log(3.0))
    found = joined(one, other)
    assert found.log_evidence == pytest.approx(-3.0 + np.log(2.0))
    weights = np.exp(found.log_weights)
    assert weights[:1000].sum() == pytest.approx(0.25)
    assert weights.sum() == pytest.approx(1.0)
    assert found.ess == pytest.approx(1.0 / (weights**2).sum())
    assert found.likelihood_evaluations == 32_000
    assert found.halves == (one, other)
    np.testing.assert_array_equal(found.positions[1000:], other.positions)


def test_a_smaller_half_counts_less() -> None:
    one = normal(1)
    first = {name: getattr(one, name)[:500] for name in ("positions", "log_likelihood", "log_prior")}
    few = replace(one, **first, log_weights=np.full(500, -np.log(500)))
    found = joined(one, few)
    np.testing.assert_allclose(np.exp(found.log_weights), 1 / 1500)
    assert found.log_evidence == pytest.approx(-3.0)


def test_the_halves_have_their_own_particles_and_keys_and_repeat_to_the_bit() -> None:
    calls: list[Any] = []

    def run(key: Any, initial: Any) -> SMCResult:
        calls.append((jax.random.key_data(key).tolist(), initial))
        return normal(len(calls) % 2)

    initial = np.arange(28.0).reshape(7, 4)
    for _ in range(2):
        in_halves(run, jax.random.key(3), initial)
    (first, a), (second, b), (again, _), _ = calls
    assert first != second
    assert first == again
    np.testing.assert_array_equal(np.concatenate([a, b]), initial)
    assert (len(a), len(b)) == (4, 3)
    assert in_halves(run, jax.random.key(3), initial[: halves.FEWEST - 1]).halves is None


def test_figures_of_halves_that_differ() -> None:
    check = compared(normal(1), normal(2, mean=1.0, sd=2.0, log_evidence=-2.0))
    one, other = np.full(1000, 1 / 1000), np.full(1000, 1 / 1000)
    x, y = normal(1).positions, normal(2, mean=1.0, sd=2.0).positions
    assert check.effective == pytest.approx((1000, 1000))
    np.testing.assert_allclose(np.exp(check.log_sd_ratio), x.std(axis=0) / y.std(axis=0))
    weights = np.concatenate([one, other * np.e]) / (1 + np.e)
    pooled = np.concatenate([x, y])
    sd = np.sqrt(weights @ (pooled - weights @ pooled) ** 2)
    np.testing.assert_allclose(check.mean_difference, (x.mean(axis=0) - y.mean(axis=0)) / sd)
    assert check.log_evidence == pytest.approx((-3.0, -2.0))
    split = check.splits[0]
    assert split.shares == pytest.approx(((x[:, 0] <= split.at).mean(), (y[:, 0] <= split.at).mean()))
    grid = np.linspace(-8, 8, 2001)[:, None]
    apart = (x[:, 0] <= grid).mean(axis=1) - (y[:, 0] <= grid).mean(axis=1)
    assert split.difference == pytest.approx(np.abs(apart).max(), abs=0.005)
    told = " ".join(check.differences)
    for words in ("means by up to", "(x0)", "by a factor of up to 2.0", "of the mass has", "log-evidences by 1.00"):
        assert words in told
    assert check.p < 1e-6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mean": 0.5}, "means by up to 0."),
        ({"sd": 1.3}, "a factor of up to 1.3"),
        ({"log_evidence": -2.5}, "log-evidences by 0.50"),
    ],
)
def test_each_difference_is_found(change: Mapping[str, Any], words: str) -> None:
    assert compared(normal(1), normal(2)).agree
    check = compared(normal(1), normal(2, **change))
    assert not check.agree
    assert check.p < LEVEL
    assert words in check.verdict


def test_what_a_thousand_related_particles_explain_is_no_difference() -> None:
    check = compared(normal(1), normal(2, mean=0.2, sd=1.15))
    assert np.abs(check.mean_difference).max() > 0.1
    assert check.agree
    assert check.p > LEVEL


def test_a_mode_in_one_half_alone_is_found_by_its_share() -> None:
    """Planted: most of one half lies in two clumps, with the same mean and nearly the same width."""
    other = normal(2)
    x = other.positions.copy()
    x[:400, 1], x[400:800, 1] = -0.95, 0.95
    check = compared(normal(1), replace(other, positions=x))
    assert "of the mass has x1 up to" in check.verdict


def test_equal_values_are_one_place() -> None:
    one = replace(normal(1), log_likelihood=np.zeros(1000))
    other = replace(normal(2), log_likelihood=np.zeros(1000))
    assert compared(one, other).splits[-1].difference == pytest.approx(0.0, abs=1e-9)


def test_weights_of_another_likelihood_count() -> None:
    """The posterior's weights may follow from an expected likelihood; each half is weighted by it alone."""
    found = joined(normal(1), normal(2))
    tilt = 0.5 * found.positions[:, 0]
    log_weights = found.log_weights + tilt
    increment = float(np.logaddexp.reduce(log_weights))
    moved = replace(
        found,
        log_weights=log_weights - increment,
        log_likelihood=found.log_likelihood + tilt,
        log_evidence=found.log_evidence + increment,
    )
    check = compare_halves(found, posterior_of(BOX.space, moved))
    assert check is not None
    first = np.exp(tilt[:1000])
    assert check.log_evidence[0] == pytest.approx(-3.0 + np.log(first.mean()))
    assert check.effective[0] == pytest.approx(first.sum() ** 2 / (first**2).sum())
    assert np.logaddexp(*check.log_evidence) - np.log(2) == pytest.approx(moved.log_evidence)
    assert check.agree


def test_one_run_has_no_halves() -> None:
    assert compare_halves(normal(1), posterior_of(BOX.space, normal(1))) is None


@pytest.mark.parametrize("name", RIGHT)
def test_halves_agree_where_the_sampler_is_right(name: str) -> None:
    assert RIGHT[name].check(PARTICLES, 0).agree


@pytest.mark.parametrize("name", WRONG)
def test_a_funnel_and_a_narrow_mode_are_reported(name: str) -> None:
    checks = [WRONG[name].check(PARTICLES, seed) for seed in range(4)]
    told = [check.verdict for check in checks if not check.agree]
    assert len(told) >= 2
    assert all("funnel, a narrow mode" in words for words in told)


@pytest.mark.long
def test_few_false_alarms_and_few_misses() -> None:
    """Of 40 seeds each: 2 alarms or fewer if right, 24 or more if wrong."""
    alarms = {
        name: sum(not target.check(PARTICLES, 100 + seed).agree for seed in range(40))
        for name, target in {**RIGHT, **WRONG}.items()
    }
    assert all(alarms[name] <= 2 for name in RIGHT), alarms
    assert all(alarms[name] >= 24 for name in WRONG), alarms


def chain(inputs: Mapping[str, float], workdir: Path) -> Simulation:
    """A polyline whose heights are the inputs' cumulated sums."""
    heights = np.cumsum([inputs[name] for name in "abcd"])
    return Simulation.of(Interface.polyline(np.stack([np.arange(5.0), np.append(0.0, heights)], axis=1)))


def chained(folder: Path, **changes: Any) -> Path:
    return write_study(
        folder,
        model={"python": {"function": f"{__name__}:chain"}},
        fixed=None,
        inputs={name: {"prior": {"uniform": [0.0, 1.0]}} for name in "abcd"},
        observation={"synthetic": dict.fromkeys("abcd", 0.5)},
        noise={"sd": 0.2},
        design={"sobol": {"runs": 64}},
        sampler={"smc": {"particles": 1000, "rejuvenation_steps": 10}},
        **changes,
    )


@pytest.mark.parametrize("surrogate", ["log_likelihood", "field"])
def test_a_study_of_four_inputs_says_it(
    surrogate: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = lambda calibration, truth: {"sampler": figures._sampler(calibration)}  # noqa: E731
    monkeypatch.setattr("strandline.report.page.figure_groups", drawn)
    folder = chained(tmp_path, surrogate={surrogate: {}})
    outcome = run_study(load_study(folder), executor=InProcess())
    show(outcome.summary, outcome.report)
    summary, printed = json.loads((folder / "summary.json").read_text("utf-8")), capsys.readouterr().out
    check, page = summary["sampler_check"], html.unescape(outcome.report.read_text("utf-8"))
    assert check["agree"]
    assert set(check["mean_difference_sd"]) == set(check["sd_ratio"]) == set("abcd")
    assert np.exp(summary["log_evidence"]) == pytest.approx(np.mean(np.exp(check["log_evidence"])), rel=1e-6)
    assert check["verdict"] in printed
    assert check["verdict"] in page
    assert "steps of the first half" in page
    assert not any("independent halves" in warning for warning in summary["warnings"])
