"""A study as the page sees it: what does not change, its runs, its posterior so far, each kept up to date."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.tri import LinearTriInterpolator, Triangulation

from strandline import studies
from strandline.calibration import AlternativePosterior, Baseline, by_field, interim_posterior
from strandline.design import Knowledge
from strandline.foundations import (
    InvalidInput,
    InvalidStudy,
    NumericsError,
    listed,
    one_thread,
    read_json,
    require,
    use_double,
)
from strandline.interface import Interface
from strandline.models import ForwardModel, declared_conditions, draws_fields
from strandline.posterior import reliability_threshold, systematic_indices
from strandline.questions import baseline_of, field_knowledge
from strandline.report import explore, without_coefficients
from strandline.runs import EXCLUDED, OPEN, Attempt, Details, Ledger, Overview
from strandline.studies import STUDY, SUMMARY, Study, observations_of
from strandline.view.assumptions import SEED, answer_to, asked_by, knobs_of, number_in

OF_SUMMARY = ("warnings", "misfit", "certificate", "nearest")
COLUMNS, DIGITS = 240, 4
"""Columns of the grid of a flow, and digits of its values."""
GROWTH, FEWEST_NEW = 0.1, 4
"""New runs, as a share of those used and at least, after which the posterior is computed again."""


@dataclass
class _Row:
    """A run as the page shows it, and when it changed last."""

    key: str
    attempt: Attempt
    excluded: str | None
    version: int


@dataclass
class RunsFeed:
    """All runs in a ledger, which need not exist yet, in the order of their first starts; `inputs` are shown."""

    path: Path
    inputs: Sequence[str]
    version: int = 0
    _rows: dict[str, _Row] = field(default_factory=dict)
    _open: dict[int, str] = field(default_factory=dict)
    _last: int = 0

    def update(self) -> bool:
        """Read what is new in the ledger; return whether there is anything."""
        if not self.path.is_file():
            return False
        with Overview(self.path) as ledger:
            found, exclusions = ledger.changes(self._last, self._open), ledger.exclusions()
        version = self.version + 1
        for key, attempt in found:
            self._note(key, attempt, version)
        for key, row in self._rows.items():
            why = exclusions[key].why if key in exclusions else None
            if row.excluded != why:
                row.excluded, row.version = why, version
        changed = any(row.version == version for row in self._rows.values())
        self.version = version if changed else self.version
        return changed

    def _note(self, key: str, attempt: Attempt, version: int) -> None:
        self._last = max(self._last, attempt.number)
        if attempt.state == OPEN:
            self._open[attempt.number] = key
        else:
            self._open.pop(attempt.number, None)
        row = self._rows.get(key)
        if row is None:
            self._rows[key] = _Row(key, attempt, None, version)
        elif attempt.number > row.attempt.number or (attempt.number == row.attempt.number and attempt != row.attempt):
            row.attempt, row.version = attempt, version

    def since(self, version: int) -> dict[str, Any]:
        """Return the rows that changed after a version, as columns; `row` is the place of each among all runs."""
        rows = [(place, row) for place, row in enumerate(self._rows.values()) if row.version > version]
        inputs = json.loads(f"[{','.join(row.attempt.inputs for _, row in rows)}]")
        return {
            "version": self.version,
            "total": len(self._rows),
            "row": [place for place, _ in rows],
            "number": [row.attempt.number for _, row in rows],
            "state": [EXCLUDED if row.excluded is not None else row.attempt.state for _, row in rows],
            "kind": [row.attempt.kind for _, row in rows],
            "seconds": explore.rounded([row.attempt.seconds for _, row in rows]),
            "inputs": {name: explore.rounded([one.get(name) for one in inputs]) for name in self.inputs},
        }

    def key_at(self, place: int) -> tuple[str, Attempt] | None:
        """Return key and last start of the run in this place; None if there is none."""
        rows = list(self._rows.values())
        return (rows[place].key, rows[place].attempt) if 0 <= place < len(rows) else None

    @property
    def succeeded(self) -> int:
        """Number of runs that ended ok and are not excluded."""
        return sum(row.attempt.state == "ok" and row.excluded is None for row in self._rows.values())


@dataclass(frozen=True)
class CurrentPosterior:
    """A posterior with all that belongs to it, replaced as a whole: another thread reads it meanwhile.

    `now` is the newest one, None if there is none; it has come from ``none``, the runs ``so far`` or is ``stored``.
    `few` has so few of its draws that they can be weighted again while a slider moves. `history` has runs, means and
    standard deviations of each posterior, the newest last.
    """

    now: Baseline | None = None
    few: Baseline | None = None
    source: str = "none"
    why_none: str = "too few forward runs have ended yet"
    history: tuple[dict[str, Any], ...] = ()


@dataclass
class PosteriorFeed:
    """The newest posterior of a study, and the means and standard deviations of all before it."""

    study: Study
    shown: CurrentPosterior = CurrentPosterior()
    _tried: int = 0
    _stored: int = 0

    def due(self, succeeded: int) -> bool:
        """Return whether there is a newer posterior than this one: stored, or worth computing with so many runs."""
        if self.study.results == "current":
            return self._stored != changed_at(self.study.folder / SUMMARY)
        return succeeded - self._tried >= max(FEWEST_NEW, math.ceil(GROWTH * self._tried))

    def refresh(self, succeeded: int) -> None:
        """Read the stored posterior if the study is finished, else compute that of so many good runs."""
        use_double()
        self._tried, self._stored = succeeded, changed_at(self.study.folder / SUMMARY)
        with one_thread():
            try:
                found, source = self._posterior()
            except (InvalidInput, NumericsError) as error:
                self.shown = replace(self.shown, why_none=f"no posterior yet: {error}")
                return
        before, moved = self.shown, None
        if before.now is not None:  # the largest shift of a mean, in earlier standard deviations
            moved = float(np.abs((found.mean - before.now.mean) / before.now.sd).max())
        step = {
            "runs": succeeded if found.knowledge is None else found.knowledge.surrogate.runs,
            "source": source,
            "mean": explore.by_name(self.study.space, found.mean),
            "sd": explore.by_name(self.study.space, found.sd),
            "moved": moved,
        }
        self.shown = CurrentPosterior(found, _thinned(found), source, before.why_none, (*before.history, step))

    def _posterior(self) -> tuple[Baseline, str]:
        if self.study.results == "current":
            stored = studies.finished_posterior(self.study, purpose="show")
            return baseline_of(self.study, stored, purpose="the page"), "stored"
        knowledge = field_knowledge(self.study, purpose="the page")
        return interim_posterior(knowledge, self.study.space, seed=SEED), "so far"


def _thinned(now: Baseline) -> Baseline:
    """Return a posterior with equally weighted draws, few enough to be weighted again while a slider moves."""
    chosen = systematic_indices(np.exp(now.log_weights), explore.DRAWS, np.random.default_rng(SEED))
    return replace(
        now,
        draws=now.draws[chosen],
        log_weights=np.full(explore.DRAWS, -math.log(explore.DRAWS)),
        log_likelihood=now.log_likelihood[chosen],
        log_prior=now.log_prior[chosen],
    )


def changed_at(path: Path) -> int:
    """Return when a file has changed last, in nanoseconds; 0 if there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


