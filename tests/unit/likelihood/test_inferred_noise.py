"""Noise inferred from residuals: its own posterior, and the density of the inputs."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, qmc

from strandline.discrepancy import ClosestPoint, Discrepancy, NormalOffset, WhitenedOffset
from strandline.errors import InvalidInput
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors, arc_lengths
from strandline.likelihood import FieldLikelihood, infer_noise
from strandline.likelihood.inferred_noise import InferredNoise, NoisePosterior, _grid, _log_evidences, require_inferable
from strandline.likelihood.joint_errors import JointErrors, error_model
from strandline.likelihood.linearised import linearise
from strandline.likelihood.model_error import Cause, causes_of, offset_scales, offset_waves
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fit_field

NODES = np.linspace(0.0, 1.0, 61)
LOW, HIGH = np.array([0.2, -0.1]), np.array([0.4, 0.2])
TRUTH = np.array([0.31, 0.04])
ERRORS = PointErrors(0.002, 0.02, offset=0.002)
UNKNOWN = UnknownErrors(offset=0.002)
ERRING = UnknownErrors(0.001, 0.0, model_error=True)


def arch(x: np.ndarray, number: int = 61) -> Interface:
    """Return an arch of some height that leans to one side."""
    points = np.stack([NODES + x[1] * np.sin(np.pi * NODES), 4 * x[0] * NODES * (1 - NODES)], axis=1)
    found = Interface.polyline(points)
    return found if number == 61 else found.resampled(number)


@cache
def surrogate(*conditions: str) -> FieldSurrogate:
    """Return a surrogate of some conditions of the same arch."""
    x = LOW + (HIGH - LOW) * qmc.Sobol(2, seed=np.random.default_rng(1)).random(16)
    runs = [dict.fromkeys(conditions or ("",), arch(row)) for row in x]
    return fit_field(FieldTraining(x, runs, None, LOW, HIGH))


def observed(seed: int, errors: PointErrors = ERRORS, *, noise: PointErrors | UnknownErrors = UNKNOWN) -> Observation:
    return Observation(errors.draw(arch(TRUTH, 200), np.random.default_rng(seed)), noise)


def inferred(*observations: Observation) -> InferredNoise:
    found = infer_noise(surrogate(*(o.condition for o in observations if o.condition)), observations)
    assert found is not None
    return found


def sd_at(found: InferredNoise, level: float) -> float:
    return found.posterior.quantiles([level])["sd"][0]


def test_no_interface_outside_the_box_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the best inputs lie in one of its corners; there they are found."""
    known, asked, mean = surrogate(), [], FieldSurrogate.mean

    def noting(self: FieldSurrogate, x: np.ndarray) -> np.ndarray:
        asked.append(x)
        return mean(self, x)

    monkeypatch.setattr(FieldSurrogate, "mean", noting)
    for truth in (HIGH, LOW):
        lin = linearise(known, JointErrors((Observation(arch(truth, 200), ERRORS),), (ERRORS,)))
        np.testing.assert_allclose(lin.at, truth, atol=1e-3)
    points = np.concatenate(asked)
    assert (points >= LOW).all()
    assert (points <= HIGH).all()


def test_the_evidence_of_a_pair_is_the_dense_gaussian() -> None:
    seen, random = arch(TRUTH, 80), np.random.default_rng(3)
    along = arc_lengths(seen)
    F, r = random.normal(size=(80, 3)) * 1e-3, random.normal(size=80) * 1e-3
    K = 0.002**2 * np.exp(-np.abs(along[:, None] - along) / 0.05)
    (found,) = _log_evidences(r, F, [seen], np.array([0.002]), 0.05) - 40 * np.log(2 * np.pi)
    assert found == pytest.approx(multivariate_normal(np.zeros(80), K + F @ F.T).logpdf(r), rel=1e-8)


def test_sd_and_length_are_found() -> None:
    found = [inferred(observed(seed)).posterior.quantiles([0.05, 0.5, 0.95]) for seed in range(5)]
    for name, true, error in (("sd", 0.002, 0.3), ("length", 0.02, 0.6)):
        low, median, high = np.array([one[name] for one in found]).T
        assert ((low < true) & (true < high)).sum() >= 3
        assert np.median(median) == pytest.approx(true, rel=error)


def test_a_range_is_a_prior_and_no_coarser_grid() -> None:
    """Quantiles are those of the free noise; the evidence falls with the width of the prior."""
    free = inferred(observed(4))
    low, high = 1e-3, 0.004
    found = inferred(observed(4, noise=UnknownErrors((low, high), offset=0.002)))
    for level in (0.05, 0.5, 0.95):
        assert sd_at(free, level) == pytest.approx(sd_at(found, level), rel=0.03)
    once, twice = (inferred(observed(4, noise=UnknownErrors((low, low * (high / low) ** k)))).posterior for k in (1, 2))
    assert once.log_evidence - twice.log_evidence == pytest.approx(np.log(2), abs=0.05)


