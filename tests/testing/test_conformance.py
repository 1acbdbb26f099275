"""The conformance suites run over the registries, so that a new entry is tested by being registered; and they fail."""

import math
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from PIL import Image
from tests.models.test_umbridge_client import JACOBIAN, running
from tests.models.test_umbridge_client import model as served_model
from tests.readers.test_meshes import TETRA, VTP_ASCII, grid, pvd

from strandline.design.active import CRITERIA
from strandline.discrepancy import DISCREPANCIES, ClosestPoint
from strandline.imaging import EDGES, Located, PictureFile, PictureReading, PixelSize
from strandline.imaging.erf_step import ErfStep
from strandline.imaging.markov_path import MarkovPath
from strandline.interface import NOISES, GaussianNoise, Interface
from strandline.models import MODELS
from strandline.models.biofilm.model import Biofilm
from strandline.models.command.model import CommandModel
from strandline.models.protocol import ForwardModel, Simulation
from strandline.models.python import PythonModel
from strandline.models.umbridge.server import UMBridgeServer
from strandline.priors import PRIORS, Normal, Uniform
from strandline.readers import READERS, Contents, Reading
from strandline.surrogate import fit_log_likelihood
from strandline.surrogate.kernels import KERNELS, Isotropic, Kernel
from strandline.testing import (
    criteria,
    discrepancies,
    edges,
    kernels,
    noise,
    pictures,
    priors,
    readers,
    simulators,
    surrogates,
)
from strandline.testing.models import Cantilever

NUMBERS = {"beta": (2.6, 1.4, 0.0, 110.0), "lognormal": (5.86, 0.4), "normal": (3.0, 2.0), "uniform": (100.0, 800.0)}
NUMBERS |= {"loguniform": (100.0, 800.0)}
OPTIONS = {"currents": {"width": 0.05}}


def options_of(kind: type) -> dict[str, Any]:
    """Return a positive number for every option without a default."""
    from dataclasses import MISSING

    return {f.name: 0.05 for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}


@pytest.mark.parametrize("check", noise.CHECKS.values(), ids=noise.CHECKS)
@pytest.mark.parametrize("name", NOISES)
def test_every_noise_model(name: str, check: Any) -> None:
    check(NOISES[name](**options_of(NOISES[name])))


@pytest.mark.parametrize("check", priors.CHECKS.values(), ids=priors.CHECKS)
@pytest.mark.parametrize("name", PRIORS)
def test_every_prior(name: str, check: Any) -> None:
    check(PRIORS[name](*NUMBERS.get(name, (1.0, 2.0))))


@pytest.mark.parametrize("check", discrepancies.CHECKS.values(), ids=discrepancies.CHECKS)
@pytest.mark.parametrize("name", DISCREPANCIES)
def test_every_discrepancy(name: str, check: Any) -> None:
    check(DISCREPANCIES[name](**(OPTIONS.get(name) or options_of(DISCREPANCIES[name]))))


@pytest.mark.parametrize("name", KERNELS)
def test_every_kernel(name: str) -> None:
    for check in kernels.CHECKS.values():
        check(KERNELS[name])


@pytest.mark.parametrize("name", KERNELS)
def test_the_gaussian_process_with_every_kernel(name: str) -> None:
    for check in surrogates.CHECKS.values():
        check(lambda x, y: fit_log_likelihood(x, y, kernel=name).process)


@pytest.mark.parametrize("name", CRITERIA)
def test_every_criterion(name: str) -> None:
    for check in criteria.CHECKS.values():
        check(CRITERIA[name])


PIECES = '<VTKFile type="PPolyData"><PPolyData><Piece Source="line.vtp"/></PPolyData></VTKFile>'


