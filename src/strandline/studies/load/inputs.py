"""`inputs`, `fixed` and `next` of study.yaml → unknown and known inputs, candidates for the next experiment."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import jax
import numpy as np

from strandline.design.candidates import WHOLE, Candidate, Look, candidates
from strandline.foundations import InvalidStudy, require, unfit
from strandline.models import (
    ForwardModel,
    ModelInput,
    UsesNames,
    declared_conditions,
    declared_inputs,
    fields_of,
    same_unit,
)
from strandline.parameters import PRIORS, GaussianField, Parameter, ParameterSpace, Prior, RandomField, Support
from strandline.readers import TO_MM
from strandline.studies.keys.parse import entry, made, open_entry, refused_at, require_parts
from strandline.studies.keys.study_file import Input, Next, Quantity, StudyFile
from strandline.studies.load.observed import require_condition

MASS_CUT_ACCEPTED = 0.5  # largest share of an unbounded prior's mass that may lie outside the box


def build_space(study: StudyFile, model: ForwardModel) -> ParameterSpace:
    """Return the unknown inputs, checked against what the model declares; those of fields are in place of these."""
    declared = {item.name: item for item in declared_inputs(model)}
    fields = {one.name: one.parameters for one in fields_of(model)}
    parameters: list[Parameter] = []
    for name, item in study.inputs.items():
        parameters += fields[name] if name in fields else [_parameter(name, item, declared.get(name))]
    for parameter in parameters:
        _check_name(parameter.name, declared, f"inputs.{parameter.name}")
        for bound in parameter.interval:
            _check_range(bound, declared, parameter.name, f"inputs.{parameter.name}: end of the design box")
    with refused_at("inputs"):
        space = ParameterSpace(tuple(parameters))
    pairs = {one.between: one.value for one in study.correlation}
    require(len(pairs) == len(study.correlation), "correlation", "a pair of inputs twice", "each pair once")
    for pair in pairs:
        expected = f"two of {', '.join(space.scalars) or 'none'}, the inputs that are no coefficients of a field"
        right = {*pair} <= {*space.scalars}
        require(right, "correlation.between", " and ".join(pair), expected, "Correct the names.", InvalidStudy)
    with refused_at():
        space = replace(space, correlation=pairs)
    _require_compiled(space)
    return space


def _require_compiled(space: ParameterSpace) -> None:
    """Refuse a prior of correlated inputs whose cdf JAX cannot compile."""
    try:
        jax.eval_shape(space.log_prior, np.zeros(space.dim, np.float32))
    except Exception as error:
        found = f"a cdf that fails with {type(error).__name__}"
        raise _refused("priors of correlated inputs", found, "one that works on JAX arrays under jax.jit") from None


def build_fields(inputs: Mapping[str, Input], model: ForwardModel, folder: Path) -> tuple[RandomField, ...]:
    """Return the inputs that are fields, at the points where the model takes them."""
    declared = {item.name: item for item in declared_inputs(model)}
    given = {name: item for name, item in inputs.items() if item.field is not None}
    return tuple(_field(name, item, model, declared, folder) for name, item in given.items())


def _field(
    name: str, item: Input, model: ForwardModel, declared: Mapping[str, ModelInput], folder: Path
) -> RandomField:
    place, options, own = f"inputs.{name}.field", dict(item.field or {}), declared.get(name)
    if not hasattr(model, "field_support"):  # else this says why the model takes no such field
        _check_name(name, declared, f"inputs.{name}")
    _require_unit(item.unit, own, f"inputs.{name}", "give the field in that unit")
    for key in ("sd", "length"):
        if isinstance(options[key], Mapping):
            options[key] = build_prior(options[key], f"{place}.{key}")
    at = options.pop("at", "solid")
    with refused_at(f"inputs.{name}"):
        prior = GaussianField(**options)
        if own is not None and own.low >= 0:
            words = f"true: the model takes values in {own.range_text()}", "Leave it out."
            require(prior.log, f"log of the field {name}", "false", *words)
        return prior.on(name, _support(name, at, model, folder), own.unit if own else item.unit or "1")


def _support(name: str, at: Any, model: Any, folder: Path) -> Support:
    """Return the points at which a model takes a field."""
    if "interval" in at:
        low, high = at["interval"]
        return Support.interval(low, high, at["points"])
    if "file" in at:
        return _points(folder / at["file"], TO_MM[at["unit"]])
    expected = (
        "{file: points.csv, unit: mm} or {interval: [0, 1], points: 200}: this simulator has no points of its own"
    )
    require(hasattr(model, "field_support"), f"field.at of {name}", at, expected, "State the points.")
    found: Support = model.field_support(name)
    return found


COLUMNS = ("x", "y", "z", "weight")


def _points(path: Path, factor: float) -> Support:
    """Return the points in a table, mm, and their weights, by default equal ones."""
    what, expected = f"points of a field, {path.name}", "a readable table of numbers, its first line x,y or x,y,z"
    try:
        titles, *lines = path.read_text(encoding="utf-8-sig").splitlines()
        names = [title.strip().lower() for title in titles.split(",")]
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise unfit(what, " ".join(str(error).split()), expected, "Correct the file, or its name.") from None
    found = [names.index(name) for name in COLUMNS if name in names]
    right = "x" in names and len(found) == len(names) == table.shape[1] and len(table) > 1
    require(right, what, f"{len(table)} rows, first line {titles!r}", expected, "Add a first line of names.")
    weights = table[:, names.index("weight")] if "weight" in names else np.ones(len(table))
    sound = np.isfinite(table).all(axis=1) & (weights > 0)
    bad = int(np.argmin(sound)) + 2
    require(sound.all(), f"{what}, line {bad}", lines[bad - 2], "finite numbers, a weight above 0", "Correct the line.")
    return Support(factor * table[:, [names.index(name) for name in COLUMNS[:3] if name in names]], weights)


def build_fixed(study: StudyFile, model: ForwardModel, space: ParameterSpace) -> dict[str, float]:
    """Return the known inputs; together with the unknown ones they must be all that the model takes."""
    declared = {item.name: item for item in declared_inputs(model)}
    if isinstance(model, UsesNames):
        with refused_at():
            model.require_names(space.names, study.fixed)
    for name, given in study.fixed.items():
        if isinstance(given, Quantity):
            _require_unit(given.unit, declared.get(name), f"fixed.{name}", "convert the value")
    fixed = {name: float(one.value if isinstance(one, Quantity) else one) for name, one in study.fixed.items()}
    check_values(fixed, model, "fixed")
    for name in fixed:
        if name in space.names:
            what, remedy = f"{name} is both fixed and an input", f"Remove {name} from fixed or from inputs."
            raise InvalidStudy(what, value=fixed[name], expected="one of the two", remedy=remedy)
    missing = [name for name in declared if name not in fixed and name not in space.names]
    if missing:
        what = f"no value for {', '.join(missing)}, which the model takes"
        expected = "a prior under inputs or a number under fixed"
        raise InvalidStudy(what, value=None, expected=expected, remedy=f"Add e.g. `fixed: {{{missing[0]}: …}}`.")
    return fixed


def check_values(values: Mapping[str, float], model: ForwardModel, place: str) -> None:
    """Refuse names that the model does not know and values outside the range it declares."""
    declared = {item.name: item for item in declared_inputs(model)}
    for name, value in values.items():
        _check_name(name, declared, f"{place}.{name}")
        _check_range(value, declared, name, f"{place}.{name}")


def check_complete(
    values: Mapping[str, float], names: Iterable[str], model: ForwardModel, place: str, *, add: str = "Add {name}."
) -> None:
    """Refuse values unless each input that the model declares, else each of `names`, has one; `add` is the remedy."""
    names = [item.name for item in declared_inputs(model)] or list(names)
    for name in values:
        _check_name(name, dict.fromkeys(names), f"{place}.{name}")
    check_values(values, model, place)
    missing = [name for name in names if name not in values]
    if missing:
        given = ", ".join(f"{name}: {value:g}" for name, value in values.items())
        expected, remedy = f"a value for {', '.join(missing)} too", add.format(name=missing[0])
        raise InvalidStudy(place, value=given or None, expected=expected, remedy=remedy)


def _parameter(name: str, item: Input, declared: ModelInput | None) -> Parameter:
    _require_unit(item.unit, declared, f"inputs.{name}", "give its prior in that unit")
    prior = build_prior(item.prior or {}, f"inputs.{name}.prior")
    with refused_at(f"inputs.{name}"):
        unit = declared.unit if declared else item.unit or "1"
        parameter = Parameter(name, prior, unit, item.box, item.nuisance, symbol=item.label or "")
    _check_prior_in_box(parameter)
    return parameter


def build_prior(given: Mapping[str, list[float]], at: str) -> Prior:
    """Return the prior that the study file names."""
    ((kind, numbers),) = given.items()
    prior_class: Any = open_entry(PRIORS, kind, at, "a prior")
    place, wanted = f"{at}.{kind}", [field.name for field in dataclasses.fields(prior_class)]
    if len(numbers) != len(wanted):
        expected = f"{len(wanted)} number{'s' if len(wanted) != 1 else ''} {getattr(prior_class, 'fields', wanted)}"
        raise InvalidStudy(place, value=numbers, expected=expected, remedy="Correct the list.")
    prior: Prior = made(prior_class, dict(zip(wanted, numbers, strict=True)), place)
    if ":" in kind:
        require_prior(prior, place)
    return prior


def _check_prior_in_box(parameter: Parameter) -> None:
    """Require a bounded prior to lie in the box, and an unbounded one to have at least half of its mass there."""
    support, box = parameter.prior.support, parameter.interval
    sticks_out = np.isfinite(support).all() and (support[0] < box[0] or support[1] > box[1])
    if sticks_out or parameter.mass_cut > MASS_CUT_ACCEPTED:
        what = f"the prior of {parameter.name} reaches beyond its design box"
        value = f"support [{support[0]:g}, {support[1]:g}], box [{box[0]:g}, {box[1]:g}]"
        value = f"{value}, {parameter.mass_cut:.0%} of its mass outside"
        expected = "a bounded prior within the box, or at most half of an unbounded prior's mass outside"
        raise InvalidStudy(what, value=value, expected=expected, remedy="Widen the box or narrow the prior.")


def _require_unit(unit: str | None, declared: ModelInput | None, place: str, remedy: str) -> None:
    """Refuse another unit than the model's: nothing is converted."""
    if declared is not None and not same_unit(unit or "1", declared.unit):
        expected = f"{declared.unit}, the unit the model takes"
        remedy = f"Write `unit: {declared.unit}` there and {remedy}."
        raise InvalidStudy(f"unit of {place}", value=unit, expected=expected, remedy=remedy)


