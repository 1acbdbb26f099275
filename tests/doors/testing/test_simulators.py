"""The conformance suite of simulators, over the registry of models."""

import sys

import pytest
from tests.doors.models.test_umbridge_client import JACOBIAN
from tests.doors.models.test_umbridge_client import model as served_model
from tests.unit.models.umbridge.served import served

from strandline.models import MODELS
from strandline.models.biofilm.model import Biofilm
from strandline.models.command.model import CommandModel
from strandline.models.python import PythonModel
from strandline.readers import Reading
from strandline.testing.models import Cantilever
from strandline.testing.simulators import CHECKS

BEAM = {"E": 400.0, "load": 1e-5}
ECHO = "import sys; e, f = map(float, sys.argv[1:]); print('0,0', f'1,{f * 1e5 / e:.17g}', '2,0', sep='\\n')"


def cantilever(inputs, workdir):
    return Cantilever()(inputs, workdir).interface


@pytest.fixture(params=MODELS)
def simulator(request, tmp_path):
    if request.param == "biofilm":
        yield Biofilm(mesh="coarse"), {"E": 400.0, "nu": 0.3, "V_in": 100.0}
    elif request.param == "python":
        yield PythonModel("tests.doors.testing.test_simulators:cantilever"), BEAM
    elif request.param == "umbridge":
        with served(JACOBIAN) as url:
            yield served_model(url), BEAM
    else:
        assert request.param == "command", f"no example of `{request.param}` here: add one"
        (tmp_path / "echo.py").write_text(ECHO)
        command = [sys.executable, "echo.py", "{{ E }}", "{{ load }}"]
        result = Reading("command.log", "mm")
        yield CommandModel(command=command, result=result, files=["echo.py"], folder=tmp_path), BEAM


def test_every_simulator_conforms(simulator):
    for check in CHECKS.values():
        check(*simulator)
