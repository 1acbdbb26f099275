"""Double precision is switched on by what needs it."""

import subprocess
import sys

import jax
import pytest

from strandline.errors import InvalidInput
from strandline.numerics.precision import use_double

PROGRAM = """
import jax
import strandline as sl
from strandline.numerics.precision import use_double

assert not jax.config.jax_enable_x64
use_double()
assert jax.numpy.ones(()).dtype == "float64"
"""


def test_it_is_switched_on_for_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)


def test_where_it_cannot_be_switched_on_it_is_refused() -> None:
    with jax.enable_x64(False), pytest.raises(InvalidInput, match="float32"):
        use_double()
