"""`StudyFile` → domain objects, with every check that needs no forward run."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from strandline.design.active import Active
from strandline.design.refinement import Refinement
from strandline.discrepancy import DISCREPANCIES, Discrepancy
from strandline.errors import InvalidInput, InvalidStudy
from strandline.models import MODELS
from strandline.models.offers import UsesNames
from strandline.models.protocol import (
    ForwardModel,
    ModelInput,
    declared_failure_kinds,
    declared_inputs,
    with_sensitivities,
)
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import PRIORS, Prior
from strandline.registry import suggestion
from strandline.runs import FailurePolicy, Retry
from strandline.runs.failures import COMMON_KINDS
from strandline.runs.record import STATES
from strandline.studies.chosen import construct, entry, open_entry, refused_at, require_parts
from strandline.studies.keys.failures import Failures
from strandline.studies.keys.study_file import Input, Quantity, StudyFile
from strandline.studies.observed import TO_MM, read_points
from strandline.studies.own_prior import require_prior
from strandline.studies.undeformed import Undeformed, undeformed_in, without_picture
from strandline.surrogate import fit_named
from strandline.surrogate.kernels import kernel_named

__all__ = [
    "build_active",
    "build_discrepancies",
    "build_failures",
    "build_fixed",
    "build_model",
    "build_prior",
    "build_refinement",
    "build_space",
    "check_complete",
    "check_fit",
    "check_kernel",
    "check_runs",
    "check_values",
    "failure_words",
]

MASS_CUT_ACCEPTED = 0.5


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


def build_space(inputs: Mapping[str, Input], model: ForwardModel) -> ParameterSpace:
    """Return the unknown inputs, checked against what the model declares."""
    declared = {item.name: item for item in declared_inputs(model)}
    parameters = tuple(_parameter(name, item, declared.get(name)) for name, item in inputs.items())
    for parameter in parameters:
        _check_name(parameter.name, declared, f"inputs.{parameter.name}")
        for bound in parameter.interval:
            _check_range(bound, declared, parameter.name, f"inputs.{parameter.name}: end of the design box")
    with refused_at("inputs"):
        return ParameterSpace(parameters)


def build_fixed(study: StudyFile, model: ForwardModel) -> dict[str, float]:
    """Return the known inputs; together with the unknown ones they must be all that the model takes."""
    declared = {item.name: item for item in declared_inputs(model)}
    _require_names(study, model)
    fixed = {name: _fixed_value(name, given, declared) for name, given in study.fixed.items()}
    check_values(fixed, model, "fixed")
    for name in fixed:
        if name in study.inputs:
            raise InvalidStudy(
                f"{name} is both fixed and an input",
                value=fixed[name],
                expected="one of the two",
                remedy=f"Remove {name} from fixed or from inputs.",
            )
    missing = [name for name in declared if name not in fixed and name not in study.inputs]
    if missing:
        raise InvalidStudy(
            f"no value for {', '.join(missing)}, which the model takes",
            value=None,
            expected="a prior under inputs or a number under fixed",
            remedy=f"Add e.g. `fixed: {{{missing[0]}: …}}`.",
        )
    return fixed


def _require_names(study: StudyFile, model: ForwardModel) -> None:
    """Let a model that knows which names it uses refuse other inputs and fixed quantities."""
    if not isinstance(model, UsesNames):
        return
    with refused_at():
        model.require_names(study.inputs, study.fixed)


def check_values(values: Mapping[str, float], model: ForwardModel, place: str) -> None:
    """Refuse names that the model does not know and values outside the range it declares."""
    declared = {item.name: item for item in declared_inputs(model)}
    for name, value in values.items():
        _check_name(name, declared, f"{place}.{name}")
        _check_range(value, declared, name, f"{place}.{name}")


def check_complete(
    values: Mapping[str, float], names: Iterable[str], model: ForwardModel, place: str, *, add: str = "Add {name}."
) -> None:
    """Refuse values unless there is one for each input that the model declares, else for each of the study's `names`.

    `add` is the remedy for a missing value.
    """
    names = [item.name for item in declared_inputs(model)] or list(names)
    for name in values:
        _check_name(name, dict.fromkeys(names), f"{place}.{name}")
    check_values(values, model, place)
    missing = [name for name in names if name not in values]
    if missing:
        given = ", ".join(f"{name}: {value:g}" for name, value in values.items())
        raise InvalidStudy(
            place,
            value=given or None,
            expected=f"a value for {', '.join(missing)} too",
            remedy=add.format(name=missing[0]),
        )


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


def _parameter(name: str, item: Input, declared: ModelInput | None) -> Parameter:
    unit = item.unit
    if declared is not None and _plain(unit or "1") != _plain(declared.unit):
        raise InvalidStudy(
            f"unit of inputs.{name}",
            value=unit,
            expected=f"{declared.unit}, the unit the model takes",
            remedy=f"Write `unit: {declared.unit}` at {name} and give its prior in that unit.",
        )
    prior = build_prior(item.prior, f"inputs.{name}.prior")
    with refused_at(f"inputs.{name}"):
        declared_unit = declared.unit if declared else unit or "1"
        parameter = Parameter(name, prior, declared_unit, item.box, item.nuisance, symbol=item.label or "")
    _check_prior_in_box(parameter)
    return parameter


def build_prior(given: Mapping[str, list[float]], at: str) -> Prior:
    """Return the prior that the study file names.

    Args:
        given: Its name with its numbers.
        at: Place in the study file.
    """
    (kind, numbers) = next(iter(given.items()))
    prior_class: Any = open_entry(PRIORS, kind, at, "a prior")
    wanted = [field.name for field in dataclasses.fields(prior_class)]
    if len(numbers) != len(wanted):
        raise InvalidStudy(
            f"{at}.{kind}",
            value=numbers,
            expected=f"{len(wanted)} numbers {getattr(prior_class, 'fields', wanted)}",
            remedy="Correct the list.",
        )
    place = f"{at}.{kind}"
    options = dict(zip(wanted, numbers, strict=True))
    prior: Prior = construct(prior_class, options, place)
    if ":" in kind:
        require_prior(prior, place)
    return prior


def _check_prior_in_box(parameter: Parameter) -> None:
    """Require a bounded prior to lie in the box, and an unbounded one to have at least half of its mass there."""
    support, box = parameter.prior.support, parameter.interval
    sticks_out = np.isfinite(support).all() and (support[0] < box[0] or support[1] > box[1])
    if sticks_out or parameter.mass_cut > MASS_CUT_ACCEPTED:
        raise InvalidStudy(
            f"the prior of {parameter.name} reaches beyond its design box",
            value=f"support [{support[0]:g}, {support[1]:g}], box [{box[0]:g}, {box[1]:g}], "
            f"{parameter.mass_cut:.0%} of its mass outside",
            expected="a bounded prior within the box, or at most half of an unbounded prior's mass outside",
            remedy="Widen the box or narrow the prior.",
        )


def _fixed_value(name: str, given: float | Quantity, declared: Mapping[str, ModelInput]) -> float:
    if not isinstance(given, Quantity):
        return float(given)
    if name in declared and _plain(given.unit) != _plain(declared[name].unit):
        raise InvalidStudy(
            f"unit of fixed.{name}",
            value=given.unit,
            expected=f"{declared[name].unit}, the unit the model takes",
            remedy="Convert the value.",
        )
    return float(given.value)


def _check_name(name: str, declared: Mapping[str, Any], place: str) -> None:
    if declared and name not in declared:
        raise InvalidStudy(
            f"{place}: the model has no such input",
            value=name,
            expected=f"one of {', '.join(declared)}",
            remedy=suggestion(name, declared, "Correct the name."),
        )


def _check_range(value: float, declared: Mapping[str, ModelInput], name: str, place: str) -> None:
    item = declared.get(name)
    if item is not None and not item.admits(value):
        meaning = f" ({item.meaning})" if item.meaning else ""
        raise InvalidStudy(
            place,
            value=value,
            expected=f"{name}{meaning} in {item.range_text()} {'' if item.unit == '1' else item.unit}".rstrip(),
            remedy=f"Choose values of {name} within this range.",
        )


def _plain(unit: str) -> str:
    """Return a unit in one spelling: ``mm²/s`` and ``mm^2/s`` are the same."""
    return unit.replace("²", "^2").replace("³", "^3").replace("**", "^").replace(" ", "")
