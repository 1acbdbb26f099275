"""The conformance suites run over the registries, so that a new entry is tested by being registered; and they fail."""

import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from PIL import Image

from strandline.design.active import CRITERIA
from strandline.discrepancy import DISCREPANCIES, ClosestPoint
from strandline.imaging import EDGES, Located, PictureFile, PictureReading, PixelSize
from strandline.imaging.erf_step import ErfStep
from strandline.imaging.markov_path import MarkovPath
from strandline.interface import NOISES, GaussianNoise, Interface
from strandline.models.protocol import Simulation
from strandline.priors import PRIORS, Normal, Uniform
from strandline.readers import READERS, Contents, Reading
from strandline.surrogate import fit_log_likelihood
from strandline.surrogate.kernels import KERNELS, Isotropic
from strandline.testing import criteria, discrepancies, edges, kernels, noise, pictures, priors, readers, surrogates
from strandline.testing.simulators import CHECKS as SIMULATOR_CHECKS

HERE = "tests.unit.testing.test_suites"
NUMBERS = {"beta": (2.6, 1.4, 0.0, 110.0), "lognormal": (5.86, 0.4), "normal": (3.0, 2.0), "uniform": (100.0, 800.0)}
NUMBERS |= {"loguniform": (100.0, 800.0)}
CAMERA = {**EDGES, "path": MarkovPath(likelihood="gaussian")}


def complaints(checks: Mapping[str, Any], entry: Any, *more: Any) -> str:
    """Return what the checks of a suite say of an entry."""
    said = []
    for check in checks.values():
        try:
            check(entry, *more)
        except AssertionError as error:
            said.append(str(error))
    return "; ".join(said)


def with_options(kind: type) -> Any:
    """Return an entry with a positive number for every option without a default."""
    needed = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    return kind(**dict.fromkeys(needed, 0.05))


def learner(name: str) -> Any:
    return lambda x, y: fit_log_likelihood(x, y, kernel=name).process


ENTRIES = [
    *((noise.CHECKS, with_options(kind)) for kind in NOISES.values()),
    *((priors.CHECKS, PRIORS[name](*NUMBERS.get(name, (1.0, 2.0)))) for name in PRIORS),
    *((discrepancies.CHECKS, with_options(kind)) for kind in DISCREPANCIES.values()),
    *((kernels.CHECKS, kernel) for kernel in KERNELS.values()),
    *((criteria.CHECKS, criterion) for criterion in CRITERIA.values()),
    *((surrogates.CHECKS, learner(name)) for name in list(KERNELS)[:2]),
    *((edges.CHECKS, method) for method in CAMERA.values()),
]


def test_every_entry_of_a_registry_conforms() -> None:
    for checks, entry in ENTRIES:
        assert complaints(checks, entry) == "", entry


X, Y = np.meshgrid(np.arange(5.0), np.arange(3.0))
CORNERS = np.array([5 * j + i for j in range(2) for i in range(4)])
TRIANGLES = np.concatenate([CORNERS[:, None] + [0, 1, 6], CORNERS[:, None] + [0, 6, 5]])
TOP = 10 + np.stack([np.arange(4), np.arange(1, 5)], axis=1)
GRID = meshio.Mesh(np.stack([X.ravel(), Y.ravel(), 0 * X.ravel()], axis=1), [("triangle", TRIANGLES), ("line", TOP)])
TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = [("triangle", [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])]
LINE = """<VTKFile type="PolyData" version="0.1"><PolyData><Piece NumberOfPoints="3" NumberOfVerts="0" NumberOfLines="1"
NumberOfPolys="0"><Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 2 1 0</DataArray>
</Points><Lines><DataArray type="Int32" Name="connectivity">0 1 2</DataArray><DataArray type="Int32" Name="offsets">3
</DataArray></Lines></Piece></PolyData></VTKFile>"""
PIECES = '<VTKFile type="P{kind}"><P{kind}><Piece Source="piece"/></P{kind}></VTKFile>'
SERIES = '<VTKFile type="Collection"><Collection><DataSet timestep="0" part="0" file="0.vtu"/></Collection></VTKFile>'
WITH_LINES = (".vtu", ".pvtu", ".pvd", ".xdmf", ".xmf", ".vtk")


