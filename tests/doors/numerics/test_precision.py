"""Double precision is switched on for a process that begins without it."""

import subprocess
import sys

PROGRAM = """
import jax
import strandline as sl
from strandline.foundations import use_double

assert not jax.config.jax_enable_x64
use_double()
assert jax.numpy.ones(()).dtype == "float64"
"""


def test_it_is_switched_on_for_the_process(monkeypatch):
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)
