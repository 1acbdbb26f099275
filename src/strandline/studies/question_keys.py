"""Keys of study.yaml that ask about finished results: changing them makes no result outdated."""

import hashlib
import re
from collections.abc import Iterator

QUESTIONS = frozenset({"next", "what_if", "specimens"})
"""Keys that no forward run and no posterior depends on."""
ASKED = re.compile(rf"^['\"]?({'|'.join(sorted(QUESTIONS))})\b", re.MULTILINE)


def digest_of(text: str) -> str:
    """Return the SHA-256 of study.yaml without its questions, to notice results of another version of it."""
    return hashlib.sha256(without_questions(text).encode()).hexdigest()


def without_questions(text: str) -> str:
    """Return the text of study.yaml without its questions, with the comment and the blank lines above each of them.

    Adding a question to a study and removing it again thus changes nothing.

    Args:
        text: Text of study.yaml; one that is not YAML is returned whole.
    """
    if not ASKED.search(text):
        return text
    import yaml  # loaded only if needed: `strandline status` is quick

    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    if not isinstance(root, yaml.MappingNode) or root.flow_style:
        return text
    lines = text.splitlines(keepends=True)
    starts = [(str(key.value), key.start_mark.line) for key, _ in root.value]
    ends = [*(line for _, line in starts[1:]), len(lines)]
    cut = {
        number
        for (name, start), end in zip(starts, ends, strict=True)
        if name in QUESTIONS
        for number in _block(lines, start, end)
    }
    return "".join(line for number, line in enumerate(lines) if number not in cut)


def _block(lines: list[str], start: int, end: int) -> Iterator[int]:
    """Return the numbers of a key's lines and of those above it; what stands above the next key belongs to that one."""
    last = end if end == len(lines) else _content_end(lines, start, end)
    first = start
    while first > 0 and lines[first - 1].startswith("#"):
        first -= 1
    while first > 0 and not lines[first - 1].strip():
        first -= 1
    return iter(range(first, last))


def _content_end(lines: list[str], start: int, end: int) -> int:
    while end > start + 1 and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
        end -= 1
    return end
