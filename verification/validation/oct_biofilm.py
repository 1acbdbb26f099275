"""Two scans of a biofilm → stiffness and Poisson's ratio: how often the truth lies in the 90 % region.

    python -m verification.validation.oct_biofilm [--renderings 40] [--folder FOLDER]

Each rendering has its own truth, drawn from the prior, its own motion of the flow cell between the two scans, speckle,
shadows, and points marked along both outlines, off by 2 px. The study is that of `examples/oct-biofilm`, run whole by
`strandline run`: edges, their errors, registration, forward runs, posterior.
"""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.stats import gaussian_kde
from verification.validation.tables import EXAMPLES, arguments, finish, kept_or_scratch, write_study

import strandline as sl

EXAMPLE = EXAMPLES / "oct-biofilm"
AIM = 0.85
MARKED, CLICK = 13, 2.0
"""Points marked along an outline, and how far they are off in x and in y, px (sd)."""
LOW, HIGH = np.array([150.0, 0.0]), np.array([800.0, 0.48])


def main() -> None:
    """Render, run, count; exit with 1 if the truth lies in the 90 % region in fewer than 85 % of the renderings."""
    given = arguments(__doc__, renderings=40, folder=Path)
    with kept_or_scratch(given.folder) as folder:
        found = [one_rendering(folder / f"{seed:02d}", seed) for seed in range(given.renderings)]
    levels, inside, seconds = (np.array(column) for column in zip(*found, strict=True))
    share, by_input = 100 * float(np.mean(levels < 0.9)), 100 * inside.mean(axis=0)
    print(f"\ntruth in the joint 90 % region: {share:.1f} % of {len(found)} (aim: at least {100 * AIM:.0f} %)")
    print(f"in the 90 % interval of E {by_input[0]:.1f} %, of nu {by_input[1]:.1f} %")
    print(f"seconds, median: {np.median(seconds):.0f}")
    finish([] if share >= 100 * AIM else ["too few"])


def one_rendering(folder: Path, seed: int) -> tuple[float, np.ndarray, float]:
    """Render two scans and run the study; return level and intervals of the truth in its posterior, and seconds."""
    random = np.random.default_rng(seed)
    truth, bent = _bent(random)
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder, bent, random)
    begin = time.perf_counter()
    outcome = sl.run_study(sl.load_study(folder))
    seconds = time.perf_counter() - begin
    posterior = outcome.calibration.posterior
    density = gaussian_kde(posterior.draws.T, weights=posterior.weights)
    denser = density(posterior.draws.T) > density(truth[:, None])
    level = float(posterior.weights[denser].sum() / posterior.weights.sum())
    low, high = posterior.quantiles([0.05, 0.95])
    inside = (low < truth) & (truth < high)
    print(
        f"{seed:3d}  E {truth[0]:4.0f}: {posterior.mean[0]:4.0f} ± {posterior.sd[0]:3.0f}  nu {truth[1]:.2f}: "
        f"{posterior.mean[1]:.2f} ± {posterior.sd[1]:.2f}  level {level:.2f}  {seconds:.0f} s",
        flush=True,
    )
    return level, inside, seconds


def _bent(random: np.random.Generator) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "point 2"]]:
    """Return a truth at which the flow has a steady state, and the interface there, mm."""
    while True:
        truth = LOW + (HIGH - LOW) * random.random(2)
        try:
            found = sl.Biofilm()({"E": float(truth[0]), "nu": float(truth[1]), "V_in": 100.0})
        except sl.ForwardModelError:
            continue
        return truth, np.asarray(found.interface.points)


def _write(folder: Path, bent: Float[np.ndarray, "point 2"], random: np.random.Generator) -> None:
    """Write both scans, with marked points, and the study of the example on them."""
    sys.path.insert(0, str(EXAMPLE))
    import make_scans as made

    still = np.asarray(sl.Biofilm().undeformed().points)
    moved, turned = (float(right) for right in random.normal(0, 3, 2)), float(random.normal(0, 0.3))
    place = (next(moved), next(moved))
    made.save(folder / "undeformed.png", made.scan(still, random))
    made.save(folder / "deformed.png", made.scan(bent, random, moved=place, turned=turned))
    study = yaml.safe_load((EXAMPLE / "study.yaml").read_text())
    study["model"]["biofilm"]["outline"]["image"]["path"] = _marked(made, still, (0.0, 0.0), 0.0, random)
    study["observation"]["image"]["path"] = _marked(made, bent, place, turned, random)
    write_study(folder, study)


def _marked(
    made: Any, outline: np.ndarray, moved: tuple[float, float], turned: float, random: Any
) -> list[list[float]]:
    """Return points along an outline in pixels as a person marks them; the feet, on the floor's line, more exactly."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    at = outline[np.linspace(0, len(outline) - 1, MARKED).round().astype(int)] * [1, -1] / made.PIXEL
    off = random.normal(0, CLICK, at.shape)
    off[[0, -1]] *= 0.25
    return np.round(at @ np.array([[c, s], [-s, c]]) + made.ORIGIN + moved + off, 1).tolist()


if __name__ == "__main__":
    main()
