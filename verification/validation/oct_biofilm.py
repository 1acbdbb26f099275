"""Two scans of a biofilm → stiffness and Poisson's ratio: how often the truth lies in the 90 % region.

python -m verification.validation.oct_biofilm [--renderings 40] [--folder FOLDER]

Each rendering has its own truth, drawn from the prior, its own motion of the flow cell between the two scans, speckle,
shadows, and points marked along both outlines, off by 2 px. The study is that of `examples/oct-biofilm`, run whole by
`strandline run`: edges, their errors, registration, forward runs, posterior.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.stats import gaussian_kde

import strandline as sl
from strandline.errors import ForwardModelError
from strandline.studies import load_study, run_study

EXAMPLE = Path(__file__).parents[2] / "examples" / "oct-biofilm"
RENDERINGS = 40
AIM = 0.85
MARKED, CLICK = 13, 2.0
"""Points marked along an outline, and how far they are off in x and in y, px (sd)."""
LOW, HIGH = np.array([150.0, 0.0]), np.array([800.0, 0.48])


def main(arguments: list[str] | None = None) -> int:
    """Render, run, count; return 1 if the truth lies in the 90 % region in fewer than 85 % of the renderings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--renderings", type=int, default=RENDERINGS)
    parser.add_argument("--folder", type=Path, help="keep the studies here")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        rows = [one_rendering(folder / f"{seed:02d}", seed) for seed in range(given.renderings)]
    shares = np.array([row["level"] for row in rows])
    inside = float(np.mean(shares < 0.9))
    by_input = np.mean([row["inside"] for row in rows], axis=0)
    print(f"\ntruth in the joint 90 % region: {100 * inside:.1f} % of {len(rows)} (aim: at least {100 * AIM:.0f} %)")
    print(f"in the 90 % interval of E {100 * by_input[0]:.1f} %, of nu {100 * by_input[1]:.1f} %")
    print(f"seconds, median: {np.median([row['seconds'] for row in rows]):.0f}")
    return 0 if inside >= AIM else 1


def one_rendering(folder: Path, seed: int) -> dict[str, Any]:
    """Render two scans, run the study on them, and return how the truth lies in its posterior."""
    random = np.random.default_rng(seed)
    truth, bent = _bent(random)
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder, bent, random)
    begin = time.perf_counter()
    outcome = run_study(load_study(folder))
    seconds = time.perf_counter() - begin
    posterior = outcome.calibration.posterior
    level = _level(posterior.draws, posterior.weights, truth)
    low, high = posterior.quantiles([0.05, 0.95])
    inside = (low < truth) & (truth < high)
    print(
        f"{seed:3d}  E {truth[0]:4.0f}: {posterior.mean[0]:4.0f} ± {posterior.sd[0]:3.0f}  nu {truth[1]:.2f}: "
        f"{posterior.mean[1]:.2f} ± {posterior.sd[1]:.2f}  level {level:.2f}  {seconds:.0f} s",
        flush=True,
    )
    return {"level": level, "inside": inside, "seconds": seconds}


def _bent(random: np.random.Generator) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "point 2"]]:
    """Return a truth at which the flow has a steady state, and the interface there, mm."""
    while True:
        truth = LOW + (HIGH - LOW) * random.random(2)
        try:
            found = sl.Biofilm()({"E": float(truth[0]), "nu": float(truth[1]), "V_in": 100.0})
        except ForwardModelError:
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
    (folder / "study.yaml").write_text(yaml.safe_dump(study))


def _marked(
    made: Any, outline: Float[np.ndarray, "point 2"], moved: tuple[float, float], turned: float, random: Any
) -> list[list[float]]:
    """Return points along an outline in pixels as a person marks them; the feet, on the floor's line, more exactly."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    at = outline[np.linspace(0, len(outline) - 1, MARKED).round().astype(int)] * [1, -1] / made.PIXEL
    off = random.normal(0, CLICK, at.shape)
    off[[0, -1]] *= 0.25
    return np.round(at @ np.array([[c, s], [-s, c]]) + made.ORIGIN + moved + off, 1).tolist()


def _level(
    draws: Float[np.ndarray, "draw 2"], weights: Float[np.ndarray, " draw"], truth: Float[np.ndarray, " 2"]
) -> float:
    """Return the mass of the posterior where it is denser than at the truth, of a Gaussian kernel density."""
    density = gaussian_kde(draws.T, weights=weights)
    return float(weights[density(draws.T) > density(truth[:, None])].sum() / weights.sum())


if __name__ == "__main__":
    sys.exit(main())
