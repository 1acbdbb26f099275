"""Would the intervals of a study contain the truth as often as they say? Its experiment repeated, without a run.

Each replicate is written to coverage.jsonl as it ends, so that a stopped command goes on where it was stopped.
"""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from strandline.calibration import Observer
from strandline.calibration.coverage import CoverageFound, Replicate, repeatable, replicated
from strandline.calibration.experiment import Experiment
from strandline.calibration.field_quality import TOLERATED, TOLERATED_SHARE, FieldQuality, field_quality
from strandline.calibration.in_notebook import observer_or_default
from strandline.calibration.source import Source, posterior_source, prior_source
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.numerics.threads import one_thread, use_double
from strandline.posterior import Posterior
from strandline.questions.arguments import chosen_measure, require_seed
from strandline.questions.coverage.replicate_file import ReplicateFile
from strandline.questions.coverage.results import TO_MICROMETRES, describe_coverage
from strandline.questions.knowledge import field_knowledge
from strandline.questions.line_file import LineFile
from strandline.questions.shown import figures_of, html_answer, input_label
from strandline.report import write_answer
from strandline.report.answers import draw_coverage
from strandline.runs import Progress
from strandline.runs.ledger_rows import outcome_digest
from strandline.studies.check import finished_posterior, posterior_digest
from strandline.studies.first_run import observations_of
from strandline.studies.folder import COVERAGE, REPLICATES, require_writable, told_if_unwritable, write_json
from strandline.studies.provenance import points_digest
from strandline.studies.study import Study
from strandline.version import __version__

__all__ = ["StudyCoverage", "coverage"]

FEWEST_REPLICATES = 20
SOURCES = ("prior", "posterior")


