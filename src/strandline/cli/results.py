"""The result of a study on the terminal."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from strandline.errors import ResultsNotWritten
from strandline.runs.failures import counted


@contextmanager
def shown_also_if_incomplete(*, as_json: bool = False) -> Iterator[None]:
    """Print the results even if the command ends with an error because some result files could not be written."""
    try:
        yield
    except ResultsNotWritten as error:
        show(error.outcome.summary, error.outcome.report, as_json=as_json)
        raise


def show(summary: Mapping[str, Any], report: Path | None, *, as_json: bool = False) -> None:
    """Print the posterior, the checks and the warnings, or the content of summary.json."""
    if as_json:
        click.echo(json.dumps(summary))
        return
    runs, check, certificate = summary["runs"], summary["quadrature_check"], summary["certificate"]
    kinds = f"({counted(runs['by_kind'])}) " if runs["by_kind"] else ""
    click.echo(
        f"\n{summary['study']}: {runs['ok']} forward runs ok, {runs['failed']} failed {kinds}"
        f"({runs['new']} new, {runs['reused']} reused)"
    )
    click.echo(f"{'input':>10} {'unit':>7} {'mean':>10} {'sd':>9} {'median':>10} {'5 %':>10} {'95 %':>10} {'MAP':>10}")
    for name, item in summary["inputs"].items():
        click.echo(_row(name, item, "" if item["unit"] == "1" else item["unit"]))
    _show_readings(summary["under_uncertainty"] or {})
    click.echo(f"log-evidence {summary['log_evidence']:.3f}; effective samples {summary['sampler']['ess']:.0f}")
    if check is not None:
        click.echo(
            f"sampler against quadrature: means differ by {check['max_mean_error_sd']:.3f} sd, "
            f"standard deviations by {check['max_sd_ratio_error']:.1%}"
        )
    halves = summary["sampler_check"]
    if halves is not None and halves["agree"]:
        click.echo(halves["verdict"])
    if certificate is not None and certificate["converged"]:
        click.echo(f"{_certified(certificate)}\n{certificate['statement']}")
        if certificate.get("fidelities"):
            click.echo(certificate["fidelities"]["statement"])
    for warning in summary["warnings"]:
        click.echo(_warned(f"warning: {warning}"))
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in summary["seconds"].items())
    click.echo(f"seconds: {seconds}")
    if summary.get("draft"):
        click.echo("a draft: remove `draft: true` from study.yaml for the result")
    if report is not None and report.name not in summary["missing"]:
        click.echo(f"report: {report}")
    if summary["nearest"]["message"]:
        click.echo(summary["nearest"]["message"])


def _warned(text: str) -> str:
    """Return a warning in its colour, or as it is if NO_COLOR is set (no-color.org)."""
    return text if os.environ.get("NO_COLOR") else click.style(text, fg="yellow")


def _certified(certificate: Mapping[str, Any]) -> str:
    """Return a line on the last check of an active design."""
    check = certificate["check"]
    shift = max(abs(value) for value in check["shift"].values())
    if check["by"] == "left-out runs":
        return (
            f"converged: {check['draws']} runs at hand, each predicted from the others, give {check['effective']:.0%} "
            "effective weights by the true model; no new run was needed"
        )
    both = certificate.get("fidelities")
    who = "the true model" if not both or both["dropped"] else "the corrected cheaper model"
    besides = f" and {check['left_out']} earlier runs, each predicted from the others," if check["left_out"] else ""
    return (
        f"converged: at {check['draws']} {check['by']}{besides} {who} gives {check['effective']:.0%} "
        f"effective draws and moves means by at most {shift:.2f} sd"
    )


def _show_readings(readings: Mapping[str, Any]) -> None:
    for reading, content in readings.items():
        click.echo(f"under uncertainty, {reading} reading (MAP: fullest of {content['map_bins']} bins per input):")
        for name, item in content["inputs"].items():
            click.echo(_row(name, item))


def _row(name: str, item: Mapping[str, Any], unit: str = "") -> str:
    mean, sd, *rest = (f"{item[key]:.4g}" for key in ("mean", "sd", "median", "q05", "q95", "map"))
    return f"{name:>10} {unit:>7} {mean:>10} {sd:>9} " + " ".join(f"{text:>10}" for text in rest)
