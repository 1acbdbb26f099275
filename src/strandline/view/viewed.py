"""A study as the page sees it: what does not change, what the ledger says now, and the posterior so far."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.tri import LinearTriInterpolator, Triangulation

from strandline.calibration import Answer, Baseline, by_field
from strandline.design import Knowledge
from strandline.foundations import InvalidInput, InvalidStudy, one_thread, read_json, use_double
from strandline.interface import Interface
from strandline.models import DrawsFields, ForwardModel, declared_conditions
from strandline.posterior import reliability_threshold, systematic_indices
from strandline.questions import require
from strandline.report import explore
from strandline.runs import Ledger, Overview
from strandline.studies import (
    REFINEMENT,
    STUDY,
    SUMMARY,
    Study,
    digest_of,
    observations_of,
    picture_behind,
    progress_as_planned,
)
from strandline.view.assumptions import answer_to, asked_by, knobs_of, number_in
from strandline.view.feeds import SEED, PosteriorFeed, RunsFeed, changed_at

OF_SUMMARY = ("warnings", "misfit", "certificate", "nearest")
COLUMNS, DIGITS = 240, 4
"""Columns of the grid of a flow, and digits of its values."""


@dataclass
class ViewedStudy:
    """A study and what has been computed for its page."""

    study: Study

    @cached_property
    def feed(self) -> RunsFeed:
        return RunsFeed(self.study.ledger_path, self.study.space.names)

    @cached_property
    def newest(self) -> PosteriorFeed:
        return PosteriorFeed(self.study)

    @property
    def facts(self) -> dict[str, Any]:
        study, observed = self.study, dict[str, Interface | None](observations_of(self.study)) or {"": None}
        pictures = {
            name: picture_behind(study, name, f"api/picture?{urlencode({'condition': name})}") for name in observed
        }
        return {
            "name": study.name,
            "folder": str(study.folder),
            "inputs": explore.inputs_as_json(study.space),
            "fixed": dict(study.fixed),
            "truth": study.truth,
            "flow": isinstance(study.model, DrawsFields),
            "conditions": explore.conditions_as_json(study.model, observed, pictures),
        }

    def require_ledger(self) -> None:
        """Refuse a ledger that is gone although the study has results or the page has shown runs."""
        path, remedy = self.study.ledger_path, "Copy it back from a backup, or run the study again."
        known = path.is_file() or not (self.feed.version or (self.study.folder / SUMMARY).is_file())
        words = f"no file {path}", "the runs behind what is shown", remedy
        require(known, "the study's ledger", *words, InvalidStudy)

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
        progress = progress_as_planned(self.study)
        summary = read_json(self.study.folder / SUMMARY) if progress.results == "current" else {}
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
        figures = {} if details is None else details.diagnostics
        return {
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
            "diagnostics": {name: value for name, value in figures.items() if math.isfinite(value)},
            "interfaces": self._interfaces(key) if attempt.state == "ok" else {},
        }

    def _interfaces(self, key: str) -> dict[str, Any]:
        """Return the interfaces of a run by condition, with the signed distances of the observed points, µm."""
        observed = observations_of(self.study)
        with Ledger.open(self.study.ledger_path, model=None, read_only=True) as ledger:
            record = ledger.latest([key]).get(key)
        return {
            name: {
                "line": explore.outline(one),
                "offsets": None if name not in observed else explore.offsets_um(observed[name], one),
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
        known = None if quality is None else {"error_um": 1e3 * quality.median, "hidden_um": 1e3 * quality.hidden}
        return {
            **out,
            "mean": explore.by_name(self.study.space, now.mean),
            "sd": explore.by_name(self.study.space, now.sd),
            "draws": explore.columns(self.study.space, few.draws),
            "bands": _bands(now),
            "surrogate": known,
        }

    def predict(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the interface that the surrogate predicts at some inputs."""
        shown = self.newest.shown
        knowledge = None if shown.now is None else shown.now.knowledge
        if knowledge is None:
            why = shown.why_none if shown.now is None else shown.now.why_not
            remedy = "Make more runs." if shown.source == "stored" else "Wait for more runs."
            raise InvalidInput("prediction", value=why, expected="a good surrogate of the interface", remedy=remedy)
        x = self._inputs(given)
        chance = float(np.exp(knowledge.log_feasibility(x[None])[0]))
        return {"conditions": _predicted(knowledge, x, observations_of(self.study)), "success": chance}

    def ask(self, given: Mapping[str, Any], *, again: bool) -> dict[str, Any]:
        """Return the posterior under other assumptions, see `asked_by`; `again` allows to sample it again."""
        asked = asked_by(given, self.study)
        shown = self.newest.shown
        now = shown.now if again else shown.few
        if now is None:
            raise InvalidInput("posterior", value=shown.why_none, expected="a posterior", remedy="Wait for runs.")
        use_double()
        with one_thread():
            return self._answered(answer_to(asked, self.study, now, again=again), now, again=again)

    def _answered(self, answer: Answer, now: Baseline, *, again: bool) -> dict[str, Any]:
        space, threshold = self.study.space, reliability_threshold(len(now.draws))
        out: dict[str, Any] = {
            "by": answer.by,
            "why_not": answer.why_not,
            "effective": answer.effective,
            "k_hat": answer.k_hat if math.isfinite(answer.k_hat) else None,
            "reliable": answer.by != "reweighting" or answer.k_hat < threshold,
        }
        if answer.draws is None:
            return out
        weights, draws = answer.draws.weights, answer.draws.draws
        if again or answer.by != "reweighting":
            draws = draws[systematic_indices(weights, explore.DRAWS, np.random.default_rng(SEED))]
            out["draws"] = explore.columns(space, draws)
        return {
            **out,
            "mean": explore.by_name(space, answer.draws.mean),
            "sd": explore.by_name(space, answer.draws.sd),
            "weights": None if "draws" in out else np.round(weights * len(weights), 5).tolist(),
            "shift": explore.by_name(space, answer.shift),
        }

    def flow(self, given: Mapping[str, Any], condition: str) -> dict[str, Any]:
        """Return velocity, pressure and displacement at some inputs, by a run of the model."""
        words, known = "a model that offers its fields", declared_conditions(self.study.model)
        require(isinstance(self.study.model, DrawsFields), "flow", type(self.study.model).__name__, words)
        require(not condition or condition in known, "condition", condition, f"one of {', '.join(known)}")
        inputs = {**self.study.fixed, **self.study.space.as_mapping(self._inputs(given))}
        return _flow_on_grid(self.study.model, inputs, condition)

    def _inputs(self, given: Mapping[str, Any]) -> Float[np.ndarray, " dim"]:
        space = self.study.space
        return np.array([number_in(name, given.get(name), *space[name].interval) for name in space.names])


