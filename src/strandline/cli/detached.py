"""Runs that continue without a driver: submit them, and report them when the driver is stopped."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import click

from strandline.calibration import Observer
from strandline.errors import InvalidInput
from strandline.runs import Executor
from strandline.runs.executors.slurm_array import Detached, SlurmArray
from strandline.runs.executors.slurm_batch import known_batches
from strandline.studies import Study

__all__ = ["submit", "told_what_goes_on"]


def submit(study: Study, executor: Executor, observer: Observer) -> None:
    """Submit all runs that `study` is known to need, and print what to do next.

    Raises:
        InvalidInput: The executor's runs cannot continue without a driver.
    """
    from strandline.studies.run import submit_study

    if not isinstance(executor, SlurmArray):
        raise InvalidInput(
            "--detach",
            value=f"the executor {type(executor).__name__}",
            expected="runs that go on without a driver, executor: {slurm_array: …}",
            remedy="Leave --detach out, or choose that executor in study.yaml.",
        )
    try:
        submit_study(study, executor=replace(executor, detach=True), observer=observer)
    except Detached as detached:
        click.echo(
            f"{detached.number} runs are with SLURM (`squeue --me`), their batches in {executor.folder}.\n"
            f"They go on by themselves. `strandline run {study.folder}` collects them and does the rest."
        )
    else:
        click.echo(f"every run of the design is done. `strandline run {study.folder}` makes the results.")


@contextmanager
def told_what_goes_on(study: Study, executor: Executor) -> Iterator[None]:
    """Report the runs that continue in SLURM if the driver is interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        number = study.runs.open_attempts
        if number and isinstance(executor, SlurmArray):
            names = ",".join(batch.name for batch in known_batches(executor.folder))
            click.echo(f"runs that go on in SLURM: {number} (`scancel --name={names}` would end them)", err=True)
        raise
