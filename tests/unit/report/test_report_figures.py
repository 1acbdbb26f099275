"""What the figures and the page of a report owe to print, and to a posterior in doubt."""

import base64
import io
import struct
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image
from tests.unit.report.plots.drawn import entries, posterior_of

from strandline.foundations import with_sd
from strandline.interface import GaussianNoise, Interface, Observation, PointErrors, UnknownErrors
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import MarginalPosterior, Offsets
from strandline.report.figures import _in_legend, _reading, unknown_errors
from strandline.report.html import fixed, number, said
from strandline.report.page import _without_bad_comparison
from strandline.report.plots import plot_run_offsets, plot_tempering
from strandline.report.plots.style import DOUBLE, SINGLE, Captioned, fitted, marked, saved


def test_a_prediction_says_what_the_whole_outline_may_still_do() -> None:
    """The figure shows the observed interface as measured; a caption without that would blame the model."""
    line = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))
    for noise, unknown in (
        (PointErrors(0.01, length=0.1), None),
        (GaussianNoise(5e-4), None),
        (PointErrors(0.01, shift=0.1), "its unknown shift can"),
        (UnknownErrors(rotation=1.0, scale=0.01), "its unknown rotation and scale can"),
    ):
        caption = said("predictive", unknown=unknown_errors(Observation(line, noise)), of="<slow>")
        assert (unknown or "observed one.") in caption
        assert ("unknown" in caption, type(caption), "of <slow>:" in caption) == (unknown is not None, str, True)


def captioned(name: str, section: str = "data") -> Captioned:
    return Captioned(name, section, "", plot_tempering([1.0], [10.0], [0.3]))


def test_the_mark_of_doubt_is_on_figures_of_the_posterior_alone() -> None:
    for name, section, doubt, is_marked in (
        ("marginals", "posterior", None, False),
        ("marginals", "posterior", "not converged", True),
        ("cut_marginals", "uncertainty", "not converged", True),
        ("predictive_slow", "certificate", "not converged", True),
        ("run_history", "certificate", "not converged", False),
    ):
        assert bool(marked(captioned(name, section), doubt).figure.get_suptitle()) == is_marked


def test_pictures_for_print_have_300_dots_an_inch_with_all_labels_on_them(tmp_path: Path) -> None:
    """The number of tick labels, and so their width, depends on the font size at the moment of drawing."""
    s = np.linspace(0.0, 1.45, 60)
    some = Offsets(s, 1e-3 * np.where(s < 0.7, 2.18, 1.18) * np.sin(4.4 * s))
    axes = plot_run_offsets(some, {f"{k} best run, log-likelihood −1.048": some for k in ("second", "third", "fourth")})
    shown = saved(Captioned("offsets", "data", "", axes), tmp_path)
    png, pdf = ((tmp_path / f"offsets.{kind}").read_bytes() for kind in ("png", "pdf"))
    assert base64.b64decode(shown["data"]) == png
    width = struct.unpack(">II", png[16:24])[0] / 300
    assert width in (pytest.approx(SINGLE, abs=0.01), pytest.approx(DOUBLE, abs=0.01))
    assert imread(io.BytesIO(png))[:, :5, :3].min() == 1.0, "the label at the left is cut off"
    assert b"/Type3" not in pdf
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf
    (tmp_path / "draft.pdf").write_text("of an earlier result", "utf-8")
    saved(captioned("draft"), tmp_path, draft=True)
    assert not (tmp_path / "draft.pdf").exists()


def test_the_largest_pictures_become_smaller_until_all_fit() -> None:
    random = np.random.default_rng(0)

    def noise(size: int) -> str:
        out = io.BytesIO()
        Image.fromarray(random.integers(0, 255, (size, size, 3), dtype=np.uint8)).save(out, format="png")
        return base64.b64encode(out.getvalue()).decode("ascii")

    both = [{"name": "a", "data": noise(20)}, {"name": "b", "data": noise(80)}]
    room = sum(len(one["data"]) for one in both)
    assert fitted(both, room) == both
    items = fitted(both, room - 1)
    assert items[0] == both[0]
    with Image.open(io.BytesIO(base64.b64decode(items[1]["data"]))) as picture:
        assert picture.size == (40, 40)


def test_a_reading_under_uncertainty_leaves_out_the_nuisance_input_and_laplace() -> None:
    inputs = [Parameter(name, Uniform(0.0, 1.0), nuisance=name == "V") for name in "Vab"]
    reading = MarginalPosterior(posterior_of(np.random.default_rng(0).random((300, 3)), *inputs))
    (shown,) = _reading("cut", reading, {"a": 0.5, "b": 0.5, "V": 0.5})
    labels = {text for ax in shown.figure.axes for text in (ax.get_xlabel(), ax.get_ylabel())}
    assert (set("ab") <= labels, "V" in labels) == (True, False)
    assert "MAP (fullest bin)" in entries(shown.figure)
    assert not any("Laplace" in text for text in entries(shown.figure))


def test_a_second_posterior_is_shown_only_if_its_surrogate_is_good_near_the_mode() -> None:
    for error, shown in ((0.4, True), (0.6, False)):
        summary = {"comparison": {"inputs": {}}, "measures": {"currents": {"loo_rms_near_mode": error}}}
        assert (_without_bad_comparison(summary)["comparison"] is not None) == shown
    assert _without_bad_comparison({"comparison": None, "measures": {}})["comparison"] is None


def test_numbers_have_a_proper_minus_and_a_power_of_ten_only_where_it_reads_better() -> None:
    given = {-5e-5: "−5·10⁻⁵", 293.0: "290", 123456.0: "120000", 1.23e6: "1.2·10⁶", -0.0: "0", -0.0123: "−0.012"}
    assert [number(value, 2).replace("\u00a0", "") for value in given] == list(given.values())
    assert [number([1.0, 2.5]), number(None)] == ["1, 2.5", "–"]
    assert [fixed(-0.001), fixed(-1.234), fixed(-0.004, 2, "+"), fixed(0.5, 1, "+")] == [
        "0.00",
        "−1.23",
        "+0.00",
        "+0.5",
    ]
    assert [with_sd(-0.3, 30.0), with_sd(-0.004, 0.12), with_sd(396.1, 30.4)] == ["0 ± 30", "0.00 ± 0.12", "396 ± 30"]
    space = ParameterSpace((Parameter("nu", Uniform(-1.0, 1.0)), Parameter("E", Uniform(1.0, 800.0), "Pa")))
    assert _in_legend(space, [-0.3, 400.0]) == "nu = −0.3, E = 400"
    end = {"name": "nu", "side": "lower", "bound": -0.8, "unit": "", "mass": 0.5}
    assert "end of its box, −0.8: 50.0%" in said("bound", page="warnings.txt.j2", called="posterior", one=end)
