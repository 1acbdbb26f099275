"""From study.yaml to objects of the domain: every key arrives where it belongs, in the studies that come along too."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.studies.test_refusals import BIOFILM, BOTH, EDGE, OWN, SHARED, TABLE, UM, UNDECLARED, message_of

from strandline.discrepancy import ClosestPoint, Currents, require_plausible
from strandline.foundations import InvalidInput, InvalidStudy, write_json
from strandline.interface import GaussianNoise, Interface, PointErrors, UnknownErrors, spacings
from strandline.models.biofilm.mesh.outline import Outline
from strandline.models.python import PythonModel
from strandline.parameters import LogNormal, Normal, ScaledBeta, Uniform
from strandline.runs import InProcess, LocalProcesses
from strandline.runs.executors import EXECUTORS, with_workers
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.smc import SMCSettings
from strandline.studies import load_study
from strandline.studies.keys.parse import parse_study
from strandline.studies.keys.study_file import ExecutorChoice
from strandline.studies.keys.text import _not_yaml
from strandline.studies.load.inputs import require_prior
from strandline.studies.load.observed import SyntheticNoise, noisy, read_points, require_stated
from strandline.testing.models import TwoLoads
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
INPUTS = {"E": 400.0, "load": 1e-5}


def loaded(folder, **changes):
    return load_study(write_study(folder, **changes))


def test_everything_arrives(tmp_path):
    (tmp_path / "other").mkdir()
    folder = write_study(
        tmp_path / "study",
        name="all",
        discrepancy=[{"currents": {"width": 0.01, "quadrature": "centre"}}, {"closest_point": None}],
        noise={"variance": 0.25},
        design={"sobol": {"runs": 33, "scramble": 7}},
        surrogate={"log_likelihood": {"kernel": "matern32"}},
        sampler={"smc": {"particles": 50, "rejuvenation_steps": 3, "zeta": 0.9}, "cut": {"values": 8}},
        executor={"local": {"workers": 3, "timeout": 5}},
        reuse=["../other"],
        seed=11,
    )
    study = load_study(folder)
    assert (study.name, study.folder, study.noise) == ("all", folder, GaussianNoise(0.25))
    assert study.model == PythonModel("strandline.testing.studies:beam")
    assert study.fixed == {"load": 1e-5}
    box = [(p.name, p.shown, p.prior, p.unit, p.nuisance) for p in study.space]
    assert box == [("E", "E", Uniform(300.0, 560.0), "Pa", False), ("tilt", "tilt", Uniform(0.0, 0.04), "1", False)]
    measures = {"currents": Currents(0.01, quadrature="centre"), "closest_point": ClosestPoint()}
    assert list(study.discrepancies.items()) == list(measures.items())
    settings = study.settings
    assert (settings.runs, settings.scramble, settings.kernel, settings.particles) == (33, 7, "matern32", 50)
    assert settings.smc == SMCSettings(rejuvenation_steps=3, zeta=0.9)
    assert (settings.seed, settings.nuisance_values) == (11, 8)
    assert study.executor == LocalProcesses(workers=3, timeout=5.0)
    assert [path.resolve() for path in study.reuse] == [tmp_path / "other" / "ledger.sqlite"]
    assert parse_study(folder)[1] == study.text == (folder / "study.yaml").read_text()
    assert study.text_digest == load_study(folder).text_digest != replace(study, text=study.text + " ").text_digest


def test_defaults_are_the_published_kernel_and_the_economical_sampler(tmp_path):
    study = loaded(tmp_path, sampler=None, executor=None, seed=None)
    settings = study.settings
    assert (settings.particles, settings.seed, settings.scramble, settings.kernel) == (5000, 1, None, "matern32")
    assert settings.smc == SMCSettings() == SMCSettings(rejuvenation_steps=15, zeta=0.5)
    assert (settings.nuisance_values, study.executor, study.synthetic_noise) == (32, LocalProcesses(), None)


def test_numbers_and_units_are_read_as_they_are_meant(tmp_path):
    """YAML 1.1 takes 1e-5 for a text: it has no point."""
    text = json.dumps(dict(BEAM_STUDY)).replace('"fixed": {"load": 1e-05}', '"fixed": {"load": 1e-5}')
    (tmp_path / "study.yaml").write_text(text)
    assert load_study(tmp_path).fixed == {"load": 1e-5}
    for unit in ("mm^2/s", "mm²/s", "mm**2 / s"):
        assert loaded(tmp_path, **BIOFILM | {"fixed": {"V_in": {"value": 90, "unit": unit}}}).fixed == {"V_in": 90.0}


def test_priors_labels_and_nuisance(tmp_path):
    inputs = {name: {**item} for name, item in BEAM_STUDY["inputs"].items()}
    inputs["E"] |= {"box": [300, 560], "label": " E_1 "}
    inputs["tilt"]["nuisance"] = True
    for family, expected in (
        ({"uniform": [310, 500]}, Uniform(310.0, 500.0)),
        ({"normal": [400, 30]}, Normal(400.0, 30.0)),
        ({"lognormal": [6, 0.1]}, LogNormal(6.0, 0.1)),
        ({"beta": [2, 3, 310, 500]}, ScaledBeta(2.0, 3.0, 310.0, 500.0)),
    ):
        inputs["E"]["prior"] = family
        space = loaded(tmp_path, inputs=inputs).space
        assert (space["E"].prior, space["E"].interval) == (expected, (300.0, 560.0))
        assert [(p.shown, p.nuisance) for p in space] == [("E_1", False), ("tilt", True)]
    # A model that declares nothing takes the study's units.
    inputs = {"E": {"prior": {"uniform": [300, 560]}}, "tilt": {"prior": {"uniform": [0, 0.04]}, "unit": "rad"}}
    assert [p.unit for p in loaded(tmp_path, **UNDECLARED, inputs=inputs).space] == ["1", "rad"]
    for truth, words in (({"E": 1, "tilt": 0}, "load too"), ({**TRUTH, "nu": 1}, "got nu")):
        assert words in message_of(write_study(tmp_path, **UNDECLARED, observation={"synthetic": truth}))


class TestObserved:
    def test_units_and_sizes(self, tmp_path):
        points, path = np.array([[0.0, 0.0], [0.5, 0.25], [1.0, -0.125]]), tmp_path / "observed.csv"
        path.write_bytes(b"\xef\xbb\xbfx,y\r\n# by hand\r\n\r\n0,0\r\n0.5 , 2.5E-1\r\n1,-0.125\r\n\r\n")
        for unit, factor in (("mm", 1), ("um", 1e-3), ("µm", 1e-3), ("m", 1e3)):
            np.testing.assert_allclose(read_points(path, unit).points, points * factor, rtol=1e-15)
        model = Interface.polyline(points)
        for scale in (0.11, 9.0):
            require_plausible("o.csv", Interface.polyline(points * scale), model, unit="mm")
        for scale in (0.09, 11.0):
            with pytest.raises(InvalidInput, match=r"o\.csv, read in mm: got .* mm across"):
                require_plausible("o.csv", Interface.polyline(points * scale), model, unit="mm")

    def test_a_file_is_read_in_its_unit_as_its_options_say_and_turned_round(self, tmp_path):
        points = Outline().interface().points
        np.savetxt(tmp_path / "o.csv", points[::-1] * 1000, delimiter=",")
        study = loaded(tmp_path, **BIOFILM | {"observation": {"file": "o.csv", "unit": "um"}})
        np.testing.assert_allclose(study.observed[""].points, points, atol=1e-12)
        assert (list(study.observed), study.turned, study.truth) == ([""], ("",), None)
        np.savetxt(tmp_path / "o.csv", points * 1000, delimiter=",")
        assert load_study(tmp_path).turned == ()
        (tmp_path / "o.csv").write_text("b;a\n0,12;1\n0,0;0\n")
        options = {"columns": ["a", "b"], "sort": "x", "decimal": ","}
        study = loaded(tmp_path, observation={"file": "o.csv", "unit": "mm", **options})
        np.testing.assert_array_equal(study.observed[""].points, [[0.0, 0.0], [1.0, 0.12]])


class TestNoise:
    def test_lengths_become_mm(self, tmp_path):
        unknown = {"shift": 8, "rotation": 0.5, "scale": 0.005, "offset": 2, "shared": True}
        for given, expected in (
            ({"sd": 0.003, "length": 0.015, "unit": "mm"}, PointErrors(0.003, 0.015)),
            ({**OWN, "unknown": unknown}, PointErrors(0.003, 0.015, 0.008, 0.5, 0.005, 0.002, True)),
            ({"sd": 0.5}, GaussianNoise(0.25)),
        ):
            noise = loaded(tmp_path, noise=given).noise
            assert type(noise) is type(expected)
            for name, value in vars(expected).items():
                assert getattr(noise, name) == pytest.approx(value)

    def test_each_point_has_the_sd_of_its_column(self, tmp_path):
        (tmp_path / "edge.csv").write_text(EDGE)
        observation = {**TABLE["observation"], "columns": ["x", "y"], "hide": {"x": [0.3, 0.4]}}
        study = loaded(tmp_path, observation=observation, noise={**TABLE["noise"], "unknown": {"offset": 2}})
        seen, errors = study.observed[""], study.noise_of("")
        expected = np.array([0.001 * (1 + k % 3) for k in range(17) if not 0.3 <= 0.0625 * k <= 0.4])
        np.testing.assert_allclose(errors.sds(seen), expected)
        assert (errors.length, errors.offset) == pytest.approx((0.02, 0.002))
        apart = spacings(seen, gaps=False)
        np.testing.assert_allclose(errors.model(seen).local, expected**2 / np.tanh(apart / 0.04), rtol=1e-9)

    def test_conditions_have_their_own_noise_column_and_offset_and_may_share_errors(self, tmp_path):
        for name, interface in TwoLoads()(INPUTS, tmp_path).interfaces.items():
            table = np.column_stack([interface.points * 1000, np.full(len(interface.points), 3.0)])
            np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",")
        heavy, light = ({**BOTH[0], "columns": [1, 2], "sd": 3}, {**BOTH[1], "columns": [1, 2]})
        noise = {**TABLE["noise"], "conditions": {"light": {"sd": 3, "length": 15, **UM}}}
        for files in ([light, heavy], [heavy, light]):
            study = loaded(tmp_path, **TWO_LOADS_STUDY | {"observation": files, "noise": noise})
            assert study.noise_of("light") == PointErrors(0.003, 0.015)
            np.testing.assert_allclose(study.noise_of("heavy").sds(study.observed["heavy"]), 0.003)
        own = {**SHARED, "sd": 5, "unknown": {**SHARED["unknown"], "offset": 2}}
        study = loaded(tmp_path, **TWO_LOADS_STUDY | {"noise": {**SHARED, "conditions": {"light": own}}})
        assert study.noise_of("light") == PointErrors(0.005, 0.015, 0.008, 0.5, offset=0.002, shared=True)

    def test_commands_that_need_a_known_noise_say_so(self):
        require_stated([PointErrors(0.003), GaussianNoise(1.0)], "strandline serve")
        erring = UnknownErrors(0.003, 0.015, model_error=True)
        for noise, value in ((UnknownErrors(), "unknown"), (erring, "a model error")):
            with pytest.raises(InvalidStudy, match=f"`strandline serve` needs a known noise: got {value};"):
                require_stated([PointErrors(0.003), noise], "strandline serve")


def test_synthetic_noise_is_independent_and_gaussian_and_that_of_its_seed_and_condition(tmp_path):
    line = Interface.polyline(np.stack([np.linspace(0.0, 100.0, 4001), np.zeros(4001)], axis=1))

    def added(sd, seed, condition=""):
        found = noisy({"another": line, condition: line}, SyntheticNoise(sd, seed))
        return found[condition].points - line.points

    noise = added(0.002, 1)
    np.testing.assert_allclose(noise.std(axis=0), 0.002, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 * 0.002 / 4001**0.5)
    assert 0.66 < (np.abs(noise) < 0.002).mean() < 0.71
    np.testing.assert_array_equal(added(0.002, 1), noise)
    pairs = [(noise[:, 0], noise[:, 1]), (noise[1:, 0], noise[:-1, 0])]
    pairs += [(noise.ravel(), other.ravel()) for other in (added(0.002, 2), added(0.002, 1, "slow"))]
    assert all(abs(np.corrcoef(*pair)[0, 1]) < 0.06 for pair in pairs)
    with pytest.raises(InvalidStudy, match=r"observation\.noise: with it.*sd: 1.*0\.025 mm"):
        noisy({"": line}, SyntheticNoise(1.0, 1))
    for given, seed in (({"sd": 0.001}, 7), ({"sd": 0.001, "seed": 0}, 0)):
        study = loaded(tmp_path, observation={"synthetic": TRUTH, "noise": given}, seed=7)
        assert study.synthetic_noise == SyntheticNoise(0.001, seed)


def test_every_option_of_an_executor_arrives(tmp_path):
    assert {name for name, field in ExecutorChoice.model_fields.items() if not field.exclude} == set(EXECUTORS)
    jobs = {"cores": 4, "memory": "8GB", "walltime": "01:00:00"}
    more = {**jobs, "queue": "q", "account": "a", "interface": "lo", "extra": ["--x"], "prologue": ["y"]}
    dask = {"cluster": "pbs", "minimum": 0, "maximum": 7, "timeout": 60.0, "jobs": more}
    array = {"walltime": "1-00", "partition": "p", "account": "a", "cpus": 2, "memory": "1G", "max_running": 3}
    array |= {"timeout": 9.0, "max_jobs": 4, "extra": ["--x"], "poll": 1.0}
    command = (sys.executable, "-m", "strandline.studies.array_task", str(tmp_path))
    slurm = SlurmArray(tmp_path / "slurm", command, **{**array, "extra": ("--x",)})
    for given, expected in (
        ({"in_process": {}}, InProcess()),
        ({"dask": dask}, DaskCluster(**dask)),
        ({"dask": {"address": "tcp://h:1"}}, DaskCluster(address="tcp://h:1")),
        ({"slurm_array": array}, slurm),
    ):
        assert loaded(tmp_path, executor=given).executor == expected
    queued = DaskCluster(cluster="slurm", minimum=1, maximum=3, jobs=jobs)
    assert with_workers(queued, 2) == DaskCluster(cluster="slurm", workers=2, jobs=jobs)


def test_studies_that_come_along_load_and_those_of_one_specimen_need_the_same_forward_runs():
    places = (Path(__file__).parents[3] / "studies").glob("*/study.yaml")
    studies = {path.parent.name: load_study(path.parent) for path in places}
    assert [study.name for study in studies.values()] == list(studies)
    refined = ("biofilm-uniform-refined", "biofilm-inflow-refined", "biofilm-parts-refined")
    sources = {name: name.removesuffix("-refined") for name in refined}
    for name, source in {
        **sources,
        "biofilm-informed": "biofilm-uniform",
        "biofilm-measures": "biofilm-uniform",
    }.items():
        assert studies[name].runs.needed_keys == studies[source].runs.needed_keys
        assert [path.resolve() for path in studies[name].reuse] == [studies[source].ledger_path]
    # Ground truth, noise and settings of the publication's last example.
    study, settings = studies["biofilm-parts"], studies["biofilm-parts"].settings
    assert study.truth == {"E1": 500, "nu1": 0.2, "E2": 200, "nu2": 0.1, "E3": 1000, "nu3": 0.3, "V_in": 100}
    assert (settings.runs, settings.particles, settings.kernel) == (2000, 10_000, "matern32_product")
    assert (study.synthetic_noise.sd, settings.smc.rejuvenation_steps, settings.smc.zeta) == (0.001, 30, 0.998)


def test_a_prior_of_ones_own_needs_an_interval():
    parts = {"log_density": lambda x: -x, "cdf": abs, "quantile": abs}
    require_prior(SimpleNamespace(support=(0.0, 1.0), **parts), "a")
    for support in ((0.0, 1.0, 2.0), (1.0, 0.0), 3.0):
        with pytest.raises(InvalidStudy, match=r"two numbers, \(low, high\)"):
            require_prior(SimpleNamespace(support=support, **parts), "a")


def test_yaml_is_refused_where_its_mistake_is():
    assert str(_not_yaml(None, "x")).startswith("study.yaml is not valid YAML")
    mark = SimpleNamespace(line=2, column=4)
    assert str(_not_yaml(mark, "x")).startswith("study.yaml, line 3, column 5 is not valid YAML")


def test_numbers_that_are_not_finite_are_null_in_json(tmp_path):
    write_json(tmp_path / "some.json", {"a": [np.nan, 1.0], "b": {"c": (np.inf,)}})
    assert json.loads((tmp_path / "some.json").read_text()) == {"a": [None, 1.0], "b": {"c": [None]}}
