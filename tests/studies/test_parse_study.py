"""study.yaml → schema: what is accepted, and the one line for what is not."""

import json
from pathlib import Path
from typing import Any

import pytest

from strandline.errors import InvalidStudy
from strandline.smc import SMCSettings
from strandline.studies import load_study
from strandline.studies.keys.study_file import Quantity
from strandline.studies.parse import parse_study
from strandline.testing.studies import BEAM_STUDY, write_study


def parsed(tmp_path: Path, **changes: Any) -> Any:
    return parse_study(write_study(tmp_path / "study", **changes))[0]


def refused(tmp_path: Path, **changes: Any) -> InvalidStudy:
    with pytest.raises(InvalidStudy) as caught:
        parsed(tmp_path, **changes)
    assert "\n" not in str(caught.value)
    return caught.value


def refused_text(tmp_path: Path, text: str | bytes) -> InvalidStudy:
    (tmp_path / "study.yaml").write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(InvalidStudy) as caught:
        parse_study(tmp_path)
    assert "\n" not in str(caught.value)
    return caught.value


def test_defaults_are_the_published_kernel_and_the_economical_sampler(tmp_path: Path) -> None:
    content = parsed(tmp_path, sampler=None, executor=None, seed=None)
    smc = content.sampler.smc
    assert smc == {"particles": 5000, "rejuvenation_steps": 15, "zeta": 0.5}
    assert (SMCSettings().rejuvenation_steps, SMCSettings().zeta) == (smc["rejuvenation_steps"], smc["zeta"])
    assert content.surrogate.log_likelihood is None
    assert load_study(tmp_path / "study").settings.kernel == "matern32"
    assert content.design.sobol.scramble is None
    assert content.seed == 1


def test_text_is_returned_as_it_stands(tmp_path: Path) -> None:
    folder = write_study(tmp_path)
    assert parse_study(folder)[1] == (folder / "study.yaml").read_text()


def test_known_quantities_take_a_unit(tmp_path: Path) -> None:
    assert parsed(tmp_path, fixed={"load": {"value": 2, "unit": "N/m"}}).fixed == {
        "load": Quantity(value=2.0, unit="N/m")
    }


def test_numbers_that_yaml_reads_as_text_are_numbers(tmp_path: Path) -> None:
    """YAML 1.1 takes 1e-5 for a text: it has no point."""
    text = json.dumps(dict(BEAM_STUDY)).replace('"fixed": {"load": 1e-05}', '"fixed": {"load": 1e-5}')
    (tmp_path / "study.yaml").write_text(text)
    assert parse_study(tmp_path)[0].fixed == {"load": 1e-5}


@pytest.mark.parametrize(
    ("changes", "place", "known", "suggestion"),
    [
        ({"desing": {"sobol": {"runs": 64}}, "design": None}, "desing", "design", "Did you mean design?"),
        ({"noise": {"varance": 1.0}}, "noise.varance", "variance", "Did you mean variance?"),
        ({"design": {"sobol": {"runs": 64, "scrambled": 1}}}, "design.sobol.scrambled", "scramble", "scramble?"),
        ({"sampler": {"smc": {"zetta": 0.5}}}, "sampler.smc.zetta", "zeta", "Did you mean zeta?"),
        ({"inputs": {"E": {"priors": {"uniform": [1, 2]}}}}, "inputs.E.priors", "prior", "Did you mean prior?"),
        ({"colour": "blue"}, "colour", "inputs", "Remove colour."),
        ({"executor": {"local": {"cores": 2}}}, "executor.local.cores", "workers", "Did you mean workers?"),
    ],
)
def test_unknown_keys(tmp_path: Path, changes: dict[str, Any], place: str, known: str, suggestion: str) -> None:
    error = refused(tmp_path, **changes)
    assert "unknown key" in error.what
    assert error.value == place
    assert known in error.expected
    assert suggestion in error.remedy


def test_the_key_that_a_misspelt_one_leaves_out_is_not_told_too(tmp_path: Path) -> None:
    assert "more to correct" not in str(refused(tmp_path, desing={"sobol": {"runs": 64}}, design=None))


