"""What one forward run shows about a study before the others are made."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import (
    Discrepancy,
    apart,
    axes_mistake,
    extent,
    oriented_like_runs,
    require_plausible,
    squared_distances,
)
from strandline.foundations import ForwardModelError, InvalidInput, InvalidStudy, NumericsError, inputs_text
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import compared, noise_length, sd_of_distances
from strandline.models import SolvesOnFinerMesh, undeformed_interface
from strandline.runs import RunRecord
from strandline.studies.keys.parse import refused_at
from strandline.studies.load.observed import noisy
from strandline.studies.load.study import Study

FAR_APART = 0.05  # share of the interface's length: ends or centres further apart than this are worth a warning
WAY_OFF = 0.2  # the same share if the run may have any inputs
SEEN_PART = 0.2  # the same share for the ends of the model's interface: an observed one may be shorter
MESH_SHARE = 0.1  # share of the noise above which the difference to the next finer mesh is worth a warning


@dataclass(frozen=True)
class NoiseLength:
    """The noise as a length, and whether it is σ_N itself, the standard deviation of a distance."""

    mm: float
    is_sd: bool

    def times(self, mm: float) -> str:
        """Return a length, mm, in words as a multiple of the noise."""
        if self.is_sd:
            return f"{mm / self.mm:.3g} σ_N (σ_N = {_length(self.mm)})"
        return f"{mm / self.mm:.3g} times the shift of {_length(self.mm)} that the noise hides"


def noise_of(study: Study, interface: Interface, condition: str = "") -> NoiseLength:
    """Return the noise of the first measure as a length.

    The sd of an observed point or σ_N if the measure sums squares; else the shift of `interface` with d² = σ_N².
    """
    measure, seen = study.measure, study.observation(interface, condition)
    sd = sd_of_distances(seen, measure, interface)
    return NoiseLength(noise_length(seen, measure), False) if sd is None else NoiseLength(sd, True)


def observations_of(study: Study) -> Mapping[str, Interface]:
    """Return the observed interfaces; a synthetic one if the ledger has its run, else nothing."""
    if study.truth is None or not study.ledger_path.is_file():
        return study.observed
    key = study.runs.key(study.truth)
    with study.runs.reading() as ledger:
        record = ledger.latest([key]).get(key)
    return noisy(record.interfaces, study.synthetic_noise) if record is not None and record.ok else {}


def require_ok(record: RunRecord, what: str, remedy: str = "") -> RunRecord:
    """Return a run that ended ok; refuse another one."""
    if record.ok:
        return record
    shown = inputs_text(record.inputs)
    said = (record.message or "no message").partition("\n")[0]
    value, expected = f"{record.failure_kind or record.state} at {shown}", "a run that ends with an interface"
    remedy = f"{remedy or 'Look at the simulator, or move the priors to where it runs.'} It says: {said}"
    raise InvalidStudy(f"the forward run {what} failed", value=value, expected=expected, remedy=remedy)


def require_same_axes(study: Study, record: RunRecord) -> None:
    """Refuse an observed interface that lies far from that of the run and would not with other axes."""
    for condition, observed in study.observed.items():
        if found := axes_mistake(observed, record.interfaces[condition]):
            what = f"axes of the observation{f' ({condition})' if condition else ''}"
            value, expected = "points far from every one of the first runs", "x and y as the model has them"
            remedy = f"{found} Correct the observation or the model."
            raise InvalidStudy(what, value=value, expected=expected, remedy=remedy)


def require_same_size(study: Study, record: RunRecord) -> None:
    """Refuse an observed interface ten times larger or smaller than that of the run."""
    for condition, observed in study.observed.items():
        name = f"observation ({condition})" if condition else "observation"
        if observed.dim == record.interfaces[condition].dim:
            with refused_at():
                require_plausible(name, observed, record.interfaces[condition])


def facing(study: Study, record: RunRecord) -> Study:
    """Return the study with its observed interfaces in the same direction as those of the run."""
    found = {name: oriented_like_runs(seen, [record.interfaces[name]]) for name, seen in study.observed.items()}
    turned = tuple(name for name, one in found.items() if one.flipped)
    observed = {name: one.interface for name, one in found.items()}
    noises = {name: noise.reversed() for name in turned if isinstance(noise := study.noise_of(name), PointErrors)}
    return replace(study, observed=observed, noises={**study.noises, **noises}, turned=(*study.turned, *turned))


def turned_like(observations: Iterable[Observation], runs: Sequence[RunRecord]) -> tuple[Observation, ...]:
    """Return observations with their points in the same direction as those of the runs."""
    out = []
    for seen in observations:
        interfaces = [record.interfaces[seen.condition] for record in runs if record.ok]
        out.append(seen.reversed() if oriented_like_runs(seen.interface, interfaces).flipped else seen)
    return tuple(out)


def turned_lines(study: Study) -> Iterator[str]:
    """Yield a line on each observed interface that runs opposite to the model's.

    In a picture, the direction follows from the side on which the study says that the body is. Models keep it on the
    right of their points, but need not.
    """
    for condition in study.turned:
        of = f" of {condition}" if condition else ""
        shown = study.pictures.get(condition) or study.stacks.get(condition)
        if shown is None:
            yield f"the observed points{of} run opposite to the model's interface and will be turned round"
            continue
        yield (
            f"warning: in {shown.name} the body lies on the other side of the interface than in the model; `solid`, or "
            "the direction of x or y in `frame`, is wrong, unless your model keeps the body on the left of its points"
        )


def shape_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield where observed interfaces and those of the run lie, how far apart they are, and doubts about that."""
    for condition, observed in study.observed.items():
        run, of = record.interfaces[condition], f" ({condition})" if condition else ""
        for name, interface in (("observed", observed), ("this run", run)):
            yield f"{name}{of}: {_place(interface)}"
        if observed.dim == run.dim:
            squares = squared_distances(observed.points, run)
            rms, largest = math.sqrt(float(squares.mean())), math.sqrt(float(squares.max()))
            yield (
                f"distance of the observed points from this run{of}: root mean square {_length(rms)}, largest "
                f"{_length(largest)}"
            )
        if observed.dim == run.dim == 2:
            yield from _doubts(observed, run, of)


