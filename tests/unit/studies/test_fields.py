"""Fields and correlated inputs in study.yaml: what is loaded, what `strandline check` says, what is refused."""

import numpy as np
import pytest
from tests.unit.models.strips import POINTS
from tests.unit.studies.test_refusals import changed_study, message_of, not_refused

from strandline.cli import main
from strandline.models import WithFields, fields_of
from strandline.models.biofilm.model import Biofilm
from strandline.parameters import LogUniform
from strandline.studies import changed_study as copied
from strandline.studies import load_study
from strandline.testing.studies import write_study

FIELD = {"mean": 400, "sd": 0.5, "length": {"loguniform": [0.1, 0.5]}, "modes": 6}
FIELD |= {"at": {"interval": [0, 1], "points": POINTS}}
STUDY = {
    "model": {"python": {"function": "tests.unit.models.strips:strip"}},
    "fixed": None,
    "inputs": {"E": {"field": FIELD, "unit": "Pa"}, "load": {"prior": {"uniform": [500, 1500]}}},
    "observation": {"synthetic": {"load": 900, "E_length": 0.3, "E_1": 1.0}},
    "noise": {"sd": 0.003},
}
CELL = STUDY | {"model": {"biofilm": {"mesh": "coarse"}}, "fixed": {"V_in": 100, "nu": 0.3}}
CELL |= {"inputs": {"E": {"field": {"mean": 400, "sd": 0.5, "length": 0.1, "modes": 20}, "unit": "Pa"}}}
CELL |= {"observation": {"synthetic": {"V_in": 100, "nu": 0.3}}}


@pytest.fixture
def folder(tmp_path):
    return write_study(tmp_path / "study", **STUDY)


def test_a_field_stands_beside_scalars(folder):
    study = load_study(folder)
    (field,) = fields_of(study.model)
    assert study.space.names == (*(f"E_{k}" for k in range(1, 7)), "E_length", "load")
    assert (field.unit, field.prior.length, field.prior.sd) == ("Pa", LogUniform(0.1, 0.5), 0.5)
    assert field.support.points[[0, -1], 0] == pytest.approx([0.5 / POINTS, 1 - 0.5 / POINTS])
    assert study.truth == {**dict.fromkeys(study.space.names, 0.0), "load": 900, "E_length": 0.3, "E_1": 1.0}


def test_points_come_from_a_table_with_weights(tmp_path):
    rows = [[k / POINTS, 0.0, 2.0 + k % 2] for k in range(POINTS)]
    text = "x, y, weight\n" + "\n".join(", ".join(map(str, row)) for row in rows)
    (tmp_path / "points.csv").write_text(text)
    field = FIELD | {"length": 200, "at": {"file": "points.csv", "unit": "m"}}
    inputs, observed = {**STUDY["inputs"], "E": {"field": field, "unit": "Pa"}}, {"synthetic": {"load": 900}}
    (found,) = fields_of(
        load_study(write_study(tmp_path, **{**STUDY, "inputs": inputs, "observation": observed})).model
    )
    np.testing.assert_allclose(found.support.points, 1e3 * np.array(rows)[:, :2])
    np.testing.assert_array_equal(found.support.weights, np.array(rows)[:, 2])


def test_correlated_inputs(tmp_path):
    study = load_study(write_study(tmp_path / "s", correlation=[{"between": ["tilt", "E"], "value": -0.5}]))
    assert study.space.correlation == {("tilt", "E"): -0.5}
    np.testing.assert_allclose(study.space.root @ study.space.root.T, [[1, -0.5], [-0.5, 1]])


def test_the_check_names_the_share_of_variance_and_no_coefficient(folder, capsys):
    main(["check", str(folder)])
    said = capsys.readouterr().out
    share = fields_of(load_study(folder).model)[0].share
    assert f"6 modes keep {share:.1%} of its variance at {POINTS} points" in said
    assert "E_1" not in said
    assert "E_length = 0.22" in said


def test_medians_of_coefficients_are_zero_without_rounding(tmp_path, capsys):
    (tmp_path / "broken.py").write_text("def strip(inputs, workdir): return None")
    changed_study(tmp_path, {"model.python.function": "broken:strip"}, **{**STUDY, "fixed": {}})
    with pytest.raises(SystemExit):
        main(["check", str(tmp_path)])
    assert "E_1 = 0, E_2 = 0" in capsys.readouterr().err


def test_a_copy_with_another_field_takes_over_no_runs(folder):
    other = copied(folder, ["inputs.E.field.mean=300"])
    assert load_study(other).reuse == ()
    assert len(load_study(copied(folder, ["noise.sd=0.005"])).reuse) == 1


