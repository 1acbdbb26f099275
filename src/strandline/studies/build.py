"""`StudyFile` → domain objects, with every check that needs no forward run."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strandline.design.active import Active
from strandline.design.refinement import Refinement
from strandline.discrepancy import DISCREPANCIES, Discrepancy
from strandline.errors import InvalidInput, InvalidStudy
from strandline.models import MODELS
from strandline.models.protocol import (
    ForwardModel,
    declared_failure_kinds,
    with_sensitivities,
)
from strandline.runs import FailurePolicy, Retry
from strandline.runs.failures import COMMON_KINDS
from strandline.runs.record import STATES
from strandline.studies.chosen import construct, entry, open_entry, refused_at, require_parts
from strandline.studies.keys.failures import Failures
from strandline.studies.observed import TO_MM, read_points
from strandline.studies.pictures.undeformed import Undeformed, undeformed_in, without_picture
from strandline.surrogate import fit_named
from strandline.surrogate.kernels import kernel_named

__all__ = [
    "build_active",
    "build_discrepancies",
    "build_failures",
    "build_model",
    "build_refinement",
    "check_fit",
    "check_kernel",
    "check_runs",
    "failure_words",
]


def build_model(
    choice: Mapping[str, Mapping[str, Any] | None],
    folder: Path = Path(),
    *,
    sensitivities: bool = False,
    undeformed: Undeformed | None = None,
) -> ForwardModel:
    """Return the forward model that the study names, with sensitivities if the study asks for them.

    An option `{file: …, unit: …}` is replaced by the points of that file in `folder`, as an outline in mm; a model with
    a field `folder` gets the study folder instead and reads files itself. `outline: {image: …}` is replaced by
    `undeformed`, by default the outline in that picture.
    """
    (name, options) = next(iter(choice.items()))
    if "sensitivities" in (options or {}):
        raise InvalidStudy(
            f"model.{name}: sensitivities is not an option of the model",
            value=(options or {})["sensitivities"],
            expected="`sensitivities: true` as a key of the study",
            remedy="Move the key to the top level of study.yaml.",
        )
    factory = open_entry(MODELS, name, "model", "a forward model")
    if wants_folder(factory):
        model: ForwardModel = construct(factory, options, f"model.{name}", folder=folder)
    else:
        options = {key: _with_points(key, value, folder) for key, value in (options or {}).items()}
        undeformed = undeformed or undeformed_in(choice, folder)
        if undeformed is not None:
            options["outline"] = {**without_picture(options["outline"]), **undeformed.options}
        model = construct(factory, options, f"model.{name}")
    return _sensitive(model) if sensitivities else model


def wants_folder(factory: Any) -> bool:
    """Return whether a model needs the study folder: it has a field `folder`, which is then not an option."""
    return any(f.name == "folder" and f.init for f in dataclasses.fields(factory))


def _with_points(name: str, value: Any, folder: Path) -> Any:
    """Return an option, with its file of points read if it names one."""
    if not isinstance(value, Mapping) or "file" not in value:
        return value
    unit = value.get("unit")
    if unit not in TO_MM:
        raise InvalidStudy(
            f"unit of the points in {value['file']}",
            value=unit,
            expected=f"one of {', '.join(TO_MM)}",
            remedy="Add `unit: mm` after `file`.",
        )
    points = read_points(folder / str(value["file"]), unit, what=name).points.tolist()
    rest = {key: item for key, item in value.items() if key not in ("file", "unit")}
    return {"points": points, "spline": False, **rest}


def build_discrepancies(
    choice: Mapping[str, Mapping[str, Any] | None] | list[dict[str, dict[str, Any] | None]],
) -> dict[str, Discrepancy]:
    """Return the measures by name, in the order of the study."""
    result: dict[str, Discrepancy] = {}
    for item in choice if isinstance(choice, list) else [choice]:
        (name, options) = next(iter(item.items()))
        if name in result:
            raise InvalidStudy(
                "discrepancy", value=name, expected="each measure once", remedy=f"Remove the second {name}."
            )
        kind = open_entry(DISCREPANCIES, name, "discrepancy", "a discrepancy")
        measure = construct(kind, options, f"discrepancy.{name}")
        require_parts(measure, ("__call__",), f"discrepancy.{name}")
        result[name] = measure
    return result


def build_failures(given: Failures, model: ForwardModel) -> FailurePolicy:
    """Return the policy for failed runs; refuse a kind that the model is known not to have."""
    if declared_failure_kinds(model) is not None:
        known = dict.fromkeys(failure_words(model))
        for kind in given.kinds:
            entry(known, kind, "failures.kinds")
    actions = {kind: action if isinstance(action, str) else Retry(action) for kind, action in given.kinds.items()}
    if given.stop is None:
        return FailurePolicy(actions, stop_share=2.0)
    return FailurePolicy(actions, stop_after=given.stop.after, stop_share=given.stop.share)


def failure_words(model: ForwardModel) -> tuple[str, ...]:
    """Return the known words for failed runs of `model`: states, its own kinds, kinds of any model."""
    states = (state for state in STATES if state != "ok")
    return tuple(dict.fromkeys([*states, *(declared_failure_kinds(model) or ()), *COMMON_KINDS]))


def check_runs(runs: int, dim: int) -> None:
    """Refuse a design with fewer runs than the surrogate needs even if none fails."""
    if runs < dim + 2:
        raise InvalidStudy(
            "design.sobol.runs",
            value=runs,
            expected=f"at least {dim + 2} runs for {dim} input(s); 100 are a start",
            remedy="Enlarge the design.",
        )


def build_active(given: Mapping[str, Any] | None, dim: int, *, sensitivities: bool) -> Active | None:
    """Return the settings of an active design, with the number of its first runs."""
    if given is None:
        return None
    options = {name: value for name, value in given.items() if name != "scramble"}
    if options.get("runs") is None:
        raise InvalidStudy("design.active.runs", value=None, expected="the most runs to make", remedy="E.g. runs: 100.")
    usual = 4 + 2 * dim
    options.setdefault("initial", max(usual // 2, 3) if sensitivities else usual)
    with refused_at("design.active"):
        return Active(**options)


def build_refinement(given: Mapping[str, Any] | None, particles: int) -> Refinement:
    """Return the rounds of refinement, none by default; a round has no more runs than there are particles."""
    if given is None:
        return Refinement()
    with refused_at("design.refine"):
        refinement = Refinement(**given)
    if refinement.runs > particles:
        raise InvalidStudy(
            "design.refine.runs",
            value=refinement.runs,
            expected=f"at most {particles}, the number of particles that they are drawn from",
            remedy="Make fewer runs in a round, and more rounds.",
        )
    return refinement


def check_kernel(name: str) -> str:
    """Return `name` if there is a kernel of that name."""
    with refused_at():
        kernel_named(name, what="surrogate.log_likelihood.kernel")
    return name


def check_fit(name: str | None) -> str | None:
    """Return `name` if it is None or names a function."""
    if name is not None:
        with refused_at():
            fit_named(name, what="surrogate.log_likelihood.fit")
    return name


def _sensitive(model: ForwardModel) -> ForwardModel:
    try:
        asked: ForwardModel = with_sensitivities(model)
    except InvalidInput as error:
        raise InvalidStudy(
            "sensitivities", value="true, but this model offers none", expected=error.expected, remedy=error.remedy
        ) from None
    return asked
