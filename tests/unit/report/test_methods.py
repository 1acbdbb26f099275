"""The paragraph for a paper says what the summary says, and what does not speak for the result."""

import re
from pathlib import Path
from typing import Any

from strandline.report.methods import BIBTEX, methods_paragraph

POINTS = {"point_sd": 0.003, "correlation_length": 0.05}
SUMMARY: dict[str, Any] = {
    "version": "0.2.0",
    "truth": None,
    "inputs": {
        "E": {
            "label": "E", "unit": "Pa", "mean": 396.1, "sd": 30.4, "nuisance": False,
            "prior": "Uniform: low 100, high 800",
        },
        "V_in": {
            "label": "V_in", "unit": "mm^2/s", "mean": 101.0, "sd": 4.9, "nuisance": True,
            "prior": "Normal: mean 100, sd 5",
        },
    },
    "fixed": {"nu": 0.3},
    "likelihood": {
        "discrepancy": "currents", "options": "Currents: width 0.005", "unit": "mm²", "noise_variance": 0.0005,
    },
    "runs": {"ok": 24, "failed": 2, "by_kind": {"continuation_stalled": 2}},
    "refinement": [],
    "surrogate": {"kind": "log_likelihood"},
    "measures": {"currents": {"n_train": 24}},
    "sampler": {
        "particles": 5000, "ess": 4733.7, "rejuvenation_steps": 15, "zeta": 0.5, "tempering_steps": 6,
    },
    "quadrature_check": None,
    "certificate": None,
    "nearest": {"message": None},
    "misfit": {"flagged": False, "p": 0.43},
}  # fmt: skip
CONVERGED = {"converged": True, "check": {"draws": 16, "by": "runs at draws of the posterior"}}
FIELD = {"kind": "field", "modes": 4, "n_train": 24, "predicted_error_um": {"median": 0.0346}}


def test_it_has_the_numbers_of_the_study() -> None:
    found = methods_paragraph(SUMMARY)
    for words in (
        "We inferred E from the observed shape of the interface, with V_in uncertain, by Bayesian calibration",
        "with strandline 0.2.0.",
        "uniform (low 100, high 800) for E in Pa and normal (mean 100, sd 5) for V_in in mm² s⁻¹.",
        "nu = 0.3 was known.",
        "the RKHS norm of the difference of their surface currents (width 0.005), with Gaussian noise of variance",
        "We made 26 forward runs, 2 of which failed (2 × continuation stalled), from a Sobol design.",
        "surrogate of the log-likelihood (24 runs)",
        "5000 particles (4734 effective), 15 rejuvenation steps and ζ = 0.5, in 6 tempering steps.",
        "The model explains the observation within the noise (p = 0.43).",
        "Posterior means and standard deviations are E = 396 ± 30 Pa.",
    ):
        assert words in found.replace("\u00a0", " "), words


DIFFERENCES: list[tuple[dict[str, Any], str]] = [
    ({"misfit": {"flagged": True, "p": 0.001}}, "The model does not explain the observation within the noise"),
    ({"nearest": {"message": "far"}}, "No forward run comes near the observation"),
    ({"certificate": {"converged": False}}, "ended before the posterior was confirmed by the true model"),
    ({"certificate": CONVERGED}, "The true model confirmed the posterior at 16 runs at draws of the posterior."),
    ({"certificate": CONVERGED}, "chosen one batch after the other where the posterior lies"),
    ({"refinement": [{}]}, "from a Sobol design that was refined where the posterior lies"),
    ({"surrogate": FIELD}, "surrogate of the interface (4 modes, 24 runs)"),
    ({"surrogate": FIELD}, "its error where the posterior lies is 0.035 µm"),
    ({"truth": {"E": 400}}, "We inferred E from a synthetic observation"),
    ({"likelihood": {**SUMMARY["likelihood"], **POINTS}}, "of 3 µm, correlated over 50 µm along the interface."),
    (
        {"likelihood": {**SUMMARY["likelihood"], "inferred_noise": {}}},
        "that were inferred from the residuals.",
    ),
    ({"fixed": {}}, "Simulated and observed"),
    (
        {"quadrature_check": {"converged": True, "max_mean_error_sd": 0.0123}},
        "Means by quadrature of the same surrogate differ by at most 0.012 standard deviations.",
    ),
    ({"runs": {"ok": 24, "failed": 0, "by_kind": {}}}, "We made 24 forward runs, from a Sobol design."),
]


def test_it_says_what_differs() -> None:
    plain = methods_paragraph(SUMMARY)
    for changes, words in DIFFERENCES:
        other = methods_paragraph({**SUMMARY, **changes})
        assert words in other, words
        assert plain != other


def test_references_have_the_version_and_balanced_braces() -> None:
    text = BIBTEX.format(version="1.2.3")
    assert "version = {1.2.3}" in text
    assert text.count("{") == text.count("}")
    kinds = re.findall(r"^@(\w+)\{(\w+),", text, flags=re.M)
    assert kinds == [("article", "willmann2022bayesian"), ("software", "strandline")]
    citation = (Path(__file__).parents[3] / "CITATION.cff").read_text("utf-8")
    assert "10.1186/s40323-022-00237-5" in text
    assert "10.1186/s40323-022-00237-5" in citation


def test_a_model_error_and_the_errors_of_the_whole_interface_are_said() -> None:
    error = {"probability": 0.98, "amplitude_um": 3.9, "amplitude_quantiles_um": {"median": 4.09}}
    inferred = {"stated": True, "prior": {"sd_um": 1.26, "length_um": 38.6}, "model_error": error}
    whole = {"shift_sd": 0.1, "rotation_sd": 3.0, "scale_sd": 0.01, "offset_sd": 0.0}
    likelihood = {**SUMMARY["likelihood"], "inferred_noise": inferred, **whole}
    misfit = {"flagged": False, "p": 0.4, "region_p": 0.3}
    text = methods_paragraph({**SUMMARY, "misfit": misfit, "likelihood": likelihood})
    assert "with errors of the observed points of 1.26 µm, correlated over 38.6 µm along the interface, and a" in text
    assert "a model error of probability 0.98 and median amplitude 4.09 µm, both inferred" in text
    assert "marginalised: 100 µm in position, 3° in rotation and 1 % in scale (standard deviations)" in text
    assert "The model explains the observation within the noise and the model error (p = 0.4)." in text


def test_the_smallest_p_value_is_that_of_a_model_that_does_not_fit() -> None:
    text = methods_paragraph({**SUMMARY, "misfit": {"flagged": True, "p": 1.0, "region_p": 0.006, "smooth_p": None}})
    assert "The model does not explain the observation within the noise (p = 0.006)." in text
