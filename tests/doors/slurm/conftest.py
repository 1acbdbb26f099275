"""A SLURM of the tests' own, where its programs are."""

import pytest
from tests.doors.slurm.private_slurm import missing_programs, temporary_slurm


@pytest.fixture(scope="session")
def running_slurm():
    missing = missing_programs()
    if missing:
        pytest.skip(f"no {', '.join(missing)}: apt-get install slurmctld slurmd slurm-client munge")
    with temporary_slurm() as slurm:
        yield slurm


@pytest.fixture
def slurm(running_slurm):
    """Give a SLURM without jobs, all nodes in service."""
    running_slurm.quiet()
    yield running_slurm
    running_slurm.quiet()
