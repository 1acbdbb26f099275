"""The table of the meshes on other outlines, with the next finer mesh in place of the reference."""

import pytest

from strandline.models.biofilm.sizes import FINER, MESHES
from verification.validation import mesh_on_other_outlines as program


@pytest.mark.long
def test_the_estimate_is_the_difference_to_the_next_finer_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "REFERENCE", FINER["coarse"])
    monkeypatch.setattr(program, "MESHES", {"coarse": MESHES["coarse"]})
    (row,) = program.table([next(iter(program.CASES))]).rows
    found = dict(zip(program.table([]).columns, row, strict=True))
    assert found["mesh"] == "coarse"
    assert found["estimate by check, µm"] == found["true error, µm"] > 0
    assert found["true error, %"] == pytest.approx(
        100 * found["true error, µm"] / found["largest displacement, µm"], rel=1e-12
    )


def test_the_outlines_are_not_the_studys() -> None:
    assert len(program.CASES) >= 3
    prints = {model.fingerprint for model, _ in program.CASES.values()}
    assert len(prints) == len(program.CASES)
    assert not any(mark.endswith("mesh=default") for mark in prints)
