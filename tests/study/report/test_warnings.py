"""Each warning is there where it is deserved, alone, and not elsewhere; the paragraph for a paper says it too."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.study.conftest import Finished
from tests.unit.report.fits import BAD, FINE, condition, misfit

from strandline.calibration import Calibration
from strandline.calibration.sampler_check import SamplerCheck, Split
from strandline.cli import main
from strandline.design.active import BatchCheck, Certificate, Step, VarianceEffect
from strandline.discrepancy import NormalOffset
from strandline.interface import Interface
from strandline.posterior import laplace
from strandline.report.page import methods_paragraph
from strandline.report.warnings import LOO_LIMIT, field_warnings, find_warnings, reason_to_doubt
from strandline.runs import RunRecord


def put(whole: Any, place: str, **changes: Any) -> Any:
    """Return a frozen dataclass with other fields at a place, such as ``field.knowledge``."""
    if not place:
        return replace(whole, **changes)
    head, _, rest = place.partition(".")
    return replace(whole, **{head: put(getattr(whole, head), rest, **changes)})


@pytest.fixture
def good(beam: Finished) -> Calibration:
    """The finished calibration, its sampler's result put on that of the quadrature so that no warning is due."""
    calibration = beam.outcome.calibration
    posterior = calibration.posterior
    return validated(put(calibration, "quadrature", mean=posterior.mean, sd=posterior.sd, converged=True), 0.1)


def validated(calibration: Calibration, loo_rms_near_mode: float) -> Calibration:
    surrogate = put(calibration.surrogate, "validation", loo_rms_near_mode=loo_rms_near_mode)
    return replace(calibration, surrogates={"tracked_points": surrogate})


def with_failures(calibration: Calibration, number: int) -> Calibration:
    records = [replace(record, state="failed", interfaces={}) for record in calibration.records[:number]]
    return replace(calibration, records=(*records, *calibration.records[number:]))


def moved(calibration: Calibration, column: int, share: float, value: float) -> Calibration:
    """Put the first `share` of the particles' weight at one place of the unit cube."""
    posterior = calibration.posterior
    unit = posterior.space.to_unit(posterior.draws.copy())
    unit[np.cumsum(posterior.weights) <= share, column] = value
    changed = replace(posterior, draws=posterior.space.to_physical(unit))
    return put(replace(calibration, posterior=changed), "quadrature", mean=changed.mean, sd=changed.sd)


def raised(calibration: Calibration) -> Calibration:
    """Log-likelihoods far above 0, which are impossible."""
    return put(calibration, "posterior", log_likelihood=calibration.posterior.log_likelihood + 50.0)


def with_halves(calibration: Calibration, difference: float) -> Calibration:
    """The halves of the sampler have means that differ by so many standard deviations, all else is alike."""
    means = {"mean_difference": np.array([difference, 0.0]), "mean_error": np.full(2, 0.09)}
    sds = {"log_sd_ratio": np.zeros(2), "log_sd_error": np.full(2, 0.06)}
    evidence = {"log_evidence": (-3.0, -3.0), "log_evidence_error": 0.2}
    names, splits = calibration.problem.space.names, (Split("E", 400.0, (0.5, 0.5)),)
    check = SamplerCheck(names=names, effective=(1000.0, 900.0), **means, **sds, **evidence, splits=splits)
    return replace(calibration, sampler_check=check)


def of_one_draw(calibration: Calibration) -> Calibration:
    """The last weighting leaves one of many particles."""
    log_weights = np.full(calibration.posterior.number, -1000.0)
    log_weights[calibration.posterior.map_index] = 0.0
    return put(replace(calibration, quadrature=None), "posterior", log_weights=log_weights)


def excluded(calibration: Calibration) -> Calibration:
    """A third of the runs are excluded by hand; none failed."""
    first = [replace(record, state="excluded", interfaces={}) for record in calibration.records[:24]]
    return replace(calibration, records=(*first, *calibration.records[24:]))


def unobserved(calibration: Calibration) -> Calibration:
    """The model has another condition, whose interface comes in steps; nobody observed it."""
    tips = [record.interfaces[""].points[-1, 1] for record in calibration.records]
    step = np.ptp(tips) / 5

    def stepped(record: RunRecord) -> RunRecord:
        x, y = record.interfaces[""].points.T
        other = Interface.polyline(np.stack([x, step * np.round(y / step)], axis=1))
        return replace(record, interfaces={**record.interfaces, "other": other})

    return replace(calibration, records=tuple(map(stepped, calibration.records)))


def printed(calibration: Calibration) -> Calibration:
    """The simulator prints two significant digits."""

    def few(record: RunRecord) -> RunRecord:
        x, y = record.interfaces[""].points.T
        rounded = [float(f"{one:.1e}") for one in y]
        return replace(record, interfaces={"": Interface.polyline(np.stack([x, rounded], axis=1))})

    return replace(calibration, records=tuple(map(few, calibration.records)))


