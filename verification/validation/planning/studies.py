"""The studies of the biofilm for planning, on the coarse mesh, with errors of 7.2 µm at each point as in S3."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

import strandline as sl

SD = 0.0072
"""Standard deviation of each observed point along its normal, mm: that for which the noise variance of S3 is right."""
TRUTH = {"E": 400.0, "nu": 0.3}

STUDY = """
version: 1
model: {biofilm: {mesh: coarse}}
inputs:
  E:  {prior: {uniform: [100, 800]}, unit: Pa}
  nu: {prior: {uniform: [-0.8, 0.5]}}
discrepancy: {normal_offset: {}}
noise: {sd: 7.2, unit: um}
design: {active: {runs: 120}}
surrogate: {field: {}}
sampler: {smc: {particles: 2000, rejuvenation_steps: 10, zeta: 0.5}}
executor: {local: {workers: 1, timeout: 120}}
seed: 1
"""


def observed(rate: float, truth: Mapping[str, float], random: np.random.Generator) -> Float[np.ndarray, "point 2"]:
    """Return the points of the interface at a rate with drawn errors, mm.

    Raises:
        ForwardModelError: The run fails.
    """
    true = sl.Biofilm(mesh="coarse")({**truth, "V_in": rate}).interface
    return sl.PointErrors(SD).draw(true, random).points


def write_study(
    folder: Path, seen: Mapping[float, Float[np.ndarray, "point 2"]], candidates: Mapping[str, Any] | None = None
) -> sl.Study:
    """Write a study with these observations by rate, and return it; several rates become conditions."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {"name": folder.name, **yaml.safe_load(STUDY), "next": dict(candidates or {})}
    for rate, points in seen.items():
        np.savetxt(folder / f"{rate:g}.csv", points, delimiter=",", header="x,y", comments="")
    files = {rate: {"file": f"{rate:g}.csv", "unit": "mm"} for rate in seen}
    if len(seen) == 1:
        (rate,) = seen
        content |= {"fixed": {"V_in": rate}, "observation": files[rate]}
    else:
        content["model"]["biofilm"]["inflow_rates"] = {f"V{rate:g}": rate for rate in seen}
        content["observation"] = [{"condition": f"V{rate:g}", **file} for rate, file in files.items()]
    (folder / "study.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return sl.load_study(folder)


def finished(study: sl.Study) -> sl.Posterior:
    """Run a study to its end and return its posterior."""
    return sl.run_study(study).calibration.posterior
