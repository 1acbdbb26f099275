"""What study.yaml may not say: tables of changes to a sound study, each with words of the line that refuses it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import strandline
from strandline.cli import main
from strandline.foundations import InvalidInput
from strandline.models.biofilm.model import Biofilm
from strandline.models.command.model import CommandModel
from strandline.models.umbridge.model import UMBridgeModel
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.failures import COMMON_KINDS
from strandline.studies import load_study
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
seed: one, noise: {sd: -1} | study.yaml: noise.sd | (1 more to correct: seed.)
name: a/b; seed: -1; seed: 4294967296; version: 2; version: '1'; version: 1.0; version: true; version: GONE
reuse: [../nothing] | reuse: got ../nothing | folder of another study
sensitivities: true | sensitivities of the model: got this model offers none
failures.kinds: {timeout: recover}; failures.kinds: {timeout: {retry: 0}} | continue, abort, or {retry: N}
failures.stop: nevr | failures.stop: got nevr | never
failures.stop: {share: 2}; failures.stop: {after: 0}
"""
MODEL = """
model: {biofilm: {}, python: {}} | model: got | exactly one entry
model: {biofilmm: {}} | model: got biofilmm | biofilm, command, python, umbridge | mean biofilm?
model.python.function: nowhere:f | got nowhere:f | PYTHONPATH
model.python.function: strandline.testing.studies:bean | a name defined in strandline.testing.studies. Correct bean.
model: {python: {function: strandline.testing.studies:two_loads, sensitivities: true}} | Move the key to the top level
"""
INPUTS = r"""
inputs.E.prior: {uniform: [1, true]} | inputs.E.prior.uniform.1: got True | not a truth value
inputs.E.unit: GONE | unit of inputs.E: got nothing | unit: Pa
inputs.E.unit: kPa | got kPa; expected Pa
inputs.E.prior: {uniform: [-300, 560]} | inputs.E | got -300 | (0, inf] Pa | Young's modulus
inputs.E.prior: {uniform: [300]} | inputs.E.prior.uniform | 2 numbers
inputs.E.prior: {uniform: [560, 300]} | inputs.E | the lower one first
inputs.E.prior: {normal: [400, 30]} | inputs.E: design box | Give E a box
inputs.E.prior: {uniform: [300, 700]}, inputs.E.box: [300, 560] | its design box | support [300, 700] | 35% of its mass
inputs.E.prior: {uniform: [600, 700]}, inputs.E.box: [300, 560] | inputs.E: truncated prior keeps no mass
inputs.E.prior: {lognormal: [8, 0.3]}, inputs.E.box: [300, 2000] | E reaches beyond its design box | at most half
inputs.Tilt: {prior: {uniform: [0, 1]}} | inputs.Tilt: the model has no such input | Did you mean tilt?
inputs.E.nuisance: true, inputs.tilt.nuisance: true | got none: E, tilt are all nuisance; expected at least one
inputs.E.label: '  '; inputs.E.label: xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx | a symbol of 1 to 30 characters on one line
inputs.a/b: {prior: {uniform: [0, 1]}} | inputs.a/b | without /
fixed.E: 400 | E is both fixed and an input: got 400.0
fixed: {} | no value for load, which the model takes | Add e.g. `fixed: {load: …}`
fixed.load: {value: 1, unit: kN/m} | unit of fixed.load: got kN/m; expected N/m
fixed.load: [1] | fixed.load: got [1] | a number or keys with values
inputs.E: GONE, fixed.E: -1 | fixed.E: got -1.0 | Young's modulus
"""
OF_ANY_MODEL = r"""
inputs.E.prior: {uniform: [-1.0e+308, 1.0e+308]} | uniform | at most 1e+100
inputs.E.unit: '$\frac{$' | inputs.E.unit: got $\frac{$ | without $
inputs.weight: {prior: {uniform: [0, 1]}} | inputs.weight | the names that the results use themselves
"""
OBSERVATION = """
observation: {} | one of `file` with its `unit`, `image`, `stack` and `synthetic`
observation: {file: none.csv, unit: mm} | observation none.csv is missing
observation: {synthetic: {E: 400}} | observation.synthetic: got E: 400 | tilt, load too
observation.synthetic.E: -4; observation.synthetic.nu: 0; observation.noise: {sd: 0}; observation.noise: 0.001
observation: {file: none.csv, unit: cm} | got cm; expected one of mm, um, µm, m. Correct observation.unit.
observation: {file: none.csv, unit: MM} | Did you mean mm?
observation.sort: x | only with a `file`
observation: {file: a.csv, unit: mm, noise: {sd: 0.001}} | observation | with `synthetic` only
discrepancy: {curents: {}} | discrepancy: got curents | Did you mean currents?
discrepancy: {currents: {width: 1.0e+300}} | width | from 1e-09 to 1e+09
discrepancy: [{closest_point: {}}, {closest_point: {}}] | each measure once
"""
NOISE = """
noise: GONE | noise: got | this key
noise: {sd: 1, variance: 1} | noise: got | either `variance` or `sd`
noise.sd: 0; noise: {unit: um, sd: -1} | noise.sd: got | a number greater than 0
noise.sd: .nan | noise.sd | a finite number
noise.sd: many | a number, or one of unknown, column, image, or a list of two numbers, [low, high]
noise.sd: 1.0e+200; noise.sd: 1.0e-200 | noise: got | from 1e-30 to 1e+30
noise: {variance: 1, unit: um} | a `variance` is already in the unit of d²
noise: {sd: 1, length: 5} | `length` with the `sd` of the observed points
noise: {sd: 1, unit: um, length: -5}; noise: {sd: 1, unit: inch}; noise: {sd: 1, unit: um, unknown: {shift: -5}}
noise: {sd: 1, unit: um, unknown: {rotation: 50}}; noise: {sd: 1, unit: um, unknown: {scale: 5}}
noise: {sd: 2}, discrepancy: {normal_offset: {}} | noise.sd, of an observed point: got 2 without a unit | unit: um
noise: {sd: image, unit: um} | comes from a picture
noise: {sd: column, length: 20, unit: um} | a table with the standard deviation
noise: {sd: unknown, unit: um}; noise: {sd: 3, model_error: true, unit: um} | normal_offset and a surrogate of the field
noise: {sd: 3, spread: [tilt], unit: um} | several, whose inputs may differ
noise: {sd: [5, 0], unit: um}; noise: {sd: 3, length: [0, 1], unit: um} | 0 < low < high
"""
METHOD = """
design.sobol.runs: many; design.sobol.runs: 64.5; design.sobol.runs: 0; design.sobol.runs: true
design.sobol.runs: 3 | design.sobol.runs: got 3 | at least 4 runs for 2 input(s)
surrogate: {log_likelihood: {kernel: matern23}} | surrogate.log_likelihood: name of the kernel: got matern23
design.sobol.runs: 1.0e+12 | design.sobol.runs | equal to 1000000
design.refine: {runs: 201}, sampler: {smc: {particles: 200}} | design.refine.runs: got 201; expected at most 200
design.active: {runs: 50}; design: {} | either `sobol
design: {active: {runs: 50}, refine: {runs: 5}} | an active design refines itself
design: {active: {runs: 60}}, surrogate: {log_likelihood: {}} | surrogate: got | `field: {}` for an active design
design: {active: {runs: 50, criterion: entropy}}; design: {active: {runs: 13}}; design: {active: {runs: 50, check: 5}}
design: {active: {runs: 50, explore: 0.9}}; design: {active: {runs: 50, rounds: 2}}
sampler.smc.particles: 3; sampler.smc.zeta: 1; sampler.smc.rejuvenation_steps: 0; sampler.cut.values: 1
executor: {local: {workers: 0}}; executor: {local: {timeout: 1.0e+9}}; executor: {slurm_array: {cpus: -1}}
executor: {locl: {}} | executor: got locl | mean local?
executor.dask: {} | one of in_process, local, dask, slurm_array
executor: {dask: {cluster: slurm, timeout: 3600, jobs: {cores: 4, memory: 8GB, walltime: '01:00:00'}}} | at most 3540 s
executor: {slurm_array: {timeout: 241, walltime: '00:05:00'}} | at most 240 s
executor: {slurm_array: {walltime: 14400}} | a time in quotes
"""


