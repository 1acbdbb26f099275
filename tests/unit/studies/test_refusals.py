"""What study.yaml may not say: tables of changes to a sound study, each with words of the line that refuses it."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from verification.validation.command_faults import FAULTS

import strandline
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy
from strandline.likelihood import set_aside
from strandline.models.biofilm.model import Biofilm
from strandline.models.command.model import CommandModel
from strandline.models.protocol import declared_failure_kinds
from strandline.models.python import PythonModel
from strandline.models.umbridge.model import UMBridgeModel
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.executors.slurm_array import ENDINGS
from strandline.runs.failures import COMMON_KINDS
from strandline.studies import load_study
from strandline.studies.parse import parse_study
from strandline.testing.models import TwoLoads
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, beam, write_study

UM = {"unit": "um"}
BIOFILM = {
    "model": {"biofilm": {"mesh": "coarse"}},
    "fixed": {"V_in": 100},
    "inputs": {"E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"}, "nu": {"prior": {"uniform": [-0.8, 0.5]}}},
    "observation": {"synthetic": {"E": 400, "nu": 0.3, "V_in": 100}},
}
UNDECLARED = {"model": {"python": {"function": "strandline.testing.studies:undeclared_beam"}}}


def message_of(folder):
    """Return the one line with which the study is refused; empty if it is not."""
    before, message = sorted(folder.iterdir()), ""
    try:
        load_study(folder)
    except InvalidInput as error:
        message = str(error)
    assert sorted(folder.iterdir()) == before
    assert "\n" not in message
    return message


def changed_study(folder, changes, **base):
    """Write the beam's study with values at places such as `noise.sd`; GONE removes one."""
    content = json.loads(json.dumps({**BEAM_STUDY, **base}))
    for place, value in changes.items():
        *way, last = place.split(".")
        inside = content
        for key in way:
            inside = inside.setdefault(key, {})
        inside[last] = value
        if value == "GONE":
            del inside[last]
    (folder / "study.yaml").write_text(json.dumps(content))
    return folder


def not_refused(folder, table, within="", **base):
    """Return the rows `changes | words | …` whose study is not refused with all of their words.

    Changes apart by semicolons are made one by one. Without words, the place of each must be named.
    """
    wrong = []
    for row in filter(None, map(str.strip, table.splitlines())):
        given, *words = row.split(" | ")
        for one in given.split("; "):
            changes = {within + key: value for key, value in yaml.safe_load(f"{{{one}}}").items()}
            message = message_of(changed_study(folder, changes, **base))
            if not message or any(word not in message for word in words or [place_of(changes)]):
                wrong.append(f"{one} {words}\n  {message}")
    return wrong


def place_of(changes):
    *_, (key, value) = changes.items()
    return f"{key}.{place_of(value)}" if isinstance(value, dict) and value else f"{key}"


