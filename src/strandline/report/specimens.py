"""The figures of many specimens, from the content of specimens.json alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from strandline.report import plots
from strandline.report.captioned import Captioned, whole
from strandline.typeset import figure_text, unit_text

__all__ = ["draw_specimens"]

QUANTILES = ("q05", "q50", "q95")
INTERVALS = (
    "90 % intervals of {} for each specimen, from its own outline alone (grey) and given all specimens (blue), with "
    "their medians, in the order of the blue ones. The less certain specimens move most towards the population; as the "
    "inputs of a specimen move together, a single one may move away."
)
ALONE = "90 % intervals of {} for each specimen, with their medians."
DENSITY = (
    "Density of {} over the population, median and 90 % band. Each stroke is the mean of a specimen given all of them."
)


def draw_specimens(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the intervals of each input, and its density in the population."""
    specimens, population = content["specimens"], content["population"]
    for name, item in content["inputs"].items() if specimens else ():
        unit = unit_text(item["unit"])
        label = f"{figure_text(item['label'])} [{unit}]" if unit else figure_text(item["label"])
        found = _intervals(specimens, name, shrunk=population is not None)
        caption = (ALONE if population is None else INTERVALS).format(item["label"])
        drawing = plots.plot_caterpillar(found, label)
        yield Captioned(f"specimens_intervals_{name}", "specimens", caption, whole(drawing.figure))
        if population is not None:
            density = plots.PopulationDensity(**_arrays(population["inputs"][name]["density"]))
            means = np.array([one["inputs"][name]["shrunk"]["mean"] for one in specimens])
            drawing = plots.plot_population(density, means, label)
            caption = DENSITY.format(item["label"])
            yield Captioned(f"specimens_population_{name}", "specimens", caption, whole(drawing.figure))


def _intervals(specimens: list[Mapping[str, Any]], name: str, *, shrunk: bool) -> plots.SpecimenIntervals:
    items = [one["inputs"][name] for one in specimens]
    return plots.SpecimenIntervals(
        names=[one["specimen"] for one in specimens],
        own=np.array([[item[q] for q in QUANTILES] for item in items]),
        shrunk=np.array([[item["shrunk"][q] for q in QUANTILES] for item in items]) if shrunk else None,
        outlier=np.array([bool(one.get("outlier")) for one in specimens]),
    )


def _arrays(density: Mapping[str, list[float]]) -> dict[str, Any]:
    return {name: np.array(values, float) for name, values in density.items()}
