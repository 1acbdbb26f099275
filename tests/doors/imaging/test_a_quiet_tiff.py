"""What a TIFF library logs of a damaged file stays off the screen."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

PROGRAM = (
    "import sys, pathlib\nfrom strandline.imaging.read import read_picture\n"
    "from strandline.imaging.reading import PictureReading\n"
    "try:\n    read_picture(pathlib.Path(sys.argv[1]), PictureReading())\n"
    "except Exception as error:\n    print(type(error).__name__)\n"
)


@pytest.mark.smoke
def test_a_damaged_tiff_prints_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.arange(5120, dtype=np.uint16).reshape(64, 80), rowsperstrip=8, metadata=None)
    with tifffile.TiffFile(path) as tif:
        place = tif.pages[0].tags["ImageLength"].valueoffset
    content = path.read_bytes()
    path.write_bytes(content[:place] + struct.pack("<I", 6400) + content[place + 4 :])
    done = subprocess.run([sys.executable, "-c", PROGRAM, path], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("Unreadable\n", "")
