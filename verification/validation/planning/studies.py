"""The studies of the biofilm for planning, on the coarse mesh, with errors of 7.2 µm at each point as in S3."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

import strandline as sl

__all__ = ["SD", "TRUTH", "finished", "observed", "rates_of", "write_study"]

SD = 0.0072
"""Standard deviation of each observed point along its normal, mm: that for which the noise variance of S3 is right."""
TRUTH = {"E": 400.0, "nu": 0.3}

TEXT = """version: 1
name: {name}
model: {{biofilm: {{mesh: coarse{rates}}}}}
{fixed}
inputs:
  E:  {{prior: {{uniform: [100, 800]}}, unit: Pa}}
  nu: {{prior: {{uniform: [-0.8, 0.5]}}}}
observation: {observation}
discrepancy: {{normal_offset: {{}}}}
noise: {{sd: 7.2, unit: um}}
design: {{active: {{runs: 120}}}}
surrogate: {{field: {{}}}}
sampler: {{smc: {{particles: 2000, rejuvenation_steps: 10, zeta: 0.5}}}}
executor: {{local: {{workers: 1, timeout: 120}}}}
seed: {seed}
next: {{{candidates}}}
"""


def observed(rate: float, truth: Mapping[str, float], random: np.random.Generator) -> Float[np.ndarray, "point 2"]:
    """Return the points of the interface at a rate with drawn errors, mm.

    Raises:
        ForwardModelError: The run fails.
    """
    true = sl.Biofilm(mesh="coarse")({**truth, "V_in": rate}).interface
    return sl.PointErrors(SD).draw(true, random).points


def write_study(
    folder: Path, seen: Mapping[float, Float[np.ndarray, "point 2"]], *, candidates: str, seed: int = 1
) -> sl.Study:
    """Write a study with these observations by rate, and return it; several rates become conditions."""
    folder.mkdir(parents=True, exist_ok=True)
    for rate, points in seen.items():
        np.savetxt(folder / f"{rate:g}.csv", points, delimiter=",", header="x,y", comments="")
    if len(seen) == 1:
        (rate,) = seen
        rates, fixed = "", f"fixed: {{V_in: {rate:g}}}"
        observation = f"{{file: {rate:g}.csv, unit: mm}}"
    else:
        names = {rate: f"V{rate:g}" for rate in seen}
        rates = f", inflow_rates: {{{', '.join(f'{name}: {rate:g}' for rate, name in names.items())}}}"
        fixed = ""
        files = [f"  - {{condition: {name}, file: {rate:g}.csv, unit: mm}}" for rate, name in names.items()]
        observation = "\n".join(["", *files])
    text = TEXT.format(
        name=folder.name, rates=rates, fixed=fixed, observation=observation, candidates=candidates, seed=seed
    )
    (folder / "study.yaml").write_text(text)
    return sl.load_study(folder)


def finished(study: sl.Study) -> sl.Posterior:
    """Run a study to its end and return its posterior."""
    return sl.run_study(study).calibration.posterior


def rates_of(values: Sequence[float]) -> str:
    """Return candidates as study.yaml writes them."""
    return f"V_in: [{', '.join(f'{one:g}' for one in values)}]"
