"""Modules that were joined do what they do apart."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from strandline.report.inline import bundled

MODULES = {
    "first-one": "export const table = { a: 1 };\nlet hidden = 1;\n"
    "export function next() {\n  hidden += 1;\n  return hidden;\n}\n",
    "second": 'import { next, table } from "./first-one.js";\nconst hidden = "mine";\n'
    "export async function told() {\n  return [next(), table.a, hidden];\n}\n",
    "entry": 'import { next } from "./first-one.js";\nimport { told } from "./second.js";\n'
    "next();\ntold().then((found) => console.log(JSON.stringify(found)));\n",
}


@pytest.mark.smoke
@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_each_module_runs_once_and_names_of_one_do_not_reach_another(tmp_path: Path) -> None:
    for name, text in MODULES.items():
        (tmp_path / f"{name}.js").write_text(text)
    script = bundled("entry", tmp_path)
    found = subprocess.run(["node", "-e", script], capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(found.stdout) == [3, 1, "mine"]
