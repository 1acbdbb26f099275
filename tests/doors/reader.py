"""Somebody who looks at a page in a real browser, and notices what a page must not do."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the package axe-playwright-python")

POINTS = "#pair-plot .scatterlayer .points path"
SCREENS = [(1280, "light"), (400, "dark")]


class Reader:
    """The page that `ready` says is there; nothing may be asked of another machine, and the console stays empty."""

    def __init__(self, browser: Any, url: str, ready: str, width=1280, colours="light", scripts=True) -> None:
        size = {"width": width, "height": 900}
        self.context = browser.new_context(viewport=size, color_scheme=colours, java_script_enabled=scripts)
        self.page, self.faults, self.own = self.context.new_page(), [], "/".join(url.split("/")[:3])
        self.page.on("console", lambda message: self.faults.append(message.text))
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self._note(request.url))
        self.page.goto(url)
        self.page.wait_for_selector(ready)

    def _note(self, url: str) -> None:
        if not url.startswith((self.own, "data:", "blob:")):
            self.faults.append(f"asked elsewhere: {url}")

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))

    def waits_for(self, what: Callable[[], Any], seconds: float = 10.0) -> None:
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, "it did not happen"
            self.page.wait_for_timeout(50)

    def goes_to(self, key: str, selector: str, row: str) -> None:
        """Press a key on a button or field, after which the run of this row is shown."""
        self.page.press(selector, key)
        self.waits_for(lambda: self.page.input_value("#run-row") == row)

    def clicks_on_point(self, number: int) -> int:
        """Click on a point of the plot, and return the row of its run."""
        self.page.locator("#pair-plot").scroll_into_view_if_needed()
        box = self.page.locator(POINTS).nth(number).bounding_box()
        place = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(*place)
        self.page.mouse.click(*place)
        self.waits_for(lambda: self.page.input_value("#run-row") != "")
        return int(self.page.input_value("#run-row")) - 1

    def drawn(self, name: str) -> np.ndarray:
        """Return x and y of a line of the plot of interfaces."""
        find = f"(e) => {{ const one = e.data.find((t) => t.name === '{name}'); return [one.x, one.y]; }}"
        return np.array(self.page.locator("#shape-plot").evaluate(find))

    def sees_no_fault(self, context: str | None = None) -> None:
        """The page fits its window, and axe-core finds no fault of contrast, labels or structure."""
        width = self.page.viewport_size["width"]
        assert self.page.evaluate("document.documentElement.scrollWidth") <= width
        found = axe.Axe().run(self.page, context=context).response["violations"]
        assert [(one["id"], [node["html"] for node in one["nodes"]][:2]) for one in found] == []

    def leaves(self) -> None:
        assert self.faults == []
        self.context.close()


def moments(cell: str) -> tuple[float, float]:
    """Return mean and standard deviation of a cell."""
    mean, sd = map(float, cell.split("±"))
    return mean, sd
