"""The study that `strandline init` writes."""

import re
from pathlib import Path

from strandline.errors import InvalidStudy
from strandline.studies.folder import STUDY

__all__ = ["write_template"]

TEMPLATE = """\
# A strandline study. Run it with:  strandline run {folder}
version: 1
name: {name}

# The simulator: a biofilm in a flow cell (built in). Meshes: coarse | default | fine.
model: {{biofilm: {{mesh: coarse}}}}

# What is known of the experiment.
fixed: {{V_in: 100}}                # inflow volume rate per depth, mm^2/s

# What is not: priors. uniform [low, high] | normal [mean, sd] | lognormal [mu, sigma] | beta [a, b, low, high].
# A prior without bounds needs a design box, e.g.  E: {{prior: {{lognormal: [5.86, 0.4]}}, box: [100, 800], unit: Pa}}
inputs:
  E:  {{prior: {{uniform: [100, 800]}}, unit: Pa}}       # Young's modulus
  nu: {{prior: {{uniform: [-0.8, 0.5]}}}}               # Poisson's ratio

# The observed interface. For your own:  observation: {{file: observed.csv, unit: mm}}   (x, y; one point a line)
# with  discrepancy: {{normal_offset: {{}}}}  and  noise: {{sd: 3, unit: um}}
observation: {{synthetic: {{E: 400, nu: 0.3, V_in: 100}}}}

# How a simulated interface is compared with the observed one:
# currents (RKHS norm; quadrature: refined | centre) | closest_point | measurement_lines | tracked_points
# normal_offset (best for a measured interface: it weighs the points by their errors)
discrepancy: {{currents: {{width: 0.005, quadrature: refined}}}}

# Variance of the noise, in the unit of the squared discrepancy (mm^2), or its standard deviation (sd: ...).
# With a unit, sd is that of an observed point:  noise: {{sd: 3, unit: um}}   (`strandline noise` estimates it)
noise: {{variance: 0.0005}}

# Which forward runs: one batch after the other where the posterior lies, at most so many; it stops when it is sure.
# What is learnt from them: the interface itself, as a field over the inputs.
# The published way:  design: {{sobol: {{runs: 300}}}}  with  surrogate: {{log_likelihood: {{kernel: matern32}}}}
design: {{active: {{runs: 80}}}}
surrogate: {{field: {{}}}}
sampler: {{smc: {{particles: 2000, rejuvenation_steps: 15, zeta: 0.5}}}}
executor: {{local: {{timeout: 300}}}}   # seconds; one worker process per core
seed: 1
"""


def write_template(folder: Path) -> Path:
    """Write a commented study.yaml into `folder`, created if needed, and return its path.

    Raises:
        InvalidStudy: There is one already, or the folder cannot be created.
    """
    path = folder / STUDY
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", folder.resolve().name).strip("-._") or "study"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(TEMPLATE.format(name=name, folder=folder))
    except FileExistsError:
        raise InvalidStudy(
            "there is a study already",
            value=str(path),
            expected="a new folder, or one without study.yaml",
            remedy="Choose another folder.",
        ) from None
    except OSError as error:
        raise InvalidStudy(
            "the folder cannot be made",
            value=f"{folder}: {error.strerror}",
            expected="a place with write permission",
            remedy="Choose another folder.",
        ) from None
    return path