TOP = """
desing: {sobol: {runs: 64}}, design: GONE | unknown key: got desing | Did you mean design?
colour: blue | unknown key: got colour | inputs | Remove colour.
seed: one, noise: {sd: -1} | study.yaml: noise.sd | (1 more to correct: seed.)
name: a/b; seed: -1; seed: 4294967296; version: 2; version: '1'; version: 1.0; version: true; version: GONE
reuse: [../nothing] | reuse: got ../nothing | folder of another study
sensitivities: true | sensitivities: got true, but this model offers none
failures.kinds: {timeout: recover}; failures.kinds: {timeout: {retry: 0}} | continue, abort, or {retry: N}
failures.kinds: {timeout: {retry: 1, wait: 2}} | continue, abort, or {retry: N}
failures.stop: always | never, or {share: 0.95, after: 20}
failures.stop: {share: 0} | greater than 0
"""
MODEL = """
model: {biofilm: {}, python: {}} | model: got | exactly one entry
model: {biofilmm: {}} | model: got biofilmm | biofilm, command, python, umbridge | mean biofilm?
model: {biofilm: {mush: 1}} | model.biofilm: unknown option: got mush | Did you mean mesh?
model: {biofilm: {mesh: huge}} | model.biofilm: mesh | got huge | coarse, default, fine
model: {python: {}} | model.python.function: got nothing | Add `function: …`
model.python.function: nowhere:f | got nowhere:f | PYTHONPATH
model.python.function: beam | got beam | module:name
model.python.function: strandline.testing.studies:bean | a callable bean
model: {python: {function: strandline.testing.studies:two_loads, sensitivities: true}} | Move the key to the top level
"""
INPUTS = r"""
inputs.E.prior: {uniform: [1, true]} | inputs.E.prior.uniform.1: got True | not a truth value
inputs.E.prior: {uniform: [1, two]}; inputs.E.prior: {uniform: 3}; model.python.function: 3
inputs.E.prior: {} | inputs.E.prior: got {} | at least one entry
inputs.E: [100, 800] | inputs.E: got [100, 800] | keys with values
inputs.E.unit: GONE | unit of inputs.E: got nothing | unit: Pa
inputs.E.unit: kPa | got kPa; expected Pa
inputs.E.prior: {uniform: [-300, 560]} | inputs.E | got -300 | (0, inf] Pa | Young's modulus
inputs.E.prior: {uniform: [300]} | inputs.E.prior.uniform | 2 numbers
inputs.E.prior: {uniform: [560, 300]} | inputs.E | the lower one first
inputs.E.prior: {normal: [400, 30]} | inputs.E: design box | Give E a box
inputs.E.prior: {uniform: [300, 700]}, inputs.E.box: [300, 560] | its design box | support [300, 700] | 35% of its mass
inputs.E.prior: {uniform: [600, 700]}, inputs.E.box: [300, 560] | inputs.E: truncated prior keeps no mass
inputs.E.prior: {lognormal: [8, 0.3]}, inputs.E.box: [300, 2000] | E reaches beyond its design box | at most half
inputs.E.prior: {lognormal: [1000, 1]}, inputs.E.box: [300, 560] | prior.lognormal | got 1000.0 | mean of log x
inputs.E.box: [300, 500] | prior of E | box [300, 500] | Widen the box
inputs.Tilt: {prior: {uniform: [0, 1]}} | inputs.Tilt: the model has no such input | Did you mean tilt?
inputs.tilt.nuisance: 1 | inputs.tilt.nuisance | true or false
inputs.E.nuisance: true, inputs.tilt.nuisance: true | got none: E, tilt are all nuisance; expected at least one
inputs.E.label: '  '; inputs.E.label: xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx | a symbol of 1 to 30 characters on one line
inputs.a/b: {prior: {uniform: [0, 1]}} | inputs.a/b | without /
inputs.draw: {prior: {uniform: [0, 1]}} | inputs.draw | none of the names that the results use
fixed.lode: 2 | fixed.lode: the model has no such input | Did you mean load?
fixed.E: 400 | E is both fixed and an input: got 400.0
fixed: {} | no value for load, which the model takes | Add e.g. `fixed: {load: …}`
fixed.load: {value: 1, unit: kN/m} | unit of fixed.load: got kN/m; expected N/m
inputs.E: GONE, fixed.E: -1 | fixed.E: got -1.0 | Young's modulus
"""
OF_ANY_MODEL = r"""
inputs.E.prior: {uniform: [-1.0e+308, 1.0e+308]} | uniform | at most 1e+100
inputs.E.prior: {uniform: [400, 400.00000000000006]} | uniform | differ by at least
inputs.E.unit: '$\frac{$' | inputs.E.unit: got $\frac{$ | without $
inputs.weight: {prior: {uniform: [0, 1]}} | inputs.weight | the names that the results use themselves
"""
OBSERVATION = """
observation: {} | one of `file` with its `unit`, `image`, `stack` and `synthetic`
observation: {file: a.csv} | observation: got {'file': 'a.csv'} | `unit: mm`
observation: {file: a.csv, unit: inch} | observation.unit: got inch | 'mm', 'um', 'µm' or 'm'
observation: {file: none.csv, unit: mm} | observation none.csv is missing
observation: {synthetic: {E: 400}} | observation.synthetic: got E: 400 | tilt, load too
observation.synthetic.E: -4; observation.synthetic.nu: 0; observation.noise: {sd: 0}; observation.noise: 0.001
observation.sort: x | only with a `file`
observation.noise: {sd: 1, seed: -1}
observation: {file: a.csv, unit: mm, noise: {sd: 0.001}} | observation | with `synthetic` only
discrepancy: [] | discrepancy: got [] | keys with values
discrepancy: {curents: {}} | discrepancy: got curents | Did you mean currents?
discrepancy: {currents: {}} | discrepancy.currents.width: got nothing
discrepancy: {currents: {width: -1}} | discrepancy.currents | got -1 | above 0
discrepancy: {currents: {width: 1.0e+300}} | width | from 1e-09 to 1e+09
discrepancy: {currents: {width: wide}} | discrepancy.currents.width: got wide; expected a number
discrepancy: {tracked_points: {lines: 3}} | unknown option: got lines; expected no options
discrepancy: {measurement_lines: {reach: 0}} | reach of the measurement lines: got 0.0
discrepancy: {measurement_lines: {lines: 1000000000}} | 1000000000 lines | 1 to 100000
discrepancy: [{closest_point: {}}, {closest_point: {}}] | each measure once
"""
NOISE = """
noise: {varance: 1} | noise.varance | Did you mean variance?
noise: GONE | noise: got | this key
noise: {sd: 1, variance: 1} | noise: got | either `variance` or `sd`
noise.sd: 0; noise: {unit: um, sd: -1} | noise.sd: got | a number greater than 0
noise.sd: .nan | noise.sd | a finite number
noise.sd: 1.0e+200; noise.sd: 1.0e-200 | noise: got | from 1e-30 to 1e+30
noise: {variance: 1, unit: um} | a `variance` is already in the unit of d²
noise: {sd: 1, length: 5} | `length` with the `sd` of the observed points
noise: {sd: 1, unknown: {shift: 5}} | `unknown` with the `sd` of the
noise: {sd: unkown, unit: um} | noise.sd: got unkown | a range [low, high], `unknown`, `column` or `image`
noise: {sd: 1, unit: um, length: -5}; noise: {sd: 1, unit: inch}; noise: {sd: 1, unit: um, unknown: {shift: -5}}
noise: {sd: 1, unit: um, unknown: {rotation: 50}}; noise: {sd: 1, unit: um, unknown: {scale: 5}}
noise: {sd: image} | noise: got | `sd: image` with the `unit` of the observed points
noise: {sd: image, unit: um} | comes from a picture
noise: {sd: column, length: 20, unit: um} | a table with the standard deviation
noise: {sd: unknown, unit: um}; noise: {sd: 3, model_error: true, unit: um} | normal_offset and a surrogate of the field
noise: {sd: 3, spread: [tilt], unit: um} | several, whose inputs may differ
noise: {sd: 3, spread: [E, nu], unit: um} | some of E, tilt
noise: {sd: [5, 1], unit: um}; noise: {sd: 3, length: [0, 1], unit: um} | 0 < low < high
"""
METHOD = """
design.sobol.runs: many; design.sobol.runs: 64.5; design.sobol.runs: 0; design.sobol.runs: true
design.sobol.runs: 3 | design.sobol.runs: got 3 | at least 4 runs for 2 input(s)
design.sobol.runs: '80' | design.sobol.runs: got 80 | without quotes
design.sobol.runs: 1.0e+12 | design.sobol.runs | equal to 1000000
design.refine: {runs: 5, temperature: 2} | design.refine: temperature | got 2.0
design.refine: {runs: 201}, sampler: {smc: {particles: 200}} | design.refine.runs: got 201; expected at most 200
design.active: {runs: 50}; design: {} | either `sobol
design: {active: {runs: 50}, refine: {runs: 5}} | an active design refines itself
design: {active: {runs: 60}}, surrogate: {log_likelihood: {}} | got an active design with a surrogate of the log-lik
surrogate: {log_likelihood: {}, field: {}} | one of `log_likelihood`, `field`
surrogate: {log_likelihood: {kernel: mattern32}} | got mattern32 | Did you mean matern32?
design: {active: {runs: 50, criterion: entropy}}; design: {active: {runs: 20}}; design: {active: {runs: 50, check: 5}}
design: {active: {runs: 50, explore: 0.9}}; design: {active: {runs: 50, rounds: 2}}
design: {active: {runs: 60, batch: 100}} | design.active.batch: got 100 | at most 52
sampler.smc.particles: 3; sampler.smc.zeta: 1; sampler.smc.rejuvenation_steps: 0; sampler.cut.values: 1
executor: {local: {cores: 2}} | executor.local.cores | Did you mean workers?
executor: {local: {workers: 0}}; executor: {local: {timeout: 1.0e+9}}; executor: {slurm_array: {cpus: -1}}
executor.dask: {} | one of in_process, local, dask, slurm_array
executor: {slurm: {}} | unknown key: got executor.slurm
executor: {dask: {jobs: {cores: 4, memory: 8GB, walltime: '01:00:00', project: x}}}
executor: {dask: {cluster: slurm, jobs: {cores: 4, memory: 8GB, walltime: 3600}}}
executor: {dask: {cluster: slurm}} | Add cores
executor: {dask: {cluster: slurm, timeout: 3600, jobs: {cores: 4, memory: 8GB, walltime: '01:00:00'}}} | at most 3540 s
executor: {slurm_array: {timeout: 241, walltime: '00:05:00'}} | at most 240 s
executor: {slurm_array: {walltime: '5'}} | in quotes
"""