def _bands(now: Baseline) -> dict[str, dict[str, Any]]:
    """Return the posterior's predictive bands by condition; nothing without a surrogate of the interface."""
    if now.knowledge is None:
        return {}
    chosen = np.random.default_rng(0).choice(len(now.draws), explore.BAND_DRAWS, p=np.exp(now.log_weights))
    return explore.predictive_band(by_field(now.knowledge.surrogate), now.mean, now.draws[chosen])


def _predicted(
    knowledge: Knowledge, x: Float[np.ndarray, " dim"], observed: Mapping[str, Interface]
) -> dict[str, dict[str, Any]]:
    """Return by condition the predicted polyline, the surrogate's standard deviation along its normals, and offsets."""
    surrogate, out = knowledge.surrogate, {}
    interfaces, variances = surrogate.interfaces(x), surrogate.predict(x[None]).variance[0]
    fields = surrogate.modes.basis / surrogate.modes.roots
    parts = surrogate.by_condition(fields)
    for name, interface in interfaces.items():
        along = np.einsum("mpx,px->mp", parts[name], explore.point_normals(interface))
        sd = np.sqrt(variances @ along**2 + surrogate.modes.remainder**2)
        out[name] = {
            "line": explore.outline(interface),
            "band": explore.band(interface, explore.SDS * sd),
            "sd_um": float(f"{1e3 * float(np.sqrt(np.mean(sd**2))):.3g}"),
            "offsets": None if name not in observed else explore.offsets_um(observed[name], interface),
        }
    return out


def _flow_on_grid(model: ForwardModel, inputs: Mapping[str, float], condition: str) -> dict[str, Any]:
    """Make a run of the built-in model, and return its fields on a regular grid; None outside the cell."""
    plain: Any = model
    fields = plain.fields(inputs, condition) if condition else plain.fields(inputs)
    (left, low), (right, high) = fields.points.min(axis=0), fields.points.max(axis=0)
    rows = max(2, round(COLUMNS * (high - low) / (right - left)))
    x, y = np.linspace(left, right, COLUMNS), np.linspace(low, high, rows)
    grid, fluid, solid = np.meshgrid(x, y), fields.cell_part == 0, fields.cell_part > 0

    def on_grid(values: Float[np.ndarray, " point"], cells: Bool[np.ndarray, " cell"]) -> list[list[float | None]]:
        mesh = Triangulation(fields.points[:, 0], fields.points[:, 1], fields.triangles[cells])
        return [explore.rounded(row, DIGITS) for row in LinearTriInterpolator(mesh, values)(*grid).filled(np.nan)]

    values = {
        "speed": (np.linalg.norm(fields.velocity, axis=1), fluid, "mm/s"),
        "pressure": (fields.pressure, fluid, "Pa"),
        "displacement": (np.linalg.norm(fields.displacement, axis=1), solid, "mm"),
    }
    return {
        "x": np.round(x, 5).tolist(),
        "y": np.round(y, 5).tolist(),
        "fields": {
            name: {"unit": unit, "values": on_grid(one, cells)}
            for name, (one, cells, unit) in values.items()
            if cells.any()
        },
    }
