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
from strandline.report import click_picture
from strandline.report.click_page import click_page, write_click_page
from strandline.report.click_picture import shown

SHA = "0123456789abcdef" * 4
VALUES = np.arange(48.0).reshape(6, 8)


def given(page: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="given">(.*?)</script>', page, re.DOTALL)
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


def grey(png: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(png))).astype(int)


def test_the_page_holds_the_picture_and_what_it_is() -> None:
    found = given(click_page(VALUES, name="scan.tif", sha256=SHA.upper(), pixel_mm=(0.006, 0.004)))
    assert (found["name"], found["sha256"], found["size"], found["factor"]) == ("scan.tif", SHA, [8, 6], 1)
    assert (found["file"], found["clicks"], found["pixel_mm"]) == ("scan.path.json", None, [0.006, 0.004])
    kind, _, data = found["picture"].partition(",")
    assert kind == "data:image/png;base64"
    assert (np.diff(grey(base64.b64decode(data)).ravel()) >= 0).all()


def test_earlier_clicks_are_in_the_page_and_must_belong_to_the_picture() -> None:
    clicks = Clicks("scan.tif", SHA, (8, 6), np.array([[1.0, 1.0], [6.0, 1.5], [4.0, 4.0]]), closed=True)
    assert given(click_page(VALUES, name="scan.tif", sha256=SHA, clicks=clicks))["clicks"] == as_json(clicks)
    with pytest.raises(InvalidInput, match="made on another picture"):
        click_page(VALUES, name="scan.tif", sha256=SHA[::-1], clicks=clicks)
    with pytest.raises(InvalidInput, match="another size"):
        click_page(VALUES.T, name="scan.tif", sha256=SHA, clicks=clicks)


def test_nothing_is_loaded_and_no_other_script_can_run() -> None:
    page = click_page(VALUES, name="scan.tif", sha256=SHA)
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert rules["script-src"] == f"'sha256-{digest}'"
    assert not re.search(r"<link|@import|url\(|https?://|\ssrc=|fetch\(|XMLHttpRequest|localStorage", page)


def test_a_name_cannot_break_out_of_the_page() -> None:
    name = "</script><b>&\"'.tif"
    page = click_page(VALUES, name=name, sha256=SHA)
    assert given(page)["name"] == name
    assert "<b>" not in page
    assert page.count("</script>") == 2


def test_every_control_has_a_name() -> None:
    page = click_page(VALUES, name="scan.tif", sha256=SHA)
    for tag in re.findall(r"<(?:input|select)[^>]*>", page):
        identity = re.search(r'id="([^"]*)"', tag)
        wrapped = re.search(rf"<label[^>]*>{re.escape(tag)}", page)
        assert wrapped or "aria-label" in tag or (identity and f'for="{identity[1]}"' in page), tag
    for attributes, text in re.findall(r"<button([^>]*)>(.*?)</button>", page):
        assert "aria-label" in attributes or re.search("[A-Za-z]{4}", text), text
    identities = re.findall(r'\sid="([^"]*)"', page)
    assert len(set(identities)) == len(identities)


def test_the_page_is_written_whole(tmp_path: Path) -> None:
    path = write_click_page(VALUES, tmp_path / "scan.html", name="scan.tif", sha256=SHA)
    assert path.read_text(encoding="utf-8") == click_page(VALUES, name="scan.tif", sha256=SHA)
    assert [p.name for p in tmp_path.iterdir()] == ["scan.html"]


def test_a_large_picture_is_shown_by_means_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(click_picture, "MOST_PIXELS", 6)
    values = np.kron(np.array([[0.0, 1.0, 0.5], [1.0, 0.5, 0.0]]), np.ones((3, 3)))[:, :8]
    found = shown(values)
    assert found.factor == 3
    np.testing.assert_array_equal(grey(found.png), [[0, 255, 128], [255, 128, 0]])


def test_a_long_picture_fits_a_canvas() -> None:
    found = shown(np.tile(np.linspace(0, 1, 20_000), (2, 1)))
    assert found.factor == 3
    assert grey(found.png).shape == (1, 6667)


def test_dark_speckle_is_brightened_and_a_photograph_is_not() -> None:
    rng = np.random.default_rng(1)
    speckle = rng.exponential(size=(100, 100)) * np.where(np.arange(100) < 90, 1.0, 100.0)
    assert 40 < np.median(grey(shown(speckle).png)) < 100
    photograph = rng.normal(100.0, 10.0, (100, 100))
    assert 118 < np.median(grey(shown(photograph).png)) < 138


@pytest.mark.parametrize("value", [0.0, 3.5, -1e300])
def test_a_picture_of_one_value_is_shown(value: float) -> None:
    assert len(np.unique(grey(shown(np.full((4, 5), value)).png))) == 1


def test_values_that_are_not_finite_are_black() -> None:
    values = np.array([[np.nan, 1.0, 2.0], [-np.inf, 2.0, 1.5]])
    assert grey(shown(values).png)[:, 0].tolist() == [0, 0]
    assert grey(shown(values).png).max() == 255
    with pytest.raises(InvalidInput, match=r"3 × 2 px without a finite value"):
        shown(np.full((2, 3), np.nan))
