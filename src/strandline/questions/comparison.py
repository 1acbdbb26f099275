"""Which of several studies of the same data the data prefer: the content of compare.json, in words and tables too."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import ERRORS, SCALE, BayesFactor, ModelComparison
from strandline.design import Knowledge, sobol
from strandline.foundations import __version__, listed
from strandline.interface import Interface, UnknownErrors
from strandline.posterior import FLAT, Posterior, Weighted, interface_band, prior_conflicts
from strandline.questions.answer import Answer, Found, Part, Table, digits, label_and_unit, moments, remark
from strandline.questions.information import CLEAR, Discrimination
from strandline.questions.prospects import CandidateSignals
from strandline.report import Captioned, plots
from strandline.studies import Study, in_words, named, offset_band, posterior_digest, versions

QUANTILES = {"median": 0.5, "q05": 0.05, "q95": 0.95}
PREDICTED = 200  # draws of each posterior whose interfaces are predicted
BINS = 25
OF_MISFIT = ("verdict", "flagged", "p", "region_p", "smooth_p")
FLAGGED = {None: "not judged", True: "noticed", False: "none"}
OUTSIDE = 0.001  # share of the draws left out at either end of a histogram
NARROWED = math.log(2.0)  # log of the factor by which the data narrow inputs of one model alone, for a remark
OFF = 3.0  # errors by which two values of a log-evidence may differ; at least `TOLERATED` nats
TOLERATED = 0.1


@dataclass(frozen=True, eq=False)
class ComparedStudy:
    """A study that is compared, its posterior, what is known of its interface, and the content of its summary.json.

    `constant` is added to its log-likelihoods.
    """

    study: Study
    posterior: Posterior
    knowledge: Knowledge
    summary: Mapping[str, Any]
    constant: float

    def narrowing(self, name: str) -> float:
        """Return the standard deviation of an input's prior over that of its posterior."""
        space = self.study.space
        k = space.names.index(name)
        prior = space.prior_quantiles(sobol(1024, space.dim, scramble=0))[:, k]
        return float(prior.std() / self.posterior.sd[k])


def not_flat(compared: Mapping[str, ComparedStudy], shared: Sequence[str]) -> list[str]:
    """Return the shared inputs that have a prior with a preference inside its box in some model."""
    spaces = [one.study.space for one in compared.values()]
    return [name for name in shared if any(not isinstance(space[name].prior, FLAT) for space in spaces)]


def describe_comparison(
    found: ModelComparison,
    flat: ModelComparison | None,
    compared: Mapping[str, ComparedStudy],
    together: Weighted | None,
    shared: Sequence[str],
    separate: Sequence[tuple[CandidateSignals, Discrimination | None]],
    *,
    seed: int,
) -> dict[str, Any]:
    """Return the content of compare.json.

    `flat` is the comparison with uniform priors of the shared inputs, None if theirs are flat; `together` are
    model-averaged draws of these. `separate` are candidates with what each is expected to tell about the models.
    """
    first = next(iter(compared.values()))
    return {
        "version": __version__,
        "versions": versions(),
        "seed": seed,
        "verdict": _verdict(found, flat, not_flat(compared, shared)),
        "favoured": found.favoured,
        "tied": list(found.tied),
        "remarks": list(_remarks(found, compared, shared)),
        "scale": [{"least": least, "words": words} for least, words in SCALE],
        "errors_needed": ERRORS,
        "models": {name: _model(found, name, one) for name, one in compared.items()},
        "bayes_factors": [_factor(one, compared, flat) for one in found.factors],
        "averaged": {} if together is None else _averaged(together, compared, shared),
        "predictive": [
            {
                "condition": seen.condition,
                "models": {name: _band(one, seen.condition) for name, one in compared.items()},
            }
            for seen in first.knowledge.likelihood.observations
        ],
        "separate": [
            _separation(shown, one)
            for shown, one in sorted(separate, key=lambda pair: math.inf if pair[1] is None else -pair[1].nats)
        ],
    }


def _separation(shown: CandidateSignals, one: Discrimination | None) -> dict[str, Any]:
    figures = [None] * 4 if one is None else [one.nats, one.error, one.clear, one.wrong]
    return {
        "candidate": shown.label,
        **dict(zip(("nats", "error", "clearly_right", "clearly_wrong"), figures, strict=True)),
        "clear_from": CLEAR,
        "reliable": one is not None and one.reliable,
        "problem": shown.problem,
    }