def hung(calibration: Calibration) -> Calibration:
    """The first run hangs; all others took a tenth of a second, whatever else this machine did."""
    first, *others = (replace(record, seconds=0.1) for record in calibration.records)
    return replace(calibration, records=(replace(first, state="timeout", interfaces={}, seconds=60.0), *others))


LIMITS: list[tuple[Callable[[Calibration, Any], Calibration], float, float, str]] = [
    (with_failures, 20, 19, "20 of 64 forward runs failed"),
    (validated, 0.6, 0.5, "leave-one-out error near the mode is 0.6"),
    (lambda c, ess: put(c, "sampling", ess=ess), 99.0, 101.0, "Only 99 effective samples among 1000"),
    (lambda c, by: put(c, "quadrature", mean=c.posterior.mean + by * c.posterior.sd), 0.06, 0.04, "up to 0.060"),
    (lambda c, by: put(c, "quadrature", sd=by * c.posterior.sd), 1.07, 1.04, "standard deviations by up to 6.5%"),
    (with_halves, -0.4, 0.25, "1000 and 900 effective samples explain (p = 5e-05): means by up to 0.40"),
    (lambda c, at: moved(c, 0, 0.05, at), 0.01, 0.03, "E reaches the lower end of its box, 300 Pa: "),
    (lambda c, share: moved(c, 1, share, 0.99), 0.05, 0.005, "tilt reaches the upper end of its box, 0.04: "),
]
"""Changes, a number that deserves a warning, one just below the limit, and the warning."""
OTHERS: list[tuple[Callable[[Calibration], Calibration], str]] = [
    (raised, "DO NOT TRUST"),
    (of_one_draw, "Only 1 effective samples among 1000"),
    (lambda c: put(c, "quadrature", converged=False), "has not converged"),
    (
        lambda c: moved(moved(moved(c, 0, 0.05, 0.01), 1, 0.1, 0.01), 1, 0.04, 0.99),
        "posterior reaches 3 ends of its box, with the mass within 2% of each: E from 300 Pa (",
    ),
    (lambda c: put(c, "posterior", log_likelihood=0.0 * c.posterior.log_likelihood, log_evidence=0.0), "tell nothing"),
    (lambda c: put(c, "misfit", flagged=None, verdict="The best run does not"), "The best run does not"),
    (excluded, "24 runs were excluded by hand"),
    (printed, "mm on average (significant digits: 2), "),
    (hung, "`timeout: 1` would save most of that"),
    (lambda c: replace(c, laplace=laplace(np.diag([-1.0, 1.0]), c.posterior.map_estimate)), "no Laplace approximation"),
]


def test_exactly_the_one_that_is_deserved_and_none_just_below_a_limit(good: Calibration) -> None:
    deserved = [(change(good, bad), words) for change, bad, _, words in LIMITS]
    for calibration, words in (*deserved, *((change(good), words) for change, words in OTHERS)):
        found = list(find_warnings(calibration))
        assert len(found) == 1, (words, found)
        assert words in found[0]
    for fine in (
        good,
        unobserved(good),
        replace(good, quadrature=None),
        *(change(good, below) for change, _, below, _ in LIMITS),
    ):
        assert not list(find_warnings(fine))


def test_a_posterior_half_of_which_lies_where_runs_fail(good: Calibration) -> None:
    mean, records = good.posterior.mean[0], list(good.records)
    records = [replace(one, state="failed", interfaces={}) if one.inputs["E"] > mean else one for one in records]
    told = [words for words in find_warnings(replace(good, records=tuple(records))) if "likely to fail" in words]
    (share,) = [float(words.partition("%")[0]) for words in told]
    assert 30 < share < 70


def test_an_observation_that_was_turned_and_a_model_that_does_not_fit(good: Calibration, field: Finished) -> None:
    """Only a surrogate of the field, with the measure normal_offset, can let the model err."""
    (warning,) = find_warnings(good, turned=("slow",))
    assert warning.startswith("The observed points of slow ran")
    flagged = misfit(condition(BAD))
    assert list(find_warnings(replace(good, misfit=flagged))) == [f"{flagged.verdict} Find out what is wrong."]
    able = put(field.outcome.calibration, "problem", discrepancies={"normal_offset": NormalOffset()})
    remedy = " Find out what is wrong, or let the model err: `model_error: true` in `noise`."
    assert next(find_warnings(replace(able, misfit=flagged))) == flagged.verdict + remedy
    assert not list(find_warnings(replace(good, misfit=misfit(condition(FINE)))))


