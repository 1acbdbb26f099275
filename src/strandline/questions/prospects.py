"""What candidates for the next experiment can be expected to show, and to teach, given a posterior and their runs."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.calibration import Experiment, Observer, Source, errors_behind, footprint, posterior_source, repeatable
from strandline.design import Candidate, Knowledge, Look, Setting, key_of, training_of
from strandline.foundations import InvalidStudy, NoCommonPoints, require
from strandline.models import declared_conditions, undeformed_interface
from strandline.posterior import Weighted, systematic_indices
from strandline.questions import observing as views
from strandline.questions.information import (
    Answers,
    CandidateAnswer,
    Direction,
    directions_of,
    expected_outlook,
    scale_of,
    shown_columns,
)
from strandline.questions.knowledge import PointRuns, field_knowledge, problem_of, runs_at, runs_to_learn_from
from strandline.runs import Executor
from strandline.studies import Study, finished_posterior
from strandline.surrogate import FieldSurrogate, fit_field

STEP = 0.5  # step of runs beside a point, in standard deviations of the posterior


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
        usable=lambda record: views.slopes_of_field(surrogate, record.sensitivities, study.space.names) is not None,
        executor=executor,
        observer=observer,
    )
    good = [record for one in runs.points for record in (one.run, *one.others) if record.ok]
    fields = [views.field_of(surrogate, record.interfaces) for record in good]
    present = replace(present, succeeded=np.array(fields) if fields else None)
    points = iter(runs.points)
    found = {key_of(one): present.prospect(one, next(points) if present.unknown(one) else None) for one in settings}
    return Prospects(present, found, runs.new, runs.reused)


@dataclass(frozen=True, eq=False)
class Prospect:
    """The predicted interfaces of an experiment: the field as a function of the inputs, None if a run failed, and at
    the draws, mm; the probability that it fails, None if nothing is known about it; and why there is no forecast.
    """

    forecast: views.Fields | None
    fields: Float[np.ndarray, "draw value"]
    failing: float | None
    problem: str = ""


@dataclass(frozen=True, eq=False)
class AfterExperiment:
    """What is known after the experiment of the study: its posterior with draws `now`, a surrogate of the interface in
    all conditions that a candidate observes, places and errors of the observed points, and fields, mm, of candidates'
    runs that `succeeded`.
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
        columns = shown_columns(self.study.space)
        return directions_of(Weighted(scaled, self.now.weights).covariance, columns)

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
            return views.field_of(surrogate, dict.fromkeys(surrogate.layouts, found))
        except NoCommonPoints:
            return None

    @cached_property
    def by_size(self) -> views.Fails | None:
        """Probability of failure by the size of the displacement."""
        known = self.source.knowledge
        if self.undeformed is None:
            return None
        others = self.undeformed[None, :][:0] if self.succeeded is None else self.succeeded
        return views.learn_failure_by_size(self.surrogate, known.x, known.ok, self.undeformed, others)

    def prospect(self, setting: Setting, runs: PointRuns | None) -> Prospect:
        """Return the fields to expect of an experiment, by its runs or the surrogate, and how likely it fails."""
        surrogate, known = self.surrogate, self.known(setting)
        if runs is not None and runs.failed is not None:
            return Prospect(None, np.zeros((0, 0)), None, problem_of(runs.failed))
        carried = None if runs is None else self._carried(runs, known)

        def forecast(points: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point value"]:
            points = views.with_known(points, known)
            return surrogate.modes.fields(surrogate.mean(points)) if carried is None else carried(points)

        fields = forecast(self.now.draws)
        failing = None
        if carried is None:
            failing = 1 - np.exp(self.source.knowledge.log_feasibility(views.with_known(self.now.draws, known)))
        elif self.by_size is not None:
            failing = self.by_size(fields)
        crossing = views.crossing_share(surrogate.by_condition(fields), surrogate.templates)
        if failing is None:
            return Prospect(forecast, fields, crossing if crossing > 0 else None)
        return Prospect(forecast, fields, 1 - (1 - float(self.now.weights @ failing)) * (1 - crossing))

    def _carried(self, runs: PointRuns, known: Mapping[int, float]) -> views.Fields:
        """Return the field of an experiment, from its sensitivities at a point or from the runs beside it."""
        surrogate, names, at = self.surrogate, self.study.space.names, views.with_known(runs.x[None], known)[0]
        field = views.field_of(surrogate, runs.run.interfaces)
        slopes = None if runs.others else views.slopes_of_field(surrogate, runs.run.sensitivities, names)
        if slopes is None:
            moved = np.array([views.field_of(surrogate, one.interfaces) for one in runs.others])
            slopes = np.asarray(((moved - field) / np.diag(runs.beside - runs.x)[:, None]).T)
        return views.transfer(surrogate, at, field, slopes, self.now.covariance)

    def _whole(self, name: str, nodes: Float[np.ndarray, "node xyz"]) -> views.View:
        """Return how a condition is observed; of one that was not observed yet, all nodes are."""
        experiment = self.experiment
        if name in experiment.footprints:
            return views.View(experiment.footprints[name], experiment.errors[name])
        simulated = self.surrogate.layouts[name].with_points(nodes)
        measure = self.study.measure
        errors = errors_behind(self.study.observation(simulated, name), measure, len(nodes))
        return views.View(footprint(simulated, simulated), errors)

    def observing(self, field: Float[np.ndarray, " value"], look: Look) -> views.Observing:
        """Return how the whole interfaces near this field, mm, are observed in the conditions of a look."""
        reference = {name: one[0] for name, one in self.surrogate.by_condition(field[None]).items()}
        names = look.conditions or self.experiment.footprints
        return views.Observing({name: self._whole(name, reference[name]) for name in names}, reference)


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


INFORMATIONS = 16  # draws at which the Fisher information is taken where a gain is linearised


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
        slopes = views.slopes_of_points(one.forecast, x, present.surrogate)
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


DRAWS = 500  # draws of each posterior, few enough to be all different


@dataclass(frozen=True, eq=False)
class CandidateSignals:
    """What a candidate shows under each model: signals of equally likely draws, in the same coordinates."""

    label: str
    signals: tuple[Float[np.ndarray, "_ signal"], ...]
    problem: str = ""


def candidates_of(studies: Sequence[Study]) -> tuple[Candidate, ...]:
    """Return the candidates of the first study that lists some; refuse studies without any."""
    found = next((one.candidates for one in studies if one.candidates), ())
    what, names = "none of the studies lists candidates for the next experiment", ", ".join(one.name for one in studies)
    words = "the key `next` in the study.yaml of one of them", "Add it; the results of the study stay as they are."
    require(found, what, names, *words, InvalidStudy)
    return found


def shown_by_models(
    studies: Mapping[str, Study],
    candidates: Sequence[Candidate],
    *,
    seed: int,
    executor: Executor | None,
    tell: Observer,
) -> tuple[CandidateSignals, ...]:
    """Return what each candidate shows under each model; it costs at most one run with sensitivities of each."""
    found = [
        prospects_of(one, candidates, draws=DRAWS, seed=seed, executor=executor or one.executor, observer=tell)
        for one in studies.values()
    ]
    return tuple(_shown(candidate, found) for candidate in candidates)


def require_settable(studies: Mapping[str, Study], candidates: Sequence[Candidate]) -> None:
    """Refuse candidates that one of the studies could not make: each model must know what they set and observe."""
    for name, study in studies.items():
        for candidate in candidates:
            quantities = [pair for setting in candidate.settings for pair in setting.items()]
            problems = [_problem(study, quantity, value) for quantity, value in quantities]
            missing = [one for one in candidate.look.conditions if one not in declared_conditions(study.model)]
            problems += [f"condition {one}, which its model does not have" for one in missing]
            what, value = f"the candidates under next do not fit {name}", next(filter(None, problems), "")
            expected = "quantities that are fixed or a nuisance input in all studies, and conditions of all models"
            require(not value, what, value, expected, "Remove the candidate, or change the study.", InvalidStudy)


def _problem(study: Study, quantity: str, value: float) -> str:
    if quantity in study.fixed:
        return ""
    if quantity not in study.space.names:
        return f"{quantity}, which its model does not have"
    low, high = study.space[quantity].interval
    if not study.space[quantity].nuisance:
        return f"{quantity}, which is calibrated there"
    return "" if low <= value <= high else f"{quantity} {value:g}, which is outside its box there"


def _shown(candidate: Candidate, found: Sequence[Prospects]) -> CandidateSignals:
    made = [one.of(candidate) for one in found]
    problem = next((one.problem for several in made for one in several if one.problem), "")
    presents, experiments = [one.present for one in found], list(zip(*made, strict=True))
    if not problem and any(not _alike(presents, candidate, several) for several in experiments):
        problem = "the models' interfaces have different points where nothing was observed"
    if problem:
        return CandidateSignals(candidate.label(), (), problem)
    parts = [_signals(candidate, presents, several) for several in experiments]
    return CandidateSignals(candidate.label(), tuple(np.hstack(one) for one in zip(*parts, strict=True)))


def _signals(
    candidate: Candidate, presents: Sequence[AfterExperiment], several: Sequence[Prospect]
) -> list[Float[np.ndarray, "_ signal"]]:
    """Return the signals of one experiment under each model, about the mean interface of the first."""
    pairs = [(present, one, present.now.weights @ one.fields) for present, one in zip(presents, several, strict=True)]
    whole = [present.observing(field, candidate.look) for present, _, field in pairs]
    observing = [one.focused(candidate.look, along=whole[0].seen) for one in whole]
    first = observing[0]
    blocks = []
    for seen, (present, one, _) in zip(observing, pairs, strict=True):
        nodes, rows = present.surrogate.by_condition(one.fields), []
        for name, view in first.views.items():
            reference = view.seen(first.reference[name])
            moves = seen.views[name].points(nodes[name]) - reference.points
            rows.append(view.along(reference, moves))
        blocks.append(np.hstack(rows))
    signals = views.signals_of(np.vstack(blocks), first.information)
    return np.split(signals, np.cumsum([len(one) for one in blocks])[:-1])


def _alike(presents: Sequence[AfterExperiment], candidate: Candidate, several: Sequence[Prospect]) -> bool:
    pairs = zip(presents, several, strict=True)
    seen = [present.observing(present.now.weights @ one.fields, candidate.look).seen for present, one in pairs]
    return all(len({one[name].points.shape for one in seen}) == 1 for name in seen[0])
