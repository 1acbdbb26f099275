"""Many specimens and one study: a posterior of each through the surrogate, its certificate, and the population.

Each posterior is written to specimens.jsonl as it is finished, so that a stopped command goes on where it was stopped.
Further runs for specimens have their own ledger, specimens.sqlite: the study's own results stay as they are.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from strandline.calibration import Observer
from strandline.calibration.in_notebook import observer_or_default
from strandline.errors import InvalidInput, InvalidStudy, NumericsError
from strandline.numerics.threads import one_thread
from strandline.population import (
    FEWEST_SPECIMENS,
    Population,
    Refused,
    Shrunk,
    SpecimenPosterior,
    Task,
    population_of,
    posteriors_of,
    shrunk,
)
from strandline.population.refinement import runs_for
from strandline.questions.shown import figures_of, html_answer, input_label
from strandline.questions.specimens.files import SpecimenFiles, specimen_files
from strandline.questions.specimens.lines import lines_of
from strandline.questions.specimens.opened import Specimens, open_specimens
from strandline.questions.specimens.results import describe_specimens, write_table
from strandline.report import write_answer
from strandline.report.answers import draw_specimens
from strandline.runs import Executor, Ledger, Progress, run_campaign
from strandline.studies.check import plain_model
from strandline.studies.folder import (
    SPECIMENS,
    SPECIMENS_LEDGER,
    SPECIMENS_TABLE,
    require_writable,
    told_if_unwritable,
    write_json,
)
from strandline.studies.study import Study
from strandline.text import with_sd

__all__ = ["StudySpecimens", "posteriors_of_files", "specimens"]

BATCH = 4
"""Fewest further runs that are made before the posteriors are looked at again."""


@dataclass(frozen=True, eq=False)
class StudySpecimens:
    """The specimens of a study and their population.

    Args:
        content: Content of specimens.json.
        posteriors: Posteriors in the order of their names.
        population: Posterior of the population; None for fewer than three specimens.
        shrunk: Each specimen given all others; None likewise.
        page: Path of specimens.html.
    """

    content: dict[str, Any]
    posteriors: tuple[SpecimenPosterior, ...]
    population: Population | None
    shrunk: Shrunk | None
    page: Path

    def __repr__(self) -> str:
        counts = self.content["counts"]
        return (
            f"<StudySpecimens of {self.content['study']}: {counts['analysed']} specimens, {counts['good']} good, "
            f"{counts['set_aside']} set aside>"
        )

    def _repr_html_(self) -> str:
        counts, population = self.content["counts"], self.content["population"]
        sentence = f"{counts['analysed']} specimens, {counts['good']} good, {counts['set_aside']} set aside"
        if population is None:
            return html_answer(sentence, (), ())
        rows = [
            (input_label(name, item), *(_with_sd(population["inputs"][name][part]) for part in ("mean", "spread")))
            for name, item in self.content["inputs"].items()
        ]
        return html_answer(sentence, ("input", "population mean", "spread"), rows)

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of specimens.html by name."""
        return figures_of(draw_specimens(self.content))


def _with_sd(moments: dict[str, float]) -> str:
    return with_sd(moments["mean"], moments["sd"])


