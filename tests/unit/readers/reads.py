"""How tests read files, and what they expect of refusals."""

import pytest

from strandline.readers import Reading, Unreadable, read_interface
from strandline.studies.keys.parse import made


def read(path, **options):
    return read_interface(path, made(Reading, {"file": path.name, "unit": "mm", **options}, "result"))


def refused(words, path, kind="result_unreadable", **options):
    """Read a file that is refused in one line with these words."""
    with pytest.raises(Unreadable, match=words) as caught:
        read(path, **options)
    assert "\n" not in str(caught.value)
    assert caught.value.kind == kind
    return str(caught.value)