def _model(found: ModelComparison, name: str, one: ComparedStudy) -> dict[str, Any]:
    evidence, misfit, posterior = found.evidences[name], one.summary["misfit"], one.posterior
    return {
        "folder": str(one.study.folder),
        "study": one.study.name,
        "study_sha256": one.study.text_digest,
        "posterior_sha256": posterior_digest(posterior),
        "model": one.study.runs.identity,
        "inputs": list(one.study.space.shown),
        "fixed": dict(one.study.fixed),
        "model_error": may_err(one.study),
        "runs": one.knowledge.surrogate.runs,
        "log_evidence": evidence.log,
        "error": evidence.error,
        "errors": {"sampling": evidence.sampling, "surrogate": evidence.surrogate, "failing": evidence.failing},
        "stored_log_evidence": posterior.log_evidence + one.constant,
        "constant": one.constant,
        "best_log_likelihood": float(np.max(posterior.log_likelihood)) + one.constant,
        "information": one.posterior.information,
        "prior_probability": found.prior[name],
        "probability": found.probabilities[name],
        "misfit": None if misfit is None else {key: misfit[key] for key in OF_MISFIT},
    }


def _verdict(found: ModelComparison, flat: ModelComparison | None, names: Sequence[str]) -> str:
    """Return the verdict, with what becomes of it under flat priors if that is another one."""
    if flat is None or flat.favoured == found.favoured:
        return found.verdict
    other = flat.verdict[0].lower() + flat.verdict[1:]
    return f"{found.verdict} But the prior of {listed(names)} decides this: with a uniform one on the same box, {other}"


def _factor(one: BayesFactor, compared: Mapping[str, ComparedStudy], flat: ModelComparison | None) -> dict[str, Any]:
    """Return a Bayes factor in two parts, ln B = fit + prior, and what it is with flat priors of the shared inputs."""
    paid = compared[one.over].posterior.information - compared[one.of].posterior.information
    pair = {one.of, one.over}
    wide = None if flat is None else next(each for each in flat.factors if {each.of, each.over} == pair)
    return {
        "fit": one.ln - paid,
        "prior": paid,
        "flat_ln": None if wide is None else wide.ln if wide.of == one.of else -wide.ln,
        "flat_error": None if wide is None else wide.error,
        "flat_words": None if wide is None else wide.words,
        **vars(one),
        **named(one, "words", "decided"),
    }


def _averaged(together: Weighted, compared: Mapping[str, ComparedStudy], shared: Sequence[str]) -> dict[str, Any]:
    space = next(iter(compared.values())).study.space
    out = {}
    for k, name in enumerate(shared):
        column = together.draws[:, k]
        parts = {
            label: Weighted(one.posterior.columns([name]), one.posterior.weights) for label, one in compared.items()
        }
        low, high = np.quantile(column, (OUTSIDE, 1 - OUTSIDE))
        edges = np.linspace(float(low), float(high), BINS + 1)
        whole = Weighted(column[:, None], together.weights)
        out[name] = {
            "label": space[name].shown,
            "unit": space[name].unit,
            **moments(whole, 0, QUANTILES),
            "models": {label: moments(part, 0, QUANTILES) for label, part in parts.items()},
            "histogram": {
                "edges": edges.tolist(),
                "averaged": _histogram(whole, edges),
                "models": {label: _histogram(part, edges) for label, part in parts.items()},
            },
        }
    return out


def _histogram(one: Weighted, edges: Float[np.ndarray, " edge"]) -> list[float]:
    mass, _ = np.histogram(one.draws[:, 0], bins=edges, weights=one.weights)
    return [float(density) for density in mass / np.diff(edges)]


def _band(one: ComparedStudy, condition: str) -> dict[str, Any] | None:
    """Return the predicted interfaces of a condition as offsets from their median; None for surfaces."""
    likelihood, surrogate = one.knowledge.likelihood, one.knowledge.surrogate
    seen = next(seen.interface for seen in likelihood.known_observations if seen.condition == condition)
    x = one.posterior.equally_weighted(0, PREDICTED)
    points = surrogate.points(surrogate.mean(x))[condition]
    template = surrogate.layouts[condition].template
    return offset_band(points, Interface(interface_band(points).median, template.cells), seen)


def _remarks(found: ModelComparison, compared: Mapping[str, ComparedStudy], shared: Sequence[str]) -> Iterator[str]:
    if (misfit := compared[found.order[0]].summary["misfit"]) is not None and misfit["flagged"]:
        yield remark("none_explains", best=found.order[0])
    for name, one in compared.items():
        yield from (f"{name}: {conflict}" for conflict in prior_conflicts(one.posterior))
    yield from _occam(found, compared, shared)
    for name in shared:
        priors = {in_words(one.study.space[name].truncated_prior) for one in compared.values()}
        if len(priors) > 1:
            yield remark("priors_differ", name=name, priors=sorted(priors))
    for name, one in compared.items():
        evidence, stored = found.evidences[name], one.posterior.log_evidence + one.constant
        if abs(stored - evidence.log) > max(OFF * evidence.error, TOLERATED):
            yield remark("evidences_differ", name=name, stored=stored, found=evidence.log)
    if not shared:
        yield remark("nothing_shared")


