"""Names, units and numbers as text: what passes, and what does not."""

import pytest

from strandline.errors import InvalidInput
from strandline.text import decimal, is_label, is_name, require_label, require_name, with_sd


@pytest.mark.parametrize("name", ["E", "V_in", "ν", "E modulus", "a.b", "k[0]", "é" * 64])
def test_names(name: str) -> None:
    assert is_name(name)
    require_name("name", name)


@pytest.mark.parametrize(
    "name", ["", " E", "E ", "a/b", "a\\b", "a=b", "a$b", ".", "..", "a\nb", "a\0b", "a\u202eb", "a" * 65, "\ud800"]
)
def test_no_names(name: str) -> None:
    assert not is_name(name)
    with pytest.raises(InvalidInput) as caught:
        require_name("name of an input", name)
    assert str(caught.value).isprintable()


def test_reserved_names() -> None:
    with pytest.raises(InvalidInput, match="draw, chain"):
        require_name("name", "draw", reserved=("draw", "chain"))
    require_name("name", "drawn", reserved=("draw",))


@pytest.mark.parametrize("text", ["", "1", "Pa", "mm²/s", "kg/(m·s)", "µm", "%", "<b>"])
def test_labels(text: str) -> None:
    assert is_label(text)


@pytest.mark.parametrize("text", ["$\\frac{$", "a$b", "m\ns", "\x1b[2J", "m" * 65])
def test_no_labels(text: str) -> None:
    with pytest.raises(InvalidInput, match="unit of E"):
        require_label("unit of E", text)


@pytest.mark.parametrize(("text", "value"), [("1e-5", 1e-5), ("+3", 3.0), ("5.", 5.0), (".5E+2", 50.0), ("-0", 0.0)])
def test_numbers(text: str, value: float) -> None:
    assert decimal(text) == value


@pytest.mark.parametrize("text", ["1_0", "١٢", "nan", "inf", "", " 1", "1e", "0x1", "1,5", "³", "1e5\n"])
def test_no_numbers(text: str) -> None:
    assert decimal(text) is None


@pytest.mark.parametrize(
    ("mean", "sd", "shown"),
    [
        (399.62, 15.34, "400 ± 15"), (580.4, 103.0, "580 ± 103"), (0.2971, 0.0588, "0.297 ± 0.059"),
        (404.31, 8.26, "404.3 ± 8.3"), (1.0, 0.0, "1 ± 0"), (2e-7, 3e-8, "2e-07 ± 3e-08"),
    ],
)  # fmt: skip
def test_a_mean_has_the_decimals_of_its_standard_deviation(mean: float, sd: float, shown: str) -> None:
    assert with_sd(mean, sd) == shown
