"""A model with fields: derivatives by coefficients, what it passes on, and what each kind of simulator gets."""

import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.models.command.commands import filled
from tests.unit.models.command.commands import model as command
from tests.unit.models.strips import CALLS, KERNEL, POINTS, S, Strip, undeclared
from tests.unit.models.umbridge.served import served

from strandline import NormalOffset, Observation, Parameter, ParameterSpace, Problem
from strandline.foundations import ForwardModelError, InvalidInput
from strandline.interface import GaussianNoise, Interface
from strandline.models import (
    PythonModel,
    WithCheaper,
    WithFields,
    declared_inputs,
    draws_fields,
    fields_of,
    fingerprint,
    require_inputs,
    vjp,
    with_option,
    with_sensitivities,
)
from strandline.models.umbridge.answers import ServedModel
from strandline.models.umbridge.model import BlockLayout, InputBlocks, UMBridgeModel
from strandline.parameters import GaussianField, LogNormal, LogUniform, Support, Uniform
from strandline.runs import RunRequest, attempt

LINE = Support.interval(0.0, 1.0, POINTS)
PRIOR = GaussianField(400.0, LogNormal(-0.7, 0.4), LogUniform(0.1, 0.6), modes=6)
FIELD = PRIOR.on("E", LINE, "Pa")
MODEL = WithFields(Strip(), (FIELD,))
AT = dict(zip(FIELD.names, [0.3, -0.8, 0.5, 1.2, -0.1, 0.4, 0.5, 0.25], strict=True)) | {"load": 900.0}


