"""What each candidate can be expected to show and to teach, from a study's posterior and a run of each candidate.

Before any data, it follows from a few runs at draws of the prior: the interface is taken to be linear in the inputs
near each draw, and the prior to be normal.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.calibration import (
    Errors,
    Experiment,
    Footprint,
    Observer,
    Source,
    errors_behind,
    footprint,
    posterior_source,
    repeatable,
)
from strandline.design import Candidate, Knowledge, Look, Setting, key_of, sobol, training_of
from strandline.foundations import InvalidInput, NoCommonPoints, TooFewRuns
from strandline.interface import Interface
from strandline.models import declared_conditions, undeformed_interface
from strandline.posterior import Weighted, systematic_indices
from strandline.questions.information import (
    Direction,
    directions_left,
    directions_of,
    expected_outlook,
    linear_outlook,
    scale_of,
)
from strandline.questions.knowledge import field_knowledge, runs_to_learn_from
from strandline.questions.next_runs import Answers, CandidateAnswer, PointRuns, problem_of, runs_at
from strandline.questions.observing import (
    Fails,
    Fields,
    Observing,
    View,
    crossing_share,
    field_of,
    learn_failure_by_size,
    slopes_of_field,
    slopes_of_points,
    transfer,
    with_known,
)
from strandline.runs import Executor, RunRecord
from strandline.studies import Study, finished_posterior, slopes_by_differences, slopes_by_sensitivities
from strandline.surrogate import FieldSurrogate, fit_field

STEP = 0.5
"""Step of runs beside a point, in standard deviations of the posterior."""


@dataclass(frozen=True, eq=False)
class Prospects:
    """What all candidates of a study can be expected to show, by the key of a setting, and the numbers of runs."""

    present: "AfterExperiment"
    by_setting: Mapping[str, "Prospect"]
    new: int
    reused: int

    def of(self, candidate: Candidate) -> list["Prospect"]:
        return [self.by_setting[key_of(one)] for one in candidate.settings]


def prospects_of(
    study: Study, candidates: Sequence[Candidate], *, draws: int, seed: int, executor: Executor, observer: Observer
) -> Prospects:
    """Return what candidates can be expected to show, given so many draws of the posterior of a finished study."""
    posterior = finished_posterior(study, purpose="plan from")
    observer.stage("surrogate")
    knowledge = field_knowledge(study, purpose="planning the next experiment")
    source = posterior_source(knowledge, posterior)
    conditions = {name for one in candidates for name in one.look.conditions}
    surrogate = _surrogate(study, knowledge, conditions)
    present = AfterExperiment(study, source, surrogate, repeatable(source), _drawn(source, draws, seed))
    for look in {candidate.look for candidate in candidates}:  # refuses a part with too few points before any run
        present.observing(surrogate.modes.fields(surrogate.mean(present.now.mean[None]))[0], look).focused(look)
    observer.stage("candidates")
    settings = list({key_of(one): one for candidate in candidates for one in candidate.settings}.values())
    wanted = [(one, present.now.mean) for one in settings if present.unknown(one)]
    runs = runs_at(
        study,
        wanted,
        STEP * present.now.sd,
        usable=lambda record: slopes_of_field(surrogate, record.sensitivities, study.space.names) is not None,
        executor=executor,
        observer=observer,
    )
    good = [record for one in runs.points for record in (one.run, *one.others) if record.ok]
    fields = [field_of(surrogate, record.interfaces) for record in good]
    present = replace(present, succeeded=np.array(fields) if fields else None)
    points = iter(runs.points)
    found = {key_of(one): present.prospect(one, next(points) if present.unknown(one) else None) for one in settings}
    return Prospects(present, found, runs.new, runs.reused)


@dataclass(frozen=True, eq=False)
class Prospect:
    """The predicted interfaces of an experiment: the field as a function of the inputs, None if a run failed, and at
    the draws, mm; the probability that it fails, None if nothing is known about it; and why there is no forecast.
    """

    forecast: Fields | None
    fields: Float[np.ndarray, "draw value"]
    failing: float | None
    problem: str = ""


@dataclass(frozen=True, eq=False)
class AfterExperiment:
    """What is known after the experiment of the study: its posterior with draws `now`, a surrogate of the interface in
    all conditions that a candidate observes, places and errors of the observed points, and fields of candidates' runs
    that `succeeded`, mm.
    """

    study: Study
    source: Source
    surrogate: FieldSurrogate
    experiment: Experiment
    now: Weighted
    succeeded: Float[np.ndarray, "run value"] | None = None

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The combinations of the inputs, from the least to the best known."""
        scaled = scale_of(self.study.space).of(self.now.draws)
        return directions_of(Weighted(scaled, self.now.weights).covariance)

    def known(self, setting: Setting) -> dict[int, float]:
        """Return the values of uncertain inputs that an experiment sets, by column."""
        names = self.study.space.names
        return {names.index(name): value for name, value in setting.items() if name in names}

    def unknown(self, setting: Setting) -> bool:
        """Return whether an experiment sets a quantity to a value that the surrogate does not cover."""
        fixed = self.study.fixed
        return any(name in fixed and fixed[name] != value for name, value in setting.items())

    @cached_property
    def undeformed(self) -> Float[np.ndarray, " value"] | None:
        """The undeformed interface as a field; None if the model does not know it."""
        found, surrogate = undeformed_interface(self.study.model), self.surrogate
        if found is None:
            return None
        try:
            return field_of(surrogate, dict.fromkeys(surrogate.layouts, found))
        except NoCommonPoints:
            return None

    @cached_property
    def by_size(self) -> Fails | None:
        """Probability of failure by the size of the displacement."""
        known = self.source.knowledge
        if self.undeformed is None:
            return None
        others = self.undeformed[None, :][:0] if self.succeeded is None else self.succeeded
        return learn_failure_by_size(self.surrogate, known.x, known.ok, self.undeformed, others)

    def prospect(self, setting: Setting, runs: PointRuns | None) -> Prospect:
        surrogate, known = self.surrogate, self.known(setting)
        if runs is not None and runs.failed is not None:
            return Prospect(None, np.zeros((0, 0)), None, problem_of(runs.failed))
        carried = None if runs is None else self._carried(runs, known)

        def forecast(points: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point value"]:
            points = with_known(points, known)
            return surrogate.modes.fields(surrogate.mean(points)) if carried is None else carried(points)

        fields = forecast(self.now.draws)
        failing = None
        if carried is None:
            failing = 1 - np.exp(self.source.knowledge.log_feasibility(with_known(self.now.draws, known)))
        elif self.by_size is not None:
            failing = self.by_size(fields)
        crossing = crossing_share(surrogate.by_condition(fields), surrogate.templates)
        if failing is None:
            return Prospect(forecast, fields, crossing if crossing > 0 else None)
        return Prospect(forecast, fields, 1 - (1 - float(self.now.weights @ failing)) * (1 - crossing))

    def _carried(self, runs: PointRuns, known: Mapping[int, float]) -> Fields:
        """Return the field of an experiment, from its sensitivities at a point or from the runs beside it."""
        surrogate, names, at = self.surrogate, self.study.space.names, with_known(runs.x[None], known)[0]
        field = field_of(surrogate, runs.run.interfaces)
        slopes = None if runs.others else slopes_of_field(surrogate, runs.run.sensitivities, names)
        if slopes is None:
            moved = np.array([field_of(surrogate, one.interfaces) for one in runs.others])
            slopes = np.asarray(((moved - field) / np.diag(runs.beside - runs.x)[:, None]).T)
        return transfer(surrogate, at, field, slopes, self.now.covariance)

    def _whole(self, name: str, nodes: Float[np.ndarray, "node xyz"]) -> View:
        """Return how a condition is observed; of one that was not observed yet, all nodes are."""
        experiment = self.experiment
        if name in experiment.footprints:
            return View(experiment.footprints[name], experiment.errors[name])
        simulated = self.surrogate.layouts[name].with_points(nodes)
        measure = self.study.measure
        errors = errors_behind(self.study.observation(simulated, name), measure, len(nodes))
        return View(footprint(simulated, simulated), errors)

    def observing(self, field: Float[np.ndarray, " value"], look: Look) -> Observing:
        """Return how the whole interfaces near this field, mm, are observed in the conditions of a look."""
        reference = {name: one[0] for name, one in self.surrogate.by_condition(field[None]).items()}
        names = look.conditions or self.experiment.footprints
        return Observing({name: self._whole(name, reference[name]) for name in names}, reference)


def _surrogate(study: Study, knowledge: Knowledge, conditions: Collection[str]) -> FieldSurrogate:
    """Return the surrogate of the study, or one of all conditions if some were not observed yet."""
    if all(name in knowledge.surrogate.layouts for name in conditions):
        return knowledge.surrogate
    records = runs_to_learn_from(study)
    x = np.array([[record.inputs[name] for name in study.space.names] for record in records], float)
    return fit_field(training_of(x, records, study.space, declared_conditions(study.model)))


def _drawn(source: Source, number: int, seed: int) -> Weighted:
    """Return draws of the posterior, each once, with their weights."""
    weights = np.exp(source.log_weights)
    chosen = systematic_indices(weights / weights.sum(), number, np.random.default_rng(seed))
    places, counts = np.unique(chosen, return_counts=True)
    return Weighted(source.points[places], counts / counts.sum())


INFORMATIONS = 16
"""Draws at which the Fisher information is taken where a gain is linearised."""


def answers_from_posterior(
    study: Study, candidates: Sequence[Candidate], *, draws: int, seed: int, executor: Executor, observer: Observer
) -> Answers:
    """Return what each candidate can be expected to teach, given the posterior of a finished study."""
    found = prospects_of(study, candidates, draws=draws, seed=seed, executor=executor, observer=observer)
    observer.stage("gains")
    return Answers(
        source="posterior",
        now=found.present.now,
        errors=found.present.experiment.errors,
        answers=tuple(_after(found.present, candidate, found.of(candidate), seed) for candidate in candidates),
        directions=found.present.directions,
        new=found.new,
        reused=found.reused,
    )


def _after(present: AfterExperiment, candidate: Candidate, made: Sequence[Prospect], seed: int) -> CandidateAnswer:
    problem = next((one.problem for one in made if one.problem), "")
    if problem:
        return CandidateAnswer(candidate, None, None, None, problem)
    now = present.now
    look, by_condition = candidate.look, present.surrogate.by_condition
    observing = [present.observing(now.weights @ one.fields, look).focused(look) for one in made]
    pairs = zip(observing, made, strict=True)
    signals = np.hstack([seen.signals(by_condition(one.fields)) for seen, one in pairs])

    def information(one: Prospect, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
        assert one.forecast is not None
        slopes = slopes_of_points(one.forecast, x, present.surrogate)
        return present.observing(one.forecast(x[None])[0], look).focused(look).fisher(slopes)

    def informations() -> list[Float[np.ndarray, "dim dim"]]:
        some = now.draws[np.linspace(0, len(now.draws) - 1, INFORMATIONS).astype(int)]
        return [np.sum([information(one, x) for one in made], axis=0) for x in some]

    outlook = expected_outlook(now, signals, informations, interest=present.study.space.calibrated, seed=seed)
    known = [1 - one.failing for one in made if one.failing is not None]
    sizes = []
    if present.undeformed is not None:
        rest = {name: points[0] for name, points in by_condition(present.undeformed[None]).items()}
        sizes = [seen.displacement(rest) for seen in observing]
    failing = 1 - float(np.prod(known)) if len(known) == len(made) else None
    return CandidateAnswer(candidate, outlook, failing, max(sizes, default=None))


SCRAMBLE = 0
PRIOR_STEP = 0.05
"""Step of runs beside a draw, in standard deviations of the prior."""
PRIOR_DRAWS = 4096
PLANNED = Candidate(({},), Look())
"""The experiment of the study."""
_Experiment = tuple[Observing, Float[np.ndarray, "dim dim"]]


def answers_from_prior(
    study: Study, candidates: Sequence[Candidate], *, runs: int, executor: Executor, observer: Observer
) -> Answers:
    """Return what the planned experiment and each candidate can be expected to teach before any data.

    Each is run at so many draws of the prior.
    """
    space = study.space
    x = space.prior_quantiles(sobol(runs, space.dim, scramble=SCRAMBLE))
    asked = [PLANNED, *(one for one in candidates if one != PLANNED)]
    settings = list({key_of(one): one for candidate in asked for one in candidate.settings}.values())
    observer.stage("candidates")
    made = runs_at(
        study,
        [(setting, row) for setting in settings for row in x],
        PRIOR_STEP * space.prior_sd,
        usable=lambda record: slopes_by_sensitivities(record, space.names) is not None,
        executor=executor,
        observer=observer,
    )
    observer.stage("gains")
    at = {key_of(setting): made.points[k * runs : (k + 1) * runs] for k, setting in enumerate(settings)}
    failed = [one.failed for one in at[key_of({})] if one.failed is not None]
    good = [one for one in at[key_of({})] if one.failed is None]
    if not good:
        raise TooFewRuns(
            "the planned experiment failed at every draw of the prior",
            value=f"0 of {runs}; e.g. {problem_of(failed[0])}",
            expected="a prior where the simulator runs",
            remedy="Look at the failures, or move the priors to where it runs.",
        )
    errors = _errors(study, good[0].run, asked)
    now = Weighted(
        space.prior_quantiles(sobol(PRIOR_DRAWS, space.dim, scramble=SCRAMBLE)), np.full(PRIOR_DRAWS, 1 / PRIOR_DRAWS)
    )
    planned = [information for _, information in _experiments(study, errors, good, PLANNED.look)]
    if not planned:
        raise InvalidInput(
            "slopes of the interface in the inputs",
            value="runs whose interfaces have different nodes, and no sensitivities",
            expected="interfaces with the same nodes in all runs, or sensitivities",
            remedy="Let the simulator return the same nodes, or finish the study and plan from its posterior.",
        )
    return Answers(
        source="prior",
        now=now,
        errors=errors,
        answers=tuple(_before(study, errors, candidate, at, now) for candidate in asked),
        directions=directions_left(scale_of(space), np.array([one.x for one in good]), planned),
        new=made.new,
        reused=made.reused,
    )


def _experiments(
    study: Study, errors: Mapping[str, Errors], points: Sequence[PointRuns], look: Look
) -> Iterator[_Experiment]:
    """Yield how the experiment is observed at each point whose runs succeeded, and its Fisher information.

    It is observed at the places of the study's observation if there is one; the errors of the points are by condition.
    """
    for one in points:
        if one.failed is not None:
            continue
        slopes = slopes_by_sensitivities(one.run, study.space.names)
        slopes = slopes or slopes_by_differences(one.run, one.others, one.x, one.beside)
        if slopes is not None:
            names = look.conditions or study.observed or one.run.interfaces
            views = {name: View(_places(study, one.run, name), errors[name]) for name in names}
            observing = Observing(views, {name: one.run.interfaces[name].points for name in names}).focused(look)
            yield observing, observing.fisher(slopes)


def _errors(study: Study, run: RunRecord, asked: Sequence[Candidate]) -> dict[str, Errors]:
    """Return the errors of the points in each condition that is, or would be, observed, near a run that succeeded."""
    measure, found = study.measure, {}
    wanted = {*(study.observed or run.interfaces), *(name for one in asked for name in one.look.conditions)}
    for name in sorted(wanted):
        places, nodes = _places(study, run, name), run.interfaces[name].points
        seen = study.observation(Interface(places.on(nodes), places.cells), name)
        found[name] = errors_behind(seen, measure, len(nodes))
    return found


def _places(study: Study, run: RunRecord, name: str) -> Footprint:
    simulated = run.interfaces[name]
    return footprint(study.observed.get(name, simulated), simulated)


def _before(
    study: Study,
    errors: Mapping[str, Errors],
    candidate: Candidate,
    at: Mapping[str, Sequence[PointRuns]],
    now: Weighted,
) -> CandidateAnswer:
    """Return what one candidate can be expected to teach; experiments made together share the draws of the inputs."""
    several = [at[key_of(setting)] for setting in candidate.settings]
    good = [k for k, points in enumerate(zip(*several, strict=True)) if all(one.failed is None for one in points)]
    failing = 1 - len(good) / len(several[0])
    if not good:
        failed = next(one.failed for points in several for one in points if one.failed is not None)
        return CandidateAnswer(candidate, None, failing, None, problem_of(failed))
    found = [[*_experiments(study, errors, [points[k] for k in good], candidate.look)] for points in several]
    if not all(len(one) == len(good) for one in found):
        return CandidateAnswer(
            candidate, None, failing, None, "the runs have different nodes, so that they give no slopes"
        )
    informations = [np.sum([one[k][1] for one in found], axis=0) for k in range(len(good))]
    rest = undeformed_interface(study.model)
    sizes = [
        seen.displacement(dict.fromkeys(seen.reference, rest.points))
        for several in found
        for seen, _ in several
        if rest is not None and all(nodes.shape == rest.points.shape for nodes in seen.reference.values())
    ]
    outlook = linear_outlook(now.covariance, informations, interest=study.space.calibrated)
    return CandidateAnswer(candidate, outlook, failing, float(np.median(sizes)) if sizes else None)