def example_file(suffix: str, folder: Path) -> Path:
    """Return the path of a whole file of that suffix."""
    path, x = folder / f"seen{suffix}", np.linspace(0.0, 1.0, 21)
    if suffix in (".csv", ".tsv", ".txt", ".dat"):
        np.savetxt(path, np.stack([x, x * (1 - x)], axis=1))
    elif suffix == ".npy":
        np.save(path, np.stack([x, x * (1 - x)], axis=1))
    elif suffix == ".pvd":
        meshio.vtu.write(str(folder / "0.vtu"), GRID)
        path.write_text(SERIES)
    elif suffix == ".vtp":
        path.write_text(LINE)
    elif suffix == ".pvtp":
        (folder / "piece").write_text(LINE)
        path.write_text(PIECES.format(kind="PolyData"))
    elif suffix == ".pvtu":
        meshio.vtu.write(str(folder / "piece"), GRID)
        path.write_text(PIECES.format(kind="UnstructuredGrid"))
    elif suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(path), GRID, data_format="XML")
    elif suffix in (".stl", ".ply"):
        meshio.write_points_cells(str(path), TETRA, FACES)
    else:
        meshio.write(str(path), GRID)
    return path


def test_every_reader_conforms(tmp_path: Path) -> None:
    for suffix in READERS:
        path = example_file(suffix, tmp_path)
        how = Reading(path.name, "mm", block="line" if suffix in WITH_LINES else None)
        assert complaints(readers.CHECKS, path, how) == "", suffix


def half_read(path: Path, how: Reading, name: str) -> Contents:
    """Read what is there, be it half a file."""
    rows = [line.split() for line in path.read_text("utf-8", errors="ignore").splitlines()]
    good = [row for row in rows if len(row) == 2]
    count = how.count or len(good)
    return Contents(np.resize(np.array(good, float), (count, 2)) + np.arange(count)[:, None])


PIXEL = PixelSize(0.008, 0.008, source="the test")


