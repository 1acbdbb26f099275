"""Runs of a model and of a cheaper one as runs of the model: the cheaper interfaces are corrected.

Each run is made by the cheaper model. At a few inputs both models are run; these pairs teach the correction, see
`strandline.surrogate.field.correction`. It is trusted once runs of both models at draws of the posterior, which it has
not learnt from, confirm it. If it explains too little, or is refuted three times, the cheaper model is dropped.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import NoCommonPoints
from strandline.models import CHEAPER, FIRST_PAIRS, is_cheaper
from strandline.runs import RunRecord
from strandline.surrogate import FEWEST_PAIRS, Correction, fit_correction

TRIED, AGAIN = 3, 1
"""Draws of a posterior at which the correction is confirmed, and of one that follows such a posterior."""
MISLEADING = 0.5
"""A cheaper model is dropped if its corrected interfaces err by more than this share of the interfaces' spread."""
REFUTED = 3  # number of trials in which the correction may prove wrong before the cheaper model is dropped
HOPELESS = 3.0  # a refuted correction gets no second chance if left-out pairs err by so many times what is tolerated
FIRM, ENOUGH = 5, 6  # pairs from which errors at left-out ones tell that a cheaper model misleads, or that it does not

At = bytes


@dataclass(frozen=True)
class FidelityReport:
    """What two models were used for; a run of the cheaper one costs this share of one of the model.

    `pairs` is the number of inputs at which both succeeded. `error` is the largest error of the corrected interface at
    the draws that confirmed it, root mean square along the interface, mm; None if it has not been confirmed. `hidden`
    is the shift of the interface that the noise hides, mm. `dropped` says why the cheaper model was dropped; None if it
    is in use.
    """

    cost: float
    cheaper: int
    model: int
    pairs: int
    error: float | None
    hidden: float
    dropped: str | None

    @property
    def equivalents(self) -> float:
        """What all runs cost, in runs of the model."""
        return self.model + self.cost * self.cheaper

    @property
    def statement(self) -> str:
        """What the cheaper model was used for, and what it cost, in sentences."""
        runs = f"{self.cheaper} runs by the cheaper model and {self.model} by the model itself"
        cost = f"{runs} cost as much as {self.equivalents:.3g} runs of the model."
        if self.dropped is not None:
            return f"{cost} The cheaper model is not used: {self.dropped}."
        if self.error is None:
            return f"{cost} The correction of the cheaper model was not confirmed."
        return (
            f"{cost} Corrected by {self.pairs} pairs of runs, interfaces of the cheaper model are accurate to "
            f"{1e3 * self.error:.2g} µm where the posterior lies, {self.error / self.hidden:.0%} of the shift that the "
            "local noise hides."
        )


