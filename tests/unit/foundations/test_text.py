"""Names, units and numbers as text: what passes, and how figures and tables show it."""

import pytest

from strandline.foundations import (
    InvalidInput,
    decimal,
    figure_text,
    html_text,
    is_label,
    is_name,
    require_label,
    require_name,
    unit_text,
    with_sd,
)
from strandline.parameters import Parameter, Uniform

NAMES = ["E", "V_in", "ν", "E modulus", "a.b", "k[0]", "é" * 64]
BAD_PARTS = ["/", "\\", "=", "$", "\n", "\0", "\u202e", "\ud800"]
NO_NAMES = ["", " E", "E ", ".", "..", "a" * 65, *(f"a{part}b" for part in BAD_PARTS)]
LABELS = ["", "1", "Pa", "mm²/s", "kg/(m·s)", "µm", "%", "<b>"]
NO_LABELS = ["$\\frac{$", "a$b", "m\ns", "\x1b[2J", "m" * 65]


def test_names_and_labels() -> None:
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
    assert all(map(is_label, LABELS))
    for text in NO_LABELS:
        with pytest.raises(InvalidInput, match="unit of E"):
            require_label("unit of E", text)


def test_numbers_and_a_mean_that_has_the_decimals_of_its_standard_deviation() -> None:
    for text, value in {"1e-5": 1e-5, "+3": 3.0, "5.": 5.0, ".5E+2": 50.0, "-0": 0.0}.items():
        assert decimal(text) == value
    for text in ["1_0", "١٢", "nan", "inf", "", " 1", "1e", "0x1", "1,5", "³", "1e5\n"]:
        assert decimal(text) is None
    said = {(399.62, 15.34): "400 ± 15", (580.4, 103.0): "580 ± 103", (0.2971, 0.0588): "0.297 ± 0.059"}
    said |= {(404.31, 8.26): "404.3 ± 8.3", (1.0, 0.0): "1 ± 0", (2e-7, 3e-8): "2e-07 ± 3e-08"}
    assert {one: with_sd(*one) for one in said} == said


UNITS = {
    "mm^2/s": "mm² s⁻¹", "mm²/s": "mm² s⁻¹", "mm**2 / s": "mm² s⁻¹", "Pa": "Pa", "1": "", "1/Pa": "Pa⁻¹",
    "J/(kg K)": "J kg⁻¹ K⁻¹", "kg/m/s": "kg m⁻¹ s⁻¹", "N*m": "N m", "m^0.5": "m^0.5", r"$\frac{$": r"$\frac{$",
}  # fmt: skip


def test_units() -> None:
    for unit, text in UNITS.items():
        assert unit_text(unit).replace("\u00a0", " ") == text
    assert " " not in unit_text("mm^2/s")  # it does not break over lines
    for unit, text in {"Pa": "Pa⁻¹", "mm^2/s": "mm⁻² s", "m^0.5": "1/(m^0.5)", "1": ""}.items():
        assert unit_text(unit, inverse=True).replace("\u00a0", " ") == text


def test_an_underscore_begins_an_index_and_what_would_be_read_as_code_is_escaped() -> None:
    assert figure_text("V̇_in") == r"V̇$_{\mathrm{in}}$"
    assert html_text("V̇_in") == "V̇<sub>in</sub>"
    assert figure_text("ν") == html_text("ν") == "ν"
    assert figure_text("$x") == r"\$x"
    assert html_text("<b>_<i>") == "&lt;b&gt;<sub>&lt;i&gt;</sub>"


def test_labels_of_an_input() -> None:
    plain = Parameter("V_in", Uniform(0.0, 1.0), "mm^2/s")
    named = Parameter("V_in", Uniform(0.0, 1.0), "mm^2/s", symbol="V̇_in")
    assert plain.label() == named.label() == "V_in [mm^2/s]"
    assert plain.figure_label().replace("\u00a0", " ") == "V_in [mm² s⁻¹]"
    assert named.figure_label().replace("\u00a0", " ") == r"V̇$_{\mathrm{in}}$ [mm² s⁻¹]"
    assert (plain.shown, named.shown) == ("V_in", "V̇_in")
    assert Parameter("nu", Uniform(0.0, 1.0)).label() == "nu"
