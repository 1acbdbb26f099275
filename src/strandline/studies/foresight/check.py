"""Check of a finished study's posterior with the true model, by runs at some of its draws, and its file check.json.

These runs have their own ledger, check.sqlite: the design's ledger stays the same to the byte, and each of the two can
be locked, deleted or reused without the other.
"""

import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline import posterior as posteriors
from strandline.calibration import Observer, observer_or_default
from strandline.foundations import InvalidInput, InvalidStudy, TooFewRuns, read_json, write_json
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models import ForwardModel, undeformed_interface, with_option
from strandline.report import add_check
from strandline.runs import Executor, Ledger, RunRecord, run_campaign, run_key
from strandline.studies.foresight.first_run import observations_of, turned_like
from strandline.studies.keys.folder import CHECK, CHECK_LEDGER, POSTERIOR, require_writable, told_if_unwritable
from strandline.studies.load.observed import require_stated
from strandline.studies.load.provenance import facts_of
from strandline.studies.load.study import Study, settled

SHIFT_SHOWN, RATIO_SHOWN = 0.25, 0.2  # a remark reports a mean off by more sds, or an sd off by a larger share
MOMENTS = ("mean", "sd", "reweighted_mean", "reweighted_sd", "shift", "shift_error", "sd_ratio")
VERDICTS: dict[posteriors.Verdict, str] = {
    "good": "The weights can be trusted, and so can the reweighted figures.",
    "usable": "The surrogate is off where the posterior lies, but the reweighted figures can be used.",
    "bad": "DO NOT TRUST THE SURROGATE where the posterior lies, nor the reweighted figures.",
}


@dataclass(frozen=True, eq=False)
class CheckedDraws:
    """Draws of a posterior, by the numbers of their particles, with the run, and the log-likelihoods, of each.

    That by the true model is -inf if the run failed. `result` are the reweighted moments.
    """

    posterior: posteriors.Posterior
    chosen: Int[np.ndarray, " draw"]
    records: tuple[RunRecord, ...]
    true: Float[np.ndarray, " draw"]
    surrogate: Float[np.ndarray, " draw"]
    result: posteriors.Reweighting

    @property
    def failed(self) -> list[RunRecord]:
        return [record for record in self.records if not record.ok]


def describe(study: Study, found: CheckedDraws, seen: Sequence[Observation], *, new_runs: int) -> dict[str, Any]:
    """Return the content of check.json except the seconds."""
    smoothed, number = found.result.smoothed, len(found.records)
    distinct = len({record.key for record in found.records})
    difference = (found.true - found.surrogate)[np.isfinite(found.true)]
    return {
        **facts_of(study, study.settings.seed),
        "posterior_sha256": posterior_digest(found.posterior),
        "draws": number,
        "runs": outcomes(found.records) | {"new": new_runs, "reused": distinct - new_runs},
        "k_hat": smoothed.k_hat,
        "threshold": posteriors.reliability_threshold(number),
        "verdict": posteriors.verdict_on(smoothed),
        "remarks": list(_remarks(study, found)),
        "ess": smoothed.ess,
        "log_likelihood": {"mean_difference": float(difference.mean()), "rms_difference": float(difference.std())},
        "inputs": _inputs(found),
        "particles": {
            "number": found.chosen.tolist(),
            "true": found.true.tolist(),
            "surrogate": found.surrogate.tolist(),
            "log_weight": smoothed.log_weights.tolist(),
        },
        "interfaces": [_interfaces(study, o, found.records) for o in seen],
    }


def outcomes(records: Sequence[RunRecord]) -> dict[str, Any]:
    """Return how many runs ended ok, how many failed, and the kinds of the failures."""
    failed = [record for record in records if not record.ok]
    kinds = dict(Counter(record.failure_kind or record.state for record in failed))
    return {"ok": len(records) - len(failed), "failed": len(failed), "by_kind": kinds}


def read_check(folder: Path, posterior: posteriors.Posterior) -> dict[str, Any] | None:
    """Return the check of `posterior` in `folder`; None if there is none, or only that of another posterior."""
    content = read_json(folder / CHECK)
    return content if content.get("posterior_sha256") == posterior_digest(posterior) else None


