"""Noise inferred from residuals: its own posterior, the density of the inputs, and coverage with a planted bug."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, qmc

from strandline.discrepancy import ClosestPoint, Discrepancy, NormalOffset, WhitenedOffset
from strandline.errors import InvalidInput
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors, arc_lengths
from strandline.likelihood import FieldLikelihood, infer_noise
from strandline.likelihood.inferred_noise import NoisePosterior, _grid, _log_evidences, require_inferable
from strandline.likelihood.joint_errors import JointErrors, error_model
from strandline.likelihood.linearised import linearise
from strandline.likelihood.model_error import Cause, causes_of, offset_scales, offset_waves
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fit_field

NODES = np.linspace(0.0, 1.0, 61)
LOW, HIGH = np.array([0.2, -0.1]), np.array([0.4, 0.2])
TRUTH = np.array([0.31, 0.04])
ERRORS = PointErrors(0.002, 0.02, offset=0.002)
UNKNOWN = UnknownErrors(offset=0.002)


def arch(x: np.ndarray, number: int = 61) -> Interface:
    """Return an arch of some height that leans to one side."""
    points = np.stack([NODES + x[1] * np.sin(np.pi * NODES), 4 * x[0] * NODES * (1 - NODES)], axis=1)
    found = Interface.polyline(points)
    return found if number == 61 else found.resampled(number)


@cache
def surrogate() -> FieldSurrogate:
    x = LOW + (HIGH - LOW) * qmc.Sobol(2, seed=np.random.default_rng(1)).random(16)
    return fit_field(FieldTraining(x, [{"": arch(row)} for row in x], None, LOW, HIGH))


def observed(seed: int, errors: PointErrors = ERRORS, *, noise: PointErrors | UnknownErrors = UNKNOWN) -> Observation:
    return Observation(errors.draw(arch(TRUTH, 200), np.random.default_rng(seed)), noise)


def test_the_best_inputs_are_found_and_the_slopes_are_right() -> None:
    seen = observed(1)
    lin = linearise(surrogate(), JointErrors((seen,), (ERRORS,)))
    sd = np.sqrt(np.diag(lin.covariance(error_model([seen], [ERRORS]))))
    assert (np.abs(lin.at - TRUTH) < 4 * sd).all()
    model = error_model([seen], [ERRORS])
    around = [model.square(lin.residuals + lin.slopes @ (3 * sd * move)) for move in np.vstack([np.eye(2), -np.eye(2)])]
    assert model.square(lin.residuals) < min(around)


def test_the_evidence_of_a_pair_is_the_dense_gaussian() -> None:
    seen, random = arch(TRUTH, 80), np.random.default_rng(3)
    along = arc_lengths(seen)
    F, r = random.normal(size=(80, 3)) * 1e-3, random.normal(size=80) * 1e-3
    K = 0.002**2 * np.exp(-np.abs(along[:, None] - along) / 0.05)
    (found,) = _log_evidences(r, F, [seen], np.array([0.002]), 0.05) - 40 * np.log(2 * np.pi)
    assert found == pytest.approx(multivariate_normal(np.zeros(80), K + F @ F.T).logpdf(r), rel=1e-8)


def test_sd_and_length_are_found() -> None:
    found = [infer_noise(surrogate(), [observed(seed)]) for seed in range(12)]
    inside = [
        np.array([low < true < high for (low, high), true in zip(_ranges(one), (0.002, 0.02), strict=True)])
        for one in found
    ]
    assert np.mean(inside, axis=0).min() >= 0.6
    medians = np.array([[one.posterior.quantiles([0.5])[name][0] for name in ("sd", "length")] for one in found if one])
    assert np.median(medians[:, 0]) == pytest.approx(0.002, rel=0.25)
    assert np.median(medians[:, 1]) == pytest.approx(0.02, rel=0.6)


def _ranges(one: object) -> list[list[float]]:
    quantiles = one.posterior.quantiles([0.05, 0.95])  # type: ignore[attr-defined]
    return [quantiles["sd"], quantiles["length"]]


@pytest.mark.parametrize("stated", [(1e-4, 0.1), (1e-6, 1.0), (1e-3, 0.004)])
def test_a_range_is_a_prior_and_no_coarser_grid(stated: tuple[float, float]) -> None:
    free = infer_noise(surrogate(), [observed(4)])
    found = infer_noise(surrogate(), [observed(4, noise=UnknownErrors(stated, offset=0.002))])
    assert free is not None
    assert found is not None
    for level in (0.05, 0.5, 0.95):
        (one,), (other,) = (noise.posterior.quantiles([level])["sd"] for noise in (free, found))
        assert one == pytest.approx(other, rel=0.03)
    # the evidence falls with the width of the prior
    twice = infer_noise(surrogate(), [observed(4, noise=UnknownErrors((stated[0], stated[1] ** 2 / stated[0])))])
    once = infer_noise(surrogate(), [observed(4, noise=UnknownErrors(stated))])
    assert twice is not None
    assert once is not None
    assert once.posterior.log_evidence - twice.posterior.log_evidence == pytest.approx(np.log(2), abs=0.05)


@pytest.mark.parametrize(
    ("noises", "measure", "by_field", "said"),
    [
        ((UNKNOWN,), ClosestPoint(), True, "the measure ClosestPoint"),
        ((UNKNOWN,), NormalOffset(), False, "a surrogate of the log-likelihood"),
        ((UNKNOWN, ERRORS), NormalOffset(), True, "an observation without"),
        ((UNKNOWN, UnknownErrors(0.002)), NormalOffset(), True, "different unknown noise"),
    ],
)
def test_unknown_noise_that_nothing_infers_is_refused(
    noises: tuple[PointErrors | UnknownErrors, ...], measure: Discrepancy, by_field: bool, said: str
) -> None:
    seen = [observed(k, noise=noise) for k, noise in enumerate(noises)]
    with pytest.raises(InvalidInput, match=said):
        require_inferable(seen, measure, by_field=by_field)
    require_inferable(seen[:1], NormalOffset(), by_field=True)


def test_what_is_known_of_the_observations_afterwards() -> None:
    likelihood = FieldLikelihood(surrogate(), (observed(4),), NormalOffset())
    (one,) = likelihood.known_observations
    assert isinstance(one.noise, PointErrors)
    assert one.noise.sd == pytest.approx(0.002, rel=0.4)
    stated = FieldLikelihood(surrogate(), (observed(4, noise=ERRORS),), NormalOffset())
    assert stated.known_observations[0].noise == ERRORS


def test_many_are_as_one_by_one() -> None:
    found = infer_noise(surrogate(), [observed(4)])
    assert found is not None
    x = TRUTH + np.random.default_rng(5).normal(size=(40, 2)) * 0.003
    points = {"": np.stack([arch(row).points for row in x])}
    each = [found.likelihood.one({"": arch(row)}) for row in x]
    np.testing.assert_allclose(found.likelihood.many(points, {"": arch(TRUTH)}), each, rtol=1e-9)


def grid(seen: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the inputs by quadrature over a grid around the truth."""
    lin = linearise(surrogate(), JointErrors((seen,), (ERRORS,)))
    sd = np.sqrt(np.diag(lin.covariance(error_model([seen], [ERRORS]))))
    axes = [np.linspace(-7, 7, 41) * sd[k] + lin.at[k] for k in (0, 1)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    values = FieldLikelihood(surrogate(), (seen,), NormalOffset()).plug_in(x)
    weights = np.exp(values - logsumexp(values))
    mean = weights @ x
    return mean, np.sqrt(weights @ (x - mean) ** 2)


def test_unknown_noise_costs_little_width() -> None:
    ratios = []
    for seed in range(6):
        _, known = grid(observed(seed, noise=ERRORS))
        _, unknown = grid(observed(seed))
        ratios.append(unknown / known)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_coverage_with_unknown_noise() -> None:
    """Planted: correlated points taken as independent, with an sd that is known."""
    scores, planted = [], []
    for seed in range(100):
        mean, sd = grid(observed(seed))
        scores.append((TRUTH - mean) / sd)
        mean, sd = grid(observed(seed, noise=PointErrors(ERRORS.sd)))
        planted.append((TRUTH - mean) / sd)
    covered = (np.abs(scores) < 1.645).mean(axis=0)
    assert ((covered > 0.82) & (covered < 0.97)).all()
    assert (np.abs(planted) < 1.645).mean(axis=0).min() < 0.7


@pytest.mark.parametrize("options", [{"sd": (0.0, 1.0)}, {"length": (2.0, 1.0)}, {"sd": -1.0}, {"shift": -1.0}])
def test_senseless_ranges_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InvalidInput, match="of the errors of points"):
        UnknownErrors(**options)  # type: ignore[arg-type]


