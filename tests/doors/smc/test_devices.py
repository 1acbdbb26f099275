"""Particles on several devices; JAX settles their number when it starts, so each case has its own process."""

import json
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib, json, sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
import numpy as np
from strandline.smc import SMCSettings, sample
from strandline.smc.sampler import spread
from tests.densities import gaussian

target = gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
initial = target.draw_prior(np.random.default_rng(0), int(sys.argv[2]))
given = jax.random.key(1), target.log_likelihood, target.log_prior, initial
found = [sample(*given, settings=SMCSettings()) for _ in "ab"]
print(json.dumps({
    "devices": len(spread(jax.numpy.asarray(initial)).sharding.device_set),
    "mean": (np.exp(found[0].log_weights) @ found[0].positions).tolist(),
    "log_evidence": found[0].log_evidence - target.log_evidence,
    "bits": [hashlib.sha256(r.positions.tobytes() + r.log_weights.tobytes()).hexdigest() for r in found],
}))
"""


def sampled(devices, particles):
    command = [sys.executable, "-c", PROGRAM, str(devices), str(particles)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_two_devices_find_what_one_finds_and_repeat_it_to_the_bit():
    """Particles that two devices cannot share alike stay on one."""
    one, two = sampled(1, 2000), sampled(2, 2000)
    assert (one["devices"], two["devices"], sampled(2, 401)["devices"]) == (1, 2, 1)
    assert two["bits"][0] == two["bits"][1]
    for found in (one, two):
        assert found["mean"] == pytest.approx([1.0, -2.0], abs=0.12)
        assert found["log_evidence"] == pytest.approx(0.0, abs=0.3)
