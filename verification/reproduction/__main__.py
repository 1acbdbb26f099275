"""`make reproduce`: the whole published study; ``python -m verification.reproduction [FOLDER]``."""

from pathlib import Path

import click

from strandline.cli import main


@click.command("reproduction")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default=Path("reproduction"))
@click.option(
    "--studies",
    type=click.Path(path_type=Path),
    default=Path("studies"),
    show_default=True,
    help="Folder that holds the study folders.",
)
@click.option("--workers", type=click.IntRange(min=1), help="Worker processes, if not as the studies say.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(folder: Path, studies: Path, workers: int | None, quiet: bool) -> None:
    """Run all examples of the published study, judge its claims, and write FOLDER/report.html and claims.json.

    Finished runs are kept: if you stop it, the same command goes on from there.
    """
    from verification.reproduction import reproduce

    from strandline.cli.progress import observing
    from strandline.runs import LocalProcesses

    executor = None if workers is None else LocalProcesses(workers=workers, timeout=120.0)
    with observing(quiet=quiet) as observer:
        found = reproduce(studies, folder, executor=executor, observer=observer)
    for key, claim in found.claims.items():
        click.echo(f"{key:>4} {claim.verdict:<10} {claim.statement}")
    click.echo(f"claims: {found.claims_file}\nreport: {found.page}")


if __name__ == "__main__":
    main(command=command)
