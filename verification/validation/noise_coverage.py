"""How often 90 % intervals contain the truth on the biofilm, for each noise and each measure, and how wide they are.

The field surrogate learns from Sobol runs of the real model. Truths are drawn from the prior, observations with the
stated noise from the predicted outline, and posteriors are integrated on a grid around the estimate. The general rule
for σ_N² takes seconds, so that one observation in 25 serves for the next ones too.

    python -m verification.validation.noise_coverage [--observations 200] [--runs 64] [--ledger FOLDER] [NOISE ...]

NOISE is part of the name of a noise.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from verification.validation.biofilm_mesh import BOX, box_points
from verification.validation.tables import arguments, kept_or_scratch, show, table

from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, JointErrors, MeasurementLines, NormalOffset
from strandline.foundations import InvalidInput, use_double
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood
from strandline.likelihood.interfaces import with_variance
from strandline.likelihood.linearised_residuals import linearise
from strandline.models.biofilm.model import Biofilm
from strandline.posterior.rank_tests import coverage_of, uniformity
from strandline.runs import Ledger, LocalProcesses, run_campaign
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fit_field

LOW, HIGH = np.array(BOX).T
SPACING = 0.005
"""Distance of the observed points, mm."""
Pair, Pairs = Float[np.ndarray, " 2"], Float[np.ndarray, "observation 2"]
GLOBAL = {"shift": 0.008, "rotation": 0.5, "scale": 0.005, "offset": 0.002}
NOISES = {
    "white 1 µm": PointErrors(0.001),
    "white 3 µm": PointErrors(0.003),
    "white 6 µm": PointErrors(0.006),
    "3 µm over 15 µm": PointErrors(0.003, 0.015),
    "3 µm over 60 µm": PointErrors(0.003, 0.060),
    "3 µm over 15 µm, global errors": PointErrors(0.003, 0.015, **GLOBAL),
}
MEASURES: dict[str, Discrepancy] = {
    "normal_offset": NormalOffset(),
    "closest_point": ClosestPoint(),
    "measurement_lines, 40": MeasurementLines(40),
    "currents, 0.1 mm": Currents(0.1),
}
SERVES = 25
"""Observations for which one evaluation of the rule for σ_N² serves."""
REACH, PLACES = 5.0, 25
"""Half the width of the grid in standard deviations of the linearised posterior, and its nodes along each input."""


def figures(ranks: Pairs, sds: Pairs, limits: Pairs) -> list[float]:
    """Return coverage in %, p-values of the ranks' uniformity, and widths relative to the Cramér–Rao limit."""
    p = [uniformity(ranks[:, k]).p_value for k in (0, 1)]
    cover, wide = 100 * coverage_of(ranks, 0.9).found, np.median(sds / limits, axis=0)
    return [*cover.tolist(), *p, *wide.tolist()]


def surrogate(runs: int, folder: Path) -> FieldSurrogate:
    """Return the field of the biofilm over E and ν, from the finished runs in `folder` and those that are missing."""
    x, model = box_points(runs, scramble=None), Biofilm(mesh="default")
    inputs = [{"E": float(a), "nu": float(b), "V_in": 100.0} for a, b in x]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        records = run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses())
    good = [k for k, record in enumerate(records) if record.ok]
    return fit_field(FieldTraining(x[good], [records[k].interfaces for k in good], None, LOW, HIGH), tolerance=1e-6)


def _observed(field: FieldSurrogate, truth: Pair, errors: PointErrors, seed: int) -> Interface:
    predicted = field.interfaces(truth)[""]
    number = round(float(predicted.lengths.sum()) / SPACING) + 1
    return errors.draw(predicted.resampled(number), np.random.default_rng([7, seed]))


