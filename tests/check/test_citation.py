"""The citation file names the version that there is, and the long description leads nowhere that is not there."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

import strandline

ROOT = Path(__file__).parents[2]


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Give what hatch_build.py defines, which imports the build backend, without that."""
    interface = SimpleNamespace(MetadataHookInterface=object)
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)  # type: ignore[arg-type]
    for name in ("hatchling", "hatchling.metadata", "hatchling.metadata.plugin"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    return SimpleNamespace(**runpy.run_path(str(ROOT / "hatch_build.py")))


def test_citation_and_change_log_are_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(citation)
    assert citation["version"] == strandline.__version__
    assert f"\n## {strandline.__version__}\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert citation["references"][0]["doi"] in (ROOT / "README.md").read_text("utf-8")


def test_relative_links_of_the_long_description_become_text_with_paths_that_exist(hook: SimpleNamespace) -> None:
    text = "![p](docs/a.png)\n\nSee [the guide](docs/guide.md), [below](#here), [LICENSE](LICENSE), [doi](https://doi.org/1)."
    wanted = "See the guide (`docs/guide.md`), below, LICENSE, [doi](https://doi.org/1)."
    assert hook.without_relative_links(text) == wanted
    metadata: dict[str, dict[str, str]] = {}
    hook.LongDescription.update(SimpleNamespace(root=ROOT), metadata)
    text = metadata["readme"]["text"]
    assert text.startswith("# strandline\n\nFiles named below")
    assert "](docs/" not in text
    named = [word for word in text.replace(")", "").replace("(", "").split() if word.startswith("`docs/")]
    assert len(named) >= 4
    assert all((ROOT / word.strip("`,.;:?")).exists() for word in named)
