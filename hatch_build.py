"""The README as a package index shows it: there its relative links and pictures lead nowhere."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

RELATIVE = r"\((?!https?://)[^)\s]*\)"
NOTE = "Files named below by their path, such as `docs/tutorials/first-study.md`, are in the source distribution."


def without_relative_links(text: str) -> str:
    """Return Markdown without pictures of the checkout, and its relative links as text with the path that they name."""
    text = re.sub(rf"!\[[^\]]*\]{RELATIVE}\n*", "", text)
    return re.sub(rf"\[([^\]]*)\](?={RELATIVE})\(([^)\s]*)\)", _named, text)


def _named(link: re.Match[str]) -> str:
    words, path = link[1], link[2].partition("#")[0]
    return words if not path or path.rstrip("/") == words.rstrip("/") else f"{words} (`{path}`)"


class LongDescription(MetadataHookInterface):
    """Takes the long description from README.md."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = without_relative_links((Path(self.root) / "README.md").read_text("utf-8"))
        heading, _, rest = text.partition("\n\n")
        metadata["readme"] = {"content-type": "text/markdown", "text": f"{heading}\n\n{NOTE}\n\n{rest}"}
