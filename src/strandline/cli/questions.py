"""`strandline coverage`, `next`, `what-if`, `compare`, `specimens`, `posterior`: questions to a finished study."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli import options
from strandline.foundations import require, with_sd

QUESTIONS = {
    "coverage": "Test by replicates whether the intervals are right.",
    "what-if": "Ask how the posterior changes with prior, noise and measure.",
    "compare": "Say which of several studies' models the data prefer.",
    "specimens": "Analyse many specimens with the runs of one study.",
    "posterior": "Check the posterior of a finished study with the true model.",
    "next": "Rank the candidates for the next experiment.",
}
"""The commands below, in the order in which the help lists them."""
SOURCES = click.Choice(["prior", "posterior"])


def _ask(question: str, study: Any, *given: Any, quiet: bool, **stated: Any) -> None:
    """Print the answer of the public function `question` to a study, or to several, with the progress meanwhile."""
    import strandline
    from strandline.cli.progress import observing

    asked = strandline.load_study(study) if isinstance(study, Path) else study
    with observing(quiet=quiet) as observer:
        answer = getattr(strandline, question)(asked, *given, observer=observer, **stated)
    click.echo(answer)


@click.command("coverage")
@options.study
@click.option("--replicates", type=int, default=200, show_default=True, help="Repetitions, at least 20.")
@click.option(
    "--from", "source", type=SOURCES, default="prior", show_default=True, help="Where the true inputs come from."
)
@options.seed
@options.measure
@options.quiet
def coverage(study: Path, **stated: Any) -> None:
    """Repeat the experiment of STUDY at other true inputs and count how often its intervals contain them.

    The surrogate of the interface stands in for the simulator: no forward run is made. Run it again to resume.
    """
    _ask("coverage", study, **stated)


@click.command("next")
@options.study
@click.option("--from", "source", type=SOURCES, help="Where to begin; by default from the posterior if there is one.")
@click.option("--draws", type=int, default=1000, show_default=True, help="Draws of the posterior.")
@click.option("--runs", type=int, default=8, show_default=True, help="Draws of the prior at which candidates are run.")
@options.seed
@options.quiet
def next_experiment(study: Path, **stated: Any) -> None:
    """Rank the candidates for the next experiment, which STUDY lists under `next`, by what they would teach.

    If the study is finished, a candidate costs one forward run or none; without sensitivities, one more for each input.
    Otherwise it is run at a few draws of the prior.
    """
    _ask("next_experiment", study, **stated)


@click.command("what-if")
@options.study
@options.repeatable(
    "--ask",
    "asked",
    "CHANGE",
    "Ask only this, with the keys of what_if: '{noise: {sd: 5, unit: um}}'. May be repeated.",
)
@options.seed
@options.quiet
def what_if(study: Path, asked: tuple[str, ...], **stated: Any) -> None:
    """Ask how the posterior of STUDY changes with its priors, noise, measure and nuisance inputs.

    The draws of the posterior get other weights, or new ones come from the surrogate: no forward run is made.
    """
    _ask("what_if", study, [_change(text) for text in asked] or None, **stated)


def _change(text: str) -> dict[str, Any]:
    from strandline.studies import load_yaml

    found, remedy = load_yaml(text), "Write e.g. --ask '{noise: {sd: 5, unit: um}}'."
    require(isinstance(found, dict), "--ask", text, "keys with values", remedy)
    return dict(found)


@click.command("compare")
@click.argument("studies", nargs=-1, type=options.STUDY)
@click.option("--to", type=options.PATH, default="comparison", show_default=True, help="Folder of the result.")
@click.option("--odds", metavar="NUMBERS", help="Prior odds of the models in their order, e.g. 2:1; equal by default.")
@click.option(
    "--separate", is_flag=True, help="Rank the candidates under `next` by how well they tell the models apart."
)
@options.seed
@options.quiet
def compare(studies: tuple[Path, ...], odds: str | None, **stated: Any) -> None:
    """Compare the models of finished STUDIES of the same data: evidences, Bayes factors, averaged posterior.

    The surrogate of the interface stands in for the simulator: without --separate, no forward run is made.
    """
    from strandline.questions import odds_in

    _ask("compare", studies, odds=odds_in(odds), **stated)


@click.command("specimens")
@options.study
@click.option(
    "--refine",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Largest number of further runs, made where the surrogate is too coarse.",
)
@click.option("--watch", is_flag=True, help="Wait for new files and analyse each as it arrives, until Ctrl-C.")
@options.seed
@options.measure
@click.option("--processes", type=click.IntRange(min=1), help="Processes that share the work; by default one per core.")
@options.quiet
def specimens(study: Path, refine: int, watch: bool, processes: int | None, **stated: Any) -> None:
    """Analyse all specimens that STUDY names, through the surrogate of its finished runs, and their population.

    Without --refine, no forward run is made. Run it again to resume, or after adding specimens.
    """
    if not watch:
        _ask("specimens", study, refine=refine, processes=processes, **stated)
        return
    if refine:
        raise click.UsageError("--watch makes no forward runs: run `strandline specimens --refine` first.")
    if processes is not None:
        raise click.UsageError("--watch analyses one file at a time: leave out --processes.")
    _watch(study, stated["seed"], stated["measure"])


def _watch(folder: Path, seed: int, measure: str | None) -> None:
    from strandline.questions import RefusedSpecimen, watch_specimens
    from strandline.studies import load_study

    study = load_study(folder)

    def ready(known: int) -> None:
        click.echo(f"{study.name}: {known} specimens known; waiting for new ones (Ctrl-C ends)")

    for arrived in watch_specimens(study, seed=seed, measure=measure, ready=ready):
        one = arrived.answer
        if isinstance(one, RefusedSpecimen):
            click.echo(f"{one.name}: set aside: {one.why}")
            continue
        pairs = zip(one.space.names, one.mean, one.sd, strict=True)
        values = ", ".join(f"{name} {with_sd(mean, sd)}" for name, mean, sd in pairs)
        click.echo(f"{one.name}: {values}; {one.certified.verdict} ({arrived.seconds:.2f} s)")


@click.group("posterior")
def posterior() -> None:
    """Check the posterior of a finished study with the true model."""


@posterior.command("check")
@options.study
@click.option("--draws", type=int, default=200, show_default=True, help="Draws at which the true model is run.")
@options.workers
@options.quiet
def check(study: Path, draws: int, workers: int | None, quiet: bool) -> None:
    """Run the true model at draws of STUDY's posterior and report what the surrogate has got wrong.

    Finished runs are kept: started again, it goes on where it was stopped.
    """
    from strandline.cli.progress import observing
    from strandline.runs import with_workers
    from strandline.studies import check_posterior, load_study

    loaded = load_study(study)
    executor = with_workers(loaded.executor, workers)
    with observing(quiet=quiet) as observer:
        found = check_posterior(loaded, draws=draws, executor=executor, observer=observer)
    _show(found.content, found.path)


def _show(content: Mapping[str, Any], path: Path) -> None:
    from strandline.runs import counted

    runs, differences = content["runs"], content["log_likelihood"]
    kinds = counted(runs["by_kind"])
    click.echo(
        f"\n{content['study']}: {content['draws']} draws of the posterior, {runs['ok']} ok, {runs['failed']} failed "
        f"{f'({kinds}) ' if kinds else ''}({runs['new']} new runs, {runs['reused']} reused)"
    )
    good = min(0.5, content["threshold"])
    click.echo(
        f"Pareto k {content['k_hat']:.2f}: {content['verdict']} (good below {good:.2f}, bad from "
        f"{content['threshold']:.2f}); effective draws {content['ess']:.0f}"
    )
    click.echo(
        f"log-likelihood, true minus surrogate: mean {differences['mean_difference']:.3g}, "
        f"rms about it {differences['rms_difference']:.3g}"
    )
    click.echo(
        f"{'input':>10} {'unit':>7} {'mean':>10} {'true':>10} {'sd':>9} {'true':>9} {'shift':>13} {'sd ratio':>9}"
    )
    for name, item in content["inputs"].items():
        unit = "" if item["unit"] == "1" else item["unit"]
        shift = f"{item['shift']:+.2f} ± {item['shift_error']:.2f}"
        click.echo(
            f"{name:>10} {unit:>7} {item['mean']:>10.4g} {item['reweighted_mean']:>10.4g} {item['sd']:>9.3g} "
            f"{item['reweighted_sd']:>9.3g} {shift:>13} {item['sd_ratio']:>9.3f}"
        )
    for remark in content["remarks"]:
        click.echo(remark)
    click.echo(f"seconds: {content['seconds']:.1f}\ncheck: {path}")