def test_reasons_to_doubt(good: Calibration, field: Finished) -> None:
    """The first counts."""
    assert reason_to_doubt(good) is reason_to_doubt(good, {"verdict": "good"}) is None
    assert "check with the true model" in str(reason_to_doubt(good, {"verdict": "bad"}))
    assert "leave-one-out error near the mode 0.9" in str(reason_to_doubt(validated(good, LOO_LIMIT + 0.4)))
    assert reason_to_doubt(good, far=True) == "no run comes near what was observed"
    wrong = "the model does not explain what was observed"
    assert reason_to_doubt(put(good, "misfit", flagged=True)) == wrong
    assert "above 0" in str(reason_to_doubt(raised(good)))
    certificate = Certificate(False, ("all 30 runs that were allowed are made",), (), (), None)
    unsure = put(field.outcome.calibration, "field", certificate=certificate)
    assert reason_to_doubt(unsure) == "not converged, all 30 runs that were allowed are made"
    assert reason_to_doubt(put(unsure, "misfit", flagged=True)) == wrong
    assert reason_to_doubt(put(unsure, "field.certificate", converged=True)) is None


def test_each_doubt_about_a_surrogate_of_the_field_is_told_alone(field: Finished) -> None:
    def told(**changes: Any) -> list[str]:
        return list(field_warnings(calibration, replace(calibration.field, **changes)))

    calibration, reasons = field.outcome.calibration, ("all 30 runs that were allowed are made",)
    known = calibration.field.knowledge
    late = replace(known, ok=known.ok & (np.arange(len(known.ok)) != known.ok.argmax()))
    step = Step(30, 27, "check", np.zeros(2), np.ones(2), 1e-4, None, None, BatchCheck(25, 3, None, True, ()))
    for changes, words in (
        ({"certificate": Certificate(False, reasons, (), (), None)}, f"NOT CONVERGED: {reasons[0]}."),
        ({"certificate": Certificate(True, (), (), (), None, 0.3, overlooks=True)}, "as design.active.unseen asks"),
        ({"effect": VarianceEffect(np.array([0.0, -0.3]), np.ones(2), 0.5)}, "by up to 0.3 standard deviations"),
        ({"effect": VarianceEffect(np.zeros(2), np.array([1.0, 1.5]), 0.5)}, "standard deviations by up to 50%"),
        ({"knowledge": late}, "1 run ended after the last batch was chosen"),
        ({"feasible": 0.9}, "10% of the posterior lies where runs are likely to fail"),
        ({"certificate": Certificate(True, (), (step,), (), step)}, "3 of 25 runs at draws of the posterior failed"),
    ):
        (line,) = told(**changes)
        assert words in line
    unsure = Certificate(False, reasons, (), (), None)
    stopped, _ = told(certificate=unsure, feasible=0.5)
    assert "More runs do not help: find out why they fail" in stopped
    flagged, stuck = put(calibration, "misfit", flagged=True), replace(calibration.field, certificate=unsure)
    assert "More runs do not help while the model does not explain" in next(field_warnings(flagged, stuck))
    for fine in ({}, {"certificate": Certificate(True, reasons, (), (), None)}, {"feasible": 0.96}):
        assert told(**fine) == []


def test_a_surrogate_that_moves_points_or_knows_nothing_is_told(field: Finished) -> None:
    """Variances 10¹⁰ times as large: every value of the nuisance input is a guess then."""
    calibration, place = field.outcome.calibration, "knowledge.likelihood.surrogate"
    surrogate = calibration.field.knowledge.likelihood.surrogate
    layouts = {name: replace(layout, way="arclength") for name, layout in surrogate.layouts.items()}
    moved_points = put(calibration.field, place, layouts=layouts, registration_error=0.002)
    (line,) = field_warnings(calibration, moved_points)
    assert "by arclength, which moves them by up to 2 µm" in line
    wide = tuple(replace(process, widening=1e10 * process.widening) for process in surrogate.processes)
    unsure = put(calibration.field, place, processes=wide)
    (line,) = field_warnings(calibration, unsure)
    assert line.startswith("The cut reading is a guess for 2 of its 2 values")
    assert not list(field_warnings(replace(calibration, under_uncertainty=None), unsure))


