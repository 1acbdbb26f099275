"""specimens.json and specimens.csv: each specimen alone and given all specimens, and the population."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.population import FEWEST_SPECIMENS, TOLERATED_SHIFT, Population, Refused, Shrunk, SpecimenPosterior
from strandline.questions.specimens.opened import Specimens
from strandline.studies.folder import whole_file
from strandline.studies.provenance import versions
from strandline.version import __version__

__all__ = ["describe_specimens", "write_table"]

QUANTILES = ("q05", "q50", "q95")
PLACES = 200
NAMED = 5
"""Specimens named in a remark."""


def describe_specimens(
    opened: Specimens,
    posteriors: Sequence[SpecimenPosterior],
    refused: Sequence[Refused],
    population: Population | None,
    lifted: Shrunk | None,
    *,
    made: int,
    alike: Sequence[Sequence[str]] = (),
) -> dict[str, Any]:
    """Return the content of specimens.json.

    Args:
        opened: The study, opened for specimens.
        posteriors: Posteriors of the specimens, in the order of their names.
        refused: Specimens that were set aside.
        population: The population, if there is one.
        lifted: The specimens given all others, if there is a population.
        made: Further runs made now.
        alike: Names of specimens whose files have the same content, for each such content.
    """
    study, good = opened.study, sum(one.certified.good for one in posteriors)
    counts = {
        "files": len(posteriors) + len(refused),
        "analysed": len(posteriors),
        "good": good,
        "refine": len(posteriors) - good,
        "set_aside": len(refused),
    }
    content = {
        "study": study.name,
        "study_sha256": study.text_digest,
        "version": __version__,
        "versions": versions(),
        "model": study.runs.identity,
        "seed": opened.seed,
        "measure": opened.measure,
        "files": opened.files.pattern,
        "surrogate": {"runs": opened.begin.knowledge.surrogate.runs, "further": len(opened.further), "made": made},
        "tolerated_shift": TOLERATED_SHIFT,
        "counts": counts,
        "given": list(opened.files.known),
        "inputs": {
            p.name: {"label": p.shown, "unit": p.unit, "low": p.interval[0], "high": p.interval[1]}
            for p in study.space
            if p.name not in opened.files.known
        },
        "specimens": [_specimen(one, lifted, i) for i, one in enumerate(posteriors)],
        "set_aside": [{"specimen": one.name, "why": one.why} for one in refused],
        "alike": [list(names) for names in alike],
        "population": None if population is None or lifted is None else _population(population, lifted),
    }
    return {**content, "remarks": list(_remarks(content))}


def _specimen(one: SpecimenPosterior, lifted: Shrunk | None, i: int) -> dict[str, Any]:
    inputs: dict[str, dict[str, Any]] = {
        name: {"mean": float(one.mean[d]), "sd": float(one.sd[d]), **_quantiles(one.quantiles[:, d])}
        for d, name in enumerate(one.space.names)
    }
    entry: dict[str, Any] = {
        "specimen": one.name,
        "given": dict(one.given),
        "certificate": one.certified.verdict,
        "shift": one.certified.shift,
        "surprise": one.certified.surprise,
        "effective": one.effective,
        "by": one.by,
        "inputs": inputs,
        "correlation": (one.covariance / np.outer(one.sd, one.sd)).tolist(),
    }
    if lifted is not None:
        for d, name in enumerate(one.space.names):
            own = {"mean": float(lifted.mean[i, d]), "sd": float(lifted.sd[i, d])}
            inputs[name]["shrunk"] = {**own, **_quantiles(lifted.quantiles[i, :, d])}
            inputs[name]["z"] = float(lifted.z[i, d])
        entry["p_value"] = float(lifted.p_values[i])
        entry["outlier"] = one.name in lifted.outliers
    return entry


def _population(population: Population, lifted: Shrunk) -> dict[str, Any]:
    space, inputs = population.space, {}
    for d, parameter in enumerate(space):
        x = np.linspace(*parameter.interval, PLACES)
        low, median, high = np.quantile(population.density(d, x), [0.05, 0.5, 0.95], axis=0)
        inputs[parameter.name] = {
            "mean": _moments(population.mean[:, d]),
            "spread": _moments(population.sd[:, d]),
            "density": {"x": x.tolist(), "median": median.tolist(), "low": low.tolist(), "high": high.tolist()},
        }
    return {"specimens": len(lifted.names), "inputs": inputs, "outliers": list(lifted.outliers), "limit": lifted.limit}


def _moments(draws: Float[np.ndarray, " draw"]) -> dict[str, float]:
    return {"mean": float(draws.mean()), "sd": float(draws.std()), **_quantiles(np.quantile(draws, [0.05, 0.5, 0.95]))}


def _quantiles(values: Float[np.ndarray, " three"]) -> dict[str, float]:
    return dict(zip(QUANTILES, values.tolist(), strict=True))


def _remarks(content: Mapping[str, Any]) -> Iterator[str]:
    counts, population = content["counts"], content["population"]
    if counts["refine"]:
        names = [one["specimen"] for one in content["specimens"] if one["certificate"] == "refine"]
        yield (
            f"The surrogate is not accurate enough for {_named(names)}: make further runs with --refine, or run the "
            "study with a larger design."
        )
    if counts["set_aside"]:
        yield f"Set aside: {_named([one['specimen'] for one in content['set_aside']])}; see the reasons below."
    for names in content["alike"]:
        yield f"The files of {_named(names)} are the same: is it one specimen under several names?"
    if population is None:
        number = counts["analysed"]
        yield (
            f"No population: {number} specimen{'s' if number != 1 else ''} with a posterior, and at least "
            f"{FEWEST_SPECIMENS} are needed."
        )
    elif population["outliers"]:
        yield f"Outliers: {_named(population['outliers'])} (p below {population['limit']:.2g})."


def _named(names: Sequence[str]) -> str:
    """Return some names, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def write_table(path: Path, content: Mapping[str, Any]) -> None:
    """Write specimens.csv, a row for each specimen, whole or not at all.

    Args:
        path: Path of the table.
        content: Content of specimens.json.
    """
    rows = [_row(one, content) for one in content["specimens"]]
    rows += [{"specimen": one["specimen"], "certificate": "set aside"} for one in content["set_aside"]]
    heads = list(dict.fromkeys(head for row in rows for head in row))
    with whole_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, heads, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: str(row["specimen"])))


def _row(one: Mapping[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {"specimen": one["specimen"], **one["given"], "certificate": one["certificate"]}
    for name in content["inputs"]:
        item = one["inputs"][name]
        row |= {f"{name}_{part}": item[part] for part in ("mean", "sd", *QUANTILES)}
        if "shrunk" in item:
            row |= {f"{name}_shrunk_{part}": item["shrunk"][part] for part in ("mean", "sd")}
    if "outlier" in one:
        row |= {"p_value": one["p_value"], "outlier": "yes" if one["outlier"] else ""}
    return row