def posterior_digest(posterior: posteriors.Posterior) -> str:
    """Return a digest of the particles; posteriors that differ in one bit have different digests."""
    parts = (posterior.draws, posterior.log_weights, posterior.log_likelihood)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part, float).tobytes() for part in parts)).hexdigest()


def _inputs(found: CheckedDraws) -> dict[str, dict[str, Any]]:
    def moments(i: int) -> dict[str, float]:
        return {name: float(getattr(found.result, name)[i]) for name in MOMENTS}

    space = found.posterior.space
    return {one.name: {"unit": one.unit, **moments(i)} for i, one in enumerate(space) if one.name in space.scalars}


def _remarks(study: Study, found: CheckedDraws) -> Iterator[str]:
    verdict = posteriors.verdict_on(found.result.smoothed)
    yield VERDICTS[verdict]
    if verdict != "good":
        coarse = getattr(study.measure, "quadrature", None) == "centre"
        refined = ", the refined quadrature of the measure," if coarse else ""
        yield (
            f"Remedy: more runs near the posterior (a narrower box, or a larger design){refined} or a larger noise. "
            "Then run the study and this check again."
        )
    if verdict != "bad":
        yield from _differences(found)
    if found.failed:
        yield (
            f"{len(found.failed)} of {len(found.records)} draws failed in the true model and have weight zero: "
            "the posterior reaches where the simulator fails, and the surrogate knows nothing there."
        )


def _differences(found: CheckedDraws) -> Iterator[str]:
    result = found.result
    for name, shift, ratio in zip(found.posterior.space.names, result.shift, result.sd_ratio, strict=True):
        if name in found.posterior.space.scalars and (abs(shift) > SHIFT_SHOWN or abs(ratio - 1) > RATIO_SHOWN):
            yield (
                f"{name}: the true model moves the mean by {shift:+.2f} standard deviations and changes the standard "
                f"deviation by a factor of {ratio:.2f}: take the reweighted figures."
            )


def _interfaces(study: Study, observation: Observation, records: Sequence[RunRecord]) -> dict[str, Any]:
    interfaces = [record.interfaces[observation.condition] for record in records if record.ok]
    shapes = {interface.points.shape for interface in interfaces}
    if len(shapes) > 1:
        note = f"no band: the interfaces of the draws have from {min(shapes)[0]} to {max(shapes)[0]} points"
        return {"condition": observation.condition, "points": None, "note": note, "displacement": None, "offset": None}
    points = np.stack([interface.points for interface in interfaces])
    band = posteriors.interface_band(points)
    origin, reference, undeformed = "median", band.median, undeformed_interface(study.model)
    if undeformed is not None and undeformed.points.shape == band.median.shape:
        origin, reference = "undeformed", undeformed.points
    return {
        "condition": observation.condition,
        "points": points.shape[1],
        "note": None,
        "displacement": {
            "from": origin,
            "reference": reference.tolist(),
            "q05": (band.low - reference).tolist(),
            "q50": (band.median - reference).tolist(),
            "q95": (band.high - reference).tolist(),
        },
        "offset": offset_band(points, Interface(band.median, interfaces[0].cells), observation.interface),
    }


def offset_band(
    points: Float[np.ndarray, "draw point xyz"], centre: Interface, observed: Interface
) -> dict[str, Any] | None:
    """Return quantiles of the offsets of draws' nodes from a polyline and the observed ones; None for surfaces.

    The polyline, `centre`, has the same nodes as the draws, such as the median of their interfaces; all in mm.
    """
    if points.shape[2] != 2:
        return None
    nodes, seen = posteriors.normal_offsets(points, centre), posteriors.observed_offsets(observed, centre)
    low, median, high = np.quantile(nodes.offset, (0.05, 0.5, 0.95), axis=0)
    return {
        "arc_length": nodes.arc_length.tolist(),
        "q05": low.tolist(),
        "q50": median.tolist(),
        "q95": high.tolist(),
        "observed_arc_length": seen.arc_length.tolist(),
        "observed": seen.offset.tolist(),
    }


FEWEST_DRAWS = 20


@dataclass(frozen=True)
class PosteriorCheck:
    """The content of check.json, and its path."""

    content: dict[str, Any]
    path: Path