@pytest.mark.parametrize("table", [TOP, MODEL, INPUTS, OF_ANY_MODEL, OBSERVATION, NOISE, METHOD], ids=range(7))
def test_each_mistake_is_refused_with_its_place(tmp_path, table):
    assert not_refused(tmp_path, table, **(UNDECLARED if table is OF_ANY_MODEL else {})) == []


CHEAPER = {"model": {"python": {"function": "tests.study.studies.exact:softer"}}, "cost": 0.2}


def test_cheaper_models(tmp_path):
    for models, words in (
        ("coarse", "fidelities: got coarse; expected a list with one cheaper model, `[coarse]`"),
        ([{"cost": 0.1}], "fidelities: the cheaper model: got the model itself"),
        (["coarse"], "only a model with meshes has names for them"),
        ([{**CHEAPER, "cost": 2}], "above 0 and below 1"),
        ([CHEAPER, CHEAPER], "exactly one entry"),
    ):
        assert words in message_of(write_study(tmp_path, design={"active": {"runs": 60}}, fidelities=models))
    assert "`active: {runs: …}` beside `fidelities`" in message_of(write_study(tmp_path, fidelities=[CHEAPER]))


BOTH = [{"condition": name, "file": f"{name}.csv", "unit": "um"} for name in ("heavy", "light")]
OWN = {"sd": 3, "length": 15, **UM, "unknown": {"shift": 8, "rotation": 0.5}}
SHARED = {**OWN, "unknown": {**OWN["unknown"], "shared": True}}
CONDITIONS = """
observation: [{file: light.csv, unit: mm}] | observation.0.condition: got nothing | Add it.
observation: [{file: heavy.csv, unit: um, condition: a/b}] | observation.0.condition: got a/b | a short name without
observation: [{condition: light, synthetic: {E: 400}}] | observation.0 | observes all of them
observation: [{condition: haevy, file: heavy.csv, unit: um}] | got haevy; expected some of light, heavy | mean heavy?
"""


