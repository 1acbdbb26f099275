"""Calibrate a simulator of your own: a plain function that returns an interface.

A clamped beam, 1 mm long and 0.2 mm high, bends under a uniform pressure. Its outline is measured at ten places with a
noise of 2 µm; how stiff is it? Any program can take the place of the formula: write its input into `workdir`, run it,
read the deformed interface. Takes a few seconds:  python examples/own_model.py
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

import strandline as sl

LENGTH, HEIGHT = 1.0, 0.2  # mm
PRESSURE = 0.25  # Pa
TRUE_E = 400.0  # Pa
NOISE = 0.002  # mm, standard deviation
STATIONS = 0.05 + 0.1 * np.arange(10)  # mm from the clamp


def beam(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the beam's bent axis, mm: w = q x² (6L² - 4Lx + x²) / 2Eh³ (Euler–Bernoulli, I = h³/12)."""
    x = np.linspace(0.0, LENGTH, 21)
    w = inputs["q"] * x**2 * (6 * LENGTH**2 - 4 * LENGTH * x + x**2) / (2 * inputs["E"] * HEIGHT**3)
    if w[-1] > LENGTH / 2:
        raise sl.ForwardModelError("large_deflection", f"the tip moves by {w[-1]:.2g} mm: too much for linear theory")
    return sl.Interface.polyline(np.stack([x, w], axis=1))


def measured() -> sl.Interface:
    """Return what the microscope would see of a beam of stiffness `TRUE_E`."""
    clean = beam({"E": TRUE_E, "q": PRESSURE}, Path())
    noise = NOISE * np.random.default_rng(7).standard_normal(len(clean.points))
    return sl.Interface.polyline(clean.points + np.stack([np.zeros_like(noise), noise], axis=1))


def calibrated() -> sl.Calibration:
    """Return the posterior of E."""
    problem = sl.Problem(
        model=beam,
        space=sl.ParameterSpace((sl.Parameter("E", sl.Uniform(50.0, 1000.0), "Pa"),)),
        fixed={"q": PRESSURE},
        observations=(sl.Observation(measured(), NOISE**2),),
        discrepancies={"lines": sl.MeasurementLines([(x, 0.0, 0.0, 1.0) for x in STATIONS])},
    )
    settings = sl.Settings(runs=64, particles=2000, smc=sl.SMCSettings(rejuvenation_steps=10, zeta=0.9))
    # Runs in this process, as suits a formula; give a real simulator executor=sl.LocalProcesses(), ledger="…"
    return sl.calibrate(problem, settings)


if __name__ == "__main__":  # worker processes import this file: what starts runs stands under this line
    posterior = calibrated().posterior
    mean, sd = posterior.mean[0], posterior.sd[0]
    print(f"E = {mean:.2f} ± {sd:.2f} Pa, truth {TRUE_E:.0f} Pa")
    assert abs(mean - TRUE_E) < 2 * sd