def test_unknown_noise_that_nothing_infers_is_refused() -> None:
    rows: list[tuple[tuple[Any, ...], Discrepancy, bool, str]] = [
        ((UNKNOWN,), ClosestPoint(), True, "the measure ClosestPoint"),
        ((UNKNOWN,), NormalOffset(), False, "a surrogate of the log-likelihood"),
        ((UNKNOWN, ERRORS), NormalOffset(), True, "an observation without"),
        ((UNKNOWN, UnknownErrors(0.002)), NormalOffset(), True, "different unknown noise"),
    ]
    for noises, measure, by_field, said in rows:
        seen = [observed(k, noise=noise) for k, noise in enumerate(noises)]
        with pytest.raises(InvalidInput, match=said):
            require_inferable(seen, measure, by_field=by_field)
        require_inferable(seen[:1], NormalOffset(), by_field=True)
    ranges: list[dict[str, Any]] = [{"sd": (0.0, 1.0)}, {"length": (2.0, 1.0)}, {"sd": -1.0}, {"shift": -1.0}]
    for options in ranges:
        with pytest.raises(InvalidInput, match="of the errors of points"):
            UnknownErrors(**options)


def test_what_is_known_of_the_observations_afterwards() -> None:
    """Many inputs together are as one by one."""
    likelihood = FieldLikelihood(surrogate(), (observed(4),), NormalOffset())
    (one,) = likelihood.known_observations
    assert isinstance(one.noise, PointErrors)
    assert one.noise.sd == pytest.approx(0.002, rel=0.4)
    stated = FieldLikelihood(surrogate(), (observed(4, noise=ERRORS),), NormalOffset())
    assert stated.known_observations[0].noise == ERRORS
    found = inferred(observed(4)).likelihood
    x = TRUTH + np.random.default_rng(5).normal(size=(10, 2)) * 0.003
    many = found.many({"": np.stack([arch(row).points for row in x])}, {"": arch(TRUTH)})
    np.testing.assert_allclose(many, [found.one({"": arch(row)}) for row in x], rtol=1e-9)


