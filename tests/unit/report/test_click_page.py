"""The page of clicks as text: whole, loading nothing, with the picture and the earlier clicks in it."""

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

from strandline.errors import InvalidInput
from strandline.imaging.clicks import Clicks
from strandline.imaging.clicks_file import as_json
from strandline.report.click_page import click_page, write_click_page
from strandline.report.click_picture import shown

SHA = "0123456789abcdef" * 4
VALUES = np.arange(48.0).reshape(6, 8)
PAGE = click_page(VALUES, name="scan.tif", sha256=SHA)


def given(page: str) -> Any:
    (text,) = re.findall(r'<script type="application/json" id="given">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def grey(png: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(png))).astype(int)


def test_the_page_holds_the_picture_and_what_it_is(tmp_path: Path) -> None:
    options: dict[str, Any] = {"name": "scan.tif", "sha256": SHA.upper(), "pixel_mm": (0.006, 0.004)}
    path = write_click_page(VALUES, tmp_path / "scan.html", **options)
    page = path.read_text(encoding="utf-8")
    assert page == click_page(VALUES, **options)
    assert [p.name for p in tmp_path.iterdir()] == ["scan.html"]
    found = given(page)
    assert (found["name"], found["sha256"], found["size"], found["factor"]) == ("scan.tif", SHA, [8, 6], 1)
    assert (found["file"], found["clicks"], found["pixel_mm"]) == ("scan.path.json", None, [0.006, 0.004])
    kind, _, data = found["picture"].partition(",")
    assert kind == "data:image/png;base64"
    assert (np.diff(grey(base64.b64decode(data)).ravel()) >= 0).all()


def test_earlier_clicks_are_in_the_page_and_must_belong_to_the_picture() -> None:
    clicks = Clicks("scan.tif", SHA, (8, 6), np.array([[1.0, 1.0], [6.0, 1.5], [4.0, 4.0]]), closed=True)
    assert given(click_page(VALUES, name="scan.tif", sha256=SHA, clicks=clicks))["clicks"] == as_json(clicks)
    for values, sha, words in ((VALUES, SHA[::-1], "made on another picture"), (VALUES.T, SHA, "another size")):
        with pytest.raises(InvalidInput, match=words):
            click_page(values, name="scan.tif", sha256=sha, clicks=clicks)


def test_nothing_is_loaded_no_other_script_can_run_and_a_name_cannot_break_out() -> None:
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', PAGE)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    (script,) = re.findall(r"<script>(.*?)</script>", PAGE, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    sources = rules["default-src"], rules["img-src"], rules["script-src"]
    assert sources == ("'none'", "data:", f"'sha256-{digest}'")
    assert not re.search(r"<link|@import|url\(|https?://|\ssrc=|fetch\(|XMLHttpRequest|localStorage", PAGE)
    name = "</script><b>&\"'.tif"
    page = click_page(VALUES, name=name, sha256=SHA)
    assert given(page)["name"] == name
    assert "<b>" not in page
    assert page.count("</script>") == 2


def test_every_control_has_a_name() -> None:
    for tag in re.findall(r"<(?:input|select)[^>]*>", PAGE):
        identity = re.search(r'id="([^"]*)"', tag)
        wrapped = re.search(rf"<label[^>]*>{re.escape(tag)}", PAGE)
        assert wrapped or "aria-label" in tag or (identity and f'for="{identity[1]}"' in PAGE), tag
    for attributes, text in re.findall(r"<button([^>]*)>(.*?)</button>", PAGE):
        assert "aria-label" in attributes or re.search("[A-Za-z]{4}", text), text
    identities = re.findall(r'\sid="([^"]*)"', PAGE)
    assert len(set(identities)) == len(identities)


def test_a_large_picture_is_shown_by_means_of_blocks_and_a_long_one_fits_a_canvas() -> None:
    values = np.kron(np.array([[0.0, 1.0, 0.5], [1.0, 0.5, 0.0]]), np.ones((3, 3)))[:, :8]
    found = shown(values, most_pixels=6)
    assert found.factor == 3
    np.testing.assert_array_equal(grey(found.png), [[0, 255, 128], [255, 128, 0]])
    assert given(click_page(values, name="scan.tif", sha256=SHA, most_pixels=6))["factor"] == 3
    long = shown(np.tile(np.linspace(0, 1, 20_000), (2, 1)))
    assert long.factor == 3
    assert grey(long.png).shape == (1, 6667)


def test_dark_speckle_is_brightened_and_a_photograph_is_not() -> None:
    rng = np.random.default_rng(1)
    speckle = rng.exponential(size=(100, 100)) * np.where(np.arange(100) < 90, 1.0, 100.0)
    assert 40 < np.median(grey(shown(speckle).png)) < 100
    assert 118 < np.median(grey(shown(rng.normal(100.0, 10.0, (100, 100))).png)) < 138


def test_values_that_are_equal_or_not_finite() -> None:
    for value in (0.0, 3.5, -1e300):
        assert len(np.unique(grey(shown(np.full((4, 5), value)).png))) == 1
    found = grey(shown(np.array([[np.nan, 1.0, 2.0], [-np.inf, 2.0, 1.5]])).png)
    assert found[:, 0].tolist() == [0, 0]
    assert found.max() == 255
    with pytest.raises(InvalidInput, match=r"3 × 2 px without a finite value"):
        shown(np.full((2, 3), np.nan))