def specimens(
    study: Study,
    *,
    refine: int = 0,
    seed: int = 1,
    measure: str | None = None,
    processes: int | None = None,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> StudySpecimens:
    """Analyse all specimens that study.yaml names through the surrogate of a finished study, and their population.

    The posterior of a specimen depends on its file, its known inputs, its name and the seed, and on the runs: not on
    the other specimens, their order or the number of processes. Writes specimens.jsonl, specimens.json, specimens.csv,
    specimens.html and figures.

    Args:
        study: A finished study, from `load_study`, with the key `specimens`.
        refine: Largest number of further runs, made for specimens whose certificate says so.
        seed: Seed of all random numbers, 0 or above.
        measure: Name of a measure of the study; its first by default.
        processes: Processes that share the specimens; one per core by default.
        executor: Where further runs are made; by default where the study says.
        observer: Receives the progress.

    Raises:
        InvalidInput: An argument is out of its range.
        InvalidStudy: The study is not finished, names no specimens, none can be used, or its folder cannot be written
            to.
        LedgerError: A ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs succeeded to learn the interface.
    """
    _require_arguments(refine, processes)
    tell = observer_or_default(observer)
    require_writable(study.folder)
    files = specimen_files(study)
    paths = _paths(files)
    tell.stage("surrogate")
    opened = open_specimens(study, seed=seed, measure=measure)
    with lines_of(study).held(), told_if_unwritable(study.folder):
        tell.stage("specimens")
        found = posteriors_of_files(opened, paths, processes=processes, tell=tell)
        _require_any(found)
        made = 0
        if refine and any(not one.certified.good for one in found.posteriors):
            opened, made = _refined(opened, paths, found, refine, executor or study.executor, processes, tell)
            found = posteriors_of_files(opened, paths, processes=processes, tell=tell)
        tell.stage("population")
        population, lifted = _population(found.posteriors, seed)
        tell.stage("report")
        content = describe_specimens(
            opened, found.posteriors, found.refused, population, lifted, made=made, alike=files.alike(paths)
        )
        page = write_answer("specimens", content, study.folder, draft=study.settings.draft)
        write_table(study.folder / SPECIMENS_TABLE, content)
        write_json(study.folder / SPECIMENS, content)
    return StudySpecimens(content, found.posteriors, population, lifted, page)


@dataclass(frozen=True, eq=False)
class Analysed:
    """Posteriors in the order of their names, and the specimens that were set aside."""

    posteriors: tuple[SpecimenPosterior, ...]
    refused: tuple[Refused, ...]


def posteriors_of_files(
    opened: Specimens,
    paths: Sequence[Path],
    *,
    processes: int | None = None,
    tell: Observer | None = None,
    known: Mapping[str, SpecimenPosterior] | None = None,
) -> Analysed:
    """Return the posteriors of the specimens in these files; those in specimens.jsonl are not computed again.

    Args:
        opened: The study, opened for specimens.
        paths: Files of the specimens.
        processes: Processes that share them.
        tell: Receives the progress.
        known: Posteriors by digest that are known; by default those in specimens.jsonl.
    """
    lines, begun = lines_of(opened.study), time.monotonic()
    known = lines.read() if known is None else known
    found: list[SpecimenPosterior] = []
    refused: list[Refused] = []
    tasks: list[Task] = []
    digests: dict[str, str] = {}
    for path in paths:
        task = _task(opened, path)
        if isinstance(task, Refused):
            refused.append(task)
        elif (posterior := known.get(task[1])) is not None:
            found.append(posterior)
        else:
            tasks.append(task[0])
            digests[task[0].name] = task[1]
    reused = done = len(found) + len(refused)
    for one in posteriors_of(opened.begin, opened.discrepancy, tasks, seed=opened.seed, processes=processes):
        if isinstance(one, Refused):
            refused.append(one)
        else:
            found.append(one)
            lines.append(one, digests[one.name])
        done += 1
        if tell is not None:
            tell.part(Progress(len(paths), done, done, 0, reused, time.monotonic() - begun))
    by_name = sorted(found, key=lambda one: one.name)
    return Analysed(tuple(by_name), tuple(sorted(refused, key=lambda one: one.name)))


def _task(opened: Specimens, path: Path) -> tuple[Task, str] | Refused:
    try:
        return opened.task(path)
    except (InvalidInput, NumericsError) as error:
        return Refused(opened.files.name(path), " ".join(str(error).split()))


def _refined(
    opened: Specimens,
    paths: Sequence[Path],
    found: Analysed,
    most: int,
    executor: Executor,
    processes: int | None,
    tell: Observer,
) -> tuple[Specimens, int]:
    """Make further runs for the specimens that need them; return the study opened again, and the number of runs."""
    made, open_ones = 0, [one for one in found.posteriors if not one.certified.good]
    by_name = {opened.files.name(path): path for path in paths}
    while open_ones and made < most:
        left = most - made
        x = runs_for(opened.begin, open_ones, min(left, max(BATCH, -(-left // 2))))
        if not len(x):
            break
        tell.stage("forward")
        made += _run(opened, x, executor, tell)
        opened = open_specimens(opened.study, seed=opened.seed, measure=opened.measure)
        tell.stage("specimens")
        again = posteriors_of_files(opened, [by_name[one.name] for one in open_ones], processes=processes, tell=tell)
        open_ones = [one for one in again.posteriors if not one.certified.good]
    return opened, made


def _run(opened: Specimens, x: Any, executor: Executor, tell: Observer) -> int:
    """Run the model at these inputs; return the number of runs."""
    study = opened.study
    inputs = [{**study.fixed, **study.space.as_mapping(row)} for row in x]
    identity, text = study.runs.identity, f"{study.name}, further runs for specimens"
    with Ledger.open(study.folder / SPECIMENS_LEDGER, model=identity, description=text) as ledger:
        run_campaign(plain_model(study), inputs, ledger=ledger, executor=executor, on_record=tell.run)
    return len(inputs)


def _population(posteriors: Sequence[SpecimenPosterior], seed: int) -> tuple[Population | None, Shrunk | None]:
    if len(posteriors) < FEWEST_SPECIMENS:
        return None, None
    with one_thread():
        population = population_of(posteriors, seed=seed)
        return population, shrunk(population, tuple(one.name for one in posteriors), seed=seed)


def _require_any(found: Analysed) -> None:
    if not found.posteriors:
        first = found.refused[0]
        raise InvalidStudy(
            "specimens: none of the files can be used",
            value=f"{first.name}: {first.why}",
            expected="at least one outline",
            remedy="Correct specimens in study.yaml, or the files.",
        )


def _paths(files: SpecimenFiles) -> list[Path]:
    """Return the files of the specimens."""
    paths = files.paths
    if not paths:
        raise InvalidStudy(
            "specimens",
            value=f"no file {files.pattern} in {files.study.folder}",
            expected="at least one outline",
            remedy="Correct specimens in study.yaml, or add the files.",
        )
    return paths


def _require_arguments(refine: int, processes: int | None) -> None:
    if refine < 0:
        raise InvalidInput("further runs", value=refine, expected="0 or more", remedy="E.g. 20.")
    if processes is not None and processes < 1:
        raise InvalidInput("processes", value=processes, expected="1 or more", remedy="Leave it out to use all cores.")
