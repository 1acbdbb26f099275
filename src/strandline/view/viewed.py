"""A study as the page sees it: what does not change, what the ledger says now, and the posterior so far."""

import json
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Float

from strandline.calibration.alternative import Present
from strandline.calibration.misfit import by_field
from strandline.calibration.what_if import Answer
from strandline.errors import InvalidInput, InvalidStudy
from strandline.models.offers import DrawsFields, undeformed_interface
from strandline.models.protocol import declared_conditions
from strandline.numerics.one_thread import one_thread
from strandline.numerics.precision import use_double
from strandline.posterior import systematic_indices
from strandline.posterior.pareto_smoothing import reliability_threshold
from strandline.report.explore import inputs_as_json
from strandline.report.outlines import offsets_um, outline, predictive_band
from strandline.runs import Ledger
from strandline.runs.overview import Overview
from strandline.studies.first_run import observations_of
from strandline.studies.folder import REFINEMENT, STUDY, SUMMARY
from strandline.studies.pictures.shown import picture_behind
from strandline.studies.progress import progress_as_planned
from strandline.studies.question_keys import digest_of
from strandline.studies.study import Study
from strandline.view.assumptions import answer_to, asked_by, knobs_of
from strandline.view.flow import flow_on_grid
from strandline.view.posterior_feed import DRAWS, SEED, PosteriorFeed, changed_at
from strandline.view.predictions import predicted
from strandline.view.runs_feed import RunsFeed

__all__ = ["ViewedStudy"]

OF_SUMMARY = ("warnings", "misfit", "certificate", "nearest", "log_evidence", "seconds", "version")
DIGITS = 6
BAND_DRAWS = 200
"""Draws of the posterior whose interfaces make the predictive band."""