def limit(field: FieldSurrogate, seen: Interface, errors: PointErrors) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimate and the standard deviations of the linearised posterior: the limit of Cramér and Rao."""
    lin = linearise(field, JointErrors((Observation(seen, errors),), (errors,)))
    information = np.linalg.inv(lin.covariance(JointErrors((Observation(seen, errors),), (errors,)).model))
    covariance = np.linalg.inv(information + np.diag(12 / (HIGH - LOW) ** 2))
    return lin.at, np.sqrt(np.diag(covariance))


def posterior(likelihood: FieldLikelihood, truth: Pair, at: Pair, sd: Pair) -> tuple[np.ndarray, np.ndarray]:
    """Return rank of the truth and standard deviation in each input, by quadrature on a grid that adapts."""
    for _ in range(8):
        low, high = np.maximum(at - REACH * sd, LOW), np.minimum(at + REACH * sd, HIGH)
        axes = [np.linspace(low[k], high[k], PLACES) for k in (0, 1)]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        values = likelihood.plug_in(x)
        weights = np.exp(values - values.max()).reshape(PLACES, PLACES)
        weights[[0, -1]] *= 0.5
        weights[:, [0, -1]] *= 0.5
        weights /= weights.sum()
        marginals = weights.sum(axis=1), weights.sum(axis=0)
        mean = np.array([m @ a for m, a in zip(marginals, axes, strict=True)])
        found = np.sqrt([m @ (a - c) ** 2 for m, a, c in zip(marginals, axes, mean, strict=True)])
        inside = (low <= LOW) | (mean - 4 * found > low), (high >= HIGH) | (mean + 4 * found < high)
        step = (high - low) / (PLACES - 1)
        if all(one.all() for one in inside) and (found > 1.2 * step).all():
            break
        at, sd = mean, np.where(found > 1.2 * step, 1.2 * found, np.maximum(0.5 * found, 0.25 * step))
    ranks = [np.interp(t, a, np.cumsum(m) - 0.5 * m) for t, a, m in zip(truth, axes, marginals, strict=True)]
    return np.array(ranks), found


def measured(field: FieldSurrogate, errors: PointErrors, number: int) -> Iterator[tuple[str, list[float]]]:
    """Yield the figures of each measure, a control with points taken as independent, and inferred noise."""
    truths = LOW + (HIGH - LOW) * np.random.default_rng(11).random((number, 2))
    seen = [_observed(field, truth, errors, k) for k, truth in enumerate(truths)]
    limits = [limit(field, one, errors) for one in seen]
    others = {name: getattr(errors, name) for name in ("shift", "rotation", "scale", "offset")}
    cases = [
        *((name, measure, errors) for name, measure in MEASURES.items()),
        ("normal_offset, s and ℓ unknown", NormalOffset(), UnknownErrors(**others)),
        ("control: points independent, no global errors", NormalOffset(), PointErrors(errors.sd)),
    ]
    nodes = len(field.interfaces(truths[0])[""].points)
    for name, measure, noise in cases:
        found, used = [], noise
        for k, (truth, one, at) in enumerate(zip(truths, seen, limits, strict=True)):
            try:
                if k % SERVES == 0 and not isinstance(measure, NormalOffset):
                    used = with_variance(Observation(one, noise), measure, nodes)
                likelihood = FieldLikelihood(field, (Observation(one, used),), measure)
                found.append((*posterior(likelihood, truth, *at), at[1]))
            except InvalidInput:  # no variance of the measure fits this noise
                continue
        if found:
            said = name if len(found) == number else f"{name} ({number - len(found)} refused)"
            yield said, figures(*(np.array(part) for part in zip(*found, strict=True)))


def _main() -> None:
    options = arguments(__doc__, words="NOISE", observations=200, runs=64, ledger=Path)
    use_double()
    with kept_or_scratch(options.ledger) as folder:
        field = surrogate(options.runs, folder)
    rows = (
        (name, measure, *found)
        for name, errors in NOISES.items()
        if not options.words or any(word in name for word in options.words)
        for measure, found in measured(field, errors, options.observations)
    )
    heading = (
        "noise | measure | E covered, % {.1f} | ν covered, % {.1f} | p(E) {.3f} | p(ν) {.3f} "
        "| sd(E) / limit {.2f} | sd(ν) / limit {.2f}"
    )
    show([table("noise_coverage", "Coverage of 90 % intervals", heading, rows, live=True)])


if __name__ == "__main__":
    _main()