def example_file(suffix: str, folder: Path) -> Path:
    """Return the path of a whole file of that suffix."""
    path, x = folder / f"seen{suffix}", np.linspace(0.0, 1.0, 21)
    if suffix in (".csv", ".tsv", ".txt", ".dat"):
        np.savetxt(path, np.stack([x, x * (1 - x)], axis=1))
    elif suffix == ".npy":
        np.save(path, np.stack([x, x * (1 - x)], axis=1))
    elif suffix == ".pvd":
        path = pvd(folder)
    elif suffix == ".vtp":
        path.write_text(VTP_ASCII)
    elif suffix == ".pvtp":
        (folder / "line.vtp").write_text(VTP_ASCII)
        path.write_text(PIECES)
    elif suffix == ".pvtu":
        meshio.vtu.write(str(folder / "line.vtp"), grid())
        path.write_text(PIECES.replace("PPolyData", "PUnstructuredGrid"))
    elif suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(path), grid(), data_format="XML")
    elif suffix in (".stl", ".ply"):
        meshio.write_points_cells(str(path), TETRA, [("triangle", [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])])
    else:
        meshio.write(str(path), grid())
    return path


WITH_LINES = (".vtu", ".pvtu", ".pvd", ".xdmf", ".xmf", ".vtk")


@pytest.mark.parametrize("suffix", READERS)
def test_every_reader(suffix: str, tmp_path: Path) -> None:
    path = example_file(suffix, tmp_path)
    how = Reading(path.name, "mm", block="line" if suffix in WITH_LINES else None)
    for check in readers.CHECKS.values():
        check(path, how)


PIXEL = PixelSize(0.008, 0.008, source="the test")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
def test_readers_of_pictures(suffix: str, tmp_path: Path) -> None:
    path, grey = tmp_path / f"seen{suffix}", np.random.default_rng(1).integers(0, 255, (60, 80), "uint8")
    if suffix == ".npy":
        np.save(path, grey)
    else:
        Image.fromarray(grey).save(path)
    for check in pictures.CHECKS.values():
        check(path, PictureReading(pixel=PIXEL))