@pytest.mark.parametrize("table", [TOP, MODEL, INPUTS, OF_ANY_MODEL, OBSERVATION, NOISE, METHOD], ids=range(7))
def test_each_mistake_is_refused_with_its_place(tmp_path, table):
    assert not_refused(tmp_path, table, **(UNDECLARED if table is OF_ANY_MODEL else {})) == []


CHEAPER = {"model": {"python": {"function": "tests.study.studies.exact:softer"}}, "cost": 0.2}


def test_cheaper_models(tmp_path):
    for models, words in (
        ("coarse", "fidelities: got coarse; expected a list with one cheaper model"),
        ([{"cost": 0.1}], "fidelities: the cheaper model: got the model itself"),
        ([{"model": 3}], "fidelities.model: got 3"),
        (["coarse"], "only a model with meshes has names for them"),
        ([{**CHEAPER, "cost": 2}], "above 0 and below 1"),
        ([{**CHEAPER, "cost": "low"}], "fidelities.cost: got 'low'"),
        ([{**CHEAPER, "function": "a:b"}], "only `cost` beside it"),
        ([CHEAPER, CHEAPER], "exactly one entry"),
    ):
        assert words in message_of(write_study(tmp_path, design={"active": {"runs": 60}}, fidelities=models))
    assert "a cheaper model without an active design" in message_of(write_study(tmp_path, fidelities=[CHEAPER]))


