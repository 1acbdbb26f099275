"""A page of a report as its tags and its text."""

import json
import re
from html.parser import HTMLParser
from typing import Any

from strandline.report.html import template


class Page(HTMLParser):
    """Tags with their attributes, the visible text, and whether every tag is closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.open, self.text = [], [], ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in {"meta", "br", "img", "link", "hr", "input"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def attributes(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]


def rendered(summary: dict[str, Any], **changes: Any) -> str:
    """Return the page of a summary with some entries changed, without figures."""
    page = template("report.html.j2")
    return str(page.render(s={**summary, **changes}, figures=[], study_text="", check=None, picture=None))


def data_in(page: str) -> Any:
    (text,) = re.findall(r'<script type="application/json" id="explore-data">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)
