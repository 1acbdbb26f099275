"""Modules become one script that does the same and cannot leave its element."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from strandline.report.inline import PANELS, bundled, embedded

FIRST = """export const table = { a: 1 };
let hidden = 1;
export function next() {
  hidden += 1;
  return hidden;
}
"""
SECOND = """import { next, table } from "./first-one.js";
const hidden = "mine";
export async function told() {
  return [next(), table.a, hidden];
}
"""
ENTRY = """import { next } from "./first-one.js";
import { told } from "./second.js";

next();
told().then((found) => console.log(JSON.stringify(found)));
"""
MODULES = {"first-one": FIRST, "second": SECOND, "entry": ENTRY}


def written(folder: Path, **others: str) -> Path:
    for name, text in {**MODULES, **others}.items():
        (folder / f"{name}.js").write_text(text)
    return folder


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_does_what_the_modules_do(tmp_path: Path) -> None:
    """Each module runs once, and names of one do not reach another."""
    script = bundled("entry", written(tmp_path))
    found = subprocess.run(["node", "-e", script], capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(found.stdout) == [3, 1, "mine"]


def test_each_module_comes_once_and_after_those_that_it_needs(tmp_path: Path) -> None:
    script = bundled("entry", written(tmp_path))
    assert re.findall(r"^const (module_\w+) =", script, re.M) == ["module_first_one", "module_second", "module_entry"]
    assert not re.search(r"^\s*(import|export)\b", script, re.M)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('import told from "./second.js";\n', "import or export of another form: import told"),
        ('import { told as other } from "./second.js";\n', "import or export of another form"),
        ("export default 1;\n", "import or export of another form: export default"),
        ("export let changed = 1;\n", "import or export of another form"),
        ('import { x } from "./entry.js";\n', "modules import each other: entry → entry"),
        ('const end = "</SCRIPT>";\n', "would end their element"),
    ],
)
def test_what_cannot_be_joined_is_refused(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        bundled("entry", written(tmp_path, entry=text))


def test_the_panels_of_the_report_need_no_server() -> None:
    script = bundled("explore")
    for word in ("fetch(", "EventSource", "XMLHttpRequest", "import(", "eval(", "api/"):
        assert word not in script
    assert script.count("const module_store = ") == 1
    assert {path.stem for path in PANELS.glob("*.js")} == {
        name.removeprefix("module_") for name in re.findall(r"^const (module_\w+) =", script, re.M)
    }


def test_embedded_data_cannot_end_its_element() -> None:
    given = {"name": "</script><script>alert(1)</script><!--", "note": "a & b < c"}
    text = str(embedded(given))
    assert "<" not in text
    assert json.loads(text) == given
    with pytest.raises(ValueError, match="JSON"):
        embedded({"mean": float("nan")})
