"""Unknown errors of points: what is refused, and what the message asks for."""

import pytest
from tests.discrepancy.surfaces import sheet

from strandline.errors import InvalidInput
from strandline.interface import UnknownErrors


@pytest.mark.parametrize(
    ("noise", "said", "remedy"),
    [
        (UnknownErrors(), "got unknown", "State them"),
        (UnknownErrors(0.003, None, model_error=True), "got unknown", "State them"),
        (UnknownErrors(0.003, 0.015, model_error=True), "got a model error", "Remove `model_error` and `spread`."),
        (UnknownErrors(0.003, 0.015, spread=(0,)), "got a spread", "Remove `model_error` and `spread`."),
    ],
)
def test_nothing_is_inferred_on_a_surface(noise: UnknownErrors, said: str, remedy: str) -> None:
    with pytest.raises(InvalidInput, match=said) as caught:
        noise.require_fits(sheet(5))
    assert remedy in str(caught.value)