def wrong(seed: int, size: float) -> Interface:
    """Return an observation of an outline that the model cannot make: a wave is added to it."""
    true = arch(TRUTH, 200)
    t = np.linspace(0.0, 1.0, 200)
    bent = true.points + size * np.sin(3 * np.pi * t)[:, None] * np.array([0.0, 1.0])
    return PointErrors(0.001).draw(Interface(bent, true.cells), np.random.default_rng(seed))


ERRING = UnknownErrors(0.001, 0.0, model_error=True)


def test_a_model_that_errs_is_noticed_and_widens_the_posterior() -> None:
    honest = infer_noise(surrogate(), [Observation(wrong(1, 0.0), ERRING)])
    found = infer_noise(surrogate(), [Observation(wrong(1, 0.004), ERRING)])
    assert honest is not None
    assert found is not None
    assert honest.posterior.probability_of_model_error < 0.5
    assert found.posterior.probability_of_model_error > 0.99
    assert 0.001 < found.posterior.model_error < 0.02
    _, known = grid(Observation(wrong(1, 0.004), PointErrors(0.001)))
    _, erring = grid(Observation(wrong(1, 0.004), ERRING))
    assert (erring > 2 * known).all()


def lengths_tried(interfaces: list[Interface], near: NoisePosterior | None = None) -> np.ndarray:
    lin = linearise(surrogate(), JointErrors((observed(1),), (ERRORS,)))
    return _grid(lin, interfaces, UnknownErrors(), near)[1]


