"""`strandline status`: how far a study is."""

from pathlib import Path

import click

__all__ = ["command"]

RESULTS = {"none": "not yet", "current": "written", "outdated": "of an earlier study.yaml"}


@click.command("status")
@click.argument("study", type=click.Path(path_type=Path))
def command(study: Path) -> None:
    """Count the runs of STUDY by how they ended; it may be running meanwhile."""
    from strandline.studies import load_study
    from strandline.studies.progress import progress_of

    state = progress_of(load_study(study))
    click.echo(f"{state.name}: {state.ok + state.failed} of {state.planned} runs of the design done")
    click.echo(f"  ok {state.ok}, failed {state.failed}, under way (or lost) {state.open}, to do {state.to_do}")
    for kind, count in state.by_kind.items():
        click.echo(f"  {kind}: {count}; e.g. {state.examples[kind]}")
    if state.median_seconds is not None and state.slowest is not None:
        click.echo(f"  median {state.median_seconds:.2f} s a run, slowest {state.slowest:.2f} s")
    click.echo(f"  results: {RESULTS[state.results]}")