class Fidelities:
    """Decides which runs both models make, and what runs of the cheaper one, at this share of the cost, are worth."""

    def __init__(self, names: Sequence[str], conditions: Sequence[str], cost: float) -> None:
        self.names, self.conditions, self.cost = tuple(names), tuple(conditions), cost
        self.dropped: str | None = None
        self.correction: Correction | None = None
        self._trial: list[At] = []
        self._tried: list[float] = []
        self._spoilt = False
        self.tolerated = np.inf
        self.confirmed: float | None = None
        self.refuted: list[str] = []
        self._runs: dict[At, dict[bool, RunRecord]] = {}
        self._learnt_from: tuple[str, ...] = ()
        self._counts = {True: 0, False: 0}

    def learn(self, records: Sequence[RunRecord]) -> None:
        """Try the correction at new draws of the posterior, if there are any, and learn it from all pairs of runs.

        An error at these draws of more than `tolerated`, mm, refutes it.
        """
        self._runs = {}
        for record in records:
            self._runs.setdefault(self._at(record), {})[is_cheaper(record.inputs)] = record
        self._counts = {kind: sum(is_cheaper(record.inputs) is kind for record in records) for kind in (True, False)}
        tried = [at for at in self._trial if len(self._runs.get(at, ())) == 2]
        found = [self._error(self._runs[at]) for at in tried if self.correction and self._runs[at][True].ok]
        self._trial = [at for at in self._trial if at not in tried]
        self._tried += found
        self._learn_correction()
        if max(found, default=0.0) > self.tolerated:
            self._refute(max(found))

    def _learn_correction(self) -> None:
        pairs = [runs for runs in self._runs.values() if _both_ok(runs)]
        keys = tuple(sorted(runs[False].key for runs in pairs))
        if self.dropped is not None or len(pairs) < FEWEST_PAIRS or keys == self._learnt_from:
            return
        try:
            cheaper, model = ([self._seen(runs[kind]) for runs in pairs] for kind in (True, False))
            self.correction = fit_correction(cheaper, model)
        except NoCommonPoints as error:
            self.drop(str(error.value))
            return
        self._learnt_from = keys
        if self._explains_little and len(pairs) >= FIRM:
            off, spread = (f"{1e3 * one:.2g} µm" for one in (self.correction.error, self.correction.spread))
            why = f"its interfaces err by {off}, where the model's differ by {spread}"
            self.drop(f"corrected by {len(pairs)} pairs of runs, {why}")

    @property
    def _explains_little(self) -> bool:
        return self.correction is not None and self.correction.error > MISLEADING * self.correction.spread

    def _refute(self, error: float) -> None:
        """Note that the correction was wrong at draws of a posterior; drop the cheaper model if it is hopeless."""
        how = "the model fails where the cheaper one does not" if np.isinf(error) else f"by {1e3 * error:.2g} µm"
        how = f"{how}; {1e3 * self.tolerated:.2g} µm are tolerated"
        reason = f"the corrected interface of the cheaper model is wrong at a draw of the posterior ({how})"
        self.refuted.append(reason)
        hopeless = self.correction is not None and self.correction.error > HOPELESS * self.tolerated
        if hopeless or len(self.refuted) >= REFUTED:
            self.drop(reason)

    def drop(self, why: str) -> None:
        """Use runs of the model alone from now on; a check under way must not pass with what it has seen."""
        self.dropped, self.correction, self._spoilt = why, None, True

    @property
    def lacking(self) -> list[dict[str, float]]:
        """Inputs of one more run each that would make the pairs enough; none if there are enough."""
        wanted = FIRM if self._explains_little else FIRST_PAIRS
        missing = wanted - sum(_both_ok(runs) for runs in self._runs.values())
        if self.dropped is not None or missing <= 0:
            return []
        alone = [next(iter(runs.values())) for runs in self._runs.values() if len(runs) == 1]
        return [_other(record) for record in alone if record.ok][:missing]

    @property
    def by_both(self) -> int:
        return sum(len(runs) == 2 for runs in self._runs.values())

    @property
    def points(self) -> Float[np.ndarray, "run dim"]:
        """Inputs of `records`, in the order in which they were first asked for."""
        rows = [[record.inputs[name] for name in self.names] for record in self.records]
        return np.array(rows, float).reshape(-1, len(self.names))

    @property
    def records(self) -> tuple[RunRecord, ...]:
        """One record for each of the inputs, as if by the model: its own, or a corrected one of the cheaper model."""
        out = []
        for runs in self._runs.values():
            if False in runs:
                out.append(runs[False])
            elif self.dropped is None:
                out.append(self._corrected(runs[True]))
        return tuple(out)

    def no_check(self) -> None:
        """Note that no check is under way."""
        self._trial, self._spoilt = [], False

    def try_at(self, points: Float[np.ndarray, "draw dim"]) -> Float[np.ndarray, "tried dim"]:
        """Begin a trial at the first draws of a posterior; return those at which both models are to be run."""
        held = bool(self._tried) and max(self._tried) <= self.tolerated
        self._tried = self._tried if held else []
        tried = points[: AGAIN if held else TRIED]
        self._trial = [row.tobytes() for row in tried]
        return tried

    def pays(self, error: float) -> bool:
        """Return whether one more pair lowers the error of the field by more, for its cost, than a cheaper run.

        An error of the correction of half of what is tolerated needs no further pairs. `error` is that of the predicted
        interface where the posterior lies, mm.
        """
        wrong = 0.0 if self.correction is None else self.correction.error
        return wrong > 0.5 * self.tolerated and self.cost * wrong**2 > error**2

    def doubts(self) -> tuple[str, ...]:
        """Return why the correction is not to be trusted where the posterior lies; nothing if it is."""
        if self.correction is None:
            return (f"the cheaper model misleads: {self.dropped}",) if self._spoilt else ()
        found = self._tried
        if not found and self.correction.pairs >= ENOUGH:
            found = list(self.correction.left_out)
        if not found:
            return ("the correction of the cheaper model has not been confirmed",)
        if max(found) > self.tolerated:
            return tuple(self.refuted[-1:]) or ("the corrections of the cheaper model are not right where it was run",)
        self.confirmed = max(found)
        return ()

    def report(self, hidden: float) -> FidelityReport:
        pairs = sum(_both_ok(runs) for runs in self._runs.values())
        confirmed = None if self.dropped is not None else self.confirmed
        cheaper, model = self._counts[True], self._counts[False]
        return FidelityReport(self.cost, cheaper, model, pairs, confirmed, hidden, self.dropped)

    def _at(self, record: RunRecord) -> At:
        return np.array([record.inputs[name] for name in self.names], float).tobytes()

    def _seen(self, record: RunRecord) -> dict[str, Any]:
        return {name: record.interfaces[name] for name in self.conditions if name in record.interfaces}

    def _error(self, runs: Mapping[bool, RunRecord]) -> float:
        """Return how far the corrected interface is from the model's; infinite if the model failed."""
        model, cheaper = runs[False], runs[True]
        assert self.correction is not None
        if not model.ok:
            return np.inf
        try:
            corrected = self.correction.corrected(self._seen(cheaper))
            return self.correction.distance(corrected, self._seen(model))
        except NoCommonPoints:
            return np.inf

    def _corrected(self, record: RunRecord) -> RunRecord:
        """Return the record of a run as the model would have made it."""
        record = replace(record, inputs={name: value for name, value in record.inputs.items() if name != CHEAPER})
        if not record.ok or self.correction is None:
            return record
        try:
            interfaces = self.correction.corrected(self._seen(record))
        except NoCommonPoints as error:
            nothing: dict[str, Any] = {"interfaces": {}, "sensitivities": {}, "message": str(error)}
            return replace(record, state="invalid", failure_kind="no_common_points", **nothing)
        slopes: dict[str, dict[str, Any]] = {}
        if record.sensitivities and self.correction.node_by_node:
            for name in self.names:
                of = {condition: record.sensitivities[condition][name] for condition in interfaces}
                for condition, one in self.correction.corrected_slopes(of).items():
                    slopes.setdefault(condition, {})[name] = one
        digest = hashlib.sha256("".join(self._learnt_from).encode()).hexdigest()[:8]
        return replace(record, key=f"{record.key}-{digest}", interfaces=interfaces, sensitivities=slopes)


def as_by_model(records: Sequence[RunRecord], names: Sequence[str], *, dropped: bool = False) -> tuple[RunRecord, ...]:
    """Return one record for each input, as if by the model; without those of a cheaper one if that is `dropped`."""
    if not any(is_cheaper(record.inputs) for record in records):
        return tuple(records)
    conditions = next((tuple(record.interfaces) for record in records if record.ok), ())
    both = Fidelities(names, conditions, 0.5)
    if dropped:
        both.drop("dropped before")
    both.learn(records)
    if both.correction is None:
        both.drop("no correction")
    return both.records


def _both_ok(runs: Mapping[bool, RunRecord]) -> bool:
    return len(runs) == 2 and all(record.ok for record in runs.values())


def _other(record: RunRecord) -> dict[str, float]:
    """Return the inputs of the run of the other model."""
    if is_cheaper(record.inputs):
        return {name: value for name, value in record.inputs.items() if name != CHEAPER}
    return {**record.inputs, CHEAPER: 1.0}