def grid(seen: Observation, number: int = 21) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the inputs by quadrature over a grid around the truth."""
    lin = linearise(surrogate(), JointErrors((seen,), (ERRORS,)))
    sd = np.sqrt(np.diag(lin.covariance(error_model([seen], [ERRORS]))))
    axes = [np.linspace(-7, 7, number) * sd[k] + lin.at[k] for k in (0, 1)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    values = FieldLikelihood(surrogate(), (seen,), NormalOffset()).plug_in(x)
    weights = np.exp(values - logsumexp(values))
    mean = weights @ x
    return mean, np.sqrt(weights @ (x - mean) ** 2)


def test_unknown_noise_costs_little_width() -> None:
    ratios = [grid(observed(seed))[1] / grid(observed(seed, noise=ERRORS))[1] for seed in range(2)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def wrong(seed: int, size: float) -> Interface:
    """Return an observation of an outline that the model cannot make: a wave is added to it."""
    true, t = arch(TRUTH, 200), np.linspace(0.0, 1.0, 200)
    bent = true.points + size * np.sin(3 * np.pi * t)[:, None] * np.array([0.0, 1.0])
    return PointErrors(0.001).draw(Interface(bent, true.cells), np.random.default_rng(seed))


def test_a_model_that_errs_is_noticed_and_widens_the_posterior() -> None:
    honest, found = (inferred(Observation(wrong(1, size), ERRING)).posterior for size in (0.0, 0.004))
    assert honest.probability_of_model_error < 0.5
    assert found.probability_of_model_error > 0.99
    assert 0.001 < found.model_error < 0.02
    _, known = grid(Observation(wrong(1, 0.004), PointErrors(0.001)))
    _, erring = grid(Observation(wrong(1, 0.004), ERRING))
    assert (erring > 2 * known).all()


def test_the_posterior_without_the_error_is_that_of_the_stated_noise() -> None:
    """But for uneven distances of the points; also where a model without error has no probability left."""
    seen = wrong(1, 0.02)
    found = inferred(Observation(seen, ERRING)).without
    assert found is not None
    stated = WhitenedOffset(PointErrors(0.001))
    one, other = arch(TRUTH), arch(TRUTH + np.array([0.004, 0.01]))
    difference = found.one({"": one}) - found.one({"": other})
    assert difference == pytest.approx(-0.5 * (stated(one, seen) - stated(other, seen)), rel=0.05)
    unknown = inferred(Observation(seen, UnknownErrors(model_error=True))).without
    assert unknown is not None
    assert unknown.levels.min() > 100 * 0.001**2
    assert inferred(Observation(seen, UnknownErrors())).without is None


def lengths_tried(interfaces: list[Interface], near: NoisePosterior | None = None) -> np.ndarray:
    lin = linearise(surrogate(), JointErrors((observed(1),), (ERRORS,)))
    return _grid(lin, interfaces, UnknownErrors(), near)[1]


def test_lengths_are_tried_again_around_those_found_and_up_to_half_the_outline() -> None:
    """For conditions alike, those of one."""

    def found(length: float) -> NoisePosterior:
        lengths = length * np.geomspace(0.98, 1.02, 5)
        return NoisePosterior(np.geomspace(0.001, 0.003, 3), lengths, (Cause(),), np.full((1, 3, 5), 1 / 15), 0.0)

    one = arch(TRUTH, 100)
    around = lengths_tried([one], found(0.02))
    assert 0.002 < around[0] < 0.02 < around[-1] < 0.2
    assert lengths_tried([one], found(0.9))[-1] == pytest.approx(0.5 * one.lengths.sum())
    np.testing.assert_allclose(lengths_tried([one, one]), lengths_tried([one]))


def test_amplitude_and_length_of_the_offset_are_those_of_the_models_that_err() -> None:
    causes = (Cause(), *(Cause(a, share) for a in (0.001, 0.004, 0.016) for share in (0.1, 0.4)))
    mass = np.array([0.5, 0.0, 0.0, 0.1, 0.4, 0.0, 0.0])  # all of it at 0.004, a fifth at the shorter length
    found = NoisePosterior(np.array([1.0]), np.array([1.0]), causes, mass[:, None, None], 0.0)
    offset = found.quantiles_of_offset([0.1, 0.5, 0.6])
    assert offset is not None
    assert offset["amplitude"][1] == pytest.approx(0.004)
    assert offset["share"] == pytest.approx([0.1, 0.1 * 4**0.8, 0.4])
    none = replace(found, causes=(Cause(), Cause(spread=0.1)), weights=np.array([0.5, 0.5])[:, None, None])
    assert none.quantiles_of_offset([0.5]) is None


def test_waves_have_the_covariance_of_the_process() -> None:
    """On a line, and on a closed outline, where sines count as much as cosines: only the distance along it matters."""
    line = Interface.polyline(np.stack([np.linspace(0.0, 2.0, 81), np.zeros(81)], axis=1))
    B = offset_waves(line) * offset_scales(line, 0.5, 0.15)
    t = np.linspace(0.0, 1.0, 81)
    inside = slice(25, 56)
    np.testing.assert_allclose((B @ B.T)[40, inside], 0.25 * np.exp(-np.abs(t[40] - t[inside]) / 0.15), atol=0.05)
    angle = np.linspace(0.0, 2 * np.pi, 80, endpoint=False)
    ring = Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)
    B = offset_waves(ring) * offset_scales(ring, 0.5, 0.15)
    rolled = np.array([np.roll(row, -k) for k, row in enumerate(B @ B.T)])
    np.testing.assert_allclose(rolled, np.tile(rolled[0], (80, 1)), atol=1e-12)
    np.testing.assert_allclose(rolled[0, :20], 0.25 * np.exp(-np.arange(20) / 80 / 0.15), atol=0.05)


def test_an_input_that_differs_between_conditions_is_noticed() -> None:
    errors, unknown = PointErrors(0.001), UnknownErrors(0.001, 0.0, spread=(0,))
    for apart, found in ((0.0, False), (0.03, True)):
        half = np.array([0.5 * apart, 0.0])
        seen = [
            Observation(errors.draw(arch(TRUTH + side * half, 200), np.random.default_rng(k)), unknown, name)
            for k, (name, side) in enumerate((("a", 1), ("b", -1)))
        ]
        posterior = inferred(*seen).posterior
        assert (posterior.probability_of_model_error > 0.95) == found
        assert (posterior.spread > 0.05) == found


def test_each_of_three_conditions_has_its_own_deviation_of_an_input() -> None:
    unknown = UnknownErrors(0.001, 0.0, spread=(0,))
    seen = [Observation(arch(TRUTH, number), unknown, name) for name, number in (("a", 20), ("b", 30), ("c", 40))]
    lin = linearise(surrogate("a", "b", "c"), JointErrors(tuple(seen), tuple(PointErrors(0.001) for _ in seen)))
    columns = causes_of(lin, seen, unknown).columns
    expected = np.zeros((90, 3))
    for k, part in enumerate((slice(0, 20), slice(20, 50), slice(50, 90))):
        expected[part, k] = lin.scaled[part, 0]
    np.testing.assert_array_equal(columns, expected)
