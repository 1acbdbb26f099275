"""A mesh with a third of the elements of ``coarse``, for what holds on every mesh; a module of a third party."""

import pytest
from tests.unit.models.biofilm.cells import OWN

from strandline.models.biofilm.mesh.geometry import FINER, MESHES, MeshSize


@pytest.fixture(scope="module", autouse=True)
def _rough_mesh():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FINER, "rough", MESHES["coarse"])
        patch.setitem(MESHES, "rough", MeshSize(far=0.5, interface=0.3, foot=0.1, grading=0.7))
        yield


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "our_model.py").write_text(OWN, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return "our_model"
