"""Would the intervals of a study contain the truth as often as they say? Its experiment repeated, without a run.

Each replicate is written to coverage.jsonl as it ends, so that a stopped command goes on where it was stopped.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from strandline import studies
from strandline.calibration import (
    TOLERATED,
    TOLERATED_SHARE,
    CoordinateErrors,
    CoverageFound,
    Experiment,
    FieldQuality,
    Observer,
    Replicate,
    Source,
    field_quality,
    observer_or_default,
    posterior_source,
    prior_source,
    repeatable,
    replicated,
)
from strandline.foundations import InvalidStudy, one_thread, require, use_double
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.parameters import ParameterSpace
from strandline.posterior import Band, Coverage, Posterior
from strandline.questions import answer
from strandline.questions.knowledge import chosen_measure, digest_of, field_knowledge, require_seed
from strandline.report import Captioned, plots, without_coefficients
from strandline.runs import Progress

__all__ = ["coverage"]

ARRAYS = ("truth", "ranks", "mean", "sd", "limit")


def _replicate(entry: Mapping[str, Any]) -> Replicate:
    names = [field.name for field in fields(Replicate)]
    values: dict[str, Any] = {name: np.array(entry[name], float) if name in ARRAYS else entry[name] for name in names}
    return Replicate(**values)


FEWEST_REPLICATES = 20
SOURCES = ("prior", "posterior")


def coverage(
    study: studies.Study,
    *,
    replicates: int = 200,
    source: str = "prior",
    seed: int = 1,
    measure: str | None = None,
    observer: Observer | None = None,
) -> answer.Answer[CoverageFound]:
    """Repeat the experiment of a finished study at other true inputs, and count how often its intervals contain them.

    The surrogate of the interface, learnt from the study's runs, takes the place of the simulator. Replicate k depends
    on the seed and on k alone: more of them, or a second call after a stop, add to those that are known. Writes
    coverage.jsonl, coverage.json, coverage.html and two figures.

    Args:
        study: A finished study, from `load_study`.
        replicates: Number of repetitions, at least 20.
        source: Where the true inputs come from: the ``prior``, or the ``posterior`` in posterior.nc, which then also
            takes the place of the prior in the analysis.
        seed: Seed of all random numbers, 0 or above.
        measure: Name of a measure of the study; its first by default.
        observer: Receives the progress.

    Raises:
        InvalidInput: An argument is out of its range, or no errors of the points have the stated σ_N².
        InvalidStudy: The study is not finished, its folder cannot be written to, or the surrogate of the interface is
            not good enough.
        LedgerError: The ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs succeeded to learn the interface.
    """
    name = chosen_measure(study, measure, "the coverage")
    _require_arguments(replicates, source, seed)
    study.runs.require_finished()
    posterior = studies.finished_posterior(study, purpose="draw from") if source == "posterior" else None
    studies.require_writable(study.folder)
    use_double()
    tell = observer_or_default(observer)
    with one_thread():
        tell.stage("surrogate")
        knowledge = field_knowledge(study, name)
        origin = prior_source(knowledge, study.space) if posterior is None else posterior_source(knowledge, posterior)
        quality = field_quality(origin)
        _require_good(quality, source)
        experiment = repeatable(origin)
        tell.stage("replicates")
        file, key = answer.LineFile(study.folder / studies.REPLICATES), _key(study, name, seed, posterior)
        with file.held("strandline coverage", "replicates"), studies.told_if_unwritable(study.folder):
            made = tuple(_replicates(experiment, origin, file, key, replicates, seed, tell))
        found = CoverageFound(study.space.names, made)
    tell.stage("report")
    content = _described(study, found, experiment, quality, source=source, seed=seed, measure=name)
    return _answer(without_coefficients(content, study.space), found, study.folder).written(draft=study.settings.draft)


def _replicates(
    experiment: Experiment, source: Source, file: answer.LineFile, key: str, number: int, seed: int, tell: Observer
) -> Iterator[Replicate]:
    """Yield the replicates in their order; only those are made that are not known."""
    known = {int(one["number"]): _replicate(one) for one in file.entries() if one.get("of") == key}
    begun = time.monotonic()
    reused = done = sum(k in known for k in range(number))
    for k in range(number):
        one = known.get(k)
        if one is None:
            one = replicated(experiment, source, seed=seed, number=k)
            values = {name: value.tolist() if name in ARRAYS else value for name, value in vars(one).items()}
            file.append({"of": key, **values})
            done += 1
            tell.part(Progress(number, done, done, 0, reused, time.monotonic() - begun))
        yield one


def _require_arguments(replicates: int, source: str, seed: int) -> None:
    fewest, remedy = f"at least {FEWEST_REPLICATES}", "200 are a good start; more make the bands narrower."
    require(replicates >= FEWEST_REPLICATES, "replicates of the coverage", replicates, fewest, remedy)
    require(source in SOURCES, "source of the true inputs", source, " or ".join(SOURCES))
    require_seed(seed, "the coverage")


def _require_good(quality: FieldQuality, source: str) -> None:
    hidden, median, left_out = (answer.TO_MICROMETRES * mm for mm in (quality.hidden, quality.median, quality.left_out))
    what = f"the surrogate of the interface is not accurate enough over the {source}"
    value = f"errors above {TOLERATED * hidden:.3g} µm at {100 * quality.beyond:.0f} % of the draws"
    value = f"{value} (median {median:.3g} µm; at left-out runs {left_out:.3g} µm)"
    expected = f"at most {100 * TOLERATED_SHARE:.0f} %, since the local noise hides shifts of {hidden:.3g} µm only"
    remedy = "Make more runs where the posterior lies: an active design does."
    if source == "prior":
        remedy = "Make more runs over the whole prior, design: {sobol: {runs: …}}, or take --from posterior."
    require(quality.good, what, value, expected, remedy, InvalidStudy)


def _key(study: studies.Study, measure: str, seed: int, posterior: Posterior | None) -> str:
    """Return a digest of everything that a replicate depends on, apart from its number."""
    stated = [
        repr(one) if isinstance(one, PointErrors | UnknownErrors) else f"{type(one).__qualname__}: {one.facts}"
        for one in (study.noise, *study.noises.values())
    ]
    return digest_of(
        study,
        measure,
        seed,
        noise=stated,
        conditions=list(study.noises),
        observed={name: studies.points_digest(seen) for name, seen in studies.observations_of(study).items()},
        posterior=None if posterior is None else studies.posterior_digest(posterior),
    )


def _described(
    study: studies.Study,
    found: CoverageFound,
    experiment: Experiment,
    quality: FieldQuality,
    *,
    source: str,
    seed: int,
    measure: str,
) -> dict[str, Any]:
    return {
        **studies.facts_of(study, seed),
        "source": source,
        "replicates": len(found.replicates),
        "measure": measure,
        "noise": _noise(study, experiment),
        "surrogate": {
            **answer.facts_of_surrogate(experiment.surrogate.runs, quality),
            "left_out_error_um": answer.TO_MICROMETRES * quality.left_out,
        },
        "calibrated": found.calibrated,
        "remarks": [*found.remarks, *_of_fields(study.space)],
        "inputs": _inputs(study, found),
        "log_likelihood": {
            "inside": found.fit_band.inside,
            "p_value": found.fit_band.p_value,
            "regions": [_share(one, 0) for one in found.regions],
            "ranks": found.fit_ranks.tolist(),
            "band": _band(found.fit_band),
        },
        "sampling": {
            "importance": sum(one.by == "importance" for one in found.replicates),
            "smc": sum(one.by == "smc" for one in found.replicates),
            "effective": float(np.median([one.effective for one in found.replicates])),
        },
    }


def _of_fields(space: ParameterSpace) -> Iterator[str]:
    for one in space.fields:
        count = f"The ranks of all {one.count} coefficients of the field {one.name} count"
        yield f"{count}, but are not listed. Its values at points and its means were not tested."


def _inputs(study: studies.Study, found: CoverageFound) -> dict[str, Any]:
    ratios, means, spreads = found.of_limit, found.z.mean(axis=0), found.z.std(axis=0, ddof=1)
    return {
        parameter.name: {
            "label": parameter.shown,
            "unit": parameter.unit,
            "inside": band.inside,
            "p_value": band.p_value,
            "intervals": [_share(one, i) for one in found.intervals],
            "z_mean": float(means[i]),
            "z_sd": float(spreads[i]),
            "sd": float(found.sd[i]),
            "of_limit": float(ratios[i]),
            "ranks": found.ranks[:, i].tolist(),
            "band": _band(band),
        }
        for i, (parameter, band) in enumerate(zip(study.space, found.bands, strict=True))
    }


def _share(one: Coverage, i: int) -> dict[str, float]:
    return {"level": one.level, **{part: float(getattr(one, part)[i]) for part in ("found", "low", "high")}}


def _band(band: Band) -> dict[str, list[float]]:
    return {part: getattr(band, part).tolist() for part in ("places", "found", "low", "high")}


def _noise(study: studies.Study, experiment: Experiment) -> list[dict[str, Any]]:
    return [
        {
            "condition": name,
            "stated": isinstance(study.noise_of(name), PointErrors),
            "drawn": errors.facts,
            "analysed": dict(experiment.noises[name].facts),
            "in_words": _in_words(errors, study.noise_of(name)),
        }
        for name, errors in experiment.errors.items()
    ]


def _in_words(errors: PointErrors | CoordinateErrors, noise: Noise | PointErrors | UnknownErrors) -> str:
    sd = f"{answer.TO_MICROMETRES * errors.sd:.3g} µm"
    if isinstance(errors, CoordinateErrors):
        return f"independent errors of all coordinates, sd {sd}"
    if isinstance(noise, PointErrors):
        return f"errors of the points as study.yaml states them, sd {sd}"
    if isinstance(noise, UnknownErrors):
        return f"errors of the points as inferred from the real observation, sd {sd}"
    return f"independent errors of the points along the normals, sd {sd}, for which the stated σ_N² is right"


def _answer(content: dict[str, Any], found: CoverageFound, folder: Path) -> answer.Answer[CoverageFound]:
    sentence, *remarks = content["remarks"]
    noise = [f"{one['condition'] or 'Drawn with'}: {one['in_words']}." for one in content["noise"]]
    return answer.Answer(
        title=f"{content['study']}: coverage",
        lead=f"Would the intervals contain the truth as often as they say? {content['replicates']} replicates, truths "
        f"from the {content['source']}.",
        sentence=sentence,
        remarks=remarks,
        good=content["calibrated"],
        parts=[*_of_inputs(content), answer.Part("How it was tested", lines=noise, notes="how_covered")],
        content=content,
        found=found,
        page=folder / "coverage.html",
        drawn=_drawn,
    )


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    ranked = {**content["inputs"], "log-likelihood": content["log_likelihood"]}
    bands = {
        name: Band(**{key: np.array(values, float) for key, values in item["band"].items()}, p_value=item["p_value"])
        for name, item in ranked.items()
    }
    yield Captioned.of("coverage_ranks", "coverage", plots.plot_rank_bands(bands))
    found = {name: item["intervals"] for name, item in content["inputs"].items()}
    if found:
        yield Captioned.of("coverage_intervals", "coverage", plots.plot_intervals(found))


def _of_inputs(content: Mapping[str, Any]) -> Iterator[answer.Part]:
    head = "input", "unit", "p of the ranks", "50 % intervals", "90 % intervals", "mean z", "sd of z", "mean sd"
    rows = [
        (
            *answer.label_and_unit(item),
            answer.digits(item["p_value"], 2),
            *(f"{one['found']:.1%} ({one['low']:.1%} to {one['high']:.1%})" for one in item["intervals"]),
            f"{item['z_mean']:+.2f}",
            *(answer.digits(item[part], 3) for part in ("z_sd", "sd", "of_limit")),
        )
        for item in content["inputs"].values()
    ]
    if rows:
        yield answer.Part("The inputs", answer.Table((*head, "sd / limit"), rows), notes="covered_inputs")