def test_derivatives_by_coefficients_and_hyperparameters_are_those_of_differences():
    slopes = with_sensitivities(MODEL)(AT, Path()).sensitivities[""]
    assert set(slopes) == set(AT)
    for name, value in AT.items():
        h = 1e-4 * max(1.0, abs(value))
        ends = [MODEL({**AT, name: value + by}, Path()).interface.points for by in (h, -h)]
        np.testing.assert_allclose(slopes[name], (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-6)


def test_it_declares_the_inputs_of_its_fields_and_fits_a_problem():
    assert [item.name for item in declared_inputs(MODEL)] == [*FIELD.names, "load"]
    assert declared_inputs(WithFields(undeclared, (FIELD,))) == ()
    require_inputs({one.name: one.unit for one in FIELD.parameters}, ("load",), MODEL)
    seen = Observation(Interface.polyline(np.stack([S, S], axis=1)), GaussianNoise(1e-4))
    space = ParameterSpace((*FIELD.parameters, Parameter("load", Uniform(500.0, 1500.0))))
    assert fields_of(Problem(MODEL, space, {}, (seen,), {"offset": NormalOffset()}).model) == (FIELD,)
    assert space.scalars == ("E_sd", "E_length", "load")
    assert (space.fields, space.shown) == ((FIELD,), ("E_sd", "E_length", "load", "E"))
    cheaper = replace(MODEL, model=lambda inputs, workdir: Strip()(inputs), random_fields=(FIELD,))
    assert fields_of(WithCheaper(WithFields(undeclared, (FIELD,)), cheaper, 0.5)) == (FIELD,)
    assert fields_of(Strip()) == ()
    assert not draws_fields(MODEL)
    with pytest.raises(InvalidInput, match="field that the model lacks: got F; expected one of E, load"):
        WithFields(Strip(), (PRIOR.on("F", LINE),))


def test_the_fingerprint_follows_priors_and_points():
    others = [
        WithFields(Strip(), (replace(PRIOR, **{name: value}).on("E", LINE, "Pa"),))
        for name, value in {"mean": 401.0, "sd": 0.5, "length": LogUniform(0.1, 0.7), "modes": 5}.items()
    ]
    others.append(WithFields(Strip(), (PRIOR.on("E", Support.interval(0.0, 1.1, POINTS)),)))
    assert len({fingerprint(one) for one in (MODEL, *others)}) == 6
    again = pickle.loads(pickle.dumps(MODEL))
    assert fingerprint(again) == fingerprint(MODEL)
    np.testing.assert_array_equal(again(AT, Path()).interface.points, MODEL(AT, Path()).interface.points)


def test_a_vjp_becomes_sensitivities_in_the_run_by_a_call_for_each_coordinate():
    plain = PythonModel("tests.unit.models.strips:pulled")
    model, request = WithFields(with_sensitivities(plain), (FIELD,)), RunRequest("key", AT)
    CALLS.clear()
    found, own = attempt(model, request, Path()), with_sensitivities(MODEL)(AT, Path())
    assert CALLS == [1.0] * (2 * POINTS)
    for name, slopes in own.sensitivities[""].items():
        np.testing.assert_allclose(found.sensitivities[""][name], slopes, atol=1e-12)
    factors = {"": np.random.default_rng(0).standard_normal((POINTS, 2))}
    for source in (model, WithFields(Strip(True), (FIELD,))):
        simulation, gradient = vjp(source, AT, factors, Path())
        for name, slopes in own.sensitivities[""].items():
            np.testing.assert_allclose(gradient[name], (factors[""] * slopes).sum(), rtol=1e-9, atol=1e-12)
        assert pickle.loads(pickle.dumps(simulation)).vjp is None
    CALLS.clear()
    assert not attempt(WithFields(plain, (FIELD,)), request, Path()).sensitivities
    assert not CALLS
    with pytest.raises(InvalidInput, match="derivatives of the model: got a run returned none; expected a vjp or sens"):
        vjp(MODEL, AT, factors, Path())


def test_a_vjp_of_the_wrong_shape_or_that_fails_ends_the_run():
    for returned, words in (
        ({"E": np.ones(29), "load": 1.0}, r"by the field E have the shape \(29,\); expected \(30,\)"),
        ({"load": 1.0}, r"by the field E have the shape \(\); expected \(30,\)"),
    ):

        def short(inputs, workdir, returned=returned):
            return replace(Strip()(inputs), vjp=lambda factors: returned)

        short.sensitivities = True
        record = attempt(WithFields(short, (FIELD,)), RunRequest("key", AT), Path())
        assert record.failure_kind == "sensitivities"
        assert re.search(words, record.message)


def test_wrong_shapes_of_sensitivities_end_the_run():
    def shapeless(inputs, workdir):
        return replace(Strip(True)(inputs), sensitivities={"": {"load": np.zeros((POINTS, 2))}})

    with pytest.raises(ForwardModelError, match=r"by the field E have the shape \(\); expected \(point, xyz, 30\)"):
        WithFields(shapeless, (FIELD,))(AT, Path())


def test_a_command_gets_a_file_with_points_or_the_values(tmp_path):
    folder = filled(tmp_path / "study")
    with pytest.raises(InvalidInput, match=r"the field E: got used in no template.*{{ E_field }} or {{ E_values }}"):
        WithFields(command(folder), (FIELD,))
    (folder / "in.j2").write_text("{{ a }} {{ E_field }}\n{{ E_values }}\n")
    model = WithFields(command(folder), (FIELD,))
    model.require_names([*FIELD.names, "a"], ())
    with pytest.raises(InvalidInput, match="the input b is used in no template"):
        model.require_names([*FIELD.names, "a", "b"], ())
    (tmp_path / "run").mkdir()
    x = np.array([AT[name] for name in FIELD.names])
    values = model.model.values_in({"a": 1.5, "E": FIELD.values(x)}, tmp_path / "run")
    table = np.loadtxt(tmp_path / "run" / values["E_field"])
    np.testing.assert_allclose(table, np.column_stack([S, 0 * S, 0 * S, FIELD.values(x)]), rtol=1e-12)
    np.testing.assert_allclose(np.array(values["E_values"].split(), float), FIELD.values(x), rtol=1e-12)
    with pytest.raises(ForwardModelError, match="the field E has 29 values for 30 points: its mesh has changed"):
        model.model.values_in({"a": 1.5, "E": np.ones(29)}, tmp_path / "run")


COUNTED: list[tuple[str, int]] = []


def output(blocks):
    E, (load,) = np.array(blocks[0]), blocks[1]
    return [np.stack([S, load * KERNEL @ (1 / E)], axis=1).ravel().tolist()]


def apply_jacobian(out, into, blocks, vec):
    COUNTED.append(("ApplyJacobian", into))
    E, (load,), by = np.array(blocks[0]), blocks[1], np.array(vec)
    w = -load * KERNEL @ (by / E**2) if into == 0 else KERNEL @ (1 / E) * by[0]
    return np.stack([0 * w, w], axis=1).ravel().tolist()


def gradient(out, into, blocks, sens):
    COUNTED.append(("Gradient", into))
    E, (load,), by = np.array(blocks[0]), blocks[1], np.array(sens).reshape(-1, 2)[:, 1]
    return (-load * by @ KERNEL / E**2).tolist() if into == 0 else [float(by @ KERNEL @ (1 / E))]


def test_a_server_gets_a_block_and_its_derivatives_are_chained():
    blocks = InputBlocks.read([["E"], ["load"]])
    with served(ServedModel("strip", (POINTS, 1), (2 * POINTS,), output, gradient=gradient)) as url:
        model = WithFields(UMBridgeModel(url, "strip", blocks, BlockLayout(), sensitivities=True), (FIELD,))
        found, own = model(AT, Path()), with_sensitivities(MODEL)(AT, Path())
        np.testing.assert_allclose(found.interface.points, own.interface.points)
        for name, slopes in own.sensitivities[""].items():
            np.testing.assert_allclose(found.sensitivities[""][name], slopes, atol=1e-12)
        COUNTED.clear()
        factors = np.random.default_rng(0).standard_normal((POINTS, 2))
        for name, value in vjp(with_option(model, "sensitivities", False), AT, {"": factors}, Path())[1].items():
            np.testing.assert_allclose(value, (factors * own.sensitivities[""][name]).sum(), rtol=1e-9, atol=1e-12)
        assert COUNTED == [("Gradient", 0), ("Gradient", 1)]
        other = WithFields(model.model, (PRIOR.on("E", Support.interval(0.0, 1.0, 20)),))
        with pytest.raises(ForwardModelError, match=r"blocks of \[30, 1\] inputs; `inputs` names blocks of \[20, 1\]"):
            other(AT, Path())
    shared = replace(model.model, inputs=InputBlocks.read(["E", "load"]))
    with pytest.raises(InvalidInput, match=r"the field E: got inputs: \[\['E', 'load'\]\]; expected a block \[E\]"):
        WithFields(shared, (FIELD,))


def test_a_server_gets_the_fewest_calls_for_the_derivatives_by_a_field():
    """A call for each of 30 values rather than of 60 coordinates, and of 20 coordinates rather than of 30 values."""
    few = slice(0, 20)
    offers = {"gradient": gradient, "apply_jacobian": apply_jacobian}
    fewer = {
        "gradient": lambda out, into, b, sens: gradient(out, into, b, [*sens, *[0.0] * 40]),
        "apply_jacobian": lambda out, into, b, vec: apply_jacobian(out, into, b, vec)[few],
    }
    all_of = ServedModel("all", (POINTS, 1), (2 * POINTS,), output, **offers)
    seen = ServedModel("seen", (POINTS, 1), (20,), lambda blocks: [output(blocks)[0][few]], **fewer)
    at = {"E": np.linspace(300, 500, POINTS), "load": 900.0}
    own = Strip(True)(at).sensitivities[""]
    blocks = InputBlocks.read([["E"], ["load"]])
    with served(all_of, seen) as url:
        for name, calls in (("all", [("ApplyJacobian", 0)] * 30), ("seen", [("Gradient", 0)] * 20)):
            COUNTED.clear()
            found = UMBridgeModel(url, name, blocks, BlockLayout(), sensitivities=True)(at, Path()).sensitivities[""]
            assert [*calls, ("ApplyJacobian", 1)] == COUNTED
            for of, slopes in found.items():
                np.testing.assert_allclose(slopes, own[of][: len(slopes)], atol=1e-12)


def test_a_vjp_by_a_server_knows_units_and_columns():
    def columns(blocks):
        return np.array(output(blocks)[0]).reshape(-1, 2).T.tolist()

    def by_column(out, into, blocks, sens):
        return gradient(out, into, blocks, np.stack([sens, sens], axis=1)) if out else [0.0] * (1 if into else POINTS)

    at, layout = {"E": np.linspace(300, 500, POINTS), "load": 900.0}, BlockLayout("columns")
    factors = np.random.default_rng(0).standard_normal((POINTS, 2))
    model = ServedModel("columns", (POINTS, 1), (POINTS, POINTS), columns, gradient=by_column)
    with served(model) as url:
        client = UMBridgeModel(url, "columns", InputBlocks.read([["E"], ["load"]]), layout, "um")
        found = vjp(client, at, {"": factors}, Path())[1]
    for of, slopes in Strip(True)(at).sensitivities[""].items():
        np.testing.assert_allclose(found[of], 1e-3 * np.tensordot(factors, slopes, 2), rtol=1e-9)