def _check_name(name: str, declared: Mapping[str, Any], place: str) -> None:
    if declared:
        entry(declared, name, f"{place}: the model has no such input")


def _check_range(value: float, declared: Mapping[str, ModelInput], name: str, place: str) -> None:
    item = declared.get(name)
    if item is not None and not item.admits(value):
        meaning = f" ({item.meaning})" if item.meaning else ""
        expected = f"{name}{meaning} in {item.range_text()} {'' if item.unit == '1' else item.unit}".rstrip()
        raise InvalidStudy(place, value=value, expected=expected, remedy=f"Choose values of {name} within this range.")


def require_prior(prior: Prior, place: str) -> None:
    """Refuse a prior that lacks a part, has no interval as support, or whose density JAX cannot compile."""
    require_parts(prior, ("support", "log_density", "cdf", "quantile"), place)
    support = prior.support
    if not (isinstance(support, tuple) and len(support) == 2 and support[0] < support[1]):
        raise _refused(place, f"the support {support!r}", "a property `support` of two numbers, (low, high)")
    numbers = np.zeros(3, np.float32)
    try:
        shape = jax.eval_shape(prior.log_density, numbers).shape
    except Exception as error:
        found = f"a log_density that fails with {type(error).__name__}"
        raise _refused(place, found, "one that works on JAX arrays under jax.jit") from None
    if shape != (3,):
        raise _refused(place, f"a log_density that turns 3 numbers into the shape {shape}", "a number for each")


