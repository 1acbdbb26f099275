"""A study with a length scale for each input, from study.yaml to the report."""

import json
from pathlib import Path

import numpy as np
import pytest

from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study


@pytest.mark.long
def test_the_lengths_of_all_inputs_are_told(tmp_path: Path) -> None:
    kernel = {"log_likelihood": {"kernel": "matern32_product"}}
    folder = write_study(tmp_path / "beam", surrogate=kernel)
    outcome = run_study(load_study(folder), executor=InProcess())
    lengths = json.loads((folder / "summary.json").read_text("utf-8"))["surrogate"]["hyperparameters"]["length_scale"]
    np.testing.assert_allclose(lengths, outcome.calibration.surrogate.process.length_scale)
    assert len(lengths) == 2
    assert ", ".join(f"{length:.3g}" for length in lengths) in outcome.report.read_text("utf-8")
    assert outcome.summary["quadrature_check"]["max_mean_error_sd"] < 0.1
