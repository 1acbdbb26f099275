"""Which wrong models the misfit section notices, and how often it raises a false alarm.

A single observation of a slightly wrong model may look right by chance, so that model is observed many times.

    python -m verification.validation.misfit_power [--wrong 50] [--right 200]
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from verification.validation.tables import arguments, show, table

import strandline as sl
from strandline.calibration.misfit import Misfit

X = np.linspace(0.0, 1.0, 21)
SD = 0.01
CURVE = (0.5, -0.2)
RATES = (("V50", 50.0), ("V100", 100.0), ("V125", 125.0))
FINE = sl.PointErrors(0.001)
"""Noise of the observed biofilm: independent, 1 µm."""


def curve(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return y = p x + q x² over [0, 1] at 21 points, mm; factors `by_p` and `by_q` act with p and q alone."""
    p, q = (inputs[name] * inputs.get(f"by_{name}", 1.0) for name in "pq")
    return sl.Interface.polyline(np.column_stack([X, p * X + q * X**2]))


def curve_in_micrometres(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the same curve, 1 mm to the right and in µm, as if these were mm."""
    points = curve(inputs, workdir).points + np.array([1.0, 0.0])
    return sl.Interface.polyline(1e3 * points)


def _judged(
    model: Any, parameters: Sequence[sl.Parameter], seen: Sequence[sl.Observation], runs: int, executor: Any = None
) -> tuple[Misfit, sl.Posterior]:
    space, measures = sl.ParameterSpace(tuple(parameters)), {"normal_offset": sl.NormalOffset()}
    problem, smc = sl.Problem(model, space, {}, tuple(seen), measures), sl.SMCSettings(rejuvenation_steps=10, zeta=0.5)
    settings = sl.Settings(runs=runs, surrogate="field", particles=2000, smc=smc)
    found = sl.calibrate(problem, settings, executor=executor)
    return found.misfit, found.posterior


def of_curve(
    seed: int, wrong: float = 0.0, *, shift: tuple[float, float] = (0.0, 0.0), model: Any = curve, untold: str = ""
) -> tuple[Misfit, sl.Posterior]:
    """Return the verdict on a curve to which `wrong` x sin 3πx was added, or that is shifted.

    For each letter of `untold` there is one more input, and one direction of inputs that changes nothing.
    """
    random = np.random.default_rng(seed)
    truth = CURVE[0] * X + CURVE[1] * X**2 + wrong * X * np.sin(3 * np.pi * X)
    seen = np.column_stack([X, truth + SD * random.standard_normal(len(X))]) + shift
    parameters = (sl.Parameter("p", sl.Uniform(0, 1), "1"), sl.Parameter("q", sl.Uniform(-0.6, 0.2), "1/mm"))
    parameters += tuple(sl.Parameter(f"by_{name}", sl.Uniform(0.6, 1.4), "1") for name in untold)
    observed = sl.Observation(sl.Interface.polyline(seen), sl.PointErrors(SD))
    return _judged(model, parameters, [observed], 16 if not untold else 48)


def of_biofilm(material: str) -> tuple[Misfit, sl.Posterior]:
    """Return the verdict on a biofilm of this law, observed as a Saint-Venant–Kirchhoff one at three inflows."""
    true = sl.Biofilm(inflow_rates=RATES)({"E": 400.0, "nu": 0.3})
    random = np.random.default_rng(5)
    seen = tuple(sl.Observation(FINE.draw(one, random), FINE, name) for name, one in true.interfaces.items())
    parameters = (sl.Parameter("E", sl.Uniform(250, 600), "Pa"), sl.Parameter("nu", sl.Uniform(-0.2, 0.48), "1"))
    model = sl.Biofilm(inflow_rates=RATES, material=material)
    return _judged(model, parameters, seen, 48, sl.LocalProcesses())


def row(case: str, found: tuple[Misfit, sl.Posterior], truth: Sequence[float] = ()) -> tuple:
    """Return a row of the table, with how far off the inputs are if a truth is given."""
    misfit, posterior = found
    off = ", ".join(f"{one:.1f}" for one in (posterior.mean - truth) / posterior.sd) if truth else ""
    return case, off, misfit.p_value, misfit.predictive_p, "yes" if misfit.flagged else "no", misfit.verdict


def often(number: int, first: int, wrong: float = 0.0, untold: str = "") -> None:
    """Print how many observations are flagged, and how far off p and q are."""
    results = []
    for seed in range(number):
        results.append(of_curve(first + seed, wrong, untold=untold))
        if seed % 50 == 49:
            jax.clear_caches()  # the programs of some 400 studies are more than a process may map into its memory
    flagged = sum(bool(found.flagged) for found, _ in results)
    unlikely = sum(found.p_value < 0.05 for found, _ in results if found.p_value is not None)
    off = np.mean([(posterior.mean[:2] - CURVE) / posterior.sd[:2] for _, posterior in results], axis=0).round(1)
    print(
        f"{wrong:g} x sin 3πx added, {len(untold)} directions that change nothing, "
        f"p and q off by {off} sd: {flagged} of {number} flagged, {unlikely} with p < 0.05",
        flush=True,
    )


def _main() -> None:
    options = arguments(__doc__, wrong=50, right=200)
    rows = [row(f"{wrong:g} x sin 3πx added", of_curve(1, wrong), CURVE) for wrong in (0.0, 0.03, 0.08)]
    rows.append(row("observation shifted by 50 µm", of_curve(1, shift=(0.0, 0.05))))
    rows.append(row("simulator in µm, observation in mm", of_curve(1, shift=(1.0, 0.0), model=curve_in_micrometres)))
    rows += [row(law, of_biofilm(law), (400.0, 0.3)) for law in ("saint_venant_kirchhoff", "neo_hookean")]
    heading = "case | inputs off, sd | p {.4f} | p of d² {.4f} | flagged | verdict"
    show([table("misfit_power", "Wrong models", heading, rows)])
    for untold in ("", "p", "pq"):
        often(options.wrong, 300, 0.03, untold)
        often(options.right, 100, untold=untold)


if __name__ == "__main__":
    _main()
