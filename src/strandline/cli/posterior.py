"""`strandline posterior`: checks of the posterior of a finished study."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli import options


@click.group("posterior")
def command() -> None:
    """Check the posterior of a finished study with the true model."""


@command.command("check")
@options.study
@click.option("--draws", type=int, default=200, show_default=True, help="Draws at which the true model is run.")
@options.workers
@options.quiet
def check(study: Path, draws: int, workers: int | None, quiet: bool) -> None:
    """Run the true model at draws of STUDY's posterior and report what the surrogate has got wrong.

    Finished runs are kept: started again, it goes on where it was stopped.
    """
    from strandline.cli.progress import observing
    from strandline.runs.executors import with_workers
    from strandline.studies import check_posterior, load_study

    loaded = load_study(study)
    executor = with_workers(loaded.executor, workers)
    with observing(quiet=quiet) as observer:
        found = check_posterior(loaded, draws=draws, executor=executor, observer=observer)
    _show(found.content, found.path)


def _show(content: Mapping[str, Any], path: Path) -> None:
    """Print k̂, the table of the inputs and the remarks."""
    from strandline.runs.failures import counted

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
