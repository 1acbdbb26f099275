"""The examples find what they are about."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from scipy.special import softmax
from tests.check.test_examples import ROOT, module_of

pytestmark = pytest.mark.long


def run(script, folder):
    """Run `script` in an interpreter of its own in `folder` and return what it printed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    kept = {"capture_output": True, "text": True, "timeout": 500}
    done = subprocess.run([sys.executable, str(script)], cwd=folder, env=environment, **kept)
    assert done.returncode == 0, done.stderr
    return done.stdout


def found(text, name):
    """Return mean and sd of `name` from a line such as ``E = 404 ± 4 Pa``."""
    match = re.search(rf"^{name} = ([-+.\de]+) ± ([-+.\de]+)", text, re.MULTILINE)
    assert match, text
    return float(match[1]), float(match[2])


def exact_moments(measured, unit_deflection, noise):
    """Return mean and sd of E ~ U(94, 1000) from Gaussian deflections w/E, by a fine sum."""
    E = np.linspace(94.0, 1000.0, 100_001)
    misfit = (measured - unit_deflection / E[:, None]) / noise
    weight = softmax(-0.5 * np.sum(misfit**2, axis=1))
    mean = weight @ E
    return mean, np.sqrt(weight @ (E - mean) ** 2)


def agrees(found, exact):
    """Tell whether a mean and a standard deviation are the exact ones within the noise of 2000 particles."""
    return abs(found[0] - exact[0]) < 0.12 * exact[1] and abs(found[1] / exact[1] - 1.0) < 0.12


def test_own_model_finds_the_exact_posterior(tmp_path):
    script = ROOT / "examples" / "own_model.py"
    example = module_of(script)
    points = example.measured().points
    nodes = [int(np.argmin(np.abs(points[:, 0] - x))) for x in example.STATIONS]
    stiff = example.beam({"E": 1.0e6, "q": example.PRESSURE}, tmp_path).points[nodes, 1] * 1.0e6
    exact = exact_moments(points[nodes, 1], stiff, example.NOISE)
    printed = found(run(script, tmp_path), "E")
    assert agrees(printed, exact)
    assert abs(printed[0] - example.TRUE_E) < 2 * printed[1]
    planted = exact_moments(points[nodes, 1], stiff, example.NOISE * np.sqrt(2.0))  # σ² without its ½
    assert not agrees(printed, planted)


def test_biofilm_finds_the_truth_and_repeats_no_run(tmp_path):
    script = ROOT / "examples" / "biofilm.py"
    first = run(script, tmp_path)
    assert_biofilm(first)
    before = (tmp_path / "ledger.sqlite").stat().st_size
    assert run(script, tmp_path) == first
    assert (tmp_path / "ledger.sqlite").stat().st_size - before < 50_000  # a session, and no 200 interfaces


def assert_biofilm(printed):
    for name, truth, widest in (("E", 400.0, 60.0), ("nu", 0.3, 0.2)):
        mean, sd = found(printed, name)
        assert abs(mean - truth) < 2 * sd
        assert 0 < sd < widest