def test_conditions_alike_are_tried_with_the_lengths_of_one() -> None:
    one = arch(TRUTH, 100)
    np.testing.assert_allclose(lengths_tried([one, one]), lengths_tried([one]))


def test_lengths_are_tried_again_around_those_found_and_up_to_half_the_outline() -> None:
    def found(length: float) -> NoisePosterior:
        lengths = length * np.geomspace(0.98, 1.02, 5)
        return NoisePosterior(np.geomspace(0.001, 0.003, 3), lengths, (Cause(),), np.full((1, 3, 5), 1 / 15), 0.0)

    one = arch(TRUTH, 100)
    around = lengths_tried([one], found(0.02))
    assert 0.002 < around[0] < 0.02 < around[-1] < 0.2
    assert lengths_tried([one], found(0.9))[-1] == pytest.approx(0.5 * one.lengths.sum())


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


def test_the_posterior_without_the_error_is_that_of_the_stated_noise() -> None:
    """But for uneven distances of the points; also where a model without error has no probability left."""
    seen = wrong(1, 0.02)
    found = infer_noise(surrogate(), [Observation(seen, ERRING)])
    assert found is not None
    assert found.without is not None
    stated = WhitenedOffset(PointErrors(0.001))
    one, other = arch(TRUTH), arch(TRUTH + np.array([0.004, 0.01]))
    difference = found.without.one({"": one}) - found.without.one({"": other})
    assert difference == pytest.approx(-0.5 * (stated(one, seen) - stated(other, seen)), rel=0.05)
    unknown = infer_noise(surrogate(), [Observation(seen, UnknownErrors(model_error=True))])
    assert unknown is not None
    assert unknown.without is not None
    assert unknown.without.levels.min() > 100 * 0.001**2
    plain = infer_noise(surrogate(), [Observation(seen, UnknownErrors())])
    assert plain is not None
    assert plain.without is None


