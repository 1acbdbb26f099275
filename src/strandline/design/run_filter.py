"""Single runs that ended ok but cannot be used: they are named and set aside, and the study goes on.

A run may have another number of points than the measure needs, or coordinates of 1e160. Such a run counts as `invalid`
for this analysis; the ledger keeps it as it is. An interface that runs the other way is turned round.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from strandline.discrepancy import Discrepancy, extent, oriented_like_runs, require_plausible
from strandline.foundations import CampaignStopped, InvalidInput, NoCommonPoints, NumericsError, inputs_text, require
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood, noise_length
from strandline.runs import EXCLUDED, FailurePolicy, RunRecord
from strandline.surrogate import flipped, odd_ones

NOT_COMPARABLE = "not_comparable"
NO_COMMON_POINTS = "no_common_points"
KINDS = frozenset({NOT_COMPARABLE, NO_COMMON_POINTS})
FARTHEST = 1e6  # distance from the observed interface, in its extents, beyond which there is nothing to compare
EXCEPTIONS = 0.1
"""Share of the runs, but at least one, that may be set aside because they lack common points with the others."""


@dataclass(frozen=True)
class SetAside:
    """A run that ended ok and is not used: its content address, its inputs, why in words, and a kind,
    ``not_comparable`` or ``no_common_points``; `measure` is the one it is set aside for, None for all.
    """

    key: str
    inputs: Mapping[str, float]
    kind: str
    measure: str | None
    why: str


class RunFilter:
    """Evaluate the measures on runs, each once, and decide which runs cannot be used; the first measure is the
    posterior's.

    The first runs show at which end an interface begins. An observation that begins at the other end is turned round,
    and `turned` names its condition; so is the interface of a run that clearly begins at the other end.
    """

    def __init__(
        self, observations: tuple[Observation, ...], discrepancies: Mapping[str, Discrepancy], policy: FailurePolicy
    ) -> None:
        self.observations, self.discrepancies, self.policy = observations, discrepancies, policy
        self.likelihoods = {name: InterfaceLikelihood(observations, one) for name, one in discrepancies.items()}
        self.first = next(iter(self.likelihoods))
        self.turned: tuple[str, ...] = ()
        self._oriented = False
        self._known: dict[tuple[str, str], float | InvalidInput | NumericsError | ArithmeticError] = {}
        self._aside: dict[str, SetAside] = {}
        self._exceptions: dict[str, SetAside] = {}

    def usable(self, records: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
        """Return `records` in the observation's direction, with those that cannot be used marked `invalid`.

        Raises:
            InvalidInput: The measure cannot be evaluated on any of the runs, so the runs are not the cause.
            NumericsError: Likewise.
            CampaignStopped: The policy says to stop.
        """
        good = [record for record in records if record.ok]
        self._orient(good)
        self._aside |= {one.key: one for one in self._not_comparable(good)}
        out = tuple(self._judged(record) for record in records)
        self._heed(out)
        return out

    def without_exceptions(self, records: Sequence[RunRecord], error: NoCommonPoints) -> None:
        """Set aside the few runs whose interfaces do not fit the others', from now on.

        Raises:
            NoCommonPoints: `error`, if such runs are not exceptions or the best run is one of them.
        """
        good = [record for record in records if record.ok and record.key not in self._aside]
        names = [seen.condition for seen in self.observations]
        measure = self.likelihoods[self.first].discrepancy
        hidden = min(noise_length(seen, measure) for seen in self.observations)
        odd = odd_ones([{name: record.interfaces[name] for name in names} for record in good], hidden)
        values = np.array([self.value(self.first, record) for record in good])
        regular = [i for i in range(len(good)) if i not in odd]
        if not odd or len(odd) > max(1, EXCEPTIONS * len(good)) or values[[*odd]].max() > values[regular].max():
            raise error
        found = {good[i].key: SetAside(good[i].key, good[i].inputs, NO_COMMON_POINTS, None, odd[i]) for i in odd}
        if found.keys() <= self._exceptions.keys():
            raise error
        self._exceptions = found

    def forget_exceptions(self) -> None:
        """Use the runs without common points again: the log-likelihood needs none."""
        self._exceptions = {}

    def value(self, measure: str, record: RunRecord) -> float:
        """Return the log-likelihood of a run under a measure, NaN if it cannot be evaluated."""
        found = self._evaluated(measure, record)
        return found if isinstance(found, float) else math.nan

    def set_aside(self, records: Sequence[RunRecord]) -> tuple[SetAside, ...]:
        """Return the runs that are set aside, for one measure or for all."""
        first = {**self._exceptions, **self._aside}
        whole = [first[record.key] for record in records if record.key in first]
        partly = [
            SetAside(record.key, record.inputs, NOT_COMPARABLE, name, _one_line(found))
            for name in self.likelihoods
            for record in records
            if name != self.first and isinstance(found := self._known.get((name, record.key)), Exception)
        ]
        return (*whole, *partly)

    def _orient(self, good: Sequence[RunRecord]) -> None:
        """Turn round the observations that run against the first available runs."""
        if self._oriented or not good:
            return
        self._oriented, observations, turned = True, [], []
        for seen in self.observations:
            runs = [record.interfaces[seen.condition] for record in good if seen.condition in record.interfaces]
            _require_size(seen, runs)
            against = oriented_like_runs(seen.interface, runs).flipped
            observations.append(seen.reversed() if against else seen)
            turned += [seen.condition] if against else []
        if turned:
            self.observations, self.turned = tuple(observations), tuple(turned)
            self.likelihoods = {
                name: InterfaceLikelihood(self.observations, one) for name, one in self.discrepancies.items()
            }

    def _evaluated(self, measure: str, record: RunRecord) -> float | InvalidInput | NumericsError | ArithmeticError:
        key = measure, record.key
        if key not in self._known:
            try:
                _require_near(record, self.observations)
                self._known[key] = self.likelihoods[measure](self._turned(record).interfaces)
            except (InvalidInput, NumericsError, ArithmeticError) as error:
                self._known[key] = error
        return self._known[key]

    def _not_comparable(self, good: Sequence[RunRecord]) -> Iterator[SetAside]:
        found = [self._evaluated(self.first, record) for record in good]
        errors = [one for one in found if not isinstance(one, float)]
        if errors and len(errors) == len(found):
            raise errors[0]
        for record, one in zip(good, found, strict=True):
            if not isinstance(one, float):
                yield SetAside(record.key, record.inputs, NOT_COMPARABLE, self.first, _one_line(one))

    def _turned(self, record: RunRecord) -> RunRecord:
        """Return the record with the interfaces turned round that run against the observation."""
        against = {
            seen.condition
            for seen in self.observations
            if seen.condition in record.interfaces and flipped(record.interfaces[seen.condition], seen.interface)
        }
        if not against:
            return record
        turned = {name: one.reversed() if name in against else one for name, one in record.interfaces.items()}
        slopes = dict(record.sensitivities)
        for name in against & slopes.keys():
            if turned[name].dim == 2:  # a surface keeps the order of its nodes
                slopes[name] = {of: slope[::-1] for of, slope in slopes[name].items()}
        return replace(record, interfaces=turned, sensitivities=slopes)

    def _judged(self, record: RunRecord) -> RunRecord:
        found = self._aside.get(record.key) or self._exceptions.get(record.key)
        if found is None or not record.ok:
            return self._turned(record) if record.ok else record
        nothing: dict[str, Any] = {"interfaces": {}, "sensitivities": {}}
        return replace(record, state="invalid", failure_kind=found.kind, message=found.why, **nothing)

    def _heed(self, records: Sequence[RunRecord]) -> None:
        for record in records:
            if record.failure_kind in KINDS and self.policy.aborts(record):
                raise CampaignStopped(
                    f"run {record.key[:12]} cannot be used ({record.failure_kind}), and study.yaml says to stop then\n"
                    f"at {inputs_text(record.inputs)}: {record.message}\n"
                    "All finished runs are kept. Fix the model and start a new ledger, or leave this run out: "
                    f"strandline runs STUDY --exclude {record.key[:12]} --why REASON"
                )
        self.policy.require_worth_going_on(records)


def says_whether_runs_succeed(record: RunRecord) -> bool:
    """Return whether a record shows if runs succeed at its inputs; one set aside or excluded does not."""
    return record.state != EXCLUDED and record.failure_kind not in KINDS


def _require_size(seen: Observation, runs: Sequence[Interface]) -> None:
    """Refuse an observation ten times larger or smaller than all runs: a wrong unit."""
    size = math.log(extent(seen.interface))
    alike = [run for run in runs if run.dim == seen.interface.dim and 0 < extent(run) < math.inf]
    if alike:
        closest = min(alike, key=lambda run: abs(math.log(extent(run)) - size))
        require_plausible(f"observation {seen.condition}".rstrip(), seen.interface, closest)


def _require_near(record: RunRecord, observations: Sequence[Observation]) -> None:
    """Refuse coordinates so far away that squared distances mean nothing."""
    for seen in observations:
        simulated = record.interfaces.get(seen.condition)
        if simulated is None:
            continue  # the likelihood reports which condition is missing
        low, high = seen.interface.points.min(axis=0), seen.interface.points.max(axis=0)
        extent = float((high - low).max())
        largest = float(np.abs(simulated.points).max())
        near = not largest > FARTHEST * max(extent, float(np.abs([low, high]).max()))
        expected = f"at most {FARTHEST:.0e} times the observed interface's extent of {extent:.3g} mm"
        remedy = "Look at the model's units and at whether this run has converged."
        require(near, "coordinates of the simulated interface", f"{largest:.3g} mm", expected, remedy)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
