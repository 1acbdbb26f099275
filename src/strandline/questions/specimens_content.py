"""specimens.json and specimens.csv: each specimen alone and given all specimens, and the population."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import whole_file, with_sd
from strandline.questions.answer import Answer, Part, Symbol, Table, digits, label_and_unit, remark
from strandline.questions.information import shown_columns
from strandline.questions.many import RefusedSpecimen
from strandline.questions.opened import Specimens
from strandline.questions.population import FEWEST_SPECIMENS, Population, Shrunk
from strandline.questions.specimen import TOLERATED_SHIFT, SpecimenPosterior
from strandline.report import Captioned, axis_label, plots, without_coefficients
from strandline.studies import facts_of, named

QUANTILES = ("q05", "q50", "q95")
PLACES = 200


@dataclass(frozen=True, eq=False)
class SpecimensFound:
    """The specimens of a study by name, those set aside, and of three or more the population with each given all."""

    posteriors: tuple[SpecimenPosterior, ...]
    refused: tuple[RefusedSpecimen, ...]
    population: Population | None = None
    shrunk: Shrunk | None = None


def describe_specimens(
    opened: Specimens, found: SpecimensFound, *, made: int, alike: Sequence[Sequence[str]] = ()
) -> dict[str, Any]:
    """Return the content of specimens.json; `made` runs were made now, and the files in `alike` are the same."""
    study, posteriors, refused = opened.study, found.posteriors, found.refused
    good = sum(one.certified.good for one in posteriors)
    counts = {
        "files": len(posteriors) + len(refused),
        "analysed": len(posteriors),
        "good": good,
        "refine": len(posteriors) - good,
        "set_aside": len(refused),
    }
    content = {
        **facts_of(study, opened.seed),
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
        "specimens": [_specimen(one, found.shrunk, i) for i, one in enumerate(posteriors)],
        "set_aside": [{"specimen": one.name, "why": one.why} for one in refused],
        "alike": [list(names) for names in alike],
        "population": None
        if found.population is None or found.shrunk is None
        else _population(found.population, found.shrunk),
    }
    shown: dict[str, Any] = without_coefficients({**content, "remarks": list(_remarks(content))}, study.space)
    return shown


def _specimen(one: SpecimenPosterior, lifted: Shrunk | None, i: int) -> dict[str, Any]:
    inputs: dict[str, dict[str, Any]] = {
        name: {"mean": float(one.mean[d]), "sd": float(one.sd[d]), **_quantiles(one.quantiles[:, d])}
        for d, name in enumerate(one.space.names)
    }
    shown = shown_columns(one.space)
    entry: dict[str, Any] = {
        "specimen": one.name,
        "given": dict(one.given),
        "certificate": one.certified.verdict,
        **vars(one.certified),
        **named(one, "effective", "by"),
        "inputs": inputs,
        "correlation": (one.covariance / np.outer(one.sd, one.sd))[np.ix_(shown, shown)].tolist(),
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
        refine = [one["specimen"] for one in content["specimens"] if one["certificate"] == "refine"]
        yield remark("inaccurate", names=refine)
    if counts["set_aside"]:
        yield remark("set_aside", names=[one["specimen"] for one in content["set_aside"]])
    yield from (remark("alike", names=names) for names in content["alike"])
    if population is None:
        yield remark("no_population", number=counts["analysed"], fewest=FEWEST_SPECIMENS)
    elif population["outliers"]:
        yield remark("outliers", names=population["outliers"], limit=population["limit"])


def write_table(path: Path, content: Mapping[str, Any]) -> None:
    """Write specimens.csv from the content of specimens.json, a row for each specimen, whole or not at all."""
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


def answer_of(content: dict[str, Any], found: SpecimensFound, folder: Path) -> Answer[SpecimensFound]:
    """Return what specimens.json says, in words and tables."""
    counts, surrogate, population = content["counts"], content["surrogate"], content["population"]
    runs = f"{surrogate['runs']} runs, {surrogate['made'] or 'none'} of them new"
    return Answer(
        title=f"{content['study']}: specimens",
        lead=f"{counts['analysed']} specimens ({content['files']}), analysed with {runs}.",
        sentence=f"{counts['analysed']} specimens: {counts['good']} good, {counts['refine']} to refine, "
        f"{counts['set_aside']} set aside{', no outliers' if population and not population['outliers'] else ''}",
        remarks=content["remarks"],
        good=not content["remarks"],
        parts=list(_parts(content)),
        content=content,
        found=found,
        page=folder / "specimens.html",
        drawn=_drawn,
    )


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    specimens, population = content["specimens"], content["population"]
    for name, item in content["inputs"].items() if specimens else ():
        axes, facts = plots.plot_caterpillar(specimens, name, axis_label(item)), {"of": name, "label": item["label"]}
        yield Captioned.of("specimens_intervals", "specimens", axes, together=population is not None, **facts)
        if population is not None:
            means = [one["inputs"][name]["shrunk"]["mean"] for one in specimens]
            axes = plots.plot_population(population["inputs"][name]["density"], means, axis_label(item))
            yield Captioned.of("specimens_population", "specimens", axes, **facts)


def _parts(content: Mapping[str, Any]) -> Iterator[Part]:
    if content["population"] is not None:
        yield _of_population(content["population"], content["inputs"])
    yield _of_specimens(content)
    if content["set_aside"]:
        yield Part("Set aside", lines=[f"{one['specimen']}: {one['why']}" for one in content["set_aside"]])


def _of_population(population: Mapping[str, Any], inputs: Mapping[str, Any]) -> Part:
    rows = []
    for name, item in population["inputs"].items():
        parts = [item["mean"], item["spread"]]
        cells = [(_with_sd(one), f"{digits(one['q05'], 4)} to {digits(one['q95'], 4)}") for one in parts]
        rows.append((*label_and_unit(inputs[name]), *cells[0], *cells[1]))
    head = "input", "unit", "mean", "90 % interval", "spread", "90 % interval"
    return Part("The population", Table(head, rows), notes="population")


def _of_specimens(content: Mapping[str, Any]) -> Part:
    given, inputs, together = content["given"], content["inputs"], content["population"] is not None
    all_of = ["given all"] * together
    columns = [(Symbol(item["label"]), *all_of) for item in inputs.values()]
    labels = [Symbol(f"known {name}") for name in given]
    head = ("specimen", *labels, "certificate", *chain(*columns), *["p"] * together)
    rows = []
    for one in content["specimens"]:
        items = [one["inputs"][name] for name in inputs]
        cells = [(_with_sd(item), *([_with_sd(item["shrunk"])] if together else [])) for item in items]
        known = [digits(one["given"][name], 4) for name in given]
        p_value = [digits(one["p_value"], 2)] if together else []
        name = f"{one['specimen']}{' (outlier)' if one.get('outlier') else ''}"
        rows.append((name, *known, one["certificate"], *chain(*cells), *p_value))
    return Part("The specimens", Table(head, rows), notes="specimens")


def _with_sd(item: Mapping[str, float]) -> str:
    return with_sd(item["mean"], item["sd"])