def picture(**keys: Any) -> dict[str, Any]:
    """Return a study's observation, found in a picture."""
    return {"observation": {"image": {"file": "a.png", "pixel": {"size": 1, "unit": "um"}, "solid": "dark", **keys}}}


def test_other_mistakes_are_told_by_place(tmp_path: Path) -> None:
    error = refused(tmp_path, seed="one", noise={"sd": -1})
    assert error.what == "study.yaml: noise.sd"
    assert "(1 more to correct: seed.)" in error.remedy


@pytest.mark.parametrize(
    ("changes", "place", "value", "expected"),
    [
        ({"design": {"sobol": {"runs": "many"}}}, "design.sobol.runs", "many", "a whole number"),
        ({"design": {"sobol": {"runs": 64.5}}}, "design.sobol.runs", 64.5, "a whole number"),
        ({"design": {"sobol": {"runs": 0}}}, "design.sobol.runs", 0, "greater than or equal to 1"),
        ({"design": {"sobol": {"runs": True}}}, "design.sobol.runs", True, "a number, not a truth value"),
        ({"noise": {"sd": False}}, "noise.sd", False, "a number, not a truth value"),
        ({"fixed": {"load": True}}, "fixed.load", True, "a number, not a truth value"),
        ({"fixed": {"load": "heavy"}}, "fixed.load", "heavy", "a number"),
        ({"inputs": {"E": {"prior": {"uniform": [1, True]}}}}, "inputs.E.prior.uniform.1", True, "not a truth value"),
        ({"inputs": {"E": {"prior": {"uniform": [1, "two"]}}}}, "inputs.E.prior.uniform.1", "two", "a number"),
        ({"inputs": {"E": {"prior": {"uniform": 3}}}}, "inputs.E.prior.uniform", 3, "a list"),
        ({"inputs": {"E": {"prior": {}}}}, "inputs.E.prior", {}, "at least one entry"),
        ({"inputs": {"E": [100, 800]}}, "inputs.E", [100, 800], "keys with values"),
        ({"inputs": {}}, "inputs", {}, "at least one entry"),
        ({"inputs": {"E": {}}}, "inputs.E.prior", None, "this key"),
        ({"noise": None}, "noise", None, "this key"),
        ({"noise": {"sd": 1, "variance": 1}}, "noise", {"sd": 1, "variance": 1}, "either `variance` or `sd`"),
        ({"noise": {"sd": 0}}, "noise.sd", 0, "a number greater than 0"),
        ({"noise": {"sd": float("nan")}}, "noise.sd", None, "a finite number"),
        ({"noise": {"variance": 1, "unit": "um"}}, "noise", None, "a `variance` is already in the unit of d²"),
        ({"noise": {"sd": 1, "length": 5}}, "noise", None, "`length` with the `sd` of the observed points"),
        (
            {"noise": {"sd": 1, "unknown": {"shift": 5}}},
            "noise",
            None,
            "`unknown` with the `sd` of the",
        ),
        ({"noise": {"sd": 1, "unit": "um", "length": -5}}, "noise.length", -5, "greater than or equal to 0"),
        ({"noise": {"sd": -1, "unit": "um"}}, "noise.sd", -1, "a number greater than 0"),
        (
            {"noise": {"sd": "unkown", "unit": "um"}},
            "noise.sd",
            "unkown",
            "a range [low, high], `unknown`, `column` or `image`",
        ),
        (
            {"noise": {"sd": {"uniform": [1, 5]}, "unit": "um"}},
            "noise.sd",
            {"uniform": [1, 5]},
            "a number, a range [low, high], `unknown`",
        ),
        ({"noise": {"sd": 1, "unit": "inch"}}, "noise.unit", "inch", "'mm', 'um', 'µm' or 'm'"),
        ({"noise": {"sd": 1, "unit": "um", "unknown": {"shift": -5}}}, "noise.unknown.shift", -5, "or equal to 0"),
        (
            {"noise": {"sd": 1, "unit": "um", "unknown": {"rotation": 50}}},
            "noise.unknown.rotation",
            50,
            "less than or equal to 45",
        ),
        ({"noise": {"sd": 1, "unit": "um", "unknown": {"scale": 5}}}, "noise.unknown.scale", 5, "or equal to 0.5"),
        ({"noise": {"sd": "image"}}, "noise", None, "`sd: image` with the `unit` of the observed points"),
        ({"name": "a/b"}, "name", "a/b", "letters, digits"),
        ({"name": 3}, "name", 3, "a text"),
        ({"seed": -1}, "seed", -1, "greater than or equal to 0"),
        ({"seed": 2**70}, "seed", 2**70, "less than 4294967296"),
        ({"sampler": {"smc": {"particles": 3}}}, "sampler.smc.particles", 3, "greater than or equal to 10"),
        ({"model": {"biofilm": {}, "python": {}}}, "model", None, "exactly one entry"),
        ({"discrepancy": []}, "discrepancy", [], "keys with values"),
        ({"discrepancy": 3}, "discrepancy", 3, "keys with values"),
        ({"observation": {"file": "a.csv"}}, "observation", {"file": "a.csv"}, "`unit: mm`"),
        ({"observation": {"file": "a.csv", "unit": "inch"}}, "observation.unit", "inch", "'mm', 'um', 'µm' or 'm'"),
        (picture(path=3), "observation.image.path", 3, "a text or a list"),
        (picture(path=[[1, 2], [3]]), "observation.image.path.1", [3], "at least 2 entries"),
        ({"observation": {}}, "observation", {}, "one of `file` with its `unit`, `image`, `stack` and `synthetic`"),
    ],
)
def test_wrong_values(tmp_path: Path, changes: dict[str, Any], place: str, value: Any, expected: str) -> None:
    error = refused(tmp_path, **changes)
    assert error.what == f"study.yaml: {place}"
    assert expected in error.expected
    if value is not None:
        assert error.value == value


