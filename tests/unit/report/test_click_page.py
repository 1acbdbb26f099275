"""Pages as text: modules and data joined in one script, and the page of clicks, whole, which loads nothing."""

import base64
import hashlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from strandline.foundations import InvalidInput
from strandline.imaging.clicks import Clicks, as_json
from strandline.report.html import MODULES, PANELS, bundled, embedded, save_page
from strandline.report.page import click_page, for_screen

SHA = "0123456789abcdef" * 4
VALUES = np.arange(48.0).reshape(6, 8)


def test_the_modules_of_the_panels_make_one_script_in_which_no_name_is_declared_twice() -> None:
    """Nor does it end its element; what a module imports, an earlier one declares."""
    script, declared = bundled(), r"^(?:export )?(?:async )?(?:function|const|let) (\w+)"
    assert not re.search(r"^\s*(import|export)\b", script, re.M)
    assert not re.search(r"</script|<!--", script, re.I)
    names = re.findall(declared, script, re.M)
    assert {"shared", "draw", "mountShapes", "start"} <= set(names)
    assert len(set(names)) == len(names)
    known: set[str] = set()
    for name in MODULES:
        text = (PANELS / f"{name}.js").read_text("utf-8")
        imported = [one.split(", ") for one in re.findall(r"^import \{ (.*) \} from", text, re.M)]
        assert {one for some in imported for one in some} <= known
        known |= set(re.findall(declared, text, re.M))


def test_embedded_data_cannot_end_its_element() -> None:
    content = {"name": "</script><script>alert(1)</script><!--", "note": "a & b < c"}
    text = str(embedded(content))
    assert "<" not in text
    assert json.loads(text) == content
    with pytest.raises(ValueError, match="JSON"):
        embedded({"mean": float("nan")})


def page_of(values: np.ndarray = VALUES, sha256: str = SHA, **options: Any) -> str:
    return click_page(values, **{"name": "scan.tif", "sha256": sha256, **options})


def given(page: str) -> Any:
    (text,) = re.findall(r'<script type="application/json" id="given">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def grey(png: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(png))).astype(int)


def test_the_page_holds_the_picture_what_it_is_and_earlier_clicks_on_it(tmp_path: Path) -> None:
    clicks = Clicks("scan.tif", SHA, (8, 6), np.array([[1.0, 1.0], [6.0, 1.5], [4.0, 4.0]]), closed=True)
    options: dict[str, Any] = {"name": "scan.tif", "sha256": SHA.upper(), "pixel_mm": (0.006, 0.004), "clicks": clicks}
    page = save_page(tmp_path / "scan.html", click_page(VALUES, **options)).read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["scan.html"]
    found = given(page)
    assert (found["name"], found["sha256"], found["size"], found["factor"]) == ("scan.tif", SHA, [8, 6], 1)
    assert (found["file"], found["clicks"], found["pixel_mm"]) == ("scan.path.json", as_json(clicks), [0.006, 0.004])
    kind, _, data = found["picture"].partition(",")
    assert kind == "data:image/png;base64"
    assert (np.diff(grey(base64.b64decode(data)).ravel()) >= 0).all()
    for values, sha, words in ((VALUES, SHA[::-1], "made on another picture"), (VALUES.T, SHA, "another size")):
        with pytest.raises(InvalidInput, match=words):
            page_of(values, sha, clicks=clicks)


def test_nothing_is_loaded_no_other_script_can_run_and_a_name_cannot_break_out() -> None:
    name = "</script><b>&\"'.tif"
    page = page_of(name=name)
    assert given(page)["name"] == name
    assert "<b>" not in page
    assert page.count("</script>") == 2
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    sources = rules["default-src"], rules["img-src"], rules["script-src"]
    assert sources == ("'none'", "data:", f"'sha256-{digest}'")
    assert not re.search(r"<link|@import|url\(|https?://|\ssrc=|fetch\(|XMLHttpRequest|localStorage", page)


def test_a_large_picture_is_shown_by_means_of_blocks_and_a_long_one_fits_a_canvas() -> None:
    values = np.kron(np.array([[0.0, 1.0, 0.5], [1.0, 0.5, 0.0]]), np.ones((3, 3)))[:, :8]
    png, factor = for_screen(values, most_pixels=6)
    np.testing.assert_array_equal(grey(png), [[0, 255, 128], [255, 128, 0]])
    assert factor == given(page_of(values, most_pixels=6))["factor"] == 3
    assert for_screen(np.tile(np.linspace(0, 1, 20_000), (2, 1)))[1] == 3


def test_dark_speckle_is_brightened_a_photograph_is_not_and_equal_or_infinite_values_are_shown() -> None:
    rng = np.random.default_rng(1)
    speckle = rng.exponential(size=(100, 100)) * np.where(np.arange(100) < 90, 1.0, 100.0)
    assert 40 < np.median(grey(for_screen(speckle)[0])) < 100
    assert 118 < np.median(grey(for_screen(rng.normal(100.0, 10.0, (100, 100)))[0])) < 138
    assert len(np.unique(grey(for_screen(np.full((4, 5), -1e300))[0]))) == 1
    found = grey(for_screen(np.array([[np.nan, 1.0, 2.0], [-np.inf, 2.0, 1.5]]))[0])
    assert (found[:, 0].tolist(), found.max()) == ([0, 0], 255)
    with pytest.raises(InvalidInput, match=r"3 × 2 px without a finite value"):
        for_screen(np.full((2, 3), np.nan))