@dataclass(frozen=True)
class StudyCoverage:
    """How often the intervals of a study contain the truth.

    Args:
        content: Content of coverage.json.
        found: What the replicates show.
        page: Path of coverage.html.
    """

    content: dict[str, Any]
    found: CoverageFound
    page: Path

    def __repr__(self) -> str:
        return f"<StudyCoverage of {self.content['study']}: {self.found.verdict}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                input_label(name, item),
                f"{one['level']:.0%}",
                f"{one['found']:.0%}",
                f"{one['low']:.0%}–{one['high']:.0%}",
            )
            for name, item in self.content["inputs"].items()
            for one in item["intervals"]
        ]
        head = ("input", "interval", "truths inside", "95 % confidence")
        return html_answer(self.found.verdict, head, rows)

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of coverage.html by name."""
        return figures_of(draw_coverage(self.content))


def coverage(
    study: Study,
    *,
    replicates: int = 200,
    source: str = "prior",
    seed: int = 1,
    measure: str | None = None,
    observer: Observer | None = None,
) -> StudyCoverage:
    """Repeat the experiment of a finished study at other true inputs, and count how often its intervals contain them.

    The surrogate of the interface, learnt from the study's runs, takes the place of the simulator. Replicate k depends
    on the seed and on k alone: more of them, or a second call after a stop, add to those that are known. Writes
    coverage.jsonl, coverage.json, coverage.html and two figures.

    Args:
        study: A finished study, from `load_study`.
        replicates: Number of repetitions, at least 20.
        source: Where the true inputs come from: the ``prior``, or the ``posterior`` in posterior.nc, which then also
            takes the place of the prior in the analysis.
        seed: Seed of all random numbers, 0 or above.
        measure: Name of a measure of the study; its first by default.
        observer: Receives the progress.

    Raises:
        InvalidInput: An argument is out of its range, or no errors of the points have the stated σ_N².
        InvalidStudy: The study is not finished, its folder cannot be written to, or the surrogate of the interface is
            not good enough.
        LedgerError: The ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs succeeded to learn the interface.
    """
    name = chosen_measure(study, measure, "the coverage")
    _require_arguments(replicates, source, seed)
    study.runs.require_finished()
    posterior = finished_posterior(study, purpose="draw from") if source == "posterior" else None
    require_writable(study.folder)
    use_double()
    tell = observer_or_default(observer)
    with one_thread():
        tell.stage("surrogate")
        origin, quality = _origin(study, name, source, posterior)
        experiment = repeatable(origin)
        tell.stage("replicates")
        file = ReplicateFile(LineFile(study.folder / REPLICATES), _key(study, name, seed, posterior))
        found = CoverageFound(study.space.names, _made(experiment, origin, file, replicates, seed, tell))
    tell.stage("report")
    content = describe_coverage(study, found, experiment, quality, source=source, seed=seed, measure=name)
    return StudyCoverage(content, found, _written(content, study))


def _origin(study: Study, measure: str, source: str, posterior: Posterior | None) -> tuple[Source, FieldQuality]:
    """Return where the true inputs come from, and how good the surrogate of the interface is there."""
    knowledge = field_knowledge(study, measure)
    origin = prior_source(knowledge, study.space) if posterior is None else posterior_source(knowledge, posterior)
    quality = field_quality(origin)
    _require_good(quality, source)
    return origin, quality


def _written(content: dict[str, Any], study: Study) -> Path:
    """Write coverage.json, coverage.html and its figures; return the path of the page."""
    with told_if_unwritable(study.folder):
        page = write_answer("coverage", content, study.folder, draft=study.settings.draft)
        write_json(study.folder / COVERAGE, content)
    return page


def _made(
    experiment: Experiment, source: Source, file: ReplicateFile, number: int, seed: int, tell: Observer
) -> tuple[Replicate, ...]:
    """Return all replicates, written to their file while nobody else writes to it."""
    with file.lines.held("strandline coverage", "replicates"), told_if_unwritable(file.lines.path.parent):
        return tuple(_replicates(experiment, source, file, number, seed, tell))


def _replicates(
    experiment: Experiment, source: Source, file: ReplicateFile, number: int, seed: int, tell: Observer
) -> Iterator[Replicate]:
    """Yield the replicates in their order; only those that are not known are made."""
    known, begun = file.read(), time.monotonic()
    reused = done = sum(k in known for k in range(number))
    for k in range(number):
        one = known.get(k)
        if one is None:
            one = replicated(experiment, source, seed=seed, number=k)
            file.append(one)
            done += 1
            tell.part(Progress(number, done, done, 0, reused, time.monotonic() - begun))
        yield one


def _require_arguments(replicates: int, source: str, seed: int) -> None:
    if replicates < FEWEST_REPLICATES:
        raise InvalidInput(
            "replicates of the coverage",
            value=replicates,
            expected=f"at least {FEWEST_REPLICATES}",
            remedy="200 are a good start; more make the bands narrower.",
        )
    if source not in SOURCES:
        raise InvalidInput(
            "source of the true inputs", value=source, expected=" or ".join(SOURCES), remedy="Choose one of them."
        )
    require_seed(seed, "the coverage")


def _require_good(quality: FieldQuality, source: str) -> None:
    if quality.good:
        return
    hidden, median, left_out = (TO_MICROMETRES * mm for mm in (quality.hidden, quality.median, quality.left_out))
    everywhere = "Make more runs over the whole prior, design: {sobol: {runs: …}}, or take --from posterior."
    raise InvalidStudy(
        f"the surrogate of the interface is not accurate enough over the {source}",
        value=f"errors above {TOLERATED * hidden:.3g} µm at {100 * quality.beyond:.0f} % of the draws "
        f"(median {median:.3g} µm; at left-out runs {left_out:.3g} µm)",
        expected=f"at most {100 * TOLERATED_SHARE:.0f} %, since the local noise hides shifts of {hidden:.3g} µm only",
        remedy=everywhere if source == "prior" else "Make more runs where the posterior lies: an active design does.",
    )


def _noise(one: Noise | PointErrors | UnknownErrors) -> str:
    """Return all that is stated about a noise."""
    return repr(one) if isinstance(one, PointErrors | UnknownErrors) else f"{type(one).__qualname__}: {one.facts}"


def _key(study: Study, measure: str, seed: int, posterior: Posterior | None) -> str:
    """Return a digest of everything that a replicate depends on, apart from its number."""
    runs, noises = study.runs, [study.noise, *study.noises.values()]
    keys = frozenset(runs.needed_keys)
    facts = {
        "study": study.text_digest,
        "model": runs.identity,
        "runs": outcome_digest(study.ledger_path, keys),
        "inputs": repr(study.space),
        "measure": f"{measure}: {study.discrepancies[measure]!r}",
        "noise": [_noise(one) for one in noises],
        "conditions": list(study.noises),
        "observed": {name: points_digest(seen) for name, seen in observations_of(study).items()},
        "posterior": None if posterior is None else posterior_digest(posterior),
        "seed": seed,
        "version": __version__,
    }
    return sha256(json.dumps(facts).encode()).hexdigest()
