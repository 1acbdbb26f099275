"""`strandline check`: everything validated, one forward run made."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from strandline.runs import RunRecord
    from strandline.studies import Study

__all__ = ["command"]

FAR_APART = 0.05
"""Share of the interface's length."""


@click.command("check")
@click.argument("study", type=click.Path(path_type=Path))
def command(study: Path) -> None:
    """Validate STUDY (a folder) and make one forward run at the medians of the priors; nothing is written."""
    from strandline.report.warnings import small_share
    from strandline.studies import load_study
    from strandline.studies.folder import require_writable
    from strandline.studies.ledgers import check_ledgers, known_runs, unheard_kinds

    loaded = load_study(study)
    require_writable(loaded.folder)
    check_ledgers(loaded)
    record, told = _forward_run(loaded)
    log_likelihoods = _measured(loaded, record)
    known = known_runs(loaded)
    click.echo(f"{loaded.name}: study.yaml is sound")
    for parameter in loaded.space:
        cut = f", {small_share(parameter.mass_cut)} of its mass cut off by the box" if parameter.mass_cut else ""
        nuisance = ", nuisance" if parameter.nuisance else ""
        click.echo(f"  {parameter.label()}: {parameter.prior}{cut}{nuisance}")
    conditions = tuple(loaded.observed or record.interfaces)
    if any(conditions):
        click.echo(f"  observed conditions: {', '.join(conditions)}")
    for condition in loaded.turned:
        of = f" of {condition}" if condition else ""
        click.echo(f"  the observed points{of} run against the model's interface and will be turned round")
    click.echo(f"  {told}")
    for line in _shapes(loaded, record):
        click.echo(f"  {line}")
    for name, value in log_likelihoods.items():
        click.echo(f"  {name}: log-likelihood {value:.6g} there")
    for kind in unheard_kinds(loaded):
        click.echo(f"  warning: failures.kinds.{kind}: no run has ended so yet; is the word the model's own?")
    refine = loaded.settings.refine
    rounds = f" ({loaded.settings.runs} and {refine.rounds} rounds of {refine.runs})" if refine.rounds else ""
    most = "at most " if loaded.settings.active is not None else ""
    planned = max(loaded.settings.planned_runs, known)
    click.echo(f"  {most}{planned} forward runs planned{rounds}, {known} of them known already")
    click.echo(f"next: strandline run {study}")


def _shapes(study: "Study", record: "RunRecord") -> Iterator[str]:
    """Yield where observed interfaces and those of the run lie, and a warning where their ends are far apart."""
    import numpy as np

    for condition, observed in study.observed.items():
        run, of = record.interfaces[condition], f" ({condition})" if condition else ""
        for name, interface in (("observed", observed), ("this run", run)):
            first, last = (np.round(interface.points[k], 4).tolist() for k in (0, -1))
            yield f"{name}{of}: from {first} to {last}, length {interface.lengths.sum():.4g} mm"
        apart = max(float(np.linalg.norm(observed.points[k] - run.points[k])) for k in (0, -1))
        if apart > FAR_APART * run.lengths.sum():
            yield (
                f"warning{of}: their ends lie {apart:.3g} mm apart. Are the columns x, y, is y upwards, and are "
                "origin, unit and extent those of the model?"
            )


def _forward_run(study: "Study") -> tuple["RunRecord", str]:
    """Return the run at the medians of the priors, and a line about it."""
    import numpy as np

    from strandline.cli.forward import attempted, show_remains
    from strandline.errors import InvalidStudy

    medians = study.space.prior_quantiles(np.full((1, study.space.dim), 0.5))[0]
    inputs = {**study.fixed, **study.space.as_mapping(medians)}
    record = attempted(study.model, inputs)
    shown = ", ".join(f"{name} = {value:.6g}" for name, value in inputs.items())
    if not record.ok:
        message = (record.message or "").partition("\n")[0]
        show_remains(record)
        raise InvalidStudy(
            "the forward run at the medians of the priors failed",
            value=f"{record.failure_kind or record.state} at {shown}",
            expected="a run that ends with an interface",
            remedy=f"Look at the simulator, or move the priors to where it runs. It says: {message}",
        )
    figures = ", ".join(f"{name} {value:.4g}" for name, value in record.diagnostics.items())
    return record, f"forward run at {shown}: ok in {record.seconds:.1f} s{f' ({figures})' if figures else ''}"


def _measured(study: "Study", record: "RunRecord") -> dict[str, float]:
    """Return the log-likelihood of the run by measure; none where the observation is still to be made."""
    from strandline.interface import Observation
    from strandline.likelihood import InterfaceLikelihood

    observed = (study.observed or record.interfaces).items()
    observations = tuple(Observation(interface, study.noise_variance, name) for name, interface in observed)
    values = {
        name: InterfaceLikelihood(observations, discrepancy)(record.interfaces)
        for name, discrepancy in study.discrepancies.items()
    }
    return values if study.observed else {}
