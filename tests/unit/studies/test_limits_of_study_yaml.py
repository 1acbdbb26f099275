"""Values of study.yaml beyond what a study can mean: each is refused in one line, where it stands."""

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from strandline.errors import InvalidInput
from strandline.runs import Ledger
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, write_study

E: dict[str, Any] = BEAM_STUDY["inputs"]["E"]
UNDECLARED = {"python": {"function": "strandline.testing.studies:undeclared_beam"}}
BIOFILM: dict[str, Any] = {
    "model": {"biofilm": {"mesh": "coarse"}},
    "fixed": {"V_in": 100},
    "inputs": {"E": E, "nu": {"prior": {"uniform": [-0.8, 0.6]}}},
    "observation": {"synthetic": {"E": 400, "nu": 0.3, "V_in": 100}},
}


def inputs(**item: Any) -> dict[str, Any]:
    return {"inputs": {**BEAM_STUDY["inputs"], "E": {**E, **item}}}


def named(name: str) -> dict[str, Any]:
    return {"inputs": {**BEAM_STUDY["inputs"], name: {"prior": {"uniform": [0, 1]}}}}


def free(**item: Any) -> dict[str, Any]:
    """Return inputs of a model that declares none, E changed."""
    return {"model": UNDECLARED, **inputs(**item)}


LIMITS: list[tuple[dict[str, Any], list[str]]] = [
    (BIOFILM, ["inputs.nu", "got 0.6", "(-1, 0.5]", "Poisson's ratio"]),
    (inputs(box=[300, 500]), ["prior of E", "box [300, 500]", "Widen the box"]),
    (inputs(prior={"lognormal": [1000, 1]}, box=[300, 560]), ["prior.lognormal", "got 1000.0", "mean of log x"]),
    (free(prior={"uniform": [-1e308, 1e308]}), ["uniform", "at most 1e+100"]),
    (free(prior={"uniform": [400, 400.00000000000006]}), ["uniform", "differ by at least"]),
    (free(unit="$\\frac{$"), ["inputs.E.unit: got $\\frac{$", "without $"]),
    (named("a\nb"), ["inputs.a b", "a short name on one line"]),
    (named("a/b"), ["inputs.a/b", "without /"]),
    (named("draw"), ["inputs.draw", "none of the names that the results use"]),
    (
        {"model": UNDECLARED, "inputs": {"weight": E, **BEAM_STUDY["inputs"]}},
        ["inputs.weight", "the names that the results use themselves"],
    ),
    ({"design": {"sobol": {"runs": "80"}}}, ["design.sobol.runs: got 80", "without quotes"]),
    ({"design": {"sobol": {"runs": "6_4"}}}, ["design.sobol.runs: got 6_4", "a whole number"]),
    ({"design": {"sobol": {"runs": 1e12}}}, ["design.sobol.runs", "equal to 1000000"]),
    ({"design": {"active": {"runs": 10**30}}}, ["design.active.runs", "equal to 1000000"]),
    ({"design": {"active": {"runs": 60, "batch": 100}}}, ["design.active.batch: got 100", "at most 52"]),
    (
        {"design": {"active": {"runs": 60}}, "surrogate": {"log_likelihood": {}}},
        ["design and surrogate do not fit together: got an active design with a surrogate of the log-likelihood;"],
    ),
    ({"noise": {"sd": True}}, ["noise.sd: got True; expected a number"]),
    ({"noise": {"sd": "١٢"}}, ["noise.sd: got ١٢", "a number"]),
    ({"noise": {"sd": 1e200}}, ["noise: got", "from 1e-30 to 1e+30"]),
    ({"noise": {"sd": 1e-200}}, ["noise: got", "from 1e-30 to 1e+30"]),
    ({"discrepancy": {"currents": {"width": "١"}}}, ["currents.width: got ١"]),
    ({"discrepancy": {"currents": {"width": 1e300}}}, ["width", "from 1e-09 to 1e+09"]),
    ({"discrepancy": {"measurement_lines": {"lines": 10**9}}}, ["1000000000 lines", "1 to 100000"]),
    ({"executor": {"local": {"timeout": 1e9}}}, ["local.timeout", "at most 31622400 (a year)"]),
    ({"reuse": ["a" * 5000]}, ["reuse: got aaa", "the folder of another study"]),
    ({"failures": {"kinds": {"timeout": "recover"}}}, ["continue, abort, or {retry: N}"]),
    ({"failures": {"kinds": {"timeout": {"retry": 0}}}}, ["continue, abort, or {retry: N}"]),
    ({"failures": {"kinds": {"timeout": {"retry": 1, "wait": 2}}}}, ["continue, abort, or {retry: N}"]),
    ({"failures": {"stop": "always"}}, ["never, or {share: 0.95, after: 20}"]),
    ({"failures": {"stop": {"share": 0}}}, ["greater than 0"]),
    ({"failures": {"stop": {"shares": 0.5}}}, ["Did you mean share?"]),
    ({"failures": {"kind": {}}}, ["Did you mean kinds?"]),
]


def test_each_value_beyond_its_limit_is_refused(tmp_path: Path) -> None:
    for changes, words in LIMITS:
        with pytest.raises(InvalidInput) as caught:
            load_study(write_study(tmp_path, **changes))
        message = str(caught.value)
        assert all(word in message for word in words), message
        assert "\n" not in message
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


@pytest.mark.parametrize("row", ["schema_version", "model"])
def test_a_ledger_without_one_of_its_facts_is_damaged(row: str, tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    Ledger.open(study.ledger_path, model="test:beam-1").close()
    with contextlib.closing(sqlite3.connect(study.ledger_path)) as connection, connection:
        connection.execute("DELETE FROM meta WHERE key = ?", (row,))
    with pytest.raises(InvalidInput, match=f"damaged.*no row {row}"):
        study.runs.require_sound_ledgers()


def test_a_template_of_3000_parentheses_is_refused(tmp_path: Path) -> None:
    command = {"templates": {"a.j2": "a"}, "command": ["true"], "result": {"file": "a.csv", "unit": "mm"}}
    folder = write_study(tmp_path, model={"command": command})
    (folder / "a.j2").write_text("{{ " + "(" * 3000 + "E" + ")" * 3000 + " }}")
    with pytest.raises(InvalidInput, match=r"the template a\.j2 cannot be compiled"):
        load_study(folder)
