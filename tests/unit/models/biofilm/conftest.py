"""A mesh with a third of the elements of ``coarse``, for what holds on every mesh."""

from collections.abc import Iterator

import pytest

from strandline.models.biofilm.sizes import FINER, MESHES, MeshSize


@pytest.fixture(scope="module", autouse=True)
def _rough_mesh() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FINER, "rough", MESHES["coarse"])
        patch.setitem(MESHES, "rough", MeshSize(far=0.5, interface=0.3, foot=0.1, grading=0.7))
        yield
