"""How drop.png was made: a drop of known surface tension, 72.4 mN/m, as a camera would see it against a bright light.

Run it in this folder: python make_picture.py
"""

from pathlib import Path

import numpy as np
from drop import outline
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter

TRUTH = {"gamma": 72.4, "b": 1.30, "length": 4.7}
PIXEL, SIZE, APEX = 0.008, (512, 480), (255.3, 436.6)  # mm; width and height; pixel of the apex, x to the right, y down
TILT, SCALE = 0.4, 1.003  # degrees; the needle, from which the pixel size comes, was measured 0.3 % too small
BLUR, DARK, BRIGHT, NOISE = 1.5, 40.0, 200.0, 8.0  # pixels; grey levels
FINER = 8


def main() -> None:
    """Draw the drop, which ends above the picture, eight times finer; reduce, blur and disturb it."""
    points = outline(TRUTH, Path()).points * SCALE / PIXEL
    c, s = np.cos(np.radians(TILT)), np.sin(np.radians(TILT))
    x, y = np.array([[c, -s], [s, c]]) @ points.T
    pixels = np.stack([APEX[0] + x, APEX[1] - y], axis=1)
    fine = Image.new("L", (FINER * SIZE[0], FINER * SIZE[1]), 0)
    ImageDraw.Draw(fine).polygon([tuple(p) for p in FINER * (pixels + 0.5) - 0.5], fill=255)
    share = np.asarray(fine, float).reshape(SIZE[1], FINER, SIZE[0], FINER).mean(axis=(1, 3)) / 255
    grey = gaussian_filter(BRIGHT + (DARK - BRIGHT) * share, BLUR)
    grey += NOISE * np.random.default_rng(1).standard_normal(grey.shape)
    Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8)).save(Path(__file__).parent / "drop.png")


if __name__ == "__main__":
    main()
