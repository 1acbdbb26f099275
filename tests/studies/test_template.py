"""The study that `strandline init` writes says of the built-in model's inputs what the model says."""

from pathlib import Path

from strandline.models.biofilm.model import Biofilm
from strandline.studies import load_study
from strandline.studies.template import write_template


def test_it_loads_and_its_comments_are_the_models_meanings(tmp_path: Path) -> None:
    path = write_template(tmp_path / "study")
    assert load_study(path.parent).name == "study"
    lines = path.read_text("utf-8").splitlines()
    for item in Biofilm().inputs:
        (line,) = (line for line in lines if line.lstrip().startswith((f"{item.name}:", f"fixed: {{{item.name}:")))
        comment = line.partition("#")[2].strip()
        assert comment.startswith(item.meaning), comment
        assert item.unit == "1" or item.unit in line
