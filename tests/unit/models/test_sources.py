"""The fingerprint of a Python model covers what its function calls in the same file, package or folder."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from strandline.models.protocol import earlier_fingerprint, fingerprint
from strandline.models.python import PythonModel
from strandline.models.sources import sources_of

FILES = {
    "beside_model.py": "WIDTH = 2.0\n",
    "unrelated_model.py": "NOTHING = 0\n",
    "fp_package/__init__.py": "from fp_package import constants\n",
    "fp_package/constants.py": "LENGTH = 1.0\n",
    "fp_package/deep/__init__.py": "",
    "fp_package/deep/shape.py": "from ..constants import LENGTH\n\ndef height(a):\n    return LENGTH * a\n",
    "fp_package/unused.py": "NEVER = 1\n",
    "fp_package/model.py": """import numpy as np

def lift(a):
    from .deep import shape
    import beside_model
    return beside_model.WIDTH * shape.height(a)

def f(inputs, workdir):
    return [[0.0, 0.0], [1.0, lift(inputs["a"])]]
""",
}
USED = ["beside_model", "fp_package", "fp_package.constants", "fp_package.deep", "fp_package.deep.shape"]


def forget() -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] in ("fp_package", "beside_model")]:
        del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    forget()
    yield tmp_path
    forget()


def identity(*, function_alone: bool = False) -> str:
    forget()
    return fingerprint(PythonModel("fp_package.model:f", function_alone=function_alone))


def test_all_that_is_imported_in_the_package_and_beside_it(folder: Path) -> None:
    assert [name for name, _ in sources_of("fp_package.model")] == sorted([*USED, "fp_package.model"])
    importlib.import_module("fp_package.model")
    assert [name for name, _ in sources_of("fp_package.model")] == sorted([*USED, "fp_package.model"])


def test_a_change_of_what_the_function_calls_is_another_model(folder: Path) -> None:
    before, alone = identity(), identity(function_alone=True)
    for name in ("fp_package/model.py", "fp_package/deep/shape.py", "fp_package/constants.py"):
        text = (folder / name).read_text()
        changed = text.replace("1.0\n", "1.5\n").replace("* a", "* a * a").replace("WIDTH *", "WIDTH +")
        assert changed != text
        (folder / name).write_text(changed)
        assert identity() != before
        assert identity(function_alone=True) == alone
        (folder / name).write_text(text)
    for name in ("unrelated_model.py", "fp_package/unused.py"):
        (folder / name).write_text("CHANGED = 1\n")
    assert identity() == before


def test_of_an_installed_package_its_own_modules_count(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = folder / "site-packages"
    site.mkdir()
    (folder / "fp_package").rename(site / "fp_package")
    (folder / "beside_model.py").rename(site / "beside_model.py")
    monkeypatch.syspath_prepend(site)
    forget()
    assert [name for name, _ in sources_of("fp_package.model")] == sorted([*USED[1:], "fp_package.model"])


def test_strandline_itself_is_known_by_its_version() -> None:
    assert [name for name, _ in sources_of("strandline.testing.studies")] == ["strandline.testing.studies"]


def test_the_earlier_fingerprint_is_what_ledgers_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The value that version 0.1 gave: with another one, old ledgers of unchanged models are refused."""
    (tmp_path / "fp_first_model.py").write_text("def f(inputs, workdir):\n    return [[0, 0], [1, 1]]\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = importlib.import_module("fp_first_model").f
    assert earlier_fingerprint(found) == "python:02ca610c26e4e6c5"
    assert fingerprint(found).startswith("python-files:")