def squeezed(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Read as many rows as are there."""
    values = np.fromfile(path, "u1")
    rows = max(len(values) // 80, 1)
    return PictureFile((rows, 80), lambda frame: np.resize(values if len(values) else [0, 1], (rows, 80)))


def test_readers_of_pictures_conform_and_a_wrong_one_is_noticed(tmp_path: Path) -> None:
    grey = np.random.default_rng(1).integers(0, 255, (60, 80), "uint8")
    for suffix in (".png", ".tif", ".npy"):
        path = tmp_path / f"seen{suffix}"
        np.save(path, grey) if suffix == ".npy" else Image.fromarray(grey).save(path)
        assert complaints(pictures.CHECKS, path, PictureReading(pixel=PIXEL)) == "", suffix
    path = tmp_path / "seen.raw"
    path.write_bytes(grey.tobytes())
    how = PictureReading(pixel=PIXEL, reader=f"{HERE}:squeezed")
    assert complaints(pictures.CHECKS, path, how) == "an empty file is read"


@dataclass(frozen=True)
class OffBy(ErfStep):
    """An edge that is off, or too sure of itself."""

    far: float = 0.0
    sure: float = 1.0

    def locate(self, picture: Any, course: Any, counted: Any) -> Located:
        found = super().locate(picture, course, counted)
        scatter = replace(found.scatter, sd=found.scatter.sd / self.sure)
        return replace(found, offsets=found.offsets + self.far, sds=found.sds / self.sure, scatter=scatter)


@dataclass(frozen=True)
class Forgetful(GaussianNoise):
    """Its constant does not count the residuals."""

    def constant(self, terms: int) -> float:
        return -0.5 * math.log(2 * math.pi * self.variance)


@dataclass(frozen=True)
class Doubled(GaussianNoise):
    """It counts the misfit twice."""

    def log_density(self, squared: np.ndarray) -> np.ndarray:
        return np.asarray(-squared / self.variance)


class Wide(Uniform):
    """Its density belongs to a box of twice the width."""

    def log_density(self, x: Any) -> Any:
        return super().log_density(x) - math.log(2.0)


class Shifted(Normal):
    """Its quantiles are those of another mean."""

    def quantile(self, p: Any) -> Any:
        return super().quantile(p) + 1.0


@dataclass(frozen=True)
class Signed:
    """A mean difference, which may be negative, as if it were a squared distance."""

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return float((observed.points - simulated.points).mean())


@dataclass(frozen=True)
class Meddling:
    """Moves the interface that it is given."""

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        value = float(((simulated.points - observed.points) ** 2).sum())
        simulated.points[0] += 0.0 if value == 0.0 else 1e-3
        return value


@dataclass(frozen=True)
class Halved(ClosestPoint):
    """Returns half of d² from signed distances."""

    def of_offsets(self, offsets: np.ndarray, observed: Interface, nodes: int) -> np.ndarray:
        return 0.5 * super().of_offsets(offsets, observed, nodes)


ROUGH = Isotropic(
    "rough",
    correlation=lambda s: 1 / (1 + s**2 / 2),
    slope=lambda s: -1 / (1 + s**2) ** 2,
    slope_rate=lambda s: 2 * s / (1 + s**2 / 2) ** 3,
)
"""Its slope belongs to another correlation."""


def forgetful(state: Any, candidates: np.ndarray, unknown: np.ndarray, targets: np.ndarray) -> Any:
    """Pick the same candidate again and again, and none to explore."""
    return lambda exploring: candidates[0]


@dataclass
class Restless:
    """Another interface at each run, and a file left behind."""

    runs: int = 0

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Interface:
        self.runs += 1
        Path("left.txt").write_text("")
        return Interface.polyline(np.array([[0.0, 0.0], [1.0, 1e-3 * self.runs]]))


@dataclass(frozen=True)
class Steep:
    """A line whose sensitivity is twice its derivative."""

    sensitivities: bool = False

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        line = Interface.polyline(np.array([[0.0, 0.0], [1.0, inputs["a"]]]))
        return Simulation.of(line, sensitivities={"a": np.array([[0.0, 0.0], [0.0, 2.0]])})


INPUTS = {"a": 0.5}
WRONG = [
    (noise.CHECKS, (Forgetful(2.0),), "density of 2 residuals integrates to"),
    (noise.CHECKS, (Doubled(2.0),), "not 0.5"),
    (priors.CHECKS, (Wide(0.0, 1.0),), "integrates to 0.49"),
    (priors.CHECKS, (Shifted(0.0, 1.0),), "is not p"),
    (discrepancies.CHECKS, (Signed(),), "d² is -"),
    (discrepancies.CHECKS, (Meddling(),), "second call|changes the simulated"),
    (discrepancies.CHECKS, (Halved(),), "from signed distances is another"),
    (kernels.CHECKS, (ROUGH,), "gradient is not that of the value"),
    (criteria.CHECKS, (forgetful,), "none of the points .*picked twice"),
    (edges.CHECKS, (OffBy(far=0.5, passes=1),), "^(?!.*standard deviation).*0.5 pixels off, with a bias of 0.1"),
    (edges.CHECKS, (OffBy(sure=4.0),), "^the stated standard deviation is 0."),
    (SIMULATOR_CHECKS, (Restless(), INPUTS), "another interface.*left.txt"),
    (SIMULATOR_CHECKS, (Steep(), INPUTS), "to a is no derivative"),
]


def test_a_wrong_entry_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for checks, wrong, words in WRONG:
        assert re.search(words, complaints(checks, *wrong)), wrong
    path = example_file(".txt", tmp_path)
    how = Reading(path.name, "mm", reader=f"{HERE}:half_read")
    assert "half a file, whose points are counted, is read" in complaints(readers.CHECKS, path, how)


class Nearest:
    """The value of the nearest run: a surrogate that learns badly."""

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        self.x, self.y = x, y

    def mean(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(self.y[((x[:, None] - self.x) ** 2).sum(axis=2).argmin(axis=1)])

    def variance(self, x: np.ndarray) -> np.ndarray:
        return np.ones(len(x))


class Shy(Nearest):
    """It draws what it predicts to zero, and judges points by their fellows."""

    def mean(self, x: np.ndarray) -> np.ndarray:
        return 0.9 * super().mean(x) + 0.1 * x[:, 0].mean()

    def variance(self, x: np.ndarray) -> np.ndarray:
        return -np.ones(len(x))


def test_a_bad_surrogate_is_noticed() -> None:
    assert "it errs by" in complaints(surrogates.CHECKS, Nearest)
    assert "other units" in complaints(surrogates.CHECKS, Nearest)
    found = complaints(surrogates.CHECKS, Shy)
    for planted in ("a variance is negative", "depends on the points beside it", "a constant added"):
        assert planted in found
    assert "has no" in complaints(surrogates.CHECKS, lambda x, y: np.mean)
    random = np.random.default_rng(1)
    assert "another surrogate" in complaints(surrogates.CHECKS, lambda x, y: Nearest(x, y + random.normal(size=len(y))))
