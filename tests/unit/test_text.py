"""Names, units and numbers as text: what passes, and what does not."""

import pytest

from strandline.errors import InvalidInput
from strandline.text import decimal, is_label, is_name, require_label, require_name, with_sd

NAMES = ["E", "V_in", "ν", "E modulus", "a.b", "k[0]", "é" * 64]
BAD_PARTS = ["/", "\\", "=", "$", "\n", "\0", "\u202e", "\ud800"]
NO_NAMES = ["", " E", "E ", ".", "..", "a" * 65, *(f"a{part}b" for part in BAD_PARTS)]
LABELS = ["", "1", "Pa", "mm²/s", "kg/(m·s)", "µm", "%", "<b>"]
NO_LABELS = ["$\\frac{$", "a$b", "m\ns", "\x1b[2J", "m" * 65]


def test_names() -> None:
    for name in NAMES:
        assert is_name(name)
        require_name("name", name)
    for name in NO_NAMES:
        assert not is_name(name)
        with pytest.raises(InvalidInput) as caught:
            require_name("name of an input", name)
        assert str(caught.value).isprintable()
    with pytest.raises(InvalidInput, match="draw, chain"):
        require_name("name", "draw", reserved=("draw", "chain"))
    require_name("name", "drawn", reserved=("draw",))


def test_labels() -> None:
    assert all(map(is_label, LABELS))
    for text in NO_LABELS:
        with pytest.raises(InvalidInput, match="unit of E"):
            require_label("unit of E", text)


def test_numbers() -> None:
    for text, value in {"1e-5": 1e-5, "+3": 3.0, "5.": 5.0, ".5E+2": 50.0, "-0": 0.0}.items():
        assert decimal(text) == value
    for text in ["1_0", "١٢", "nan", "inf", "", " 1", "1e", "0x1", "1,5", "³", "1e5\n"]:
        assert decimal(text) is None


def test_a_mean_has_the_decimals_of_its_standard_deviation() -> None:
    assert [with_sd(*one) for one in [(399.62, 15.34), (580.4, 103.0), (0.2971, 0.0588)]] == [
        "400 ± 15",
        "580 ± 103",
        "0.297 ± 0.059",
    ]
    assert [with_sd(*one) for one in [(404.31, 8.26), (1.0, 0.0), (2e-7, 3e-8)]] == [
        "404.3 ± 8.3",
        "1 ± 0",
        "2e-07 ± 3e-08",
    ]
