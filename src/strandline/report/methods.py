"""A study in the words of a paper: a paragraph for the methods section, and what to cite."""

from collections.abc import Iterator, Mapping
from typing import Any

from strandline.report.html import number
from strandline.text import listed, with_sd
from strandline.typeset import unit_text

BIBTEX = """\
@article{{willmann2022bayesian,
  author  = {{Willmann and Nitzler and Brandstäter and Wall}},
  title   = {{Bayesian calibration of coupled computational mechanics models under uncertainty based on interface
             deformation}},
  journal = {{Advanced Modeling and Simulation in Engineering Sciences}},
  volume  = {{9}},
  number  = {{24}},
  year    = {{2022}},
  doi     = {{10.1186/s40323-022-00237-5}}
}}

@software{{strandline,
  author  = {{{{strandline contributors}}}},
  title   = {{strandline: Bayesian calibration of computational-mechanics models from the shape of a measured
             interface}},
  version = {{{version}}}
}}
"""
"""References of the method and of the software, for ``format(version=…)``."""
MEASURES = {
    "currents": "the RKHS norm of the difference of their surface currents",
    "closest_point": "the distances to the closest points",
    "measurement_lines": "their distances along measurement lines",
    "normal_offset": "the distances of the observed points along the normals",
    "tracked_points": "the distances of tracked points",
}
TO_UM = 1e3


def methods_paragraph(summary: Mapping[str, Any]) -> str:
    """Return a paragraph for the methods section of a paper, with the numbers of a study, from the content of
    summary.json.

    It also says what speaks against the result: runs that failed, a design that did not converge, a model that does not
    explain the observation.
    """
    return " ".join(_sentences(summary))


def _sentences(s: Mapping[str, Any]) -> Iterator[str]:
    calibrated = [name for name, item in s["inputs"].items() if not item["nuisance"]]
    nuisance = [name for name, item in s["inputs"].items() if item["nuisance"]]
    labels = {name: item["label"] for name, item in s["inputs"].items()}
    uncertain = f", with {listed([labels[name] for name in nuisance])} uncertain" if nuisance else ""
    source = "a synthetic observation" if s.get("truth") else "the observed shape of the interface"
    yield (
        f"We inferred {listed([labels[name] for name in calibrated])} from {source}{uncertain}, by Bayesian "
        f"calibration (Willmann et al. 2022) with strandline {s['version']}."
    )
    yield f"The priors were {listed([_prior(item) for item in s['inputs'].values()])}."
    if s["fixed"]:
        known = [f"{name} = {number(value, 6)}" for name, value in s["fixed"].items()]
        yield f"{listed(known)} {'was' if len(known) == 1 else 'were'} known."
    yield _likelihood(s["likelihood"])
    yield _runs(s)
    yield _surrogate(s)
    yield (
        f"The posterior was sampled by adaptive tempered sequential Monte Carlo with {s['sampler']['particles']} "
        f"particles ({s['sampler']['ess']:.0f} effective), {s['sampler']['rejuvenation_steps']} rejuvenation steps and "
        f"ζ = {s['sampler']['zeta']:g}, in {s['sampler']['tempering_steps']} tempering steps."
    )
    yield from _checks(s)
    items = [s["inputs"][name] for name in calibrated]
    found = [f"{item['label']} = {with_sd(item['mean'], item['sd'])}{_unit(item, ' ')}" for item in items]
    yield f"Posterior means and standard deviations are {listed(found)}."


def _prior(item: Mapping[str, Any]) -> str:
    kind, _, numbers = item["prior"].partition(": ")
    shown = f"{kind.lower()} ({numbers})" if numbers else kind
    return f"{shown} for {item['label']}{_unit(item, ' in ')}"


def _unit(item: Mapping[str, Any], before: str) -> str:
    text = unit_text(item["unit"])
    return f"{before}{text}" if text else ""


