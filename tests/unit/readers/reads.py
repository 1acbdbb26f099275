"""How tests read files, and what they expect of refusals."""

import pytest

from strandline.readers import Reading, Unreadable, read_interface


def read(path, **options):
    return read_interface(path, Reading.from_options({"file": path.name, "unit": "mm", **options}, "result"))


def refused(words, path, kind="result_unreadable", **options):
    """Read a file that is refused in one line with these words."""
    with pytest.raises(Unreadable, match=words) as caught:
        read(path, **options)
    assert "\n" not in str(caught.value)
    assert caught.value.kind == kind
    return str(caught.value)
