"""Log evidence and its gradient by (log variance, log lengths) as a fit of strandline computes it dozens of times."""

import math
from collections.abc import Mapping
from typing import Any

from worker import Task, serve


def prepare(content: Mapping[str, Any]) -> Task:
    import numpy as np

    from strandline.surrogate import KERNELS
    from strandline.surrogate.hyperparameters import Objective

    objective = Objective(content["x"], content["y"], KERNELS["matern32_product"], float(content["nugget"]))
    log_lengths = np.log(content["lengths"])
    log_ratio = math.log(content["variance"]) - 3 * log_lengths.mean()

    def task() -> list[float]:
        found = objective.evidence(float(log_ratio), log_lengths.tolist())
        by_variance, by_lengths = found.gradient[0], found.gradient[1:]
        return [found.value, by_variance, *(by_lengths - 3 / len(log_lengths) * by_variance)]

    return task


if __name__ == "__main__":
    serve(("strandline", "numpy", "scipy"), prepare)