@dataclass
class ViewedStudy:
    """A study and what has been computed for its page.

    Args:
        study: The study, from `load_study`.
    """

    study: Study
    _solving: threading.Lock = field(default_factory=threading.Lock)

    @cached_property
    def feed(self) -> RunsFeed:
        """The runs in the study's ledger."""
        return RunsFeed(self.study.ledger_path, self.study.space.names)

    @cached_property
    def newest(self) -> PosteriorFeed:
        """The posterior now, and how it took shape."""
        return PosteriorFeed(self.study)

    @property
    def facts(self) -> dict[str, Any]:
        """What the page needs to know once: the inputs, the conditions, what was observed, what can be changed."""
        study = self.study
        return {
            "name": study.name,
            "folder": str(study.folder),
            "model": type(study.model).__name__,
            "inputs": inputs_as_json(study.space),
            "fixed": dict(study.fixed),
            "truth": study.truth,
            "measures": list(study.discrepancies),
            "flow": isinstance(study.model, DrawsFields),
            "conditions": self._conditions(),
        }

    def _conditions(self) -> list[dict[str, Any]]:
        """Return each condition with what was observed, the undeformed interface and the picture behind it."""
        study, rest = self.study, undeformed_interface(self.study.model)
        observed = observations_of(study)
        names = list(observed) or [""]
        return [
            {
                "name": name,
                "observed": None if name not in observed else outline(observed[name]),
                "undeformed": None if rest is None else outline(rest),
                "picture": picture_behind(study, name, f"api/picture?{urlencode({'condition': name})}"),
            }
            for name in names
        ]

    def require_ledger(self) -> None:
        """Refuse a ledger that is gone although the study has results or the page has shown runs.

        Raises:
            InvalidStudy: It is gone.
        """
        if self.study.ledger_path.is_file() or not (self.feed.version or (self.study.folder / SUMMARY).is_file()):
            return
        raise InvalidStudy(
            "the study's ledger",
            value=f"no file {self.study.ledger_path}",
            expected="the runs behind what is shown",
            remedy="Copy it back from a backup, or run the study again.",
        )

    @property
    def stamp(self) -> tuple[Any, ...]:
        """What the state depends on, cheap to read: the ledger, the driver, the files of the study."""
        folder, ledger = self.study.folder, self.study.ledger_path
        driver = None
        if ledger.is_file():
            with Overview(ledger) as overview:
                driver = overview.driver()
        files = tuple(changed_at(folder / name) for name in (STUDY, SUMMARY, REFINEMENT))
        return self.feed.version, driver, files, len(self.newest.shown.history)

    @property
    def state(self) -> dict[str, Any]:
        """How far the study has got."""
        progress = progress_as_planned(self.study)
        summary = _read(self.study.folder / SUMMARY) if progress.results == "current" else {}
        return {
            **progress.as_dict(),
            "version": self.feed.version,
            "edited": self._edited,
            "posterior": len(self.newest.shown.history),
            "summary": {name: summary.get(name) for name in OF_SUMMARY if name in summary},
        }

    @property
    def _edited(self) -> bool:
        """Whether study.yaml asks for something else than when the page was opened."""
        try:
            text = (self.study.folder / STUDY).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return True
        return digest_of(text) != self.study.text_digest

    def run(self, place: int) -> dict[str, Any] | None:
        """Return the run in this place of the feed, with its interfaces, message and log; None if there is none."""
        found = self.feed.key_at(place)
        if found is None:
            return None
        key, attempt = found
        with Overview(self.study.ledger_path) as overview:
            exclusion = overview.exclusions().get(key)
            details = overview.details([attempt.number]).get(attempt.number)
        out: dict[str, Any] = {
            "row": place,
            "key": key,
            "number": attempt.number,
            "inputs": json.loads(attempt.inputs),
            "state": attempt.state,
            "kind": attempt.kind,
            "excluded": None if exclusion is None else exclusion.why,
            "observes": self.study.truth is not None and key == self.study.runs.key(self.study.truth),
            "seconds": attempt.seconds,
            "message": "" if details is None else details.message,
            "log": "" if details is None else details.log,
            "diagnostics": {} if details is None else _finite(details.diagnostics),
            "interfaces": {},
        }
        if attempt.state == "ok":
            out["interfaces"] = self._interfaces(key)
        return out

    def _interfaces(self, key: str) -> dict[str, Any]:
        """Return the interfaces of a run by condition, with the signed distances of the observed points, µm."""
        observed = observations_of(self.study)
        with Ledger.open(self.study.ledger_path, model=None, read_only=True) as ledger:
            record = ledger.latest([key]).get(key)
        return {
            name: {
                "line": outline(one),
                "offsets": None if name not in observed else offsets_um(observed[name], one),
            }
            for name, one in ({} if record is None else record.interfaces).items()
        }

    @property
    def posterior(self) -> dict[str, Any]:
        """The posterior now, with its history, what it predicts, and what may be changed."""
        shown = self.newest.shown
        now, few = shown.now, shown.few
        out: dict[str, Any] = {
            "source": shown.source,
            "why_none": "" if now is not None else shown.why_none,
            "history": shown.history,
            "knobs": knobs_of(self.study, now),
        }
        if now is None or few is None:
            return out
        quality = now.quality
        return {
            **out,
            **_moments(self.study.space.names, now.weighted.draws, np.exp(now.log_weights)),
            "draws": self._columns(few.draws),
            "bands": _bands(now),
            "surrogate": None
            if quality is None
            else {
                "error_um": 1e3 * quality.median,
                "hidden_um": 1e3 * quality.hidden,
                "good": quality.good,
            },
        }

    def predict(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the interface that the surrogate predicts at some inputs.

        Raises:
            InvalidInput: An input is missing or outside its box, or there is no surrogate yet.
        """
        shown = self.newest.shown
        if shown.now is None or shown.now.knowledge is None:
            why = shown.why_none if shown.now is None else shown.now.why_not
            remedy = "Make more runs." if shown.source == "stored" else "Wait for more runs."
            raise InvalidInput("prediction", value=why, expected="a good surrogate of the interface", remedy=remedy)
        x = self._inputs(given)
        knowledge = shown.now.knowledge
        chance = float(np.exp(knowledge.log_feasibility(x[None])[0]))
        return {"conditions": predicted(knowledge, x, observations_of(self.study)), "success": chance}

    def ask(self, given: Mapping[str, Any], *, again: bool) -> dict[str, Any]:
        """Return the posterior under other assumptions.

        Args:
            given: The assumptions, see `asked_by`.
            again: Whether it may be sampled again.

        Raises:
            InvalidInput: The assumptions cannot be used, or there is no posterior yet.
        """
        asked = asked_by(given, self.study)
        shown = self.newest.shown
        now = shown.now if again else shown.few
        if now is None:
            raise InvalidInput("posterior", value=shown.why_none, expected="a posterior", remedy="Wait for runs.")
        use_double()
        with one_thread():
            return self._answered(answer_to(asked, self.study, now, again=again), now, again=again)

    def _answered(self, answer: Answer, now: Present, *, again: bool) -> dict[str, Any]:
        threshold = reliability_threshold(len(now.draws))
        out: dict[str, Any] = {
            "by": answer.by,
            "why_not": answer.why_not,
            "effective": answer.effective,
            "k_hat": answer.k_hat if math.isfinite(answer.k_hat) else None,
            "threshold": threshold,
            "reliable": answer.by != "reweighting" or answer.k_hat < threshold,
        }
        if answer.draws is None:
            return out
        weights, draws = answer.draws.weights, answer.draws.draws
        if again or answer.by != "reweighting":
            draws = draws[systematic_indices(weights, DRAWS, np.random.default_rng(SEED))]
            out["draws"] = self._columns(draws)
        return {
            **out,
            **_moments(self.study.space.names, answer.draws.draws, answer.draws.weights),
            "weights": None if "draws" in out else np.round(weights * len(weights), 5).tolist(),
            "shift": dict(zip(self.study.space.names, _finite_list(answer.shift), strict=True)),
            "sd_ratio": dict(zip(self.study.space.names, _finite_list(answer.sd_ratio), strict=True)),
        }

    def flow(self, given: Mapping[str, Any], condition: str) -> dict[str, Any]:
        """Return velocity, pressure and displacement at some inputs, by a run of the model.

        Raises:
            InvalidInput: An input is missing or outside its box, or the model has no fields.
            ForwardModelError: The run failed.
        """
        if not isinstance(self.study.model, DrawsFields):
            raise InvalidInput(
                "flow",
                value=type(self.study.model).__name__,
                expected="a model that offers its fields",
                remedy="Use the other panels.",
            )
        known = declared_conditions(self.study.model)
        if condition and condition not in known:
            raise InvalidInput(
                "condition", value=condition, expected=f"one of {', '.join(known)}", remedy="Choose one."
            )
        inputs = {**self.study.fixed, **self.study.space.as_mapping(self._inputs(given))}
        with self._solving:
            return flow_on_grid(self.study.model, inputs, condition)

    def _inputs(self, given: Mapping[str, Any]) -> Float[np.ndarray, " dim"]:
        values = []
        for parameter in self.study.space:
            low, high = parameter.interval
            value = given.get(parameter.name)
            if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
                raise InvalidInput(
                    parameter.name,
                    value=value,
                    expected=f"a number in its box, [{low:g}, {high:g}]",
                    remedy="Choose another one.",
                )
            values.append(float(value))
        return np.array(values)

    def _columns(self, draws: Float[np.ndarray, "draw dim"]) -> dict[str, list[float]]:
        names = self.study.space.names
        return {name: [float(f"{v:.{DIGITS}g}") for v in draws[:, i].tolist()] for i, name in enumerate(names)}


def _bands(now: Present) -> dict[str, dict[str, Any]]:
    """Return the posterior's predictive bands by condition; nothing without a surrogate of the interface."""
    if now.knowledge is None:
        return {}
    chosen = np.random.default_rng(0).choice(len(now.draws), BAND_DRAWS, p=np.exp(now.log_weights))
    return predictive_band(by_field(now.knowledge.surrogate), now.mean, now.draws[chosen])


def _moments(
    names: Sequence[str], draws: Float[np.ndarray, "draw dim"], weights: Float[np.ndarray, " draw"]
) -> dict[str, Any]:
    mean = weights @ draws
    sd = np.sqrt(weights @ (draws - mean) ** 2)
    return {
        "mean": dict(zip(names, mean.tolist(), strict=True)),
        "sd": dict(zip(names, sd.tolist(), strict=True)),
    }


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if math.isfinite(value)}


def _finite_list(values: Float[np.ndarray, " dim"]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
