"""The figures of a comparison of models, from the content of compare.json alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from strandline.report import plots
from strandline.report.captioned import Captioned, whole
from strandline.report.check import band_of

__all__ = ["draw_comparison"]

MARGINALS = (
    "Posterior of the inputs that all models share, under each model, and averaged over the models with their "
    "probabilities."
)
PREDICTIVE = (
    "Predicted interfaces under each model and the observed one, as offsets along the normals of the median of the "
    "predicted interfaces. The band holds 90 % of the draws of the posterior, without the noise of the observation."
)


def draw_comparison(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the shared inputs, if there are any, and that of the predictions, unless of surfaces."""
    if content["averaged"]:
        steps = {name: _steps(item) for name, item in content["averaged"].items()}
        yield Captioned("compare_marginals", "compare", MARGINALS, whole(plots.plot_averaged(steps)))
    bands = {
        (str(item["condition"]), str(name)): found
        for item in content["predictive"]
        for name, band in item["models"].items()
        if (found := band_of(band)) is not None
    }
    if bands:
        yield Captioned("compare_predictive", "compare", PREDICTIVE, whole(plots.plot_predictions(bands)))


def _steps(item: Mapping[str, Any]) -> plots.ModelMarginals:
    histogram = item["histogram"]
    return plots.ModelMarginals(
        label=item["label"],
        unit=item["unit"],
        edges=np.array(histogram["edges"], float),
        averaged=np.array(histogram["averaged"], float),
        models={name: np.array(values, float) for name, values in histogram["models"].items()},
    )
