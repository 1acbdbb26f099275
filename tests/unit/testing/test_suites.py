"""The conformance suites run over the registries, so that a new entry is tested by being registered; and they fail."""

import re
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from strandline.design.active import CRITERIA
from strandline.discrepancy import DISCREPANCIES, ClosestPoint
from strandline.imaging import EDGES, PictureReading, PixelSize
from strandline.imaging.edges.edge_methods import ErfStep
from strandline.interface import NOISES, GaussianNoise, Interface
from strandline.models.protocol import Simulation
from strandline.parameters import PRIORS, Normal, Uniform
from strandline.readers import Contents, Reading
from strandline.runs import InProcess
from strandline.surrogate import fit_log_likelihood
from strandline.surrogate.kernels import KERNELS, Isotropic
from strandline.testing import criteria, discrepancies, edges, kernels, noise, pictures, priors, readers, surrogates
from strandline.testing.executors import CHECKS as EXECUTOR_CHECKS
from strandline.testing.executors import WAITING_CHECKS
from strandline.testing.simulators import CHECKS as SIMULATOR_CHECKS

HERE = "tests.unit.testing.test_suites"
NUMBERS = {"beta": (2.6, 1.4, 0.0, 110.0), "lognormal": (5.86, 0.4), "loguniform": (100.0, 800.0)}


def complaints(checks, entry, *more):
    """Return what the checks of a suite say of an entry."""
    said = []
    for check in checks.values():
        try:
            check(entry, *more)
        except AssertionError as error:
            said.append(str(error))
    return "; ".join(said)


def with_options(kind):
    """Return an entry with a positive number for every option without a default."""
    needed = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    return kind(**dict.fromkeys(needed, 0.05))


def learner(name):
    return lambda x, y: fit_log_likelihood(x, y, kernel=name).process


ENTRIES = [
    *((noise.CHECKS, with_options(kind)) for kind in NOISES.values()),
    *((priors.CHECKS, PRIORS[name](*NUMBERS.get(name, (1.0, 2.0)))) for name in PRIORS),
    *((discrepancies.CHECKS, with_options(kind)) for kind in DISCREPANCIES.values()),
    *((kernels.CHECKS, kernel) for kernel in KERNELS.values()),
    *((criteria.CHECKS, criterion) for criterion in CRITERIA.values()),
    *((surrogates.CHECKS, learner(name)) for name in list(KERNELS)[:2]),
    *((edges.CHECKS, EDGES[name]) for name in ("erf", "contour")),
]


def test_every_entry_of_a_registry_conforms():
    for checks, entry in ENTRIES:
        assert complaints(checks, entry) == "", entry


def half_read(path, how, name):
    """Read what is there, be it half a file."""
    rows = [line.split() for line in path.read_text("utf-8", errors="ignore").splitlines()]
    good = [row for row in rows if len(row) == 2]
    count = how.count or len(good)
    return Contents(np.resize(np.array(good, float), (count, 2)) + np.arange(count)[:, None])


def test_readers_conform_and_a_wrong_one_is_noticed(tmp_path):
    x = np.linspace(0.0, 1.0, 21)
    np.savetxt(tmp_path / "seen.csv", np.stack([x, x * (1 - x)], axis=1))
    np.save(tmp_path / "seen.npy", np.stack([x, x * (1 - x)], axis=1))
    for name in ("seen.csv", "seen.npy"):
        assert complaints(readers.CHECKS, tmp_path / name, Reading(name, "mm", columns=(1, 2))) == "", name
    how = Reading("seen.csv", "mm", reader=f"{HERE}:half_read")
    found = complaints(readers.CHECKS, tmp_path / "seen.csv", how)
    assert "half a file, whose points are counted, is read" in found


def test_readers_of_pictures_conform(tmp_path):
    grey, how = np.random.default_rng(1).integers(0, 255, (60, 80), "uint8"), PixelSize(0.008, 0.008, source="the test")
    for suffix in (".png", ".tif"):
        Image.fromarray(grey).save(tmp_path / f"seen{suffix}")
        assert complaints(pictures.CHECKS, tmp_path / f"seen{suffix}", PictureReading(pixel=how)) == "", suffix


@dataclass(frozen=True)
class OffBy(ErfStep):
    """An edge that is off, or too sure of itself."""

    far: float = 0.0
    sure: float = 1.0

    def locate(self, *given):
        found = super().locate(*given)
        scatter = replace(found.scatter, sd=found.scatter.sd / self.sure)
        return replace(found, offsets=found.offsets + self.far, sds=found.sds / self.sure, scatter=scatter)


def meddling(simulated, observed):
    value = float(((simulated.points - observed.points) ** 2).sum())
    simulated.points[0] += 0.0 if value == 0.0 else 1e-3
    return value


