"""Who gets at a Dask cluster of ours: nobody without its key, and nobody from another machine where it is local."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from strandline.errors import InvalidInput
from strandline.runs.executors import dask_cluster
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.dask_cluster import opened
from strandline.runs.executors.dask_security import keys_in_files
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever

distributed = pytest.importorskip("distributed", reason="the extra `dask` is not installed")
pytest.importorskip("cryptography", reason="the extra `dask` is not installed")
REFUSED = "Timed out|reset by peer|TLS|SSL|closed"
KEYS = {"ca-file": "tls_ca_file", "client.cert": "tls_client_cert", "client.key": "tls_client_key"}


@pytest.fixture(scope="module")
def cluster():
    """Give a local cluster as the executor starts it."""
    with opened("local", None, 1, {}) as cluster:
        cluster.client.wait_for_workers(1)
        yield cluster


def test_only_keys_of_this_machine_are_cleared(tmp_path, monkeypatch):
    """One whose name begins like ours shares the folder; its process 2-… is no process 2 of ours."""
    monkeypatch.setattr(socket, "gethostname", lambda: "node")
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    theirs, ours, alive = (
        tmp_path / f"dask-node-{rest}" for rest in (f"{gone.pid}-{gone.pid}-x1", f"{gone.pid}-x1", f"{os.getpid()}-x1")
    )
    for folder in (theirs, ours, alive):
        folder.mkdir()
    with keys_in_files(tmp_path):
        assert [folder.exists() for folder in (theirs, ours, alive)] == [True, False, True]


def run_of_a_stranger(address, *, timeout=3, **options):
    """Run code on the cluster at `address`, as whoever can reach its port would."""
    with distributed.Client(address, set_as_default=False, timeout=timeout, **options) as client:
        return client.submit(os.getpid).result(timeout=60)


def test_a_client_without_the_key_is_refused(cluster):
    assert cluster.address.startswith("tls://")
    with pytest.raises(OSError, match=REFUSED):
        run_of_a_stranger(cluster.address.replace("tls://", "tcp://"))


def test_a_client_with_another_key_is_refused(cluster):
    with pytest.raises(OSError, match=REFUSED):
        run_of_a_stranger(cluster.address, security=distributed.Security.temporary())


def test_a_client_with_the_key_gets_in(cluster):
    assert run_of_a_stranger(cluster.address, timeout=60, security=cluster.client.security) != os.getpid()


def test_a_worker_without_the_key_gives_nothing_away(cluster):
    """The workers have ports of their own, by which they could be given runs as well."""
    (worker,) = cluster.client.nthreads()
    assert worker.startswith("tls://")
    with pytest.raises(OSError, match=REFUSED):
        run_of_a_stranger(worker.replace("tls://", "tcp://"))


def test_a_local_cluster_listens_on_loopback_alone(cluster):
    import psutil

    this = psutil.Process()
    listening = [
        connection.laddr.ip
        for process in [this, *this.children(recursive=True)]
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) >= 3
    assert set(listening) <= {"127.0.0.1", "::1"}


def test_the_key_is_on_no_command_line(cluster):
    import psutil

    lines = [" ".join(process.cmdline()) for process in psutil.Process().children(recursive=True)]
    assert lines
    assert not any(cluster.client.security.tls_worker_key.splitlines()[1] in line for line in lines)


def test_dasks_own_configuration_gives_the_keys_of_an_address(cluster):
    import dask

    given = {f"distributed.comm.tls.{name}": getattr(cluster.client.security, field) for name, field in KEYS.items()}
    with dask.config.set(given):
        records = list(DaskCluster(address=cluster.address)(Cantilever(), requests_for(Cantilever())))
    assert all(record.ok for record in records)


def test_an_address_that_wants_keys_is_one_clear_error(cluster, monkeypatch):
    monkeypatch.setattr(dask_cluster, "REACH_SECONDS", 2.0)
    with pytest.raises(InvalidInput, match=r"tls://127\.0\.0\.1.*distributed\.comm\.tls"):
        list(DaskCluster(address=cluster.address)(Cantilever(), requests_for(Cantilever())))


def test_a_missing_cryptography_names_its_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(InvalidInput, match=r'cryptography.*pip install "strandline\[dask\]"'):
        list(DaskCluster(workers=1)(Cantilever(), requests_for(Cantilever())))


def test_files_of_keys_are_for_their_owner_and_go(tmp_path):
    before = os.umask(0)
    try:
        with keys_in_files(tmp_path / "here") as security:
            key, certificate = Path(security.tls_worker_key), Path(security.tls_ca_file)
            assert "PRIVATE KEY" in key.read_text()
            assert "PRIVATE KEY" not in certificate.read_text()
            assert {path.stat().st_mode & 0o777 for path in (key, certificate)} == {0o600}
            assert key.parent.stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(before)
    assert list((tmp_path / "here").iterdir()) == []


def test_keys_of_a_killed_driver_are_removed_by_the_next(tmp_path):
    with keys_in_files(tmp_path) as security:
        mine = Path(security.tls_worker_key).parent
        with subprocess.Popen([sys.executable, "-c", ""]) as gone:
            pass
        forgotten = tmp_path / mine.name.replace(f"-{os.getpid()}-", f"-{gone.pid}-")
        forgotten.mkdir()
        (forgotten / "key.pem").touch()
        with keys_in_files(tmp_path):
            assert not forgotten.exists()
            assert mine.exists()


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(InvalidInput, match="shared-temp-directory"),
        keys_in_files(tmp_path / "file" / "below"),
    ):
        pytest.fail("keys were written")


def test_the_scheduler_of_jobs_listens_at_one_address_and_shows_no_pages():
    from distributed.utils import get_ip

    options = dask_cluster._listening("slurm", {})
    assert options == {"dashboard": False, "dashboard_address": "127.0.0.1:0", "host": get_ip()}
    assert "host" not in dask_cluster._listening("slurm", {"interface": "ib0"})