def observed_otherwise(folder: Path, points: Any, **changes: Any) -> dict[str, Any]:
    """Run a copied study again with these observed points, and return its summary; its runs are known already."""
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    content = yaml.safe_load((folder / "study.yaml").read_text())
    content |= {"observation": {"file": "observed.csv", "unit": "mm"}, **changes}
    (folder / "study.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    main(["run", str(folder), "--quiet"])
    return dict(json.loads((folder / "summary.json").read_text("utf-8")))


def points_of(finished: Finished) -> np.ndarray:
    (seen,) = finished.outcome.calibration.problem.observations
    return np.asarray(seen.interface.points)


def test_an_observation_elsewhere_is_told_first(field: Finished, copy_of: Any, capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("strandline.report.page.figure_groups", lambda *_: {})
    assert "COMES NEAR" not in (field.folder / "report.html").read_text("utf-8")
    folder = copy_of(field)
    summary = observed_otherwise(folder, points_of(field) + np.array([50.0, 0.0]))["nearest"]
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("NOTHING IN THE BOX COMES NEAR")
    assert (summary["near"], summary["message"]) == (False, last)
    page = (folder / "report.html").read_text("utf-8")
    first = page[page.index("for the result.</strong></p>") + 28 :].lstrip()
    assert first.startswith('<p class="warnings"><strong>NOTHING IN THE BOX COMES NEAR')


def test_a_reversed_contour_gives_the_same_posterior(beam: Finished, copy_of: Any) -> None:
    """Of a model without an undeformed state: the runs say from which end it is run through."""
    found = observed_otherwise(copy_of(beam), points_of(beam)[::-1], report="none")
    assert found["set_aside"] == []
    assert any("were turned round" in line for line in found["warnings"])
    for symbol, values in beam.outcome.summary["inputs"].items():
        same = found["inputs"][symbol]
        assert (same["mean"], same["sd"]) == pytest.approx((values["mean"], values["sd"]), rel=1e-6)


CONVERGED = {"converged": True, "check": {"draws": 16, "by": "runs at draws of the posterior"}}
SURROGATE = {"kind": "field", "modes": 4, "n_train": 24, "predicted_error_um": {"median": 0.0346}}
WORSE = {"flagged": True, "p": 1.0, "region_p": 0.006, "smooth_p": None}
ERROR = {"probability": 0.98, "amplitude_um": 3.9, "amplitude_quantiles_um": {"median": 4.09}}
INFERRED = {"inferred_noise": {"stated": True, "prior": {"sd_um": 1.26, "length_um": 38.6}, "model_error": ERROR}}
WHOLE = {"shift_sd": 0.1, "rotation_sd": 3.0, "scale_sd": 0.01, "offset_sd": 0.0}
DIFFERENCES = [
    ("misfit", WORSE, "The model does not explain the observation within the noise (p = 0.006)."),
    ("misfit", {**WORSE, "flagged": None}, "Whether the model explains the observation is not known."),
    ("certificate", CONVERGED, "The true model confirmed the posterior at 16 runs at draws of the posterior."),
    ("surrogate", SURROGATE, "the interface (4 modes, 24 runs) took the place of the model; its error where the"),
    ("truth", None, "from the observed shape of the interface, with V_in uncertain, by Bayesian calibration"),
    ("likelihood", {"point_sd": 0.003, "correlation_length": 0.05}, "of 3 µm, correlated over 50 µm along the inter"),
    ("likelihood", INFERRED, "model error of probability 0.98 and median amplitude 4.09 µm, both"),
    ("likelihood", WHOLE, "marginalised: 100 µm in position, 3° in rotation and 1 % in scale (standard deviations)"),
    ("runs", {"ok": 24, "failed": 2, "by_kind": {"limit_point": 2}}, "26 forward runs, 2 of which failed (2 × limit"),
]


def test_the_paragraph_for_a_paper_has_the_numbers_of_the_study_and_says_what_differs(beam: Finished) -> None:
    flow = {"label": "V_in", "unit": "mm^2/s", "prior": "Normal: mean 100, sd 5", "nuisance": True}
    stiffness = {"label": "E", "unit": "Pa", "prior": "Uniform: low 100, high 800", "nuisance": False}
    sampler = {"particles": 5000, "ess": 4733.7, "rejuvenation_steps": 15, "zeta": 0.5, "tempering_steps": 6}
    inputs = {"E": {**stiffness, "mean": 396.1, "sd": 30.4}, "V_in": flow}
    summary = {**beam.outcome.summary, "inputs": inputs, "sampler": sampler, "quadrature_check": None}
    plain = methods_paragraph(summary).replace("\u00a0", " ")
    for words in (
        "We inferred E from a synthetic observation, with V_in uncertain, by Bayesian calibration",
        "uniform (low 100, high 800) for E in Pa and normal (mean 100, sd 5) for V_in in mm² s⁻¹.",
        "We made 64 forward runs, from a Sobol design.",
        "5000 particles (4734 effective), 15 rejuvenation steps and ζ = 0.5, in 6 tempering steps.",
        "The model explains the observation within the noise (p = ",
        "Posterior means and standard deviations are E = 396 ± 30 Pa.",
    ):
        assert words in plain, words
    for key, value, words in DIFFERENCES:
        value = {**summary[key], **value} if key == "likelihood" else value
        assert words in methods_paragraph({**summary, key: value}).replace("\u00a0", " "), words
        assert words not in plain
