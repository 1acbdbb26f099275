"""The keys `model` and `fidelities` of study.yaml → forward models."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict

from strandline.discrepancy import DISCREPANCIES, Discrepancy, apart
from strandline.foundations import InvalidInput, InvalidStudy, read_json, require
from strandline.models import (
    CHEAPER,
    MODELS,
    ForwardModel,
    UsesNames,
    WithCheaper,
    WithFields,
    by_cheaper,
    fields_of,
    with_sensitivities,
)
from strandline.parameters import RandomField
from strandline.runs import RunRecord
from strandline.studies.keys.folder import SUMMARY
from strandline.studies.keys.parse import checked, made, open_entry, refused_at, require_parts
from strandline.studies.keys.schema import Choice, Number, Section
from strandline.studies.keys.study_file import StudyFile
from strandline.studies.load.observed import read_points
from strandline.studies.load.photographed import Undeformed, undeformed_in


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
    given, what = options or {}, f"model.{name}: sensitivities is not an option of the model"
    words = "`sensitivities: true` as a key of the study", "Move the key to the top level of study.yaml."
    require("sensitivities" not in given, what, given.get("sensitivities"), *words, InvalidStudy)
    factory, place = open_entry(MODELS, name, "model", "a forward model"), f"model.{name}"
    if any(one.name == "folder" and one.init for one in dataclasses.fields(factory)):
        model: ForwardModel = made(factory, options, place, folder=folder)
    else:
        options = {key: _with_points(key, value, folder) for key, value in given.items()}
        undeformed = undeformed or undeformed_in(choice, folder)
        if undeformed is not None:
            options["outline"] = undeformed.options(options["outline"])
        model = made(factory, options, place)
    with refused_at():
        return with_sensitivities(model) if sensitivities else model


def _with_points(name: str, value: Any, folder: Path) -> Any:
    if not isinstance(value, Mapping) or "file" not in value:
        return value
    unit = str(value.get("unit", "nothing"))
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
        words = "each measure once", f"Remove the second {name}."
        require(name not in result, "discrepancy", name, *words, InvalidStudy)
        kind = open_entry(DISCREPANCIES, name, "discrepancy", "a discrepancy")
        measure = made(kind, options, f"discrepancy.{name}")
        require_parts(measure, ("__call__",), f"discrepancy.{name}")
        result[name] = measure
    return result


def with_fields(model: ForwardModel, fields: tuple[RandomField, ...]) -> ForwardModel:
    """Return the model with the fields among its inputs; the model itself if there are none."""
    if not fields:
        return model
    with refused_at("inputs"):
        return WithFields(model, fields)


def differentiating(model: ForwardModel) -> ForwardModel | None:
    """Return `model` with sensitivities switched on; None if it has none."""
    try:
        asked: ForwardModel = with_sensitivities(model)
    except InvalidInput:
        return None
    return asked


COST = 0.3  # cost of a run of the cheaper model if the study states none: that of the built-in model on its coarse mesh
TOLERATED = 2.0  # multiple of the stated cost from which a check warns
EXAMPLES = {"command": "{templates: {coarse.inp.j2: deck.inp}, cost: 0.1}"}
EXAMPLE = "{model: {python: {function: 'own_model:cheaper'}}, cost: 0.1}"
"""Cheaper models by the kind of the model, and for any other kind."""
FAR = 0.5  # share of the interface's extent from which a check warns that the cheaper model's is off by too much


class _Cheaper(Section):
    """What `fidelities` states of the cheaper model: options in which it differs, or another model; and its cost."""

    model_config = ConfigDict(extra="allow")
    cost: Number = COST
    model: Choice | None = None


def with_cheaper(
    model: ForwardModel, content: StudyFile, folder: Path, undeformed: Undeformed | None = None
) -> ForwardModel:
    """Return the model together with the cheaper one that the study names, or alone if it names none."""
    if not content.fidelities:
        return model
    (given,) = content.fidelities
    stated = checked(_Cheaper, {"mesh": given} if isinstance(given, str) else given, "fidelities")
    if isinstance(given, str) and not hasattr(model, "mesh"):
        expected = "the options in which the cheaper model differs: only a model with meshes has names for them"
        remedy = f"Write e.g. fidelities: [{EXAMPLES.get(next(iter(content.model)), EXAMPLE)}]."
        raise InvalidStudy("fidelities", value=given, expected=expected, remedy=remedy)
    free = CHEAPER not in {*content.inputs, *content.fixed}
    require(free, "an input of a study with fidelities", CHEAPER, "another name", "Rename it.", InvalidStudy)
    choice, differing = stated.model or content.model, stated.model_extra or {}
    if stated.model is None:
        ((name, own),) = content.model.items()
        choice = {name: {**(own or {}), **differing}}
    elif differing:
        what = "fidelities.model"
        expected = "one simulator with its options, as under `model`, and only `cost` beside it"
        remedy = "Write e.g. fidelities: [{model: {command: {…}}, cost: 0.1}]."
        raise InvalidStudy(what, value=f"with {', '.join(differing)} beside it", expected=expected, remedy=remedy)
    with refused_at("fidelities"):
        other = build_model(choice, folder, sensitivities=content.sensitivities, undeformed=undeformed)
        cheaper = with_fields(other, fields_of(model))
        if isinstance(cheaper, UsesNames):
            cheaper.require_names(content.inputs, content.fixed)
        return WithCheaper(model, cheaper, stated.cost)


def cheaper_dropped(folder: Path) -> bool:
    """Return whether the results in a study's folder leave the runs of its cheaper model aside."""
    try:
        return read_json(folder / SUMMARY)["certificate"]["fidelities"]["dropped"] is not None
    except (KeyError, TypeError):
        return False


def cheaper_lines(
    model: ForwardModel, record: RunRecord, make: Callable[[ForwardModel, Mapping[str, float]], RunRecord]
) -> Iterator[str]:
    """Yield how a run of the cheaper model compares with one of the model at the same inputs; nothing without one."""
    if not isinstance(model, WithCheaper):
        return
    other = make(model, by_cheaper(record.inputs))
    if not other.ok:
        yield f"warning: there the run of the cheaper model fails ({other.failure_kind}): it is no help near this point"
        return
    apart_mm = max(apart(one, record.interfaces[name])[1] for name, one in other.interfaces.items())
    extent = max(float(np.ptp(one.points, axis=0).max()) for one in record.interfaces.values())
    if apart_mm > FAR * extent:
        yield (
            f"warning: the interface of the cheaper model is off by {apart_mm:.3g} mm, but that of the model is only "
            f"{extent:.3g} mm long: does its result have another unit, or is it another interface?"
        )
    share = other.seconds / max(record.seconds, 1e-9)
    if share >= 1.0:
        yield f"warning: a run of the cheaper model takes {share:.2g} times as long as one of the model"
    elif share > TOLERATED * model.cost:
        yield f"warning: a run of the cheaper model takes {share:.2g} of the time, not {model.cost:g}: state its cost"
    yield (
        f"the cheaper model: ok in {other.seconds:.2g} s, {share:.2g} of the time (stated cost {model.cost:g}); "
        f"before the correction its interface is off by at most {1e3 * apart_mm:.2g} µm"
    )