@pytest.mark.parametrize("version", [2, "1", 1.0, True, None])
def test_version(tmp_path: Path, version: Any) -> None:
    error = refused(tmp_path, version=version)
    assert error.what == "study.yaml: version"
    assert "version: 1" in error.expected


@pytest.mark.parametrize(
    ("text", "what", "value"),
    [
        ("version: 1\nname: a\nversion: 1\n", "line 3: a key for the second", "got version"),
        ("version: 1\ninputs:\n  E: {prior: 1}\n  E: {prior: 2}\n", "line 4: a key for the second", "got E"),
        ("version: 1\nname: [a\n", "line 3", "expected ',' or ']'"),
        ("version: 1\n\tname: a\n", "line 2", "\\t"),
        ("version: 1\nname: 2020-13-45\n", "not valid YAML", "month must be in 1..12"),
        ("version: 1\nname: !!python/object:os.system {}\n", "line 2", "plain YAML without tags"),
        ("- version\n", "holds no keys", "['version']"),
        ("", "holds no keys", "nothing"),
        (b"version: 1\nname: \xff\xfe\n", "cannot be read", "utf-8"),
    ],
)
def test_not_yaml(tmp_path: Path, text: str | bytes, what: str, value: str) -> None:
    error = refused_text(tmp_path, text)
    assert what in error.what
    assert value in str(error)


def test_not_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"not a study folder: got .*nowhere.*strandline init"):
        parse_study(tmp_path / "nowhere")
    with pytest.raises(InvalidStudy, match="not a study folder"):
        parse_study(tmp_path)


def test_the_file_instead_of_its_folder(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "beam")
    with pytest.raises(InvalidStudy, match=r"Give the folder that it is in, `.*beam`, not a file"):
        parse_study(folder / "study.yaml")


def test_a_folder_in_place_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").mkdir()
    with pytest.raises(InvalidStudy, match="not a study folder"):
        parse_study(tmp_path)


def test_a_label_is_a_symbol_on_one_line(tmp_path: Path) -> None:
    inputs = {**BEAM_STUDY["inputs"], "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa", "label": " E_1 "}}
    assert parsed(tmp_path, inputs=inputs).inputs["E"].label == "E_1"
    study = load_study(write_study(tmp_path / "other", inputs=inputs))
    assert [parameter.shown for parameter in study.space] == ["E_1", "tilt"]
    for bad in ("", "  ", "a\nb", "x" * 31):
        inputs["E"] = inputs["E"] | {"label": bad}
        assert "a symbol of 1 to 30 characters on one line" in str(refused(tmp_path, inputs=inputs))