@dataclass
class ViewedStudy:
    """A study and what has been computed for its page."""

    study: Study

    def __post_init__(self) -> None:
        self.feed = RunsFeed(self.study.ledger_path, self.study.space.scalars)
        self.newest = PosteriorFeed(self.study)

    @property
    def facts(self) -> dict[str, Any]:
        study, observed = self.study, dict[str, Interface | None](observations_of(self.study)) or {"": None}
        links = {name: f"api/picture?{urlencode({'condition': name})}" for name in observed}
        pictures = {name: studies.picture_behind(study, name, link) for name, link in links.items()}
        fields = listed([one.name for one in study.space.fields]) if study.space.fields else ""
        content = {
            "name": study.name,
            "folder": str(study.folder),
            "inputs": explore.inputs_as_json(study.space),
            "fixed": dict(study.fixed),
            "truth": study.truth,
            "held": f"The coefficients of {fields} are at their posterior mean, or 0 without a posterior."
            if fields
            else "",
            "flow": draws_fields(study.model),
            "conditions": explore.conditions_as_json(study.model, observed, pictures),
        }
        return self._shown(content)

    def _shown(self, content: dict[str, Any]) -> dict[str, Any]:
        """Return what the page gets: nothing of the coefficients of fields."""
        shown: dict[str, Any] = without_coefficients(content, self.study.space)
        return shown

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
        files = tuple(changed_at(folder / name) for name in (STUDY, SUMMARY, studies.REFINEMENT))
        return self.feed.version, driver, files, len(self.newest.shown.history)

    @property
    def state(self) -> dict[str, Any]:
        progress = studies.progress_as_planned(self.study)
        summary = read_json(self.study.folder / SUMMARY) if progress.results == "current" else {}
        return self._shown(
            {
                **progress.as_dict(),
                "version": self.feed.version,
                "edited": self._edited,
                "posterior": len(self.newest.shown.history),
                "summary": {name: summary.get(name) for name in OF_SUMMARY if name in summary},
            }
        )

    @property
    def _edited(self) -> bool:
        """Whether study.yaml asks for something else than when the page was opened."""
        try:
            text = (self.study.folder / STUDY).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return True
        return studies.digest_of(text) != self.study.text_digest

    def run(self, place: int) -> dict[str, Any] | None:
        """Return the run in this place of the feed, with its interfaces, message and log; None if there is none."""
        if (found := self.feed.key_at(place)) is None:
            return None
        key, attempt = found
        with Overview(self.study.ledger_path) as overview:
            exclusion = overview.exclusions().get(key)
            details = overview.details([attempt.number]).get(attempt.number, Details("", "", {}))
        found_run = {
            "row": place,
            "key": key,
            "number": attempt.number,
            "inputs": json.loads(attempt.inputs),
            "state": attempt.state,
            "kind": attempt.kind,
            "excluded": None if exclusion is None else exclusion.why,
            "observes": self.study.truth is not None and key == self.study.runs.key(self.study.truth),
            "seconds": attempt.seconds,
            "message": details.message,
            "log": details.log,
            "diagnostics": {name: value for name, value in details.diagnostics.items() if math.isfinite(value)},
            "interfaces": self._interfaces(key) if attempt.state == "ok" else {},
        }
        return self._shown(found_run)

    def _interfaces(self, key: str) -> dict[str, Any]:
        """Return the interfaces of a run by condition, with the signed distances of the observed points, µm."""
        with Ledger.open(self.study.ledger_path, model=None, read_only=True) as ledger:
            record = ledger.latest([key]).get(key)
        found, observed = {} if record is None else record.interfaces, observations_of(self.study)
        return {name: _line(one, observed.get(name)) for name, one in found.items()}

    @property
    def posterior(self) -> dict[str, Any]:
        """The posterior now, with its history, what it predicts, and what may be changed."""
        shown = self.newest.shown
        now, few = shown.now, shown.few
        out = {"source": shown.source, "history": shown.history, "knobs": knobs_of(self.study, now)}
        if now is None or few is None:
            return {**out, "why_none": shown.why_none}
        quality = now.quality
        known = None if quality is None else {"error_um": 1e3 * quality.median, "hidden_um": 1e3 * quality.hidden}
        return self._shown(
            {
                **out,
                "why_none": "",
                "mean": explore.by_name(self.study.space, now.mean),
                "sd": explore.by_name(self.study.space, now.sd),
                "draws": explore.columns(self.study.space, few.draws),
                "bands": _bands(now),
                "surrogate": known,
            }
        )

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
            return self._shown(self._answered(answer_to(asked, self.study, now, again=again), now, again=again))

    def _answered(self, answer: AlternativePosterior, now: Baseline, *, again: bool) -> dict[str, Any]:
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
        require(draws_fields(self.study.model), "flow", type(self.study.model).__name__, words)
        require(not condition or condition in known, "condition", condition, f"one of {', '.join(known)}")
        inputs = {**self.study.fixed, **self.study.space.as_mapping(self._inputs(given))}
        return _flow_on_grid(self.study.model, inputs, condition)

    def _inputs(self, given: Mapping[str, Any]) -> Float[np.ndarray, " dim"]:
        """Return the inputs that the page sends, with the coefficients of fields at their posterior mean, else 0."""
        now, space = self.newest.shown.now, self.study.space
        x = np.zeros(space.dim) if now is None else np.array(now.mean)
        for k, one in enumerate(space):
            if one.of_field is None:
                x[k] = number_in(one.name, given.get(one.name), *one.interval)
        return x


