"""`strandline check`: validate everything, make one forward run and report what it shows."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from strandline.runs import RunRecord
    from strandline.studies import Study

from strandline.cli import options
from strandline.cli.forward import attempted, show_remains

PICTURE = "check.png"
MOST_PLANNED = 1000
"""Planned runs that are looked at one by one."""


@click.command("check")
@options.study
@click.option("--plot", is_flag=True, help="Draw check.png in the study folder: observed, undeformed, simulated.")
@options.as_json
@click.option("--widths", is_flag=True, help="Predict the posterior's widths; makes one more run per input if needed.")
def command(study: Path, plot: bool, as_json: bool, widths: bool) -> None:
    """Validate STUDY (a folder) and make one forward run at the medians of the priors.

    With a model that has sensitivities, or with --widths, it predicts the widths of the posterior. The biofilm model
    also solves on the next finer mesh. Nothing is written without --plot.
    """
    from strandline.studies import facing, load_study, require_same_size, require_writable

    loaded = load_study(study)
    require_writable(loaded.folder)
    loaded.runs.require_sound_ledgers()
    record, told = _forward_run(loaded)
    require_same_size(loaded, record)
    loaded = facing(loaded, record)
    log_likelihoods = _measured(loaded, record)
    lines, known = list(_lines(loaded, record, log_likelihoods)), loaded.runs.known
    lines += _widths(loaded, record, asked=widths)
    picture = _drawn(loaded, record) if plot else None
    lines = [*_about(loaded, record), told, *_prepared(loaded), *lines]
    for kind in loaded.runs.unheard_kinds:
        lines.append(f"warning: failures.kinds.{kind}: no run has ended with it yet; does the model use it?")
    settings = loaded.settings
    planned, refine = max(settings.planned_runs, known), settings.refine
    if as_json:
        figures = {name: value for name, value in record.diagnostics.items() if math.isfinite(value)}
        shown = {
            "study": loaded.name,
            "inputs": {p.name: {"unit": p.unit, "box": list(p.interval), "nuisance": p.nuisance} for p in loaded.space},
            "run": {"inputs": dict(record.inputs), "seconds": record.seconds, "diagnostics": figures},
            "log_likelihood": log_likelihoods,
            "planned": planned,
            "known": known,
            "lines": lines,
        }
        click.echo(json.dumps(shown))
        return
    number = sum(line.startswith("warning") for line in lines)
    doubts = f", with {number} warning{'s' * (number > 1)}" if number else ""
    rounds = f" ({settings.runs} and {refine.rounds} rounds of {refine.runs})" if refine.rounds else ""
    active = settings.active
    most = "at most " if active is not None else ""
    exactly = ""
    if active is not None and active.exact:
        exactly = "; then some thousand to draw from the true posterior"
    elif active is not None and active.exact is None and loaded.draws_by_chains:
        exactly = "; if they do not settle it, some thousand more that take a minute at most (`exact`)"
    lines.append(f"{most}{planned} forward runs planned{rounds}, {known} of them known already{exactly}")
    click.echo("\n  ".join([f"{loaded.name}: study.yaml is sound{doubts}", *lines]))
    if picture is not None:
        click.echo(f"wrote {picture}")
    click.echo(f"next: strandline run {study}")


def _about(study: "Study", record: "RunRecord") -> Iterator[str]:
    from strandline.report import small_share
    from strandline.studies import read_lines, turned_lines

    for parameter in (study.space[name] for name in study.space.scalars):
        cut = f", {small_share(parameter.mass_cut)} of its mass cut off by the box" if parameter.mass_cut else ""
        nuisance = ", nuisance" if parameter.nuisance else ""
        yield f"{parameter.label()}: {parameter.prior}{cut}{nuisance}"
    for one in study.space.fields:
        kept = f"{one.count} modes keep {one.share:.1%} of its variance at {len(one.support.points)} points"
        yield f"{one.name}: {one.words}; {kept}"
    if study.space.correlation:
        yield "correlated: " + ", ".join(f"{a} and {b} {r:g}" for (a, b), r in study.space.correlation.items())
    conditions = tuple(study.observed or record.interfaces)
    if any(conditions):
        yield f"observed conditions: {', '.join(conditions)}"
    if getattr(study.model, "timeout", 0) is None and getattr(study.executor, "timeout", None) is None:
        yield "no timeout: a run that hangs is never ended; set `timeout` of the command, in seconds"
    yield from turned_lines(study)
    yield from read_lines(study)
    for shown in study.pictures.values():
        yield from (f"warning: {shown.name}: {said}" for said in shown.ignored)


def _prepared(study: "Study") -> Iterator[str]:
    """Yield a line on how many planned runs make use of what the model prepares, a warning if most do not."""
    from strandline.models import PreparesRuns

    model, planned = study.model, study.runs.design[:MOST_PLANNED]
    if not isinstance(model, PreparesRuns) or not model.preparation or not planned:
        return
    served = sum(model.is_prepared(inputs) for inputs in planned)
    doubt = "" if 2 * served >= len(planned) else "warning: "
    first = "first " if len(planned) < study.settings.planned_runs else ""
    yield f"{doubt}{model.preparation}: {served} of the {first}{len(planned)} planned runs start from them"


def _lines(study: "Study", record: "RunRecord", log_likelihoods: Mapping[str, float]) -> Iterator[str]:
    """Yield what the run shows: shapes, their distance, log-likelihoods, displacement, error of the mesh."""
    from strandline.studies import cheaper_lines, measure_lines, node_lines
    from strandline.studies.foresight import first_run

    yield from first_run.shape_lines(study, record)
    yield from measure_lines(study, record)
    yield from first_run.noise_lines(study, record)
    for name, value in log_likelihoods.items():
        yield f"{name}: log-likelihood {value:.6g} there"
    yield from first_run.displacement_lines(study, record)
    yield from first_run.mesh_lines(study, record)
    yield from cheaper_lines(study.model, record, attempted)
    yield from node_lines(study, record)


def _widths(study: "Study", record: "RunRecord", *, asked: bool) -> Iterator[str]:
    """Yield the expected widths of the posterior: from sensitivities, or if `asked` from one more run per input."""
    import numpy as np

    from strandline.foundations import InvalidInput, NumericsError
    from strandline.interface import UnknownErrors
    from strandline.studies import observations_of
    from strandline.studies.foresight import widths

    seen = study.observations(study.observed or record.interfaces)
    guessed = [(one.noise, one.interface) for one in seen if isinstance(one.noise, UnknownErrors)]
    for noise, interface in guessed:
        if not noise.stated:
            assumed = 1e3 * noise.typical(interface).sd
            yield f"the noise will be inferred; this check assumes an sd of {assumed:.2g} µm and predicts no widths"
            return
    names = study.space.names
    slopes, source = widths.slopes_by_sensitivities(record, names), "sensitivities of this run"
    if slopes is None and asked:
        at = np.array([record.inputs[name] for name in names])
        x = widths.neighbours(study.space, at)
        others = [attempted(study.model, {**study.fixed, **study.space.as_mapping(row)}) for row in x]
        slopes, source = widths.slopes_by_differences(record, others, at, x), f"{len(x)} more runs"
        if slopes is None:
            yield "warning: a run beside this one failed or has other nodes, so that no widths can be predicted"
    elif slopes is None:
        yield f"add --widths to predict the widths of the posterior: {len(names)} more run{'s' * (len(names) > 1)}"
    if slopes is not None:
        try:
            sd = widths.expected_sd(study, record.interfaces, slopes, observations_of(study))
        except (InvalidInput, NumericsError):
            return  # what the measure refuses is reported elsewhere
        source += "".join(f", without {left_out}" for left_out in dict.fromkeys(one.inferred for one, _ in guessed))
        yield from widths.width_lines(study, sd, source)


def _drawn(study: "Study", record: "RunRecord") -> Path:
    from strandline.foundations import whole_file
    from strandline.models import undeformed_interface
    from strandline.report import plot_conditions, plot_interfaces
    from strandline.studies import observations_of, told_if_unwritable

    observed, label = observations_of(study), "simulated, medians of the priors"
    reference = undeformed_interface(study.model)
    if len(record.interfaces) == 1:
        ((condition, run),) = record.interfaces.items()
        figure: Any = plot_interfaces(observed.get(condition), reference=reference, simulated={label: run}).figure
    else:
        simulated = {condition: {label: run} for condition, run in record.interfaces.items()}
        shown = {condition: observed.get(condition) for condition in record.interfaces}
        figure = plot_conditions(shown, reference=reference, simulated=simulated)
    target = study.folder / PICTURE
    with told_if_unwritable(study.folder), whole_file(target) as partial:
        figure.savefig(partial, dpi=200, format="png")
    return target


def _forward_run(study: "Study") -> tuple["RunRecord", str]:
    import numpy as np

    from strandline.foundations import inputs_text
    from strandline.models import prepare_runs
    from strandline.studies import differentiating, require_ok

    medians = study.space.prior_quantiles(np.full((1, study.space.dim), 0.5))[0]
    medians[np.abs(medians) < 1e-12 * study.space.prior_sd] = 0.0  # rounding of a quantile
    inputs = {**study.fixed, **study.space.as_mapping(medians)}
    prepare_runs(study.model)  # its time is not the run's
    record = attempted(differentiating(study.model) or study.model, inputs)
    if record.failure_kind == "no_sensitivities":
        record = attempted(study.model, inputs)
    if not record.ok:
        show_remains(record)
    require_ok(record, "at the medians of the priors")
    named = {name: inputs[name] for name in (*study.fixed, *study.space.scalars)}
    shown = inputs_text(named) if named else "the medians of the priors"
    figures = ", ".join(f"{name} {value:.4g}" for name, value in record.diagnostics.items())
    return record, f"forward run at {shown}: ok in {record.seconds:.1f} s{f' ({figures})' if figures else ''}"


def _measured(study: "Study", record: "RunRecord") -> dict[str, float]:
    """Return the log-likelihood of the run by measure; empty if the observation has not been made yet."""
    from strandline.likelihood import InterfaceLikelihood

    found, seen = record.interfaces, study.observations(study.observed or record.interfaces)
    values = {name: InterfaceLikelihood(seen, one)(found) for name, one in study.discrepancies.items()}
    return values if study.observed else {}
