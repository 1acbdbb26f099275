"""`--device`: the sampler on the GPU where there is one, a clear refusal where there is none."""

import json
import os
import subprocess
import sys

import pytest

from strandline.testing.studies import write_study

COMMAND = [sys.executable, "-m", "strandline"]
PROBE = "import jax; print(jax.default_backend())"
SPY = """
import sys, jax
from strandline.cli import main
from strandline.smc import sampler
original, seen = sampler.spread, []

def spread(positions):
    there = original(positions)
    seen.append({device.platform for device in there.devices()})
    return there

sampler.spread = spread
main(sys.argv[1:])
assert seen == [{"gpu"}], seen
"""


def started(program, *arguments):
    """Return the end of a program that finds JAX as the machine has it, not as the tests set it."""
    clean = {name: value for name, value in os.environ.items() if name != "JAX_PLATFORMS"}
    return subprocess.run([*program, *arguments], capture_output=True, text=True, env=clean)


@pytest.fixture(scope="module")
def backend():
    return started([sys.executable, "-c", PROBE]).stdout.split()[-1]


@pytest.fixture
def folder(tmp_path):
    sampler = {"smc": {"particles": 1000, "rejuvenation_steps": 2, "zeta": 0.5}}
    return write_study(tmp_path / "study", design={"sobol": {"runs": 32}}, sampler=sampler, draft=True, report="none")


def test_a_gpu_that_is_not_there_is_refused_in_one_line(backend, folder):
    if backend == "gpu":
        pytest.skip("there is a GPU")
    ended = started(COMMAND, "run", str(folder), "--device", "gpu")
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith("strandline: --device: got gpu; expected a device that JAX has; here it is cpu.")
    assert [path.name for path in folder.iterdir()] == ["study.yaml"]


def test_the_sampler_runs_on_the_gpu(backend, folder):
    if backend != "gpu":
        pytest.skip("no GPU")
    means = []
    for program, command, device in (([sys.executable, "-c", SPY], "run", "gpu"), (COMMAND, "report", "cpu")):
        assert started(program, command, str(folder), "--quiet", "--device", device).returncode == 0
        (path,) = folder.rglob("summary.json")
        means.append({name: one["mean"] for name, one in json.loads(path.read_text())["inputs"].items()})
    assert means[0] == pytest.approx(means[1], rel=0.3)