class Halved(ClosestPoint):
    """Returns half of d² from signed distances."""

    def of_offsets(self, *given):
        return 0.5 * super().of_offsets(*given)


ROUGH = Isotropic(  # its slope belongs to another correlation
    "rough",
    correlation=lambda s: 1 / (1 + s**2 / 2),
    slope=lambda s: -1 / (1 + s**2) ** 2,
    slope_rate=lambda s: 2 * s / (1 + s**2 / 2) ** 3,
)


@dataclass
class Restless:
    runs: int = 0

    def __call__(self, inputs, workdir):
        self.runs += 1
        Path("left.txt").write_text("")
        return Interface.polyline(np.array([[0.0, 0.0], [1.0, 1e-3 * self.runs]]))


@dataclass(frozen=True)
class Steep:
    """A line whose sensitivity is twice its derivative."""

    sensitivities: bool = False

    def __call__(self, inputs, workdir):
        line = Interface.polyline(np.array([[0.0, 0.0], [1.0, inputs["a"]]]))
        return Simulation.of(line, sensitivities={"a": np.array([[0.0, 0.0], [0.0, 2.0]])})


def wrong(kind, *numbers, **methods):
    """Return an entry of a kind with another method."""
    return type("Wrong", (kind,), methods)(*numbers)


def less_by_half(prior, x):
    return Uniform.log_density(prior, x) - np.log(2.0)


def the_first(state, candidates, *_):
    return lambda exploring: candidates[0]


INPUTS = {"a": 0.5}
WRONG = [
    (noise.CHECKS, (wrong(GaussianNoise, 2.0, log_density=lambda noise, d2: -d2 / noise.variance),), "not 0.5"),
    (priors.CHECKS, (wrong(Uniform, 0.0, 1.0, log_density=less_by_half),), "integrates to 0.49"),
    (priors.CHECKS, (wrong(Normal, 0.0, 1.0, quantile=lambda prior, p: Normal.quantile(prior, p) + 1.0),), "is not p"),
    (discrepancies.CHECKS, (meddling,), "second call|changes the simulated"),
    (discrepancies.CHECKS, (Halved(),), "from signed distances is another"),
    (kernels.CHECKS, (ROUGH,), "Hessian is not the value"),
    (criteria.CHECKS, (the_first,), "none of the points .*picked twice"),
    (edges.CHECKS, (OffBy(far=0.5, passes=1),), "^(?!.*standard deviation).*0.5 pixels off, with a bias of 0.1"),
    (edges.CHECKS, (OffBy(sure=4.0),), "^the stated standard deviation is 0."),
    (SIMULATOR_CHECKS, (Restless(), INPUTS), "another interface.*left.txt"),
    (SIMULATOR_CHECKS, (Steep(), INPUTS), "to a is no derivative"),
]


def test_a_wrong_entry_is_noticed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for checks, given, words in WRONG:
        assert re.search(words, complaints(checks, *given)), given


class Nearest:
    """The value of the nearest run: a surrogate that learns badly."""

    def __init__(self, x, y):
        self.x, self.y = x, y

    def mean(self, x):
        return np.asarray(self.y[((x[:, None] - self.x) ** 2).sum(axis=2).argmin(axis=1)])

    def variance(self, x):
        return np.ones(len(x))


class Shy(Nearest):
    """It draws what it predicts to zero, and judges points by their fellows."""

    def mean(self, x):
        return 0.9 * super().mean(x) + 0.1 * x[:, 0].mean()

    def variance(self, x):
        return -np.ones(len(x))


def test_a_bad_surrogate_is_noticed():
    for learn, planted in (
        (Nearest, ["it errs by", "other units"]),
        (Shy, ["a variance is negative", "depends on the points beside it", "a constant added"]),
    ):
        found = complaints(surrogates.CHECKS, learn)
        assert all(words in found for words in planted), found


RUN = InProcess()


def test_the_executor_in_this_process_conforms():
    for check in EXECUTOR_CHECKS.values():
        check(RUN, workers=1)


BROKEN = [
    ("pulls_when_a_worker_is_free", lambda model, requests: RUN(model, list(requests))),
    ("answers_each_request_once", lambda model, requests: iter(list(RUN(model, requests))[:-1])),
    ("yields_in_order_of_completion", lambda model, requests: reversed(list(RUN(model, requests)))),
    ("waits_for_what_follows", RUN),
]


def test_the_suite_catches_a_broken_executor():
    for caught_by, broken in BROKEN:
        with pytest.raises(AssertionError):
            (EXECUTOR_CHECKS | WAITING_CHECKS)[caught_by](broken, workers=1)