def early_doubts(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield what one run, whatever its inputs, shows to be wrong: a body on the other side, ends that are far apart."""
    faced, at = facing(study, record), inputs_text(record.inputs)
    yield from (line for line in turned_lines(faced) if line.startswith("warning"))
    for condition, observed in faced.observed.items():
        run, of = record.interfaces[condition], f" ({condition})" if condition else ""
        if observed.dim == run.dim == 2:
            doubts = _doubts(observed, run, of, share=WAY_OFF)
            yield from (line.replace("of this run", f"of the run at {at}") for line in doubts)


def _place(interface: Interface) -> str:
    if interface.dim == 3:
        low, high = (np.round(f(interface.points, axis=0), 4).tolist() for f in (np.min, np.max))
        return f"from {low} to {high}, area {interface.areas.sum():.4g} mm²"
    length = f"length {interface.lengths.sum():.4g} mm"
    if interface.closed:
        return f"closed around {np.round(_middle(interface), 4).tolist()}, {length}"
    first, last = (np.round(interface.points[k], 4).tolist() for k in (0, -1))
    return f"from {first} to {last}, {length}"


def _middle(interface: Interface) -> Float[np.ndarray, " xyz"]:
    """Return the centre of the area in a closed polyline, whatever its spacing; of a surface, the mean of its cells."""
    middle = interface.centres.mean(axis=0)
    if interface.dim == 3:
        return np.asarray(middle)
    begin, end = ((interface.points - middle)[interface.cells[:, k]] for k in (0, 1))
    areas = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    return np.asarray(middle + areas @ (begin + end) / (3 * areas.sum()) if areas.sum() else middle)


def _doubts(observed: Interface, run: Interface, of: str, share: float = FAR_APART) -> Iterator[str]:
    """Yield a warning for ends, or centres of closed contours, farther apart than a share of the interface's length."""
    far = share * float(run.lengths.sum())
    if observed.closed and run.closed:
        apart_by = float(np.linalg.norm(_middle(observed) - _middle(run)))
        what = "the centres of the observed interface and of this run lie"
    else:
        off = math.sqrt(float(squared_distances(_ends(observed), run).max()))
        missing = math.sqrt(float(squared_distances(_ends(run), observed).max()))
        apart_by = max(off, missing if missing > SEEN_PART * float(run.lengths.sum()) else 0.0)
        what = "the ends of the observed interface and of this run lie"
    if apart_by > far:
        usual = (
            "Are x and y in this order, is y upwards, are origin, unit and extent those of the model, and the inputs "
            "in its units?"
        )
        yield f"warning{of}: {what} {apart_by:.3g} mm apart. {axes_mistake(observed, run) or usual}"


def _ends(interface: Interface) -> Float[np.ndarray, "end xyz"]:
    return interface.points[:1] if interface.closed else interface.points[[0, -1]]


def displacement_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield the largest displacement of the run in µm and in units of the noise, if the undeformed state is known."""
    undeformed, measure = undeformed_interface(study.model), study.measure
    if undeformed is None:
        return
    for condition, run in record.interfaces.items():
        if run.dim != undeformed.dim:
            continue
        of, noise = f" ({condition})" if condition else "", noise_of(study, undeformed, condition)
        if run.points.shape == undeformed.points.shape:
            moved = float(np.linalg.norm(run.points - undeformed.points, axis=1).max())
        else:
            moved = apart(run, undeformed)[1]
        yield f"largest displacement{of}: {_length(moved)}, {noise.times(moved)}"
        if _hidden(measure, run, study.observation(undeformed, condition)):
            yield f"warning{of}: the displacement is below the noise: the data cannot show it"


def _hidden(measure: Discrepancy, run: Interface, undeformed: Observation) -> bool:
    """Return whether the undeformed interface explains the run within the noise, all points together: d² < σ_N²."""
    errors, seen = undeformed.errors, undeformed.interface
    try:
        one = compared(undeformed, measure, len(run.points))
        return float(one.measure(run, seen)) < one.noise.scale
    except InvalidInput:  # e.g. nodes that do not correspond
        variance = compared(undeformed, measure, 0).noise.scale if errors is None else errors.sd**2
        return apart(run, seen)[1] ** 2 < variance


def noise_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield a warning if the stated noise is larger than the whole interface."""
    for condition, run in record.interfaces.items():
        if isinstance(study.noise_of(condition), UnknownErrors):
            continue
        try:
            noise = noise_of(study, run, condition).mm
        except (InvalidInput, NumericsError):
            continue  # what the measure refuses is reported elsewhere
        if noise > extent(run):
            of = f" ({condition})" if condition else ""
            yield (
                f"warning{of}: the data tell nothing: the noise, {_length(noise)}, is larger than the whole interface, "
                f"{_length(extent(run))} across; correct the noise or its unit"
            )


def mesh_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield how far the run's interfaces move on the next finer mesh, if the model offers one.

    Too large a difference gives a warning, unless the model itself makes the observation on the same mesh.
    """
    if not isinstance(study.model, SolvesOnFinerMesh):
        return
    try:
        finer = study.model.on_finer_mesh(record.inputs)
    except ForwardModelError as error:
        yield f"warning: on the next finer mesh this run fails ({error.kind}), so that its accuracy is not known"
        return
    for condition, interface in finer.items():
        run, of = record.interfaces[condition], f" ({condition})" if condition else ""
        moved = float(np.linalg.norm(interface.points - run.points, axis=1).max())
        noise = noise_of(study, run, condition)
        yield f"next finer mesh{of}: the interface differs by at most {_length(moved)}, {noise.times(moved)}"
        if moved > MESH_SHARE * noise.mm and study.truth is None:
            yield (
                f"warning{of}: the mesh is too coarse for this noise; take a finer one, such as `mesh: default`, "
                "or state a larger noise"
            )


def _length(mm: float) -> str:
    return f"{mm:.3g} mm" if mm >= 1 else f"{1e3 * mm:.3g} µm"
