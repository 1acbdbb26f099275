"""What a TIFF library logs of a damaged file stays off the screen."""

import subprocess
import sys

import numpy as np
import pytest
from tests.unit.imaging.files import tiff, with_tag

PROGRAM = """import sys, pathlib
from strandline.imaging.read import read_picture
from strandline.imaging.picture import PictureReading
try:
    read_picture(pathlib.Path(sys.argv[1]), PictureReading())
except Exception as error:
    print(type(error).__name__)"""


@pytest.mark.smoke
def test_a_damaged_tiff_prints_nothing_else(tmp_path):
    whole = tiff(np.arange(5120, dtype=np.uint16).reshape(64, 80), rowsperstrip=8)
    (tmp_path / "a.tif").write_bytes(with_tag(whole, "ImageLength", 6400))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path / "a.tif"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("Unreadable\n", "")