BOTH = [{"condition": name, "file": f"{name}.csv", "unit": "um"} for name in ("heavy", "light")]
OWN = {"sd": 3, "length": 15, **UM, "unknown": {"shift": 8, "rotation": 0.5}}
SHARED = {**OWN, "unknown": {**OWN["unknown"], "shared": True}}
CONDITIONS = """
observation: [] | observation: got []; expected at least one entry
observation: [{file: light.csv, unit: mm}] | observation.0.condition: got nothing | Add it.
observation: [{file: heavy.csv, unit: um, condition: a/b}] | observation.0.condition: got a/b | a short name without
observation: [{condition: light, file: light.csv}] | observation.0 | `unit: mm`
observation: [{condition: light, synthetic: {E: 400}}] | observation.0 | observes all of them
observation: [{condition: light, file: light.csv, unit: um, condtion: a}] | got observation.0.condtion | mean condition?
observation: [{condition: haevy, file: heavy.csv, unit: um}] | got haevy; expected some of light, heavy | mean heavy?
observation: {file: light.csv, unit: um} | the condition is not named | Give a list
observation: {condition: light, file: light.csv, unit: um} | unknown key: got observation.condition
"""


def test_conditions(tmp_path):
    for name, interface in TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces.items():
        np.savetxt(tmp_path / f"{name}.csv", interface.points * 1000, delimiter=",")
    assert not_refused(tmp_path, CONDITIONS, **TWO_LOADS_STUDY) == []
    assert "each condition once" in message_of(write_study(tmp_path, **TWO_LOADS_STUDY | {"observation": BOTH[:1] * 2}))
    assert "without a name: got heavy; expected one mapping" in message_of(write_study(tmp_path, observation=BOTH))
    shift = {**SHARED, "unknown": {**SHARED["unknown"], "shift": 9}}
    by_field = {**TWO_LOADS_STUDY, "discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
    for noise, words in (
        ({**OWN, "conditions": {"light": SHARED}}, "light: got condition heavy with its own errors"),
        ({**SHARED, "conditions": {"light": {"variance": 1}}}, "got condition light with its own errors"),
        ({**SHARED, "conditions": {"light": shift}}, "got condition heavy with another shift, rotation or scale"),
        ({**OWN, "conditions": {"light": {"sd": "unknown", **UM}}}, "for every condition, or for none."),
        ({**SHARED, "model_error": True}, "a known sd and length, no model_error and no spread"),
    ):
        assert words in message_of(write_study(tmp_path, **by_field | {"noise": noise}))


EDGE = "x,y,sd\n" + "".join(f"{0.0625 * k},{0.12 * (k / 16) ** 2},{0.001 * (1 + k % 3)}\n" for k in range(17))
TABLE = {
    "observation": {"file": "edge.csv", "unit": "mm", "columns": [1, 2], "sd": "sd"},
    "noise": {"sd": "column", "length": 20, **UM},
}
COLUMNS = """
observation.sd: GONE | observation: {file: …, sd: COLUMN}
noise: {sd: 3, unit: um} | the noise does not take it
observation.sd: s | no column s
observation.sd: 0 | a column, by name or by number
observation.sd: x | standard deviation of point 1
noise.length: unknown | State the length, or write `sd: unknown`.
noise.model_error: true | Remove model_error and spread.
noise: {sd: column} | `unit`
observation.sd: GONE, observation.columns: [x, z], noise: {sd: 1} | edge.csv has no column z: got x, y, sd
observation.sd: GONE, observation.sort: z, noise: {sd: 1} | observation.sort: got z
observation.sd: GONE, noise: {sd: 3, length: 1.0e+7, unit: um} | correlation length
"""


def test_columns_of_a_table(tmp_path):
    (tmp_path / "edge.csv").write_text(EDGE)
    assert not_refused(tmp_path, COLUMNS, **TABLE) == []


def test_texts_that_are_no_yaml_and_no_template(tmp_path):
    for text, words in (
        (b"version: 1\ninputs:\n  E: {prior: 1}\n  E: {prior: 2}\n", "line 4: a key for the second time: got E"),
        (b"version: 1\nname: 2020-13-45\n", "month must be in 1..12"),
        (b"- version\n", "holds no keys: got ['version']"),
        (b"", "holds no keys: got nothing"),
        (b"version: 1\nname: \xff\xfe\n", "study.yaml cannot be read"),
    ):
        (tmp_path / "study.yaml").write_bytes(text)
        assert words in message_of(tmp_path)
    # A template of 3000 parentheses is no text to be compiled.
    command = {"templates": {"a.j2": "a"}, "command": ["true"], "result": {"file": "a.csv", "unit": "mm"}}
    (write_study(tmp_path, model={"command": command}) / "a.j2").write_text("{{ " + "(" * 3000 + "E" + ")" * 3000)
    assert "the template a.j2 cannot be compiled" in message_of(tmp_path)


def test_files_that_hold_no_interface(tmp_path):
    for name, content, words in (
        ("o.csv", b"0,0\n1,one\n", "no point in line 2: got 1 one"),
        ("o.csv", b"0,0\n1,1\n1,0\n0,1\n", "crosses itself: segments 0 and 2: got (0.5, 0.5) mm"),
        ("o.csv", b"0,0\n500,60\n1000,100\n", "o.csv, read in mm: got"),
        ("o.csv", b"0,0\n5e-4,6e-5\n1e-3,1e-4\n", "times the model"),
        ("o.png", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "o.png is a picture: got a PNG image;"),
        ("o.csv", b"\xff\xd8\xff\xe0" + bytes(range(256)), "o.csv is a picture: got a JPEG image;"),
        ("o.csv", b"MM\x00*" + bytes(range(256)), "o.csv is a picture: got a TIFF image;"),
    ):
        (tmp_path / name).write_bytes(content)
        study = write_study(tmp_path, **BIOFILM | {"observation": {"file": name, "unit": "mm"}})
        assert words in message_of(study)


def test_places_that_are_no_study_folder(tmp_path):
    (tmp_path / "study" / "study.yaml").mkdir(parents=True)
    for place in (tmp_path / "nowhere", tmp_path, tmp_path / "study"):
        with pytest.raises(InvalidStudy, match=r"not a study folder: got .*strandline init"):
            parse_study(place)
    with pytest.raises(InvalidStudy, match=r"Give the folder that it is in, `.*beam`, not a file"):
        parse_study(write_study(tmp_path / "beam") / "study.yaml")


SOURCES = Path(strandline.__file__).parent
PLACES = {"ForwardModelError": 0, "_failure": 0, "InvalidResult": 0, "_lost": 1, "_ended": 2}
"""Where calls that make a failure have its kind."""
NO_POLICY = {"stopped", "lost"}
"""Of a run that no campaign asked for, and of one that was given up: no policy is asked about these."""


def raised_in(folder):
    return {kind for path in (SOURCES / folder).rglob("*.py") for kind in kinds_in(ast.parse(path.read_text("utf-8")))}


def kinds_in(tree):
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        given = [keyword.value for keyword in call.keywords if keyword.arg in ("kind", "failure_kind")]
        if name in PLACES:
            given += call.args[PLACES[name] : PLACES[name] + 1]
        yield from (node.value for node in given if isinstance(node, ast.Constant) and isinstance(node.value, str))


def test_what_the_code_raises_is_declared():
    for model, folder in ((Biofilm, "biofilm"), (CommandModel, "command"), (UMBridgeModel, "umbridge")):
        assert raised_in(f"models/{folder}") - {*COMMON_KINDS} == {*model.failure_kinds} - raised_in("readers")
        assert len({*model.failure_kinds, *COMMON_KINDS}) == len(model.failure_kinds) + len(COMMON_KINDS)
    assert raised_in("runs") | {kind for _, kind in ENDINGS.values()} | set_aside.KINDS == {*COMMON_KINDS, *NO_POLICY}
    assert {fault.kind for fault in FAULTS if fault.kind} <= {*CommandModel.failure_kinds, *COMMON_KINDS}


UNKNOWN = """
kinds: {invalid: abort, timout: abort} | kinds: got timout; expected one of failed, timeout, killed | mean timeout?
kinds: {limit-point: abort} | failures.kinds: got limit-point; expected one of failed, timeout | limit_point?
kinds: {exit_code: abort} | failures.kinds: got exit_code; expected one of failed, timeout | Choose
"""


def test_a_word_that_the_model_cannot_end_with_is_refused(tmp_path):
    assert not_refused(tmp_path, UNKNOWN, "failures.", **BIOFILM) == []
    known = dict.fromkeys(("failed", "killed", "limit_point", "out_of_memory", "non_finite"), "abort")
    study = load_study(write_study(tmp_path, **BIOFILM, failures={"kinds": known}))
    assert study.settings.failures.actions == known


def test_a_function_may_declare_its_kinds(tmp_path, monkeypatch):
    function = "strandline.testing.studies:beam"
    assert declared_failure_kinds(PythonModel(function)) is None
    monkeypatch.setattr(beam, "failure_kinds", ("large_deflection",), raising=False)
    assert declared_failure_kinds(PythonModel(function)) == ("large_deflection",)
    assert message_of(changed_study(tmp_path, {"failures.kinds.large_deflection": "abort"})) == ""
    wrong = message_of(changed_study(tmp_path, {"failures.kinds.large_deflexion": "abort"}))
    assert "Did you mean large_deflection" in wrong


def test_check_warns_of_a_word_where_kinds_are_not_known(tmp_path, capsys):
    folder = write_study(tmp_path / "study", failures={"kinds": {"timeout": {"retry": 1}, "large_deflexion": "abort"}})

    def warnings():
        main(["check", str(folder)])
        return [line.strip() for line in capsys.readouterr().out.splitlines() if "failures.kinds" in line]

    (line,) = warnings()
    assert line.startswith("warning: failures.kinds.large_deflexion: no run has ended with it yet")
    key = load_study(folder).runs.design_keys[0]
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.started(RunRequest(key, {"E": 1.0}))
        ledger.finished(RunRecord(key, {"E": 1.0}, "failed", failure_kind="large_deflexion"))
    assert warnings() == []
