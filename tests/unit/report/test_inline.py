"""Modules become one script that cannot leave its element, and so do data."""

import json
import re
from pathlib import Path

import pytest

from strandline.report.inline import PANELS, bundled, embedded

MODULES = {
    "first-one": "export const table = { a: 1 };\nexport function next() {\n  return 2;\n}\n",
    "second": 'import { next, table } from "./first-one.js";\nexport async function told() {\n  return next();\n}\n',
    "entry": 'import { next } from "./first-one.js";\nimport { told } from "./second.js";\nnext();\n',
}


def written(folder: Path, **others: str) -> Path:
    for name, text in {**MODULES, **others}.items():
        (folder / f"{name}.js").write_text(text)
    return folder


def test_each_module_comes_once_and_after_those_that_it_needs(tmp_path: Path) -> None:
    script = bundled("entry", written(tmp_path))
    assert re.findall(r"^const (module_\w+) =", script, re.M) == ["module_first_one", "module_second", "module_entry"]
    assert not re.search(r"^\s*(import|export)\b", script, re.M)


def test_what_cannot_be_joined_is_refused(tmp_path: Path) -> None:
    for number, (text, words) in enumerate(
        (
            ('import told from "./second.js";\n', "import or export of another form: import told"),
            ("export let changed = 1;\n", "import or export of another form"),
            ('import { x } from "./entry.js";\n', "modules import each other: entry → entry"),
            ('const end = "</SCRIPT>";\n', "would end their element"),
            ('const end = "<!--";\n', "would end their element"),
        )
    ):
        (tmp_path / str(number)).mkdir()
        with pytest.raises(ValueError, match=re.escape(words)):
            bundled("entry", written(tmp_path / str(number), entry=text))


def test_the_panels_of_the_report_need_no_server() -> None:
    script = bundled("explore")
    assert not [
        word for word in ("fetch(", "EventSource", "XMLHttpRequest", "import(", "eval(", "api/") if word in script
    ]
    assert script.count("const module_store = ") == 1
    modules = {name.removeprefix("module_") for name in re.findall(r"^const (module_\w+) =", script, re.M)}
    assert modules == {path.stem for path in PANELS.glob("*.js")}


def test_embedded_data_cannot_end_its_element() -> None:
    given = {"name": "</script><script>alert(1)</script><!--", "note": "a & b < c"}
    text = str(embedded(given))
    assert "<" not in text
    assert json.loads(text) == given
    with pytest.raises(ValueError, match="JSON"):
        embedded({"mean": float("nan")})
