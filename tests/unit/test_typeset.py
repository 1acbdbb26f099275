"""Units and symbols as figures and tables have them."""

from strandline.parameters import Parameter
from strandline.priors import Uniform
from strandline.typeset import figure_text, html_text, unit_text

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


def test_an_underscore_begins_an_index() -> None:
    assert figure_text("V̇_in") == r"V̇$_{\mathrm{in}}$"
    assert html_text("V̇_in") == "V̇<sub>in</sub>"
    assert figure_text("ν") == html_text("ν") == "ν"


def test_what_a_figure_or_page_would_read_as_code_is_escaped() -> None:
    assert figure_text("$x") == r"\$x"
    assert html_text("<b>_<i>") == "&lt;b&gt;<sub>&lt;i&gt;</sub>"


def test_labels_of_an_input() -> None:
    plain = Parameter("V_in", Uniform(0.0, 1.0), "mm^2/s")
    named = Parameter("V_in", Uniform(0.0, 1.0), "mm^2/s", symbol="V̇_in")
    assert plain.label() == named.label() == "V_in [mm^2/s]"
    assert plain.figure_label().replace("\u00a0", " ") == "V_in [mm² s⁻¹]"
    assert named.figure_label().replace("\u00a0", " ") == r"V̇$_{\mathrm{in}}$ [mm² s⁻¹]"
    assert (plain.shown, named.shown) == ("V_in", "V̇_in")