def squeezed(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Read as many rows as are there."""
    values = np.fromfile(path, "u1")
    rows = max(len(values) // 80, 1)
    return PictureFile((rows, 80), lambda frame: np.resize(values if len(values) else [0, 1], (rows, 80)))


def test_a_wrong_reader_of_pictures_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "seen.raw"
    path.write_bytes(np.random.default_rng(1).bytes(4800))
    how = PictureReading(pixel=PIXEL, reader="tests.testing.test_conformance:squeezed")
    assert complaints(pictures.CHECKS, path, how) == "an empty file is read"


CAMERA = {**EDGES, "path": MarkovPath(likelihood="gaussian")}


@pytest.mark.parametrize("name", CAMERA)
def test_every_edge_method(name: str) -> None:
    for check in edges.CHECKS.values():
        check(CAMERA[name])


@dataclass(frozen=True)
class OffBy(ErfStep):
    """An edge that is off, or too sure of itself."""

    far: float = 0.0
    sure: float = 1.0

    def locate(self, picture: Any, course: Any, counted: Any) -> Located:
        found = super().locate(picture, course, counted)
        scatter = replace(found.scatter, sd=found.scatter.sd / self.sure)
        return replace(found, offsets=found.offsets + self.far, sds=found.sds / self.sure, scatter=scatter)


def test_wrong_edge_methods_are_noticed() -> None:
    assert complaints(edges.CHECKS, ErfStep()) == ""
    far = complaints(edges.CHECKS, OffBy(far=0.5, passes=1))
    assert "0.5 pixels off, with a bias of 0.1" in far
    assert "standard deviation" not in far
    sure = complaints(edges.CHECKS, OffBy(sure=4.0))
    assert sure.startswith("the stated standard deviation is 0.")


BEAM = {"E": 400.0, "load": 1e-5}
ECHO = "import sys; e, f = map(float, sys.argv[1:]); print('0,0', f'1,{f * 1e5 / e:.17g}', '2,0', sep='\\n')"


def cantilever(inputs: Mapping[str, float], workdir: Path) -> Interface:
    """Return the outline of a bent beam."""
    return Cantilever()(inputs, workdir).interface


@pytest.fixture(params=MODELS)
def simulator(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[ForwardModel, dict[str, float]]]:
    """A model of each kind, and inputs of a run."""
    if request.param == "biofilm":
        yield Biofilm(mesh="coarse"), {"E": 400.0, "nu": 0.3, "V_in": 100.0}
    elif request.param == "python":
        yield PythonModel("tests.testing.test_conformance:cantilever"), BEAM
    elif request.param == "umbridge":
        with running(UMBridgeServer([JACOBIAN], port=0)) as url:
            yield served_model(url), BEAM
    else:
        assert request.param == "command", f"no example of `{request.param}` here: add one"
        (tmp_path / "echo.py").write_text(ECHO)
        command = [sys.executable, "echo.py", "{{ E }}", "{{ load }}"]
        result = {"file": "command.log", "unit": "mm"}
        yield CommandModel(command=command, result=result, files=["echo.py"], folder=tmp_path), BEAM


@pytest.mark.parametrize("check", simulators.CHECKS.values(), ids=simulators.CHECKS)
def test_every_simulator(simulator: tuple[ForwardModel, dict[str, float]], check: Any) -> None:
    check(*simulator)


def complaints(checks: Mapping[str, Any], wrong: Any, *more: Any) -> str:
    """Return what the checks of a suite say of an entry."""
    said = []
    for check in checks.values():
        try:
            check(wrong, *more)
        except AssertionError as error:
            said.append(str(error))
    return "; ".join(said)


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


@pytest.mark.parametrize(
    ("wrong", "words"), [(Forgetful(2.0), "density of 2 residuals integrates to"), (Doubled(2.0), "not 0.5")]
)
def test_a_wrong_noise_model_is_noticed(wrong: GaussianNoise, words: str) -> None:
    assert re.search(words, complaints(noise.CHECKS, wrong))


class Wide(Uniform):
    """Its density belongs to a box of twice the width."""

    def log_density(self, x: Any) -> Any:
        return super().log_density(x) - math.log(2.0)


class Shifted(Normal):
    """Its quantiles are those of another mean."""

    def quantile(self, p: Any) -> Any:
        return super().quantile(p) + 1.0


@pytest.mark.parametrize(("wrong", "words"), [(Wide(0.0, 1.0), "integrates to 0.49"), (Shifted(0.0, 1.0), "is not p")])
def test_a_wrong_prior_is_noticed(wrong: Any, words: str) -> None:
    assert re.search(words, complaints(priors.CHECKS, wrong))


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


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (Signed(), "d² is -"),
        (Meddling(), "second call|changes the simulated"),
        (Halved(), "from signed distances is another"),
    ],
)
def test_a_wrong_discrepancy_is_noticed(wrong: Any, words: str) -> None:
    assert re.search(words, complaints(discrepancies.CHECKS, wrong))


ROUGH = Isotropic(
    "rough",
    correlation=lambda s: 1 / (1 + s**2 / 2),
    slope=lambda s: -1 / (1 + s**2) ** 2,
    slope_rate=lambda s: 2 * s / (1 + s**2 / 2) ** 3,
)
"""Its slope belongs to another correlation."""


def test_a_wrong_kernel_is_noticed() -> None:
    kernel: Kernel = ROUGH
    assert "gradient is not that of the value" in complaints(kernels.CHECKS, kernel)


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


def forgetful(state: Any, candidates: np.ndarray, unknown: np.ndarray, targets: np.ndarray) -> Any:
    """Pick the same candidate again and again, and none to explore."""
    return lambda exploring: candidates[0]


def test_a_wrong_criterion_is_noticed() -> None:
    assert re.search("none of the points .*picked twice", complaints(criteria.CHECKS, forgetful))


def half_read(path: Path, how: Reading, name: str) -> Contents:
    """Read what is there, be it half a file."""
    rows = [line.split() for line in path.read_text("utf-8", errors="ignore").splitlines()]
    good = [row for row in rows if len(row) == 2]
    count = how.count or len(good)
    return Contents(np.resize(np.array(good, float), (count, 2)) + np.arange(count)[:, None])


def test_a_wrong_reader_is_noticed(tmp_path: Path) -> None:
    path = example_file(".txt", tmp_path)
    how = Reading(path.name, "mm", reader="tests.testing.test_conformance:half_read")
    assert "half a file, whose points are counted, is read" in complaints(readers.CHECKS, path, how)


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


@pytest.mark.parametrize(
    ("wrong", "words"), [(Restless(), "another interface.*left.txt"), (Steep(), "to a is no derivative")]
)
def test_a_wrong_simulator_is_noticed(wrong: Any, words: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert re.search(words, complaints(simulators.CHECKS, wrong, {"a": 0.5}))
