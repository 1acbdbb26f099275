"""Double precision is switched on by what needs it."""

import jax
import pytest

from strandline.errors import InvalidInput
from strandline.numerics.precision import use_double


def test_where_it_cannot_be_switched_on_it_is_refused() -> None:
    with jax.enable_x64(False), pytest.raises(InvalidInput, match="float32"):
        use_double()
