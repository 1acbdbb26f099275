"""Which wrong models the misfit section notices, and how often it raises a false alarm.

A single observation of a slightly wrong model may look right by chance, so that model is observed many times.

    python -m verification.validation.misfit_power [--wrong 50] [--right 200] [--no-biofilm]
"""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from verification.validation.tables import Table

import strandline as sl
from strandline.calibration.misfit import Misfit

X = np.linspace(0.0, 1.0, 21)
SD = 0.01
RATES = (("V50", 50.0), ("V100", 100.0), ("V125", 125.0))
Model = Callable[[Mapping[str, float], Path], sl.Interface] | sl.Biofilm
FINE = sl.PointErrors(0.001)
"""Noise of the observed biofilm: independent, 1 µm."""


def curve(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return y = p x + q x² over [0, 1] at 21 points, mm."""
    return sl.Interface.polyline(np.column_stack([X, inputs["p"] * X + inputs["q"] * X**2]))


def curve_in_micrometres(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the same curve, 1 mm to the right and in µm, as if these were mm."""
    points = curve(inputs, workdir).points + np.array([1.0, 0.0])
    return sl.Interface.polyline(1e3 * points)


def judged(
    model: Model,
    parameters: tuple[sl.Parameter, ...],
    observations: tuple[sl.Observation, ...],
    *,
    runs: int,
    fixed: Mapping[str, float] | None = None,
    executor: sl.LocalProcesses | None = None,
) -> tuple[Misfit, sl.Posterior]:
    """Return the verdict on a calibration by a field learnt from Sobol runs."""
    problem = sl.Problem(
        model, sl.ParameterSpace(parameters), fixed or {}, observations, {"normal_offset": sl.NormalOffset()}
    )
    settings = sl.Settings(
        runs=runs, surrogate="field", particles=2000, smc=sl.SMCSettings(rejuvenation_steps=10, zeta=0.5)
    )
    found = sl.calibrate(problem, settings, executor=executor)
    assert found.misfit is not None
    return found.misfit, found.posterior


def of_curve(
    seed: int, wrong: float = 0.0, *, shift: tuple[float, float] = (0.0, 0.0), model: Model = curve
) -> tuple[Misfit, sl.Posterior]:
    """Return the verdict on a curve to which `wrong` x sin 3πx was added, or that is shifted."""
    random = np.random.default_rng(seed)
    truth = 0.5 * X - 0.2 * X**2 + wrong * X * np.sin(3 * np.pi * X)
    seen = np.column_stack([X, truth + SD * random.standard_normal(len(X))]) + shift
    parameters = (sl.Parameter("p", sl.Uniform(0, 1), "1"), sl.Parameter("q", sl.Uniform(-0.6, 0.2), "1/mm"))
    observed = sl.Observation(sl.Interface.polyline(seen), sl.PointErrors(SD))
    return judged(model, parameters, (observed,), runs=16)


def of_biofilm(material: str) -> tuple[Misfit, sl.Posterior]:
    """Return the verdict on a biofilm of this law, observed as a Saint-Venant–Kirchhoff one at three inflows."""
    true = sl.Biofilm(inflow_rates=RATES)({"E": 400.0, "nu": 0.3})
    random = np.random.default_rng(5)
    seen = tuple(sl.Observation(FINE.draw(one, random), FINE, name) for name, one in true.interfaces.items())
    parameters = (
        sl.Parameter("E", sl.Uniform(250, 600), "Pa"),
        sl.Parameter("nu", sl.Uniform(-0.2, 0.48), "1"),
    )
    model = sl.Biofilm(inflow_rates=RATES, material=material)
    return judged(model, parameters, seen, runs=48, executor=sl.LocalProcesses())


def row(case: str, found: Misfit, off: Float[np.ndarray, " dim"] | None = None) -> tuple[object, ...]:
    """Return a row of the table."""
    apart = "" if off is None else ", ".join(f"{one:.1f}" for one in off)
    return case, apart, found.p_value, found.predictive_p, "yes" if found.flagged else "no", found.verdict


def often(number: int, wrong: float = 0.03) -> None:
    """Print how many of the observations of a slightly wrong model are flagged, and how far off the inputs are."""
    results = [of_curve(300 + seed, wrong) for seed in range(number)]
    if results:
        flagged = sum(found.flagged for found, _ in results)
        off = np.mean([(posterior.mean - [0.5, -0.2]) / posterior.sd for _, posterior in results], axis=0)
        least = [min(found.p_value, found.predictive_p, found.smooth_p or 1.0) for found, _ in results]
        print(
            f"{wrong:g} x sin 3πx added, inputs off by {off[0]:.1f}, {off[1]:.1f} sd on average: {flagged} of {number} "
            f"observations flagged; smallest p, median {np.median(least):.1g}",
            flush=True,
        )


def main() -> None:
    """Print a table of wrong models, then the share of false alarms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wrong", type=int, default=50, help="number of observations of a slightly wrong model")
    parser.add_argument("--right", type=int, default=200, help="number of right studies")
    parser.add_argument("--no-biofilm", action="store_true")
    options = parser.parse_args()
    rows = []
    for wrong in (0.0, 0.03, 0.08):
        found, posterior = of_curve(1, wrong)
        rows.append(row(f"{wrong:g} x sin 3πx added", found, (posterior.mean - [0.5, -0.2]) / posterior.sd))
    rows.append(row("observation shifted by 50 µm", of_curve(1, shift=(0.0, 0.05))[0]))
    rows.append(row("simulator in µm, observation in mm", of_curve(1, shift=(1.0, 0.0), model=curve_in_micrometres)[0]))
    if not options.no_biofilm:
        for material in ("saint_venant_kirchhoff", "neo_hookean"):
            found, posterior = of_biofilm(material)
            rows.append(row(material, found, (posterior.mean - [400.0, 0.3]) / posterior.sd))
    columns = ("case", "inputs off, sd", "p", "p of d²", "flagged", "verdict")
    print(Table("misfit_power", "Wrong models", columns, ("s", "s", ".4f", ".4f", "s", "s"), tuple(rows)).markdown())
    often(options.wrong)
    alarms = sum(of_curve(100 + seed)[0].flagged for seed in range(options.right))
    print(f"false alarms: {alarms} of {options.right} right studies")


if __name__ == "__main__":
    main()