def test_conditions(tmp_path):
    for name, interface in TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces.items():
        np.savetxt(tmp_path / f"{name}.csv", interface.points * 1000, delimiter=",")
    assert not_refused(tmp_path, CONDITIONS, **TWO_LOADS_STUDY) == []
    assert "each condition once" in message_of(write_study(tmp_path, **TWO_LOADS_STUDY | {"observation": BOTH[:1] * 2}))
    words = "observation: the model has no such condition: got heavy; expected no name"
    assert words in message_of(write_study(tmp_path, observation=BOTH))
    shift = {**SHARED, "unknown": {**SHARED["unknown"], "shift": 9}}
    by_field = {**TWO_LOADS_STUDY, "discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
    for noise, words in (
        ({**OWN, "conditions": {"light": SHARED}}, "light: got condition heavy with its own errors"),
        ({**SHARED, "conditions": {"light": shift}}, "got condition heavy with another shift, rotation or scale"),
        ({**OWN, "conditions": {"light": {"sd": "unknown", **UM}}}, "for every condition"),
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
observation.sd: x | standard deviation in line 2
noise.length: unknown | State the length, or write `sd: unknown`.
noise.model_error: true | Remove model_error and spread.
observation.sd: GONE, observation.columns: [x, z], noise: {sd: 1} | edge.csv has no column z: got x, y, sd
"""


def test_columns_of_a_table(tmp_path):
    (tmp_path / "edge.csv").write_text(EDGE)
    assert not_refused(tmp_path, COLUMNS, **TABLE) == []


def test_a_template_that_is_no_text_to_be_compiled(tmp_path):
    command = {"templates": {"a.j2": "a"}, "command": ["true"], "result": {"file": "a.csv", "unit": "mm"}}
    (write_study(tmp_path, model={"command": command}) / "a.j2").write_text("{{ " + "(" * 3000 + "E" + ")" * 3000)
    assert "the template a.j2 cannot be compiled" in message_of(tmp_path)


def test_files_that_hold_no_interface(tmp_path):
    for name, content, words in (
        ("o.csv", b"0,0\n1,one\n", "no point in line 2: got 1 one"),
        ("o.csv", b"0,0\n1,1\n1,0\n0,1\n", "crosses itself: segments 1 and 3: got (0.5, 0.5) mm"),
        ("o.png", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "o.png is a picture: got a PNG image;"),
        ("o.csv", b"MM\x00*" + bytes(range(256)), "o.csv is a picture: got a TIFF image;"),
    ):
        (tmp_path / name).write_bytes(content)
        study = write_study(tmp_path, **BIOFILM | {"observation": {"file": name, "unit": "mm"}})
        assert words in message_of(study)


def test_what_models_raise_is_declared():
    kind = re.compile(r'(?:ForwardModelError|_failure)\(\s*"(\w+)"')
    for model, folder in ((Biofilm, "biofilm"), (CommandModel, "command"), (UMBridgeModel, "umbridge")):
        sources = (Path(strandline.__file__).parent / "models" / folder).rglob("*.py")
        raised = {found for path in sources for found in kind.findall(path.read_text("utf-8"))}
        assert set() < raised <= {*model.failure_kinds, *COMMON_KINDS}


UNKNOWN = """
kinds: {invalid: abort, timout: abort} | kinds: got timout; expected one of failed, timeout, killed | mean timeout?
kinds: {exit_code: abort} | failures.kinds: got exit_code; expected one of failed, timeout | Choose
"""


def test_a_word_that_the_model_cannot_end_with_is_refused(tmp_path):
    assert not_refused(tmp_path, UNKNOWN, "failures.", **BIOFILM) == []
    known = dict.fromkeys(("failed", "killed", "limit_point", "out_of_memory", "non_finite"), "abort")
    study = load_study(write_study(tmp_path, **BIOFILM, failures={"kinds": known}))
    assert study.settings.failures.actions == known


def test_a_function_may_declare_its_kinds(tmp_path, monkeypatch):
    monkeypatch.setattr(beam, "failure_kinds", ("large_deflection",), raising=False)
    assert message_of(changed_study(tmp_path, {"failures.kinds.large_deflection": "abort"})) == ""
    assert "mean large_deflection" in message_of(changed_study(tmp_path, {"failures.kinds.large_deflexion": "abort"}))


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


def test_keys_inside_what_is_wrong_are_not_counted_as_well(tmp_path):
    assert message_of(changed_study(tmp_path, {"discrepancy": [3]})).endswith("Correct discrepancy.0.")
