"""What each candidate can be expected to teach before any data, from a few runs at draws of the prior.

The interface is taken to be linear in the inputs near each draw, and the prior to be normal.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.calibration.experiment import Errors, Footprint, errors_behind, footprint
from strandline.design import sobol
from strandline.design.candidates import Candidate, Look, key_of
from strandline.errors import InvalidInput, TooFewRuns
from strandline.interface import Interface
from strandline.models.protocol import undeformed_interface
from strandline.posterior import Weighted
from strandline.questions.information import directions_left, linear_outlook, scale_of
from strandline.questions.next_runs import Answers, CandidateAnswer, PointRuns, problem_of, runs_at
from strandline.questions.observing import Observing, View
from strandline.runs import Executor, RunRecord
from strandline.studies.study import Study
from strandline.studies.widths import slopes_by_differences, slopes_by_sensitivities

SCRAMBLE = 0
STEP = 0.05
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
        STEP * space.prior_sd,
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
        answers=tuple(_answer(study, errors, candidate, at, now) for candidate in asked),
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


def _answer(
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