def _refused(place: str, value: str, expected: str) -> InvalidStudy:
    return InvalidStudy(place, value=value, expected=expected, remedy="Check the prior with strandline.testing.priors.")


MOST_CANDIDATES = 500  # largest number of candidates


def read_candidates(
    given: Next | None, model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]
) -> tuple[Candidate, ...]:
    """Return the candidates that study.yaml lists; none if it lists none."""
    if given is None or not given.model_fields_set:
        return ()
    values = given.model_extra or {}
    for name in values:
        _require_settable(name, values[name], model, space, fixed)
    sds = [None if sd is None else sd * TO_MM[str(given.unit)] for sd in given.sd or [None]]
    conditions = [_condition(one, model) for one in given.condition or [""]]
    looks = [Look(*row) for row in product(conditions, given.part or [WHOLE], given.points or [None], sds)]
    found = candidates(values, looks, together=given.together, present=fixed)
    if len(found) > MOST_CANDIDATES:
        expected, remedy = f"at most {MOST_CANDIDATES}", "List fewer values, or lower `together`."
        raise InvalidStudy("next: too many candidates", value=len(found), expected=expected, remedy=remedy)
    return found


def _require_settable(
    name: str, values: Iterable[float], model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]
) -> None:
    settable = (*fixed, *(space.names[k] for k in space.nuisance), *Next.model_fields)
    why = ": an experiment cannot set what is to be inferred" if name in space.names else ""
    entry(dict.fromkeys(settable), name, f"next.{name}{why}")
    for value in values:
        check_values({name: value}, model, "next")
        if name in space.names and not space[name].interval[0] <= value <= space[name].interval[1]:
            expected = f"a value in the box of this input, {list(space[name].interval)}: no run was made outside it"
            remedy = "Correct the value, or make the box wider and run the study again."
            raise InvalidStudy(f"next.{name}", value=value, expected=expected, remedy=remedy)


def _condition(given: str | list[str], model: ForwardModel) -> tuple[str, ...]:
    names = [given] if isinstance(given, str) else given
    for name in names if given != "" else ():
        require_condition(name, declared_conditions(model), "next.condition")
    return tuple(name for name in names if name)