def _bands(now: Baseline) -> dict[str, dict[str, Any]]:
    """Return the posterior's predictive bands by condition; nothing without a surrogate of the interface."""
    if now.knowledge is None:
        return {}
    chosen = np.random.default_rng(0).choice(len(now.draws), explore.BAND_DRAWS, p=np.exp(now.log_weights))
    return explore.predictive_band(by_field(now.knowledge.surrogate), now.mean, now.draws[chosen])


def _line(interface: Interface, observed: Interface | None) -> dict[str, Any]:
    """Return an outline, and the signed distances of the observed points, µm; None where nothing was observed."""
    offsets = None if observed is None else explore.offsets_um(observed, interface)
    return {"line": explore.outline(interface), "offsets": offsets}


def _predicted(
    knowledge: Knowledge, x: Float[np.ndarray, " dim"], observed: Mapping[str, Interface]
) -> dict[str, dict[str, Any]]:
    """Return by condition the predicted polyline, the surrogate's standard deviation along its normals, and offsets."""
    surrogate, out = knowledge.surrogate, {}
    interfaces, variances = surrogate.interfaces(x), surrogate.predict(x[None]).variance[0]
    parts = surrogate.by_condition(surrogate.modes.basis / surrogate.modes.roots)
    for name, interface in interfaces.items():
        along = np.einsum("mpx,px->mp", parts[name], explore.point_normals(interface))
        sd = np.sqrt(variances @ along**2 + surrogate.modes.remainder**2)
        mean_sd = float(f"{1e3 * float(np.sqrt(np.mean(sd**2))):.3g}")
        band = explore.band(interface, explore.SDS * sd)
        out[name] = {**_line(interface, observed.get(name)), "band": band, "sd_um": mean_sd}
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