REFUSED = """
inputs.E.field.length: GONE | inputs.E.field.length | Add it
inputs.E.field.length: 0.01 | inputs.E: length of the field E | got 0.01 mm | at least 0.0333 mm
inputs.E.field.length: {uniform: [0, 1]} | inputs.E: length of the field E | low=0 | a lower end of at least 0.0333 mm
inputs.E.field.length: [1]; inputs.E.field.sd: high | inputs.E.field
inputs.E.field.sd: {uniform: [1]} | inputs.E.field.sd.uniform | 2 numbers
inputs.E.field.sd: 50 | inputs.E: sd of a field: got 50 | at most 3 | unit of the field, or set log to false
inputs.E.field.sd: {uniform: [0.1, 50]} | inputs.E: sd of a field | at most 3
inputs.E.field.modes: 31 | modes of the field E: got 31 | at most 30, its points
inputs.E.field.mean: -1 | inputs.E: mean of a field: got -1 | above 0 | set log to false
inputs.E.field.covariance: cubic | covariance of a field: got cubic | matern32
inputs.E.field.log: false | log of the field E | (0, inf]
inputs.E.unit: MPa | unit of inputs.E: got MPa
inputs.E.prior: {uniform: [1, 2]} | inputs.E | either `prior
inputs.E.box: [1, 2]; inputs.E.nuisance: true; inputs.E.label: Y | `field` with `unit` only
inputs.E.field.at: solid | field.at of E | no points of its own
inputs.E.field.at: {interval: [1, 0], points: 5} | inputs.E.field.at | the lower one first
inputs.E.field.at: {file: none.csv, unit: mm} | points of a field, none.csv | No such file
inputs.E.field.at: {file: nan.csv, unit: mm} | nan.csv, line 3: got 1,nan | finite numbers
inputs.E.field.at: {file: bare.csv, unit: mm} | bare.csv: got 1 rows, first line '0,0' | x,y or x,y,z
inputs.E.field.at: {file: text.csv, unit: mm}; inputs.E.field.at: {file: ragged.csv, unit: mm} | readable table
inputs.F: {field: {mean: 1, sd: 1, length: 1}} | inputs.F: the model has no such input
inputs.E_1: {prior: {uniform: [0, 1]}} | names of the inputs | all names different
correlation: [{between: [E, load], value: 0.5}] | correlation.between: got E and load | two of E_length, load
correlation: [{between: [load, E_1], value: 0.5}] | got load and E_1 | two of E_length, load
correlation: [{between: [load, load], value: 0.5}] | correlation of load and load: got load and load | two of
correlation: [{between: [load, E_1], value: 0.5}, {between: [load, E_1], value: 0.4}] | each pair once
correlation: [{between: [load, E_1], value: 1.5}] | correlation.0.value | less than 1
"""
REFUSED_CELL = """
model.biofilm.partition: three_parts | inputs.E: field of the biofilm model | without partition
model.biofilm.anchors: {E: [300, 500], nu: 0.3, V_in: 100} | without partition, branches and anchors
inputs.E.field.at: {interval: [0, 1], points: 30} | points of the field E: got 30 points | at: solid
inputs.E.field.length: 0.001 | length of the field E
inputs.E.field.modes: 40 | unknown inputs: got 40 | at most 30, or an active design with sensitivities (`sensitivities:
design: {active: {runs: 60, exact: true}} | exact: got true with 20 inputs and no sensitivities | `sensitivities: true`
design: {active: {runs: 20, differences: true}} | runs: got 20 | at least 47: 23 to begin with and 24 draws
sensitivities: true, design: {active: {runs: 60, differences: true}} | got true with 20 inputs and sensitivities
observation.synthetic.E_999: 1 | E_999 | E_1 … E_
"""


def test_what_is_no_field_is_refused_in_a_line(tmp_path):
    for name, text in {
        "nan": "x,y\n0,0\n1,nan",
        "bare": "0,0\n1,1",
        "text": "x\na\nb",
        "ragged": "x,y\n1,2\n3",
    }.items():
        (tmp_path / f"{name}.csv").write_text(text)
    base = {key: value for key, value in STUDY.items() if value is not None}
    assert not_refused(tmp_path, REFUSED, **base, fixed={}) == []
    assert not_refused(tmp_path, REFUSED_CELL, **CELL) == []


def test_the_cell_takes_it_at_its_own_points_and_a_cheaper_mesh_has_others(tmp_path):
    study = load_study(changed_study(tmp_path, {}, **CELL))
    assert isinstance(study.model, WithFields)
    points = Biofilm(mesh="coarse").field_support("E").points
    np.testing.assert_array_equal(fields_of(study.model)[0].support.points, points)
    cheaper = {"fidelities": ["coarse"], "model.biofilm.mesh": "default", "design": {"active": {"runs": 100}}}
    assert f"expected the {len(points)} points" in message_of(changed_study(tmp_path, cheaper, **CELL))


def test_a_refusal_ends_with_code_2_and_writes_nothing(tmp_path, capsys):
    changed_study(tmp_path, {"inputs.E.field.modes": 100}, **{**STUDY, "fixed": {}})
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path)])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [one.name for one in tmp_path.iterdir()] == ["study.yaml"]