def _likelihood(found: Mapping[str, Any]) -> str:
    measure = MEASURES.get(found["discrepancy"], f"the measure {found['discrepancy']}")
    options = found["options"].partition(": ")[2]
    compared = f"Simulated and observed interfaces were compared by {measure}{f' ({options})' if options else ''}"
    inferred, sd, length = found.get("inferred_noise"), found.get("point_sd"), found.get("correlation_length")
    if inferred is not None and inferred.get("stated"):
        sd, length = (inferred["prior"][name] / TO_UM for name in ("sd_um", "length_um"))
    if inferred is not None and not inferred.get("stated"):
        errors = "errors of the observed points that were inferred from the residuals"
    elif sd is not None:
        along = f", correlated over {number(TO_UM * length, 3)} µm along the interface" if length else ""
        errors = f"errors of the observed points of {number(TO_UM * sd, 3)} µm{along}"
    else:
        unit = unit_text(found["unit"] or "")
        errors = f"Gaussian noise of variance {number(found['noise_variance'], 4)}{f' {unit}' if unit else ''}"
    allowed = _model_error(found)
    model = ""
    if allowed:
        chance = found["inferred_noise"]["model_error"]["probability"]
        size = f"probability {number(chance, 2)} and median amplitude {number(allowed, 3)} µm"
        model = f", and a model error of {size}, both inferred"
    return f"{compared}, with {errors}{model}.{_of_the_whole(found)}"


def _model_error(found: Mapping[str, Any]) -> float | None:
    """Return the median amplitude of the inferred model error if there is one, µm; None if no offset was allowed."""
    quantiles = ((found.get("inferred_noise") or {}).get("model_error") or {}).get("amplitude_quantiles_um")
    return None if quantiles is None else float(quantiles["median"])


def _of_the_whole(found: Mapping[str, Any]) -> str:
    """Return a sentence about the errors that all points share."""
    sizes = {
        "position": f"{number(TO_UM * (found.get('shift_sd') or 0.0), 3)} µm",
        "rotation": f"{number(found.get('rotation_sd') or 0.0, 3)}°",
        "scale": f"{number(100 * (found.get('scale_sd') or 0.0), 3)} %",
        "a common offset along the normals": f"{number(TO_UM * (found.get('offset_sd') or 0.0), 3)} µm",
    }
    stated = [f"{size} in {name}" for name, size in sizes.items() if not size.startswith(("0 ", "0°"))]
    return (
        f" Errors of the whole interface were marginalised: {listed(stated)} (standard deviations)." if stated else ""
    )


def _runs(s: Mapping[str, Any]) -> str:
    ok, failed = s["runs"]["ok"], s["runs"]["failed"]
    kinds = ", ".join(f"{count} × {kind.replace('_', ' ')}" for kind, count in s["runs"]["by_kind"].items())
    lost = f", {failed} of which failed ({kinds})" if failed else ""
    if s["certificate"] is not None:
        how = "chosen one batch after the other where the posterior lies"
    elif s["refinement"]:
        how = "from a Sobol design that was refined where the posterior lies"
    else:
        how = "from a Sobol design"
    return f"We made {ok + failed} forward runs{lost}, {how}."


def _surrogate(s: Mapping[str, Any]) -> str:
    found = s["surrogate"]
    if found["kind"] == "field":
        error = found["predicted_error_um"]["median"]
        return (
            f"A Gaussian-process surrogate of the interface ({found['modes']} modes, {found['n_train']} runs) took the "
            f"place of the model; its error where the posterior lies is {number(error, 2)} µm."
        )
    first = next(iter(s["measures"].values()))
    return f"A Gaussian-process surrogate of the log-likelihood ({first['n_train']} runs) took the place of the model."


def _checks(s: Mapping[str, Any]) -> Iterator[str]:
    certificate, misfit, quadrature = s["certificate"], s["misfit"], s["quadrature_check"]
    if quadrature is not None and quadrature["converged"]:
        yield (
            "Means by quadrature of the same surrogate differ by at most "
            f"{number(quadrature['max_mean_error_sd'], 2)} standard deviations."
        )
    if certificate is not None:
        check = certificate.get("check")
        if certificate["converged"] and check is not None:
            yield f"The true model confirmed the posterior at {check['draws']} {check['by']}."
        else:
            yield "The design ended before the posterior was confirmed by the true model."
    if s["nearest"]["message"]:
        yield "No forward run comes near the observation, so the posterior must not be used."
    elif misfit is not None:
        does = "does not explain" if misfit["flagged"] else "explains"
        known = [misfit[name] for name in ("p", "region_p", "smooth_p", "predictive_p") if misfit.get(name) is not None]
        least = (min(known) if misfit["flagged"] else misfit["p"]) if known else None
        p = "" if least is None else f" (p = {number(least, 2)})"
        allowed = " and the model error" if _model_error(s["likelihood"]) else ""
        yield f"The model {does} the observation within the noise{allowed}{p}."
