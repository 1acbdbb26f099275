"""From study.yaml to objects of the domain: every key arrives where it belongs."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.studies.refused import message_of
from tests.unit.studies.test_refusals import BIOFILM, BOTH, COLUMN, EDGE, JOBS, OWN, SHARED, UM, of_table, prior

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, TrackedPoints
from strandline.errors import InvalidStudy
from strandline.interface import GaussianNoise, Interface, PointErrors, UnknownErrors, spacings
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.python import PythonModel
from strandline.priors import LogNormal, Normal, ScaledBeta, Uniform
from strandline.runs import InProcess, LocalProcesses
from strandline.runs.executors import EXECUTORS, with_workers
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.smc import SMCSettings
from strandline.studies import Study, load_study
from strandline.studies.keys.executor import ExecutorChoice
from strandline.studies.noise import require_stated
from strandline.studies.observed import SyntheticNoise, noisy, read_points, require_plausible
from strandline.studies.parse import parse_study
from strandline.studies.template import write_template
from strandline.testing.models import TwoLoads
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
INPUTS = {"E": 400.0, "load": 1e-5}


def loaded(folder: Path, **changes: Any) -> Study:
    return load_study(write_study(folder, **changes))


def test_everything_arrives(tmp_path: Path) -> None:
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
    assert study.truth == TRUTH
    assert sorted(path.name for path in folder.iterdir()) == ["study.yaml"]
    assert parse_study(folder)[1] == study.text == (folder / "study.yaml").read_text()
    assert study.text_digest == load_study(folder).text_digest != replace(study, text=study.text + " ").text_digest


def test_defaults_are_the_published_kernel_and_the_economical_sampler(tmp_path: Path) -> None:
    study = loaded(tmp_path, sampler=None, executor=None, seed=None)
    settings = study.settings
    assert (settings.particles, settings.seed, settings.scramble, settings.kernel) == (5000, 1, None, "matern32")
    assert settings.smc == SMCSettings() == SMCSettings(rejuvenation_steps=15, zeta=0.5)
    assert (settings.nuisance_values, study.executor, study.synthetic_noise) == (32, LocalProcesses(), None)
    assert (study.turned, study.sensitivities) == ((), False)


def test_numbers_and_units_are_read_as_they_are_meant(tmp_path: Path) -> None:
    """YAML 1.1 takes 1e-5 for a text: it has no point."""
    text = json.dumps(dict(BEAM_STUDY)).replace('"fixed": {"load": 1e-05}', '"fixed": {"load": 1e-5}')
    (tmp_path / "study.yaml").write_text(text)
    assert load_study(tmp_path).fixed == {"load": 1e-5}
    assert loaded(tmp_path, fixed={"load": {"value": 2, "unit": "N/m"}}).fixed == {"load": 2.0}
    for unit in ("mm^2/s", "mm²/s", "mm**2 / s"):
        study = loaded(tmp_path, **BIOFILM | {"fixed": {"V_in": {"value": 90, "unit": unit}}})
        assert study.fixed == {"V_in": 90.0}


def test_priors_labels_and_nuisance(tmp_path: Path) -> None:
    for family, expected in (
        ({"uniform": [310, 500]}, Uniform(310.0, 500.0)),
        ({"normal": [400, 30]}, Normal(400.0, 30.0)),
        ({"lognormal": [6, 0.1]}, LogNormal(6.0, 0.1)),
        ({"beta": [2, 3, 310, 500]}, ScaledBeta(2.0, 3.0, 310.0, 500.0)),
    ):
        item = loaded(tmp_path, **prior([300, 560], **family)).space["E"]
        assert (item.prior, item.interval) == (expected, (300.0, 560.0))
    assert 0.0 < loaded(tmp_path, **prior([300, 560], lognormal=[6.0, 0.2])).space["E"].mass_cut < 0.5
    inputs = {name: {**item} for name, item in BEAM_STUDY["inputs"].items()}
    inputs["E"]["label"], inputs["tilt"]["nuisance"] = " E_1 ", True
    found = loaded(tmp_path, inputs=inputs).space
    assert [(p.shown, p.nuisance) for p in found] == [("E_1", False), ("tilt", True)]


def test_a_model_that_declares_nothing_takes_the_studys_units(tmp_path: Path) -> None:
    undeclared: dict[str, Any] = {
        "model": {"python": {"function": "strandline.testing.studies:undeclared_beam"}},
        "inputs": {"E": {"prior": {"uniform": [300, 560]}}, "tilt": {"prior": {"uniform": [0, 0.04]}, "unit": "rad"}},
    }
    assert [p.unit for p in loaded(tmp_path, **undeclared).space] == ["1", "rad"]
    for truth, words in (({"E": 1, "tilt": 0}, "load too"), ({**TRUTH, "nu": 1}, "got nu")):
        assert words in message_of(write_study(tmp_path, **undeclared, observation={"synthetic": truth}))


def test_measures_by_their_options(tmp_path: Path) -> None:
    lines = [[0.5, 0.1, 0, 1]]
    found = loaded(tmp_path, discrepancy=[{"measurement_lines": {"lines": lines}}, {"tracked_points": {}}])
    assert found.discrepancies == {"measurement_lines": MeasurementLines(lines), "tracked_points": TrackedPoints()}


def test_sensitivities_are_asked_of_models_that_offer_them(tmp_path: Path) -> None:
    study = loaded(tmp_path, **TWO_LOADS_STUDY, sensitivities=True)
    assert study.sensitivities
    assert study.runs.needed_keys == loaded(tmp_path, **TWO_LOADS_STUDY).runs.needed_keys


class TestObserved:
    POINTS = np.array([[0.0, 0.0], [0.5, 0.25], [1.0, -0.125]])

    def test_variants_of_one_table(self, tmp_path: Path) -> None:
        path = tmp_path / "observed.csv"
        for text in (
            b"0,0\n0.5,0.25\n1,-0.125\n",
            b"x,y\n0,0\n0.5,0.25\n1,-0.125\n",
            b"x [mm]; y [mm]\n0;0\n0.5;0.25\n1;-0.125\n",
            b"0 0\n5e-1\t2.5E-1\n  1   -0.125",
            b"# by hand\n\n0, 0\n# between\n0.5 , 0.25\n\n1,-0.125\n\n",
            b"\xef\xbb\xbfx,y\r\n0,0\r\n0.5,0.25\r\n1,-0.125\r\n",
        ):
            path.write_bytes(text)
            found = read_points(path, "mm")
            np.testing.assert_array_equal(found.points, self.POINTS)
            assert not found.closed
        for unit, factor in (("um", 1e-3), ("µm", 1e-3), ("m", 1e3)):
            np.testing.assert_allclose(read_points(path, unit).points, self.POINTS * factor, rtol=1e-15)
        with pytest.raises(InvalidStudy, match="cannot be read"):
            read_points(tmp_path, "mm")

    def test_a_file_is_read_in_its_unit_and_turned_round(self, tmp_path: Path) -> None:
        points = Outline().interface().points
        np.savetxt(tmp_path / "o.csv", points[::-1] * 1000, delimiter=",")
        study = loaded(tmp_path, **BIOFILM | {"observation": {"file": "o.csv", "unit": "um"}})
        np.testing.assert_allclose(study.observed[""].points, points, atol=1e-12)
        assert (list(study.observed), study.turned, study.truth) == ([""], ("",), None)
        np.savetxt(tmp_path / "o.csv", points * 1000, delimiter=",")
        assert load_study(tmp_path).turned == ()

    def test_options_of_reading_arrive(self, tmp_path: Path) -> None:
        (tmp_path / "o.csv").write_text("b;a\n0,12;1\n0,0;0\n")
        options = {"columns": ["a", "b"], "sort": "x", "decimal": ","}
        study = loaded(tmp_path, observation={"file": "o.csv", "unit": "mm", **options})
        np.testing.assert_array_equal(study.observed[""].points, [[0.0, 0.0], [1.0, 0.12]])

    def test_a_wrong_unit_shows_in_the_size(self) -> None:
        model = Interface.polyline(self.POINTS)
        for scale in (0.11, 2.0, 9.0):
            require_plausible("o.csv", Interface.polyline(self.POINTS * scale), model, unit="mm")
        for scale in (0.09, 11.0):
            with pytest.raises(InvalidStudy, match=r"o\.csv, read in mm: got .* mm across"):
                require_plausible("o.csv", Interface.polyline(self.POINTS * scale), model, unit="mm")

    def test_files_are_read_by_condition(self, tmp_path: Path) -> None:
        interfaces = TwoLoads()(INPUTS, tmp_path).interfaces
        for name, interface in interfaces.items():
            np.savetxt(tmp_path / f"{name}.csv", interface.points * 1000, delimiter=",", fmt="%.17g")
        study = loaded(tmp_path, **TWO_LOADS_STUDY | {"observation": BOTH})
        assert list(study.observed) == ["heavy", "light"]
        for name, interface in interfaces.items():
            np.testing.assert_allclose(study.observed[name].points, interface.points, rtol=1e-12)
        assert list(loaded(tmp_path, **TWO_LOADS_STUDY | {"observation": BOTH[:1]}).observed) == ["heavy"]
        synthetic = loaded(tmp_path, **TWO_LOADS_STUDY)
        assert (synthetic.observed, synthetic.truth) == ({}, INPUTS)


class TestNoise:
    @pytest.mark.parametrize(
        ("given", "expected"),
        [
            ({"sd": 3, **UM}, PointErrors(0.003)),
            ({"sd": 0.003, "length": 0.015, "unit": "mm"}, PointErrors(0.003, 0.015)),
            (
                {**OWN, "unknown": {"shift": 8, "rotation": 0.5, "scale": 0.005, "offset": 2, "shared": True}},
                PointErrors(0.003, 0.015, 0.008, 0.5, 0.005, 0.002, True),
            ),
            ({"sd": 0.5}, GaussianNoise(0.25)),
        ],
    )
    def test_lengths_become_mm(self, tmp_path: Path, given: dict[str, Any], expected: Any) -> None:
        noise = loaded(tmp_path, noise=given).noise
        assert type(noise) is type(expected)
        for name, value in vars(expected).items():
            assert getattr(noise, name) == pytest.approx(value)

    def test_each_point_has_the_sd_of_its_column(self, tmp_path: Path) -> None:
        (tmp_path / "edge.csv").write_text(EDGE)
        options = {"columns": ["x", "y"], "sd": "sd", "hide": {"x": [0.3, 0.4]}}
        study = loaded(tmp_path, **of_table({**COLUMN, "unknown": {"offset": 2}}, **options))
        seen, errors = study.observed[""], study.noise_of("")
        assert isinstance(errors, PointErrors)
        expected = np.array([0.001 * (1 + k % 3) for k in range(17) if not 0.3 <= 0.0625 * k <= 0.4])
        np.testing.assert_allclose(errors.sds(seen), expected)
        assert (errors.length, errors.offset) == pytest.approx((0.02, 0.002))
        apart = spacings(seen, gaps=False)
        np.testing.assert_allclose(errors.model(seen).local, expected**2 / np.tanh(apart / 0.04), rtol=1e-9)

    def test_a_condition_of_its_own_noise_has_no_column(self, tmp_path: Path) -> None:
        for name, interface in TwoLoads()(INPUTS, tmp_path).interfaces.items():
            table = np.column_stack([interface.points * 1000, np.full(len(interface.points), 3.0)])
            np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",")
        heavy, light = ({**BOTH[0], "columns": [1, 2], "sd": 3}, {**BOTH[1], "columns": [1, 2]})
        noise = {**COLUMN, "conditions": {"light": {"sd": 3, "length": 15, **UM}}}
        for files in ([light, heavy], [heavy, light]):
            study = loaded(tmp_path, **TWO_LOADS_STUDY | {"observation": files, "noise": noise})
            assert study.noise_of("light") == PointErrors(0.003, 0.015)
            np.testing.assert_allclose(study.noise_of("heavy").sds(study.observed["heavy"]), 0.003)  # type: ignore[union-attr]

    def test_conditions_may_share_errors_and_have_their_own_sd_and_offset(self, tmp_path: Path) -> None:
        own = {**SHARED, "sd": 5, "unknown": {**SHARED["unknown"], "offset": 2}}
        study = loaded(tmp_path, **TWO_LOADS_STUDY | {"noise": {**SHARED, "conditions": {"light": own}}})
        assert study.noise_of("light") == PointErrors(0.005, 0.015, 0.008, 0.5, offset=0.002, shared=True)

    def test_commands_that_need_a_known_noise_say_so(self) -> None:
        require_stated([PointErrors(0.003), GaussianNoise(1.0)], "strandline serve")
        for noise, value in (
            (UnknownErrors(), "unknown"),
            (UnknownErrors(0.003, 0.015, model_error=True), "a model error"),
        ):
            with pytest.raises(InvalidStudy, match=f"`strandline serve` needs a known noise: got {value};"):
                require_stated([PointErrors(0.003), noise], "strandline serve")


class TestSyntheticNoise:
    LINE = Interface.polyline(np.stack([np.linspace(0.0, 100.0, 4001), np.zeros(4001)], axis=1))
    SHORT = Interface.polyline(LINE.points[:1201])

    def added(self, noise: SyntheticNoise, condition: str = "", line: Interface = SHORT) -> Any:
        return noisy({condition: line}, noise)[condition].points - line.points

    def test_it_is_independent_gaussian_on_both_coordinates(self) -> None:
        noise = self.added(SyntheticNoise(0.002, 1), line=self.LINE)
        np.testing.assert_allclose(noise.std(axis=0), 0.002, rtol=0.05)
        np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 * 0.002 / 4001**0.5)
        assert abs(np.corrcoef(noise.T)[0, 1]) < 0.06
        assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.06
        assert 0.66 < (np.abs(noise) < 0.002).mean() < 0.71
        assert noisy({"": self.LINE}, None) == {"": self.LINE}

    def test_seed_and_condition_decide_it(self) -> None:
        first = self.added(SyntheticNoise(0.002, 1))
        np.testing.assert_array_equal(self.added(SyntheticNoise(0.002, 1)), first)
        np.testing.assert_allclose(self.added(SyntheticNoise(0.004, 1)), 2 * first, rtol=1e-6, atol=1e-12)
        for other in (self.added(SyntheticNoise(0.002, 2)), self.added(SyntheticNoise(0.002, 1), "slow")):
            assert abs(np.corrcoef(other.ravel(), first.ravel())[0, 1]) < 0.06
        both = noisy({"slow": self.SHORT, "": self.SHORT}, SyntheticNoise(0.002, 1))
        np.testing.assert_array_equal(both[""].points - self.SHORT.points, first)

    def test_the_seed_is_the_studys_unless_it_has_its_own(self, tmp_path: Path) -> None:
        for noise, expected in (({"sd": 0.001}, 7), ({"sd": 0.001, "seed": 0}, 0)):
            study = loaded(tmp_path, observation={"synthetic": TRUTH, "noise": noise}, seed=7)
            assert study.synthetic_noise == SyntheticNoise(0.001, expected)

    def test_an_interface_that_touches_itself_is_refused(self) -> None:
        with pytest.raises(InvalidStudy, match=r"observation\.noise: with it.*sd: 1.*0\.025 mm"):
            noisy({"": self.LINE}, SyntheticNoise(1.0, 1))


class TestExecutor:
    def test_every_option_arrives(self, tmp_path: Path) -> None:
        assert {name for name, field in ExecutorChoice.model_fields.items() if not field.exclude} == set(EXECUTORS)
        jobs = {**JOBS, "queue": "q", "account": "a", "interface": "lo", "extra": ["--x"], "prologue": ["y"]}
        options: dict[str, Any] = {"cluster": "pbs", "minimum": 0, "maximum": 7, "timeout": 60.0}
        for given, expected in (
            ({"in_process": {}}, InProcess()),
            ({"local": {"workers": 3, "timeout": 5}}, LocalProcesses(3, 5.0)),
            ({"dask": {**options, "jobs": jobs}}, DaskCluster(**options, jobs=jobs)),
            ({"dask": {"address": "tcp://h:1"}}, DaskCluster(address="tcp://h:1")),
        ):
            assert loaded(tmp_path, executor=given).executor == expected

    def test_every_option_of_an_array_arrives(self, tmp_path: Path) -> None:
        options = {"walltime": "1-00", "partition": "p", "account": "a", "cpus": 2, "memory": "1G", "max_running": 3}
        more: dict[str, Any] = {"timeout": 9.0, "max_jobs": 4, "extra": ("--x",), "poll": 1.0}
        found = loaded(tmp_path, executor={"slurm_array": {**options, **more, "extra": ["--x"]}}).executor
        command = (sys.executable, "-m", "strandline.studies.array_task", str(tmp_path))
        assert found == SlurmArray(tmp_path / "slurm", command, **options, **more)
        fixed = ["--array=0-9%3", "--no-requeue", "--signal=B:USR1@45", "--time=1-00", "--partition=p", "--account=a"]
        assert found.options(10) == [*fixed, "--cpus-per-task=2", "--mem=1G", "--x"]  # type: ignore[union-attr]

    def test_another_number_of_workers(self) -> None:
        assert with_workers(LocalProcesses(3, 5.0), 2) == LocalProcesses(2, 5.0)
        queued = DaskCluster(cluster="slurm", minimum=1, maximum=3, jobs=JOBS)
        assert with_workers(queued, 2) == DaskCluster(cluster="slurm", workers=2, jobs=JOBS)
        assert with_workers(InProcess(), 2) == InProcess()
        assert with_workers(queued, None) is queued


def test_the_template_loads_and_its_comments_are_the_models_meanings(tmp_path: Path) -> None:
    path = write_template(tmp_path / "study")
    assert load_study(path.parent).name == "study"
    lines = path.read_text("utf-8").splitlines()
    for item in Biofilm().inputs:
        (line,) = (line for line in lines if line.lstrip().startswith((f"{item.name}:", f"fixed: {{{item.name}:")))
        assert line.partition("#")[2].strip().startswith(item.meaning)
        assert item.unit == "1" or item.unit in line