def _occam(found: ModelComparison, compared: Mapping[str, ComparedStudy], shared: Sequence[str]) -> Iterator[str]:
    """Yield a remark on each model with inputs of its own that the data narrow much."""
    for name in found.order:
        one = compared[name]
        own = {other: one.narrowing(other) for other in one.study.space.scalars if other not in shared}
        narrowed = {other: factor for other, factor in own.items() if factor > 1}
        if sum(map(math.log, narrowed.values())) >= NARROWED:
            yield remark("pays_for_width", name=name, factors=narrowed)


def may_err(study: Study) -> bool:
    """Return whether the study allows for an error of the model."""
    noises = [study.noise, *study.noises.values()]
    return any(isinstance(one, UnknownErrors) and (one.model_error or bool(one.spread)) for one in noises)


def answer_of(content: dict[str, Any], found: Found, folder: Path) -> Answer[Found]:
    """Return what compare.json says, in words and tables."""
    names = ", ".join(content["models"])
    return Answer(
        title=names,
        lead="Which of these models do the data prefer?",
        sentence=content["verdict"],
        remarks=content["remarks"],
        good=content["favoured"] is not None,
        parts=list(_parts(content)),
        content=content,
        found=found,
        page=folder / "compare.html",
        drawn=_drawn,
    )


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    if content["averaged"]:
        yield Captioned.of("compare_marginals", "compare", plots.plot_averaged(content["averaged"]))
    bands = {
        (str(item["condition"]), str(name)): found
        for item in content["predictive"]
        for name, band in item["models"].items()
        if (found := plots.OffsetBand.of(band)) is not None
    }
    if bands:
        yield Captioned.of("compare_predictive", "compare", plots.plot_predictions(bands))


def _parts(content: Mapping[str, Any]) -> Iterator[Part]:
    yield _models(content)
    yield _factors(content)
    if content["averaged"]:
        yield _of_average(content["averaged"])
    verdicts = {
        name: "The fit was not judged." if one["misfit"] is None else one["misfit"]["verdict"]
        for name, one in content["models"].items()
    }
    yield Part("Does each model explain the data?", lines=[f"{name}: {said}" for name, said in verdicts.items()])
    if content["separate"]:
        yield _separate(content["separate"])
    yield Part("How it was computed", notes="how_compared")


def _models(content: Mapping[str, Any]) -> Part:
    head = "study", "inputs", "known", "log-evidence", "best log L", "information", "probability", "misfit"
    rows = [
        (
            name,
            ", ".join(one["inputs"]),
            ", ".join(f"{key} = {digits(value, 4)}" for key, value in one["fixed"].items()),
            f"{one['log_evidence']:.2f} ± {one['error']:.2f}",
            f"{one['best_log_likelihood']:.2f}",
            digits(one["information"], 3),
            f"{one['probability']:.1%}",
            FLAGGED[one["misfit"] and one["misfit"]["flagged"]],
        )
        for name, one in content["models"].items()
    ]
    return Part("The models", Table(head, rows), notes="compared_models")


def _factors(content: Mapping[str, Any]) -> Part:
    head = "of", "over", "ln B", "evidence", "fit", "prior", "with uniform priors"
    rows = [
        (
            one["of"],
            one["over"],
            f"{one['ln']:.2f} ± {one['error']:.2f}",
            one["words"],
            f"{one['fit']:.2f}",
            f"{one['prior']:.2f}",
            "the same" if one["flat_ln"] is None else f"{one['flat_ln']:.2f}, {one['flat_words']}",
        )
        for one in content["bayes_factors"]
    ]
    return Part("Bayes factors", Table(head, rows), notes="bayes_factors")


def _of_average(averaged: Mapping[str, Any]) -> Part:
    rows = []
    for item in averaged.values():
        for model, one in {"all models": item, **item["models"]}.items():
            figures = [digits(one[part], 4) for part in ("mean", "sd", "median", "q05", "q95")]
            rows.append((*label_and_unit(item), model, *figures))
    head = "input", "unit", "under", "mean", "sd", "median", "5 %", "95 %"
    return Part("The shared inputs, averaged over the models", Table(head, rows))


def _separate(candidates: Sequence[Mapping[str, Any]]) -> Part:
    head = "experiment", "nats about the model", "the right model wins clearly", "a wrong model wins clearly"
    rows = [
        (one["candidate"], one["problem"])
        if one["nats"] is None
        else (
            one["candidate"],
            f"{digits(one['nats'], 2)} ± {digits(one['error'], 1)}{'' if one['reliable'] else ' (few draws)'}",
            f"{one['clearly_right']:.0%}",
            f"{one['clearly_wrong']:.0%}",
        )
        for one in candidates
    ]
    return Part("Which experiment would tell them apart", Table(head, rows), notes="separate")
