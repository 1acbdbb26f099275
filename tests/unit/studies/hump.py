"""A picture of a dark hump on a bright ground, and a study that observes it."""

import numpy as np
from PIL import Image
from scipy.special import ndtr

from strandline.studies import load_study
from strandline.testing.studies import write_study

PIXEL, SIZE, ORIGIN = 0.01, (220, 160), (10.0, 120.0)
CLICKS = [[12, 98], [60, 62], [110, 50], [160, 60], [208, 97]]


def height(x):
    """Return the true edge: row over column, in pixels; the solid is below it."""
    return 50 + 0.005 * (x - 110) ** 2


def picture(folder, *, noise=6.0, seed=1):
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    inside = (y - height(x)) / np.sqrt(1 + (0.01 * (x - 110)) ** 2)
    grey = 200 - 150 * ndtr(inside / 1.5) + noise * np.random.default_rng(seed).standard_normal(x.shape)
    Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8)).save(folder / "hump.png")
    return folder / "hump.png"


def seen(**changes):
    """Return the picture as an observation; None removes a key of it."""
    image = {
        "file": "hump.png",
        "pixel": {"size": 1e3 * PIXEL, "unit": "um"},
        "frame": {"origin": list(ORIGIN)},
        "path": CLICKS,
        "solid": "dark",
    }
    return {"image": {key: value for key, value in {**image, **changes}.items() if value is not None}}


def written(folder, *, noise=None, **changes):
    folder.mkdir(exist_ok=True)
    if not (folder / "hump.png").exists():
        picture(folder)
    stated = noise or {"sd": "image", "unit": "um", "unknown": {"shift": 5}}
    inferred = {"surrogate": {"field": {}}} if "model_error" in stated else {}
    measure = {"discrepancy": {"normal_offset": {}}, "noise": stated, **inferred}
    return write_study(folder, observation=seen(**changes), **measure)


def loaded(folder, **changes):
    return load_study(written(folder, **changes))


def off(study):
    """Return how far the observed points are from the true edge, in pixels along the vertical."""
    points = study.observed[""].points
    x, y = ORIGIN[0] + points[:, 0] / PIXEL, ORIGIN[1] - points[:, 1] / PIXEL
    return np.asarray(y - height(x))
