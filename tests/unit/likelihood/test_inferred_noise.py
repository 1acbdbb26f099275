"""Noise inferred from residuals: its own posterior, the density of the inputs, and the mixture of noise levels."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, qmc
from tests.unit.discrepancy.curves import graph, ring

from strandline.discrepancy import ClosestPoint, JointErrors, NormalOffset, WhitenedOffset
from strandline.foundations import InvalidInput
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors, arc_lengths
from strandline.likelihood import FieldLikelihood, infer_noise
from strandline.likelihood.field import evaluated, predicted
from strandline.likelihood.inferred_noise import (
    Cause,
    InferredNoise,
    NoisePosterior,
    _log_evidences,
    causes_of,
    offset_scales,
    offset_waves,
    require_inferable,
)
from strandline.likelihood.linearised_residuals import linearise
from strandline.likelihood.local_likelihood import Mixture
from strandline.surrogate import fit_log_likelihood
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fit_field

NODES = np.linspace(0.0, 1.0, 61)
LOW, HIGH = np.array([0.2, -0.1]), np.array([0.4, 0.2])
TRUTH = np.array([0.31, 0.04])
ERRORS = PointErrors(0.002, 0.02, offset=0.002)
UNKNOWN = UnknownErrors(offset=0.002)
ERRING = UnknownErrors(0.001, 0.0, model_error=True)


def arch(x: np.ndarray, number: int = 61) -> Interface:
    """Return an arch of some height that leans to one side."""
    found = graph(NODES + x[1] * np.sin(np.pi * NODES), 4 * x[0] * NODES * (1 - NODES))
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
    return infer_noise(surrogate(*(o.condition for o in observations if o.condition)), observations)


def test_no_interface_outside_the_box_is_asked_for(monkeypatch):
    """Where the best inputs lie in one of its corners; there they are found."""
    asked, mean = [], FieldSurrogate.mean
    monkeypatch.setattr(FieldSurrogate, "mean", lambda known, x: asked.append(x) or mean(known, x))
    for truth in (HIGH, LOW):
        lin = linearise(surrogate(), JointErrors((Observation(arch(truth, 200), ERRORS),), (ERRORS,)))
        np.testing.assert_allclose(lin.at, truth, atol=1e-3)
    points = np.concatenate(asked)
    assert (points >= LOW).all()
    assert (points <= HIGH).all()


def test_the_evidence_of_a_pair_is_the_dense_gaussian():
    seen, random = arch(TRUTH, 80), np.random.default_rng(3)
    along = arc_lengths(seen)
    F, r = random.normal(size=(80, 3)) * 1e-3, random.normal(size=80) * 1e-3
    K = 0.002**2 * np.exp(-np.abs(along[:, None] - along) / 0.05)
    (found,) = _log_evidences(r, F, [seen], np.array([0.002]), 0.05) - 40 * np.log(2 * np.pi)
    assert found == pytest.approx(multivariate_normal(np.zeros(80), K + F @ F.T).logpdf(r), rel=1e-8)


def test_sd_and_length_are_found():
    found = [inferred(observed(seed)).posterior.quantiles([0.05, 0.5, 0.95]) for seed in range(5)]
    for name, true, error in (("sd", 0.002, 0.3), ("length", 0.02, 0.6)):
        low, median, high = np.array([one[name] for one in found]).T
        assert ((low < true) & (true < high)).sum() >= 3
        assert np.median(median) == pytest.approx(true, rel=error)


def test_a_range_is_a_prior_and_no_coarser_grid():
    """Quantiles are those of the free noise; the evidence falls with the width of the prior."""
    noises = UNKNOWN, UnknownErrors((1e-3, 0.004), offset=0.002)
    free, found = (inferred(observed(4, noise=one)).posterior.quantiles([0.05, 0.5, 0.95])["sd"] for one in noises)
    assert free == pytest.approx(found, rel=0.03)
    for name, low, factor, offset, error in (("sd", 1e-3, 4.0, 0.0, 0.05), ("length", 0.002, 100.0, 0.002, 0.1)):
        once, twice = (UnknownErrors(**{name: (low, low * factor**k)}, offset=offset) for k in (1, 2))
        one, other = (inferred(observed(4, noise=noise)).posterior.log_evidence for noise in (once, twice))
        assert one - other == pytest.approx(np.log(2), abs=error)


def test_unknown_noise_that_nothing_infers_is_refused():
    for noises, measure, by_field, said in (
        ((UNKNOWN,), ClosestPoint(), True, "the measure ClosestPoint"),
        ((UNKNOWN,), NormalOffset(), False, "a surrogate of the log-likelihood"),
        ((UNKNOWN, ERRORS), NormalOffset(), True, "an observation without"),
        ((UNKNOWN, UnknownErrors(0.002)), NormalOffset(), True, "different unknown noise"),
    ):
        seen = [observed(k, noise=noise) for k, noise in enumerate(noises)]
        with pytest.raises(InvalidInput, match=said):
            require_inferable(seen, measure, by_field=by_field)
    with pytest.raises(InvalidInput, match="of the errors of points"):
        UnknownErrors(length=(2.0, 1.0))


def test_what_is_known_of_the_observations_afterwards():
    (known,) = FieldLikelihood(surrogate(), (observed(4),), NormalOffset()).known_observations
    assert isinstance(known.noise, PointErrors)
    assert known.noise.sd == pytest.approx(0.002, rel=0.4)


def grid(seen: Observation, number: int = 21) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the inputs by quadrature over a grid around the truth."""
    lin = linearise(surrogate(), JointErrors((seen,), (ERRORS,)))
    sd = np.sqrt(np.diag(lin.covariance(JointErrors((seen,), (ERRORS,)).model)))
    axes = [np.linspace(-7, 7, number) * sd[k] + lin.at[k] for k in (0, 1)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    values = FieldLikelihood(surrogate(), (seen,), NormalOffset()).plug_in(x)
    weights = np.exp(values - logsumexp(values))
    mean = weights @ x
    return mean, np.sqrt(weights @ (x - mean) ** 2)


def test_unknown_noise_costs_little_width():
    ratios = [grid(observed(seed))[1] / grid(observed(seed, noise=ERRORS))[1] for seed in range(2)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def wrong(seed: int, size: float) -> Interface:
    """Return an observation of an outline that the model cannot make: a wave is added to it."""
    true, t = arch(TRUTH, 200), np.linspace(0.0, 1.0, 200)
    bent = true.points + size * np.sin(3 * np.pi * t)[:, None] * np.array([0.0, 1.0])
    return PointErrors(0.001).draw(Interface(bent, true.cells), np.random.default_rng(seed))


def test_a_model_that_errs_is_noticed_and_widens_the_posterior():
    honest, found = (inferred(Observation(wrong(1, size), ERRING)).posterior for size in (0.0, 0.004))
    assert honest.probability_of_model_error < 0.5
    assert found.probability_of_model_error > 0.99
    assert 0.001 < found.model_error < 0.02
    _, known = grid(Observation(wrong(1, 0.004), PointErrors(0.001)))
    _, erring = grid(Observation(wrong(1, 0.004), ERRING))
    assert (erring > 2 * known).all()


def test_the_posterior_without_the_error_is_that_of_the_stated_noise():
    """But for uneven distances of the points; also where a model without error has no probability left."""
    seen = wrong(1, 0.02)
    found = inferred(Observation(seen, ERRING)).without
    stated = WhitenedOffset(PointErrors(0.001))
    one, other = arch(TRUTH), arch(TRUTH + np.array([0.004, 0.01]))
    difference = found.one({"": one}) - found.one({"": other})
    assert difference == pytest.approx(-0.5 * (stated(one, seen) - stated(other, seen)), rel=0.05)
    unknown = inferred(Observation(seen, UnknownErrors(model_error=True))).without
    assert unknown.levels.min() > 100 * 0.001**2
    assert inferred(Observation(seen, UnknownErrors())).without is None


def test_amplitude_and_length_of_the_offset_are_those_of_the_models_that_err():
    causes = (Cause(), *(Cause(a, share) for a in (0.001, 0.004, 0.016) for share in (0.1, 0.4)))
    mass = np.array([0.5, 0.0, 0.0, 0.1, 0.4, 0.0, 0.0])  # all of it at 0.004, a fifth at the shorter length
    found = NoisePosterior(np.array([1.0]), np.array([1.0]), causes, mass[:, None, None], 0.0)
    offset = found.quantiles_of_offset([0.1, 0.5, 0.6])
    assert offset["amplitude"][1] == pytest.approx(0.004)
    assert offset["share"] == pytest.approx([0.1, 0.1 * 4**0.8, 0.4])


def test_waves_have_the_covariance_of_the_process():
    """On a line, and on a closed outline, where sines count as much as cosines: only the distance along it matters."""
    line, closed = graph(np.linspace(0.0, 2.0, 81), 0.0), ring(80)
    B = offset_waves(line) * offset_scales(line, 0.5, 0.15)
    apart = np.abs(np.arange(81) - 40)[25:56] / 80
    np.testing.assert_allclose((B @ B.T)[40, 25:56], 0.25 * np.exp(-apart / 0.15), atol=0.05)
    B = offset_waves(closed) * offset_scales(closed, 0.5, 0.15)
    rolled = np.array([np.roll(row, -k) for k, row in enumerate(B @ B.T)])
    np.testing.assert_allclose(rolled, np.tile(rolled[0], (80, 1)), atol=1e-12)
    np.testing.assert_allclose(rolled[0, :20], 0.25 * np.exp(-np.arange(20) / 80 / 0.15), atol=0.05)


def test_an_input_that_differs_between_conditions_is_noticed():
    unknown = UnknownErrors(0.001, 0.0, spread=(0,))
    for apart, found in ((0.0, False), (0.03, True)):
        half, seen = np.array([0.5 * apart, 0.0]), []
        for k, (name, truth) in enumerate({"a": TRUTH + half, "b": TRUTH - half}.items()):
            drawn = PointErrors(0.001).draw(arch(truth, 200), np.random.default_rng(k))
            seen.append(Observation(drawn, unknown, name))
        posterior = inferred(*seen).posterior
        assert (posterior.probability_of_model_error > 0.95) == found
        assert (posterior.spread > 0.05) == found


def test_each_of_three_conditions_has_its_own_deviation_of_an_input():
    unknown = UnknownErrors(0.001, 0.0, spread=(0,))
    seen = [Observation(arch(TRUTH, number), unknown, name) for name, number in (("a", 20), ("b", 30), ("c", 40))]
    lin = linearise(surrogate("a", "b", "c"), JointErrors(tuple(seen), tuple(PointErrors(0.001) for _ in seen)))
    expected = np.zeros((90, 3))
    for k, part in enumerate((slice(0, 20), slice(20, 50), slice(50, 90))):
        expected[part, k] = lin.scaled[part, 0]
    np.testing.assert_array_equal(causes_of(lin, seen, unknown).columns, expected)


def test_the_mixture_of_levels_is_the_sum_over_dense_gaussians_and_moves_the_observation_as_is_likeliest():
    """By least squares, at the heavier level: residuals over their sds and shared errors over theirs are least."""
    random, weights, levels = np.random.default_rng(2), np.array([0.3, 0.7]), np.array([0.5, 2.0])
    local, shared, scales = random.uniform(0.5, 2.0, 40), random.normal(size=(40, 5)), random.uniform(0.2, 3.0, (2, 5))
    errors, residuals = PointErrors(0.01, shift=0.1, rotation=1.0), random.normal(size=(6, 40))
    joint = JointErrors((Observation(graph(np.linspace(0.0, 1.0, 40), 0.0), errors),), (errors,))
    mixture = Mixture(joint, local, shared, levels, scales, np.log(weights))
    dense = [level * np.diag(local) + shared * scale**2 @ shared.T for level, scale in zip(levels, scales, strict=True)]
    squares = np.array([[r @ np.linalg.solve(C, r) for C in dense] for r in residuals])
    found = mixture.of_sums((residuals**2 / local).sum(axis=1), (residuals / local) @ shared)
    np.testing.assert_allclose(found, np.log(np.exp(-0.5 * squares) @ weights), rtol=1e-9)
    each = np.array([residuals @ np.linalg.solve(C, residuals.T) for C in dense])
    likely = weights * np.exp(-0.5 * each[:, 0, 0])  # components count as the first residuals make them likely
    of_sums = mixture.weights_of_sums(residuals @ (residuals / local).T, (residuals / local) @ shared)
    np.testing.assert_allclose(of_sums, np.tensordot(likely / likely.sum(), each, axes=1), rtol=1e-9)
    sds = np.sqrt(levels[1] * local)
    design = np.vstack([shared * scales[1] / sds[:, None], np.eye(5)])
    for r, one in zip(residuals, mixture._global_errors((residuals / local) @ shared), strict=True):
        best = np.linalg.lstsq(design, np.concatenate([r / sds, np.zeros(5)]), rcond=None)[0] * scales[1]
        assert one == pytest.approx([*best[:3], 0.0, 0.0])  # two shifts and the rotation; the others do not move it


def test_the_prediction_of_a_surrogate_to_a_power():
    """Also of a surrogate of the user's own."""
    bowl = SimpleNamespace(mean=lambda x: -((x - 0.3) ** 2).sum(axis=1), variance=lambda x: np.zeros(len(x)))
    runs, x = (np.random.default_rng(seed).uniform(0.0, 1.0, (20, 2)) for seed in (0, 1))
    for process in (bowl, fit_log_likelihood(runs, bowl.mean(runs)).process):
        for power in (1.0, 0.25):
            found = evaluated(predicted(process, power=power))(x)
            np.testing.assert_allclose(found, power * process.mean(x), rtol=1e-10)


def test_half_of_the_prior_is_on_a_model_without_error():
    """p(no error | r) = ½ p(r | no error) / p(r)."""
    sds, lengths = (1e-3, 0.004), (0.01, 0.04)
    alone, both = (
        inferred(observed(4, noise=UnknownErrors(sds, lengths, model_error=erring))).posterior
        for erring in (False, True)
    )
    expected = np.log(0.5) + alone.log_evidence - np.log(1 - both.probability_of_model_error)
    assert both.log_evidence == pytest.approx(expected, abs=0.05)
