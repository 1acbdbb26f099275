"""How the two scans were made: a biofilm on the floor of a flow cell as OCT sees it, at rest and bent by the flow.

Run it in this folder: python make_scans.py
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter

import strandline as sl

TRUTH = {"E": 400.0, "nu": 0.30, "V_in": 100.0}  # Pa, 1, mm²/s
PIXEL, SIZE, ORIGIN = 0.003, (460, 240), (-105.0, 205.0)  # mm; width and height; pixel of the model's (0, 0)
MOVED, TURNED = (4.3, -2.1), 0.3  # px to the right and down, degrees: the flow cell between the two scans
BODY, FLOOR, FLUID = 10.0, 60.0, 1.0  # reflectivity: 10 dB between biofilm and fluid
SPECKLE, DEPTH, SHADOWS = 1.2, 150.0, 3  # px; px
PARTS = ((0, 0.25), (0.31, 0.40), (0.43, 1.47), (1.52, 1.60), (1.63, 2))  # of the floor, between scratches, mm
FINER = 8


def main() -> None:
    """Write undeformed.png and deformed.png, 16 bits, linear intensity."""
    model, random = sl.Biofilm(), np.random.default_rng(1)
    folder = Path(__file__).parent
    save(folder / "undeformed.png", scan(model.undeformed().points, random))
    save(folder / "deformed.png", scan(model(TRUTH).interface.points, random, moved=MOVED, turned=TURNED))


def scan(
    outline: np.ndarray, random: np.random.Generator, *, moved: tuple[float, float] = (0.0, 0.0), turned: float = 0.0
) -> np.ndarray:
    """Return the intensity of a scan of the body below an outline (mm), with speckle; the fluid's mean is 1."""
    place = (moved, turned)
    body = covered(np.concatenate([outline, [[outline[-1, 0], -0.01], [outline[0, 0], -0.01]]]), *place)
    floor = sum(covered(np.array([[a, -0.012], [b, -0.012], [b, 0], [a, 0]]), *place) for a, b in PARTS)
    x = np.arange(SIZE[0])
    shadow = np.ones(SIZE[0])
    top = ORIGIN[0] + moved[0] + outline[:, 0].mean() / PIXEL
    for middle in random.uniform(top - 60, top + 80, SHADOWS):
        shadow *= 1 - 0.75 * np.exp(-0.5 * ((x - middle) / random.uniform(4, 8)) ** 2)
    reflects = (FLUID + (BODY - FLUID) * body + FLOOR * floor) * np.exp(-np.cumsum(body, axis=0) / DEPTH) * shadow
    white = np.sqrt(reflects) * random.standard_normal((2, *reflects.shape))
    real, imaginary = (gaussian_filter(part, SPECKLE, mode="reflect") for part in white)
    return np.asarray(2 * np.pi * SPECKLE**2 * (real**2 + imaginary**2))


def covered(polygon: np.ndarray, moved: tuple[float, float], turned: float) -> np.ndarray:
    """Return the share of each pixel that a polygon (mm) covers; the set-up is moved, and turned about its origin."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    x, y = (polygon * [1, -1] / PIXEL @ np.array([[c, s], [-s, c]])).T
    pixels = np.stack([ORIGIN[0] + moved[0] + x, ORIGIN[1] + moved[1] + y], axis=1)
    fine = Image.new("L", (FINER * SIZE[0], FINER * SIZE[1]), 0)
    ImageDraw.Draw(fine).polygon([tuple(p) for p in FINER * (pixels + 0.5) - 0.5], fill=1)
    return np.asarray(fine, float).reshape(SIZE[1], FINER, SIZE[0], FINER).mean(axis=(1, 3))


def save(path: Path, intensity: np.ndarray) -> None:
    """Write a picture of 16 bits; 300 steps are the fluid's mean."""
    Image.fromarray(np.clip(np.round(300 * intensity), 0, 65535).astype(np.uint16)).save(path)


if __name__ == "__main__":
    main()