def test_waves_have_the_covariance_of_the_process() -> None:
    line = Interface.polyline(np.stack([np.linspace(0.0, 2.0, 81), np.zeros(81)], axis=1))
    B = offset_waves(line) * offset_scales(line, 0.5, 0.15)
    found, t = B @ B.T, np.linspace(0.0, 1.0, 81)
    expected = 0.25 * np.exp(-np.abs(t[:, None] - t) / 0.15)
    inside = slice(25, 56)
    np.testing.assert_allclose(found[40, inside], expected[40, inside], atol=0.05)


@cache
def twice() -> FieldSurrogate:
    """Return a surrogate of two conditions of the same arch."""
    x = LOW + (HIGH - LOW) * qmc.Sobol(2, seed=np.random.default_rng(1)).random(16)
    return fit_field(FieldTraining(x, [{"a": arch(row), "b": arch(row)} for row in x], None, LOW, HIGH))


@pytest.mark.parametrize(("apart", "found"), [(0.0, False), (0.03, True)])
def test_an_input_that_differs_between_conditions_is_noticed(apart: float, found: bool) -> None:
    errors, unknown = PointErrors(0.001), UnknownErrors(0.001, 0.0, spread=(0,))
    half = np.array([0.5 * apart, 0.0])
    heights = {"a": TRUTH + half, "b": TRUTH - half}
    seen = [
        Observation(errors.draw(arch(x, 200), np.random.default_rng(k)), unknown, name)
        for k, (name, x) in enumerate(heights.items())
    ]
    inferred = infer_noise(twice(), seen)
    assert inferred is not None
    assert (inferred.posterior.probability_of_model_error > 0.95) == found
    assert (inferred.posterior.spread > 0.05) == found


def test_waves_of_a_closed_outline_are_alike_everywhere() -> None:
    """Sines count as much as cosines: the covariance depends on the distance along the outline alone."""
    angle = np.linspace(0.0, 2 * np.pi, 80, endpoint=False)
    ring = Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)
    B = offset_waves(ring) * offset_scales(ring, 0.5, 0.15)
    found = B @ B.T
    rolled = np.array([np.roll(found[k], -k) for k in range(80)])
    np.testing.assert_allclose(rolled, np.tile(rolled[0], (80, 1)), atol=1e-12)
    near = np.arange(20) / 80
    np.testing.assert_allclose(rolled[0, :20], 0.25 * np.exp(-near / 0.15), atol=0.05)


def test_each_of_three_conditions_has_its_own_deviation_of_an_input() -> None:
    x = LOW + (HIGH - LOW) * qmc.Sobol(2, seed=np.random.default_rng(1)).random(16)
    fields = [{name: arch(row) for name in "abc"} for row in x]
    unknown = UnknownErrors(0.001, 0.0, spread=(0,))
    seen = [Observation(arch(TRUTH, number), unknown, name) for name, number in (("a", 20), ("b", 30), ("c", 40))]
    errors = tuple(PointErrors(0.001) for _ in seen)
    lin = linearise(fit_field(FieldTraining(x, fields, None, LOW, HIGH)), JointErrors(tuple(seen), errors))
    columns = causes_of(lin, seen, unknown).columns
    assert columns.shape == (90, 3)
    expected = np.zeros((90, 3))
    for k, part in enumerate((slice(0, 20), slice(20, 50), slice(50, 90))):
        expected[part, k] = lin.scaled[part, 0]
    np.testing.assert_array_equal(columns, expected)


@pytest.mark.parametrize("truth", [[0.4, 0.2], [0.2, -0.1]], ids=["upper corner", "lower corner"])
def test_no_interface_outside_the_box_is_asked_for(truth: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    known, asked, mean = surrogate(), [], FieldSurrogate.mean

    def noting(self: FieldSurrogate, x: np.ndarray) -> np.ndarray:
        asked.append(x)
        return mean(self, x)

    monkeypatch.setattr(FieldSurrogate, "mean", noting)
    seen = Observation(arch(np.array(truth), 200), ERRORS)
    lin = linearise(known, JointErrors((seen,), (ERRORS,)))
    np.testing.assert_allclose(lin.at, truth, atol=1e-3)
    points = np.concatenate(asked)
    assert (points >= LOW).all()
    assert (points <= HIGH).all()
