"""What study.yaml may not say: one table for each section of its keys."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.studies.refused import Row, message_of, not_refused

from strandline.testing.models import TwoLoads
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY

BIOFILM: dict[str, Any] = {
    "model": {"biofilm": {"mesh": "coarse"}},
    "fixed": {"V_in": 100},
    "inputs": {"E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"}, "nu": {"prior": {"uniform": [-0.8, 0.5]}}},
    "observation": {"synthetic": {"E": 400, "nu": 0.3, "V_in": 100}},
}
UM = {"unit": "um"}


def prior(box: list[float] | None = None, unit: Any = "Pa", **family: Any) -> dict[str, Any]:
    """Return the inputs of the beam with another prior of E."""
    item = {"prior": family, "unit": unit, "box": box}
    return {"inputs": {**BEAM_STUDY["inputs"], "E": {key: value for key, value in item.items() if value is not None}}}


def inputs(**items: Any) -> dict[str, Any]:
    return {"inputs": {**BEAM_STUDY["inputs"], **items}}


def labelled(label: str) -> dict[str, Any]:
    return inputs(E={"prior": {"uniform": [300, 560]}, "unit": "Pa", "label": label})


def synthetic(**truth: float) -> dict[str, Any]:
    return {"observation": {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5} | truth}}


def seen(noise: Any) -> dict[str, Any]:
    return synthetic() | {"observation": synthetic()["observation"] | {"noise": noise}}


def smc(**options: Any) -> dict[str, Any]:
    return {"sampler": {"smc": options}}


def sobol(runs: Any, **more: Any) -> dict[str, Any]:
    return {"design": {"sobol": {"runs": runs}, **more}}


def active(**options: Any) -> dict[str, Any]:
    return {"design": {"active": {"runs": 50, **options}}}


def python(function: Any) -> dict[str, Any]:
    return {"model": {"python": {"function": function}}}


def noise(**keys: Any) -> dict[str, Any]:
    return {"noise": keys}


TOP: list[Row] = [
    ({"desing": {"sobol": {"runs": 64}}, "design": None}, "unknown key: got desing", "Did you mean design?"),
    ({"colour": "blue"}, "unknown key: got colour", "inputs", "Remove colour."),
    ({"seed": "one", "noise": {"sd": -1}}, "study.yaml: noise.sd", "(1 more to correct: seed.)"),
    ({"name": "a/b"}, "name: got a/b", "letters, digits"),
    ({"name": 3}, "name: got 3", "a text"),
    ({"seed": -1}, "seed: got -1", "greater than or equal to 0"),
    ({"seed": 2**70}, "seed: got ", "less than 4294967296"),
    ({"reuse": ["../nothing"]}, "reuse: got ../nothing", "folder of another study"),
    ({"sensitivities": True}, "sensitivities: got true, but this model offers none"),
    ({"sensitivities": "yes please"}, "sensitivities: got yes please; expected true or false"),
    *[({"version": version}, "study.yaml: version", "version: 1") for version in (2, "1", 1.0, True, None)],
]
MODEL: list[Row] = [
    ({"model": {"biofilm": {}, "python": {}}}, "model: got", "exactly one entry"),
    ({"model": {"biofilmm": {}}}, "model: got biofilmm", "biofilm, command, python, umbridge", "mean biofilm?"),
    ({"model": {"biofilm": {"mush": 1}}}, "model.biofilm: unknown option: got mush", "Did you mean mesh?"),
    ({"model": {"biofilm": {"mesh": "huge"}}}, "model.biofilm: mesh", "got huge", "coarse, default, fine"),
    ({"model": {"python": {}}}, "model.python.function: got nothing", "Add `function: …`"),
    (python("nowhere:f"), "got nowhere:f", "PYTHONPATH"),
    (python(3), "model.python.function: got 3", "a text"),
    (python("beam"), "got beam", "module:name"),
    (python("strandline.testing.studies:bean"), "a callable bean"),
    (
        {"model": {"python": {"function": "strandline.testing.studies:two_loads", "sensitivities": True}}},
        "Move the key to the top level",
    ),
]
INPUTS: list[Row] = [
    (inputs(E={"priors": {"uniform": [1, 2]}}), "inputs.E.priors", "prior", "Did you mean prior?"),
    (prior(uniform=[1, True]), "inputs.E.prior.uniform.1: got True", "not a truth value"),
    (prior(uniform=[1, "two"]), "inputs.E.prior.uniform.1: got two", "a number"),
    (prior(uniform=3), "inputs.E.prior.uniform: got 3", "a list"),
    (prior(), "inputs.E.prior: got {}", "at least one entry"),
    (inputs(E=[100, 800]), "inputs.E: got [100, 800]", "keys with values"),
    ({"inputs": {}}, "inputs: got {}", "at least one entry"),
    (inputs(E={}), "inputs.E.prior: got", "this key"),
    (prior(unit=None, uniform=[300, 560]), "unit of inputs.E: got nothing", "unit: Pa"),
    (prior(unit="kPa", uniform=[300, 560]), "got kPa; expected Pa"),
    (prior(uniform=[-300, 560]), "inputs.E", "got -300", "(0, inf] Pa"),
    (prior(uniform=[300]), "inputs.E.prior.uniform", "2 numbers"),
    (prior(uniform=[560, 300]), "inputs.E", "the lower one first"),
    (prior(unifrom=[1, 2]), "got unifrom", "Did you mean uniform?"),
    (prior(normal=[400, 30]), "inputs.E: design box", "Give E a box"),
    (prior([300, 560], uniform=[300, 700]), "reaches beyond its design box", "support [300, 700]", "35% of its mass"),
    (prior([300, 560], uniform=[600, 700]), "inputs.E: truncated prior keeps no mass", "Move the bounds or the prior."),
    (prior([300, 2000], lognormal=[8, 0.3]), "the prior of E reaches beyond its design box", "at most half"),
    (inputs(Tilt={"prior": {"uniform": [0, 1]}}), "inputs.Tilt: the model has no such input", "Did you mean tilt?"),
    (BIOFILM | {"inputs": BIOFILM["inputs"] | {"nu": {"prior": {"uniform": [-0.8, 0.6]}}}}, "inputs.nu", "got 0.6"),
    *[
        (inputs(tilt={"prior": {"uniform": [0, 1]}, "nuisance": value}), "inputs.tilt.nuisance", "true or false")
        for value in (3, "yes", 1, None)
    ],
    (
        {"inputs": {name: {**item, "nuisance": True} for name, item in BEAM_STUDY["inputs"].items()}},
        "got none: E, tilt are all nuisance; expected at least one",
    ),
    *[(labelled(bad), "a symbol of 1 to 30 characters on one line") for bad in ("", "  ", "a\nb", "x" * 31)],
]
FIXED: list[Row] = [
    ({"fixed": {"load": True}}, "fixed.load: got True", "a number, not a truth value"),
    ({"fixed": {"load": "heavy"}}, "fixed.load: got heavy", "a number"),
    ({"fixed": {"load": 1, "lode": 2}}, "fixed.lode: the model has no such input", "Did you mean load?"),
    ({"fixed": {"load": 1, "E": 400}}, "E is both fixed and an input: got 400.0"),
    ({"fixed": {}}, "no value for load, which the model takes", "Add e.g. `fixed: {load: …}`"),
    ({"fixed": {"load": {"value": 1, "unit": "kN/m"}}}, "unit of fixed.load: got kN/m; expected N/m"),
    (BIOFILM | {"fixed": {"V_in": -1}}, "fixed.V_in: got -1.0", "inflow volume rate per depth"),
]
OBSERVATION: list[Row] = [
    ({"observation": {}}, "one of `file` with its `unit`, `image`, `stack` and `synthetic`"),
    ({"observation": {"file": "a.csv"}}, "observation: got {'file': 'a.csv'}", "`unit: mm`"),
    ({"observation": {"file": "a.csv", "unit": "inch"}}, "observation.unit: got inch", "'mm', 'um', 'µm' or 'm'"),
    ({"observation": {"file": "none.csv", "unit": "mm"}}, "observation none.csv is missing"),
    ({"observation": {"synthetic": {"E": 400}}}, "observation.synthetic: got E: 400", "tilt, load too"),
    (synthetic(E=-4), "observation.synthetic.E: got -4", "Young's modulus"),
    (synthetic(nu=0), "observation.synthetic.nu: the model has no such input"),
    ({"observation": {"synthetic": {"E": 400}, "sort": "x"}}, "only with a `file`"),
    (seen({"sd": -0.001}), "observation.noise.sd", "greater than 0"),
    (seen({"sd": 0}), "observation.noise.sd", "greater than 0"),
    (seen({"sd": "much"}), "observation.noise.sd"),
    (seen({"seed": 1}), "observation.noise.sd"),
    (seen({"sd": 1, "seed": -1}), "observation.noise.seed"),
    (seen({"sd": 1, "variance": 1}), "observation.noise.variance"),
    (seen(0.001), "observation.noise"),
    ({"observation": {"file": "a.csv", "unit": "mm", "noise": {"sd": 0.001}}}, "observation", "with `synthetic` only"),
]
DISCREPANCY: list[Row] = [
    ({"discrepancy": []}, "discrepancy: got []", "keys with values"),
    ({"discrepancy": 3}, "discrepancy: got 3", "keys with values"),
    ({"discrepancy": {"curents": {}}}, "discrepancy: got curents", "Did you mean currents?"),
    ({"discrepancy": {"currents": {}}}, "discrepancy.currents.width: got nothing"),
    ({"discrepancy": {"currents": {"width": -1.0}}}, "discrepancy.currents", "got -1", "above 0"),
    ({"discrepancy": {"currents": {"width": "wide"}}}, "discrepancy.currents.width: got wide; expected a number"),
    ({"discrepancy": {"currents": {"width": True}}}, "discrepancy.currents.width: got True"),
    ({"discrepancy": {"tracked_points": {"lines": 3}}}, "unknown option: got lines; expected no options"),
    ({"discrepancy": {"measurement_lines": {"reach": 0}}}, "reach of the measurement lines: got 0.0"),
    ({"discrepancy": [{"closest_point": {}}, {"closest_point": {}}]}, "each measure once"),
]
INFERRED = "the measure normal_offset and a surrogate of the field"
NOISE: list[Row] = [
    (noise(varance=1.0), "noise.varance", "Did you mean variance?"),
    ({"noise": None}, "noise: got", "this key"),
    (noise(sd=1, variance=1), "noise: got", "either `variance` or `sd`"),
    (noise(sd=0), "noise.sd: got 0", "a number greater than 0"),
    (noise(sd=-1, **UM), "noise.sd: got -1", "a number greater than 0"),
    (noise(sd=False), "noise.sd: got False", "a number, not a truth value"),
    (noise(sd=float("nan")), "noise.sd", "a finite number"),
    (noise(variance=1, **UM), "a `variance` is already in the unit of d²"),
    (noise(sd=1, length=5), "`length` with the `sd` of the observed points"),
    (noise(sd=1, unknown={"shift": 5}), "`unknown` with the `sd` of the"),
    (noise(sd=1, length=-5, **UM), "noise.length: got -5", "greater than or equal to 0"),
    (noise(sd="unkown", **UM), "noise.sd: got unkown", "a range [low, high], `unknown`, `column` or `image`"),
    (noise(sd={"uniform": [1, 5]}, **UM), "noise.sd: got {'uniform'", "a number, a range [low, high], `unknown`"),
    (noise(sd=1, unit="inch"), "noise.unit: got inch", "'mm', 'um', 'µm' or 'm'"),
    (noise(sd=1, **UM, unknown={"shift": -5}), "noise.unknown.shift: got -5", "or equal to 0"),
    (noise(sd=1, **UM, unknown={"rotation": 50}), "noise.unknown.rotation: got 50", "less than or equal to 45"),
    (noise(sd=1, **UM, unknown={"scale": 5}), "noise.unknown.scale: got 5", "or equal to 0.5"),
    (noise(sd="image"), "noise: got", "`sd: image` with the `unit` of the observed points"),
    (noise(sd="image", **UM), "comes from a picture"),
    (noise(sd="column", length=20, **UM), "a table with the standard deviation"),
    (noise(sd="unknown", **UM), INFERRED),
    (noise(sd=[1, 5], **UM), INFERRED),
    (noise(sd=3, model_error=True, **UM), INFERRED),
    (noise(sd=3, spread=["tilt"], **UM), "several, whose inputs may differ"),
    (noise(sd=3, spread=["E", "nu"], **UM), "some of E, tilt"),
    (noise(sd=[5, 1], **UM), "0 < low < high"),
    (noise(sd=3, length=[0, 1], **UM), "0 < low < high"),
]
METHOD: list[Row] = [
    (sobol("many"), "design.sobol.runs: got many", "a whole number"),
    (sobol(64.5), "design.sobol.runs: got 64.5", "a whole number"),
    (sobol(0), "design.sobol.runs: got 0", "greater than or equal to 1"),
    (sobol(True), "design.sobol.runs: got True", "a number, not a truth value"),
    (sobol(3), "design.sobol.runs: got 3", "at least 4 runs for 2 input(s)"),
    ({"design": {"sobol": {"runs": 64, "scrambled": 1}}}, "design.sobol.scrambled", "Did you mean scramble?"),
    (sobol(9, refine={"runs": 5, "temperature": 2}), "design.refine: temperature", "got 2.0"),
    (sobol(8, refine={"runs": 201}) | smc(particles=200), "design.refine.runs: got 201; expected at most 200"),
    (sobol(24, active={"runs": 50}), "either `sobol"),
    ({"design": {}}, "either `sobol"),
    (active() | {"design": {"active": {"runs": 50}, "refine": {"runs": 5}}}, "an active design refines itself"),
    (active() | {"surrogate": {"log_likelihood": {}}}, "for an active design"),
    (active() | {"surrogate": {"log_likelihood": {}, "field": {}}}, "one of `log_likelihood`, `field`"),
    (active(criterion="entropy"), "design.active.criterion"),
    (active(runs=20), "design.active.runs"),
    (active(check=5), "design.active.check"),
    (active(explore=0.9), "design.active.explore"),
    (active(rounds=2), "design.active.rounds"),
    ({"surrogate": {"log_likelihood": {"kernel": "mattern32"}}}, "got mattern32", "Did you mean matern32?"),
    (smc(zetta=0.5), "sampler.smc.zetta", "Did you mean zeta?"),
    (smc(particles=3), "sampler.smc.particles: got 3", "greater than or equal to 10"),
    (smc(zeta=1), "sampler.smc.zeta: got 1"),
    (smc(rejuvenation_steps=0), "sampler.smc.rejuvenation_steps: got 0"),
    *[({"sampler": {"cut": {"values": values}}}, "sampler.cut.values") for values in (1, 2.5, True, "many")],
]
JOBS = {"cores": 4, "memory": "8GB", "walltime": "01:00:00"}
EXECUTOR: list[Row] = [
    ({"executor": {"local": {"cores": 2}}}, "executor.local.cores", "Did you mean workers?"),
    ({"executor": {"local": {"workers": 0}}}, "executor.local.workers: got 0"),
    ({"executor": {"local": {}, "dask": {}}}, "one of in_process, local, dask, slurm_array"),
    ({"executor": {"slurm": {}}}, "unknown key: got executor.slurm"),
    ({"executor": {"in_process": {"workers": 2}}}, "executor.in_process.workers"),
    ({"executor": {"dask": {"jobs": {**JOBS, "project": "x"}}}}, "executor.dask.jobs.project"),
    ({"executor": {"dask": {"cluster": "slurm"}}}, "Add cores"),
    ({"executor": {"dask": {"cluster": "slurm", "jobs": {**JOBS, "walltime": 3600}}}}, "executor.dask.jobs.walltime"),
    ({"executor": {"dask": {"cluster": "slurm", "timeout": 3600, "jobs": JOBS}}}, "at most 3540 s"),
    ({"executor": {"slurm_array": {"timeout": 241, "walltime": "00:05:00"}}}, "at most 240 s"),
    ({"executor": {"slurm_array": {"walltime": "5"}}}, "in quotes"),
    ({"executor": {"slurm_array": {"cpu": 2}}}, "Did you mean cpus?"),
    ({"executor": {"slurm_array": {"cpus": -1}}}, "executor.slurm_array.cpus: got -1"),
]
CHEAPER = {"model": {"python": {"function": "tests.study.studies.softer:softer"}}, "cost": 0.2}
FIDELITIES: list[Row] = [
    ({"fidelities": "coarse"}, "fidelities: got coarse; expected a list with one cheaper model"),
    ({"fidelities": [{"cost": 0.1}]}, "fidelities: the cheaper model: got the model itself"),
    ({"fidelities": [{**CHEAPER, "cost": 2}]}, "above 0 and below 1"),
    ({"fidelities": [{**CHEAPER, "cost": "low"}]}, "fidelities.cost: got 'low'"),
    ({"fidelities": [{**CHEAPER, "function": "a:b"}]}, "only `cost` beside it"),
    ({"fidelities": [{"model": 3}]}, "fidelities.model: got 3"),
    ({"fidelities": ["coarse"]}, "only a model with meshes has names for them", "function: 'own_model:cheaper"),
    ({"fidelities": [CHEAPER, CHEAPER]}, "exactly one entry"),
    (sobol(30) | {"fidelities": [CHEAPER]}, "a cheaper model without an active design"),
]


@pytest.mark.parametrize(
    "rows",
    [TOP, MODEL, INPUTS, FIXED, OBSERVATION, DISCREPANCY, NOISE, METHOD, EXECUTOR],
    ids=["top", "model", "inputs", "fixed", "observation", "discrepancy", "noise", "method", "executor"],
)
def test_each_mistake_is_refused_with_its_place(tmp_path: Path, rows: list[Row]) -> None:
    assert not_refused(tmp_path, rows) == []


def test_cheaper_models(tmp_path: Path) -> None:
    assert not_refused(tmp_path, FIDELITIES, design={"active": {"runs": 60}}) == []


BOTH = [{"condition": name, "file": f"{name}.csv", "unit": "um"} for name in ("heavy", "light")]
FIRST = BOTH[0]
OWN = {"sd": 3, "length": 15, **UM, "unknown": {"shift": 8, "rotation": 0.5}}
SHARED = {**OWN, "unknown": {**OWN["unknown"], "shared": True}}
BY_FIELD = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
CONDITIONS: list[Row] = [
    ({"observation": []}, "observation: got []; expected at least one entry"),
    ({"observation": [{"file": "light.csv", "unit": "mm"}]}, "observation.0.condition: got nothing", "Add it."),
    ({"observation": [{**FIRST, "condition": ""}]}, "observation.0.condition", "a short name without slashes"),
    ({"observation": [{**FIRST, "condition": "a/b"}]}, "observation.0.condition: got a/b"),
    ({"observation": [{"condition": "light", "file": "light.csv"}]}, "observation.0", "`unit: mm`"),
    ({"observation": [{"condition": "light", "synthetic": {"E": 400}}]}, "observation.0", "observes all of them"),
    ({"observation": [{**FIRST, "condtion": "a"}]}, "unknown key: got observation.0.condtion", "mean condition?"),
    ({"observation": [FIRST, FIRST]}, "observation", "each condition once"),
    ({"observation": [{**FIRST, "condition": "haevy"}]}, "got haevy; expected some of light, heavy", "mean heavy?"),
    ({"observation": {"file": "light.csv", **UM}}, "the condition is not named", "Give a list"),
    ({"observation": {**FIRST}}, "unknown key: got observation.condition"),
    ({"noise": {**OWN, "conditions": {"light": SHARED}}}, "light: got condition heavy with its own errors"),
    ({"noise": {**SHARED, "conditions": {"light": {"variance": 1}}}}, "got condition light with its own errors"),
    (
        {"noise": {**SHARED, "conditions": {"light": {**SHARED, "unknown": {**SHARED["unknown"], "shift": 9}}}}},
        "got condition heavy with another shift, rotation or scale",
    ),
    (
        BY_FIELD | {"noise": {**OWN, "conditions": {"light": {"sd": "unknown", **UM}}}},
        "State the same unknown sd, length or model_error for every condition, or for none.",
    ),
    (BY_FIELD | {"noise": {**SHARED, "model_error": True}}, "a known sd and length, no model_error and no spread"),
]


def test_conditions(tmp_path: Path) -> None:
    for name, interface in TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces.items():
        np.savetxt(tmp_path / f"{name}.csv", interface.points * 1000, delimiter=",")
    assert not_refused(tmp_path, CONDITIONS, **TWO_LOADS_STUDY) == []
    assert not_refused(tmp_path, [({"observation": BOTH}, "without a name: got heavy; expected one mapping")]) == []


COLUMN = {"sd": "column", "length": 20, **UM}
EDGE = "x,y,sd\n" + "".join(f"{0.0625 * k},{0.12 * (k / 16) ** 2},{0.001 * (1 + k % 3)}\n" for k in range(17))


def of_table(noise: dict[str, Any], **options: Any) -> dict[str, Any]:
    return {"observation": {"file": "edge.csv", "unit": "mm", **options}, "noise": noise}


COLUMNS: list[Row] = [
    (of_table(COLUMN, columns=[1, 2]), "observation: {file: …, sd: COLUMN}"),
    (of_table({"sd": 3, **UM}, columns=[1, 2], sd="sd"), "the noise does not take it"),
    (of_table(COLUMN, columns=[1, 2], sd="s"), "no column s"),
    (of_table(COLUMN, columns=[1, 2], sd=0), "a column, by name or by number"),
    (of_table(COLUMN, columns=[1, 2], sd="x"), "standard deviation of point 1"),
    (of_table({**COLUMN, "length": "unknown"}, sd="sd"), "State the length, or write `sd: unknown`."),
    (of_table({**COLUMN, "model_error": True}, sd="sd"), "Remove model_error and spread."),
    (of_table({"sd": "column"}, sd="sd"), "`unit`"),
    (of_table({"sd": 1}, columns=["x", "z"]), "edge.csv has no column z: got x, y, sd"),
    (of_table({"sd": 1}, sort="z"), "observation.sort: got z"),
    (of_table({"sd": 3, "length": 1e7, **UM}, columns=[1, 2]), "correlation length"),
]


def test_columns_of_a_table(tmp_path: Path) -> None:
    (tmp_path / "edge.csv").write_text(EDGE)
    assert not_refused(tmp_path, COLUMNS) == []


TEXTS: list[tuple[str | bytes, str, str]] = [
    ("version: 1\nname: a\nversion: 1\n", "line 3: a key for the second", "got version"),
    ("version: 1\ninputs:\n  E: {prior: 1}\n  E: {prior: 2}\n", "line 4: a key for the second", "got E"),
    ("version: 1\nname: [a\n", "line 3", "expected ',' or ']'"),
    ("version: 1\n\tname: a\n", "line 2", "\\t"),
    ("version: 1\nname: 2020-13-45\n", "not valid YAML", "month must be in 1..12"),
    ("version: 1\nname: !!python/object:os.system {}\n", "line 2", "plain YAML without tags"),
    ("- version\n", "holds no keys", "['version']"),
    ("", "holds no keys", "nothing"),
    (b"version: 1\nname: \xff\xfe\n", "cannot be read", "utf-8"),
]


def test_texts_that_are_no_yaml(tmp_path: Path) -> None:
    for text, *words in TEXTS:
        (tmp_path / "study.yaml").write_bytes(text.encode() if isinstance(text, str) else text)
        message = message_of(tmp_path)
        assert [word for word in words if word not in message] == [], message


FILES: list[tuple[str, str | bytes, str]] = [
    ("o.csv", "", "o.csv holds no points"),
    ("o.csv", "x,y\n# nothing\n", "o.csv holds no points"),
    ("o.csv", ",\n", "o.csv holds no points"),
    ("o.csv", "0,0\n", "too few points for an interface: got 1 point(s)"),
    ("o.csv", "x,y\n\n0,0\n1,2,3\n", "no point in line 4: got 1 2 3"),
    ("o.csv", "0,0\n1\n", "no point in line 2: got 1"),
    ("o.csv", "0,0\n1,one\n", "no point in line 2: got 1 one"),
    ("o.csv", "0,O\n1,1\n2,0\n", "no point in line 1: got 0 O"),
    ("o.csv", "0,0\nnan,1\n2,0\n", "point 1 of the interface is not finite"),
    ("o.csv", "0,0\n1,1\n1,1\n2,0\n", "segment 1 of the interface has no length"),
    ("o.csv", "0,0\n1,1\n1,0\n0,1\n", "crosses itself: segments 0 and 2: got (0.5, 0.5) mm"),
    ("o.csv", b"0,0\n\xff,1\n", "o.csv cannot be read"),
    ("o.csv", "x;y\n0;0\n0,5;0,1\n", 'With decimal commas give `decimal: ","`'),
    ("o.csv", "0,0\n500,60\n1000,100\n", "o.csv, read in mm: got"),
    ("o.csv", "0,0\n5e-4,6e-5\n1e-3,1e-4\n", "times the model"),
    ("o.png", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "o.png is a picture: got a PNG image;"),
    ("o.csv", b"\xff\xd8\xff\xe0" + bytes(range(256)), "o.csv is a picture: got a JPEG image;"),
    ("o.vtu", b"II*\x00" + bytes(range(256)), "o.vtu is a picture: got a TIFF image;"),
    ("o.csv", b"MM\x00*" + bytes(range(256)), "o.csv is a picture: got a TIFF image;"),
]


def test_files_that_hold_no_interface(tmp_path: Path) -> None:
    for name, content, words in FILES:
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        row = ({"observation": {"file": name, "unit": "mm"}}, words)
        assert not_refused(tmp_path, [row], **(BIOFILM if "mm: got" in words or "times" in words else {})) == []


def test_places_that_are_no_study_folder(tmp_path: Path) -> None:
    from strandline.errors import InvalidStudy
    from strandline.studies.parse import parse_study
    from strandline.testing.studies import write_study

    (tmp_path / "study" / "study.yaml").mkdir(parents=True)
    for place in (tmp_path / "nowhere", tmp_path, tmp_path / "study"):
        with pytest.raises(InvalidStudy, match=r"not a study folder: got .*strandline init"):
            parse_study(place)
    with pytest.raises(InvalidStudy, match=r"Give the folder that it is in, `.*beam`, not a file"):
        parse_study(write_study(tmp_path / "beam") / "study.yaml")
