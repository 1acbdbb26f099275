"""`strandline check`: everything validated, one forward run made."""

from pathlib import Path

import click

__all__ = ["command"]


@click.command("check")
@click.argument("study", type=click.Path(path_type=Path))
def command(study: Path) -> None:
    """Validate STUDY (a folder) and make one forward run at the medians of the priors; nothing is written."""
    import numpy as np

    from strandline.cli.forward import attempted
    from strandline.errors import InvalidStudy
    from strandline.studies import load_study
    from strandline.studies.run import check_ledgers, require_writable

    loaded = load_study(study)
    require_writable(loaded.folder)
    check_ledgers(loaded)
    medians = loaded.space.prior_quantiles(np.full((1, loaded.space.dim), 0.5))[0]
    inputs = {**loaded.fixed, **loaded.space.as_mapping(medians)}
    click.echo(f"{loaded.name}: study.yaml is sound; {loaded.settings.runs} forward runs planned")
    for parameter in loaded.space:
        cut = f", {parameter.mass_cut:.2%} cut off by the box" if parameter.mass_cut else ""
        click.echo(f"  {parameter.label()}: {parameter.prior}{cut}")
    record = attempted(loaded.model, inputs)
    shown = ", ".join(f"{name} = {value:.6g}" for name, value in inputs.items())
    if record.interface is None:
        raise InvalidStudy(
            "the forward run at the medians of the priors failed",
            value=f"{shown}: {record.failure_kind or record.state}: {(record.message or '').splitlines()[0]}",
            expected="a run that ends with an interface",
            remedy="Look at the simulator, or move the priors to where it runs.",
        )
    figures = ", ".join(f"{name} {value:.4g}" for name, value in record.diagnostics.items())
    click.echo(f"  forward run at {shown}: ok in {record.seconds:.1f} s ({figures})")
    click.echo(f"next: strandline run {study}")