def check_posterior(
    study: Study, *, draws: int = 200, executor: Executor | None = None, observer: Observer | None = None
) -> PosteriorCheck:
    """Run the true model at draws of the study's posterior, and reweight the draws by its likelihood.

    The draws depend only on the posterior, the seed and their number, and the runs are kept: no run is made twice.
    Writes check.json, figures/check.png and .pdf, and a section of report.html.

    At least 20 draws are taken, and at most as many as there are particles. The runs are made where the study says if
    no executor is given. The observer receives the progress.

    Raises:
        InvalidInput: `draws` is too small or too large.
        InvalidStudy: The study has no results for its present study.yaml, or its folder cannot be written to.
        LedgerError: The ledger is locked, belongs to another model, or is damaged.
        TooFewRuns: The run failed at every draw.
    """
    posterior = finished_posterior(study)
    if not FEWEST_DRAWS <= draws <= posterior.number:
        expected = f"from {FEWEST_DRAWS} to {posterior.number}, the number of particles"
        remedy = "200 are a good start; more draws make k̂ more certain."
        raise InvalidInput("draws of the check", value=draws, expected=expected, remedy=remedy)
    require_writable(study.folder)
    tell, begun = observer_or_default(observer), time.perf_counter()
    observations = study.observations(observations_of(study))
    require_stated((seen.noise for seen in observations), "strandline posterior check")
    chosen = posteriors.subset(posterior.weights, draws, study.settings.seed)
    positions, surrogate = posterior.draws[chosen], posterior.log_likelihood[chosen]
    tell.stage("draws")
    records, new_runs = _run(study, positions, executor or study.executor, tell)
    tell.stage("report")
    observations = turned_like(observations, records)
    likelihood = InterfaceLikelihood(observations, study.measure)
    true = np.array([likelihood(record.interfaces) if record.ok else -np.inf for record in records])
    if not any(record.ok for record in records):
        first = records[0]
        reason = (first.message or "no message").splitlines()[0]
        what, expected = "the true model failed at every draw of the posterior", "a posterior where the simulator runs"
        remedy = "Look at the failures; the surrogate knows nothing of where the posterior lies."
        remedy = f"{remedy} E.g. {first.failure_kind or first.state}: {reason}"
        raise TooFewRuns(what, value=f"0 of {len(records)}", expected=expected, remedy=remedy)
    found = CheckedDraws(posterior, chosen, records, true, surrogate, posteriors.reweight(positions, true - surrogate))
    content = describe(study, found, observations, new_runs=new_runs)
    with told_if_unwritable(study.folder):
        add_check(content, study.folder, draft=study.settings.draft)
        content["seconds"] = time.perf_counter() - begun
        write_json(study.folder / CHECK, content)
    return PosteriorCheck(content, study.folder / CHECK)


def finished_posterior(study: Study, *, purpose: str = "check") -> posteriors.Posterior:
    """Return the posterior of a study that has results for its present study.yaml."""
    results, path = study.results, study.folder / POSTERIOR
    if results != "current" or not path.is_file():
        what, expected = f"the study has no posterior to {purpose}", f"{POSTERIOR}, made from study.yaml as it is"
        value = "results of an earlier study.yaml" if results == "outdated" else "a study that is not finished"
        remedy = f"Run it first: strandline run {study.folder}"
        raise InvalidStudy(what, value=value, expected=expected, remedy=remedy)
    study.runs.require_finished()
    try:
        return posteriors.from_datatree(posteriors.read(path), study.space)
    except (OSError, KeyError, ValueError) as error:
        expected, remedy = "the posterior of this study", f"Make it again: strandline report {study.folder}"
        raise InvalidStudy(f"{POSTERIOR} cannot be read", value=str(error), expected=expected, remedy=remedy) from error


def _run(
    study: Study, positions: Float[np.ndarray, "draw dim"], executor: Executor, observer: Observer
) -> tuple[tuple[RunRecord, ...], int]:
    model, identity = plain_model(study), study.runs.identity
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in positions]
    keys = {run_key(identity, entry) for entry in inputs}
    with Ledger.open(study.folder / CHECK_LEDGER, model=identity, description=f"{study.name}, checked") as ledger:
        known = len(settled(ledger, keys))
        records = run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=observer.run)
    return records, len(keys) - known


def plain_model(study: Study) -> ForwardModel:
    """Return the model without sensitivities, which are not needed here."""
    plain: ForwardModel = with_option(study.model, "sensitivities", False) if study.sensitivities else study.model
    return plain
