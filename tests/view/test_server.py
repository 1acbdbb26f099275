"""The server of the page: what it answers, whom it refuses, and that it leaves the study as it is."""

import hashlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

import strandline as sl
from strandline.errors import InvalidInput
from strandline.testing.studies import beam
from strandline.view import Server, serving


@pytest.fixture
def server(folder: Path) -> Iterator[Server]:
    with serving(sl.load_study(folder)) as found:
        yield found


@pytest.fixture
def client(server: Server) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=server.url, timeout=60) as found:
        assert found.get("").status_code == 200
        yield found


def settled(client: httpx.Client) -> dict[str, Any]:
    """Return the posterior, once there is one; as a page does, ask for the runs first."""
    client.get("/api/runs")
    for _ in range(600):
        found: dict[str, Any] = client.get("/api/posterior").json()
        if "mean" in found:
            return found
        threading.Event().wait(0.1)
    raise AssertionError(found)


def digests(folder: Path) -> dict[str, str]:
    hidden = ("-shm", "-wal", ".lock")
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.is_file() and not path.name.endswith(hidden)
    }


def test_it_answers_what_the_study_says_and_changes_nothing(folder: Path, client: httpx.Client) -> None:
    before = digests(folder)
    facts = client.get("/api/study").json()
    assert [one["name"] for one in facts["inputs"]] == ["E", "tilt"]
    assert facts["inputs"][1]["nuisance"]
    assert len(facts["conditions"][0]["observed"][0]) == 17
    posterior = settled(client)
    summary = json.loads((folder / "summary.json").read_text("utf-8"))
    for name, item in summary["inputs"].items():
        assert posterior["mean"][name] == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert posterior["sd"][name] == pytest.approx(item["sd"], rel=0.06)
    runs = client.get("/api/runs", params={"since": 0}).json()
    assert runs["total"] == 25
    assert set(runs["state"]) == {"ok"}
    run = client.get("/api/run", params={"row": 3}).json()
    assert run["inputs"]["E"] == pytest.approx(runs["inputs"]["E"][3], rel=1e-5)
    assert len(run["interfaces"][""]["offsets"]) == 17
    state = client.get("/api/state").json()
    assert (state["ok"], state["results"]) == (24, "current")
    assert state["summary"]["misfit"]["verdict"] == summary["misfit"]["verdict"]
    assert digests(folder) == before


def test_predictions_are_those_of_the_model(client: httpx.Client) -> None:
    settled(client)
    inputs = {"E": 430.0, "tilt": 0.013}
    found = client.post("/api/predict", json={"inputs": inputs}).json()
    true = beam({**inputs, "load": 1e-5}, Path()).interfaces[""]
    line = found["conditions"][""]["line"]
    assert line[1] == pytest.approx(true.points[:, 1].tolist(), abs=2e-4)
    assert found["success"] > 0.9
    assert found["conditions"][""]["sd_um"] < 1


def test_other_assumptions_are_those_of_what_if(folder: Path, client: httpx.Client) -> None:
    """The slider says what the command says, from the same draws."""
    settled(client)
    asked = {"noise": 1.5, "priors": {"E": {"normal": [420.0, 30.0]}}}
    quick = client.post("/api/ask", json={"assumptions": asked, "again": False}).json()
    again = client.post("/api/ask", json={"assumptions": asked, "again": True}).json()
    study = sl.load_study(folder)
    truth = sl.what_if(study, [{"noise": {"sd": 4.5, "unit": "um"}, "prior": {"E": {"normal": [420.0, 30.0]}}}])
    (answer,) = truth.answers
    assert answer.draws is not None
    for found in (quick, again):
        for k, name in enumerate(study.space.names):
            assert found["mean"][name] == pytest.approx(answer.draws.mean[k], abs=0.15 * answer.draws.sd[k])
            assert found["sd"][name] == pytest.approx(answer.draws.sd[k], rel=0.12)
    assert quick["by"] == "reweighting"
    assert quick["effective"] > 100
    assert len(quick["weights"]) == 2000
    nothing = client.post("/api/ask", json={"assumptions": {}, "again": False}).json()
    assert nothing["effective"] == pytest.approx(2000, rel=1e-6)
    fixed = client.post("/api/ask", json={"assumptions": {"fixed": {"tilt": 0.01}}, "again": False}).json()
    assert set(fixed["draws"]["tilt"]) == {0.01}


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("predict", {"inputs": {"E": 430}}, "tilt: got nothing; expected a number in its box, [0, 0.04]"),
    ("predict", {"inputs": {"E": 4300, "tilt": 0.01}}, "E: got 4300; expected a number in its box, [300, 560]"),
    ("ask", {"assumptions": {"noise": 0}}, "noise: got 0; expected a number from 0.2 to 5"),
    ("ask", {"assumptions": {"nose": 1}}, "assumptions: got nose; expected some of"),
    ("ask", {"assumptions": {"measure": "currents"}}, "measure: got currents; expected one of normal_offset, tracked"),
    ("ask", {"assumptions": {"priors": {"E": {"norml": [1, 2]}}}}, "norml"),
    ("ask", {"assumptions": {"priors": {"F": {"normal": [1, 2]}}}}, "input: got F; expected one of E, tilt"),
    ("ask", {"assumptions": {"fixed": {"E": 400}}}, "at least one calibrated input left"),
    ("flow", {"inputs": {"E": 400, "tilt": 0.01}}, "expected a model that offers its fields"),
    ("predict", {"inputs": [1, 2]}, "inputs: got [1, 2]; expected a JSON object"),
    ("ask", {"assumptions": {"measure": ["x"]}}, "measure: got ['x']"),
    ("ask", {"assumptions": {"priors": [1]}}, "priors and fixed: got something else"),
    ("save", {"name": "ünï"}, "name of the new study: got ünï"),
    ("save", {"name": "../there"}, "name of the new study: got ../there"),
    ("save", {"name": "beam"}, "expected no such folder yet"),
]


@pytest.mark.parametrize(("name", "body", "words"), REFUSED)
def test_what_makes_no_sense_is_refused_in_a_line(
    name: str, body: dict[str, Any], words: str, client: httpx.Client
) -> None:
    settled(client)
    answer = client.post(f"/api/{name}", json=body)
    assert answer.status_code == 400
    assert words in answer.json()["error"]
    assert "\n" not in answer.json()["error"]


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/nothing", 404), ("/nothing", 404), ("/page/x/../../server.py", 404), ("/page/%2e%2e/server.py", 403),
        ("/page/..%2fserver.py", 403), ("/api/run?row=999", 404), ("/api/run?row=-1", 400), ("/api/runs?since=x", 400),
        ("/api/picture", 404), ("/page/", 403), ("/page/app.js", 200), ("/panels/vendor/plotly-cartesian.min.js", 200),
    ],
)  # fmt: skip
def test_paths(path: str, status: int, client: httpx.Client) -> None:
    assert client.get(path).status_code == status


def test_a_body_that_is_no_object_is_refused(client: httpx.Client) -> None:
    for body in (b"{", b"[1]", b"\xff", b"null"):
        assert client.post("/api/ask", content=body).status_code == 400


@pytest.mark.parametrize(
    "path", ["/", "/api/study", "/events", "/page/app.js", "/panels/charts.js", "/api/picture", "/nothing"]
)
def test_nobody_gets_in_without_the_token(path: str, server: Server) -> None:
    for token in ("", "/wrong", "/" + server.door.token + "x"):
        assert httpx.get(f"http://127.0.0.1:{server.port}{token}{path}").status_code == 403
    whole = server.url.rstrip("/") + path
    assert httpx.get(whole, headers={"Host": "example.org"}).status_code == 403
    assert httpx.get(whole, headers={"Origin": "http://example.org"}).status_code == 403


def test_nothing_is_loaded_from_elsewhere(client: httpx.Client) -> None:
    for path in ("", "/page/app.js", "/panels/charts.js", "/api/study"):
        headers = client.get(path).headers
        assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'self'")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "Server" not in headers
        assert "Set-Cookie" not in headers


def test_it_listens_on_this_machine_alone(server: Server) -> None:
    assert server.url.startswith("http://127.0.0.1:")
    with socket.socket() as other:
        other.bind(("127.0.0.2", server.port))  # free: the server holds one address, not all


def test_a_forwarded_port_shows_the_page(server: Server) -> None:
    """As with `ssh -L`: the browser calls another port, of localhost."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        threading.Thread(target=_forward, args=(listening, server.port), daemon=True).start()
        for host in ("localhost", "127.0.0.1"):
            address = f"http://{host}:{port}/{server.door.token}/"
            origin = {"Origin": f"http://{host}:{port}"}
            assert httpx.get(f"{address}api/study", headers=origin).json()["name"] == "beam"
            with httpx.stream("GET", f"{address}events") as stream:
                assert next(stream.iter_lines()).startswith("data: ")


def _forward(listening: socket.socket, port: int) -> None:
    """Pass on whatever comes, until the listening socket is closed."""
    while True:
        try:
            near, _ = listening.accept()
        except OSError:
            return
        far = socket.create_connection(("127.0.0.1", port))
        for one, other in ((near, far), (far, near)):
            threading.Thread(target=_pump, args=(one, other), daemon=True).start()


def _pump(one: socket.socket, other: socket.socket) -> None:
    with one, suppress(OSError):
        while data := one.recv(65536):
            other.sendall(data)
        other.shutdown(socket.SHUT_WR)


def test_a_port_in_use_is_refused(server: Server, folder: Path) -> None:
    with pytest.raises(InvalidInput, match=f"port: got {server.port}: "):
        Server(sl.load_study(folder), port=server.port)


def test_events_tell_of_new_runs_within_a_second(folder: Path, client: httpx.Client) -> None:
    settled(client)
    with client.stream("GET", "/events") as stream:
        lines = (line for line in stream.iter_lines() if line.startswith("data: "))
        first = json.loads(next(lines)[6:])
        study = sl.load_study(folder)
        with study.runs.ledger() as ledger:
            key = study.runs.design_keys[0]
            ledger.exclude(key, "to see what happens")
        at = time.monotonic()
        changed = next(json.loads(line[6:]) for line in lines if json.loads(line[6:])["version"] > first["version"])
        assert time.monotonic() - at < 1.5
        assert (changed["ok"], changed["failed"]) == (23, 1)


def posterior_within(seconds: float, client: httpx.Client) -> bool:
    """Return whether there is a posterior before the time is over."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if "mean" in client.get("/api/posterior").json():
            return True
        time.sleep(0.05)
    return False


def test_the_posterior_waits_until_a_page_has_the_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.view.desk.PATIENCE", 1000.0)
    with serving(sl.load_study(folder)) as server, httpx.Client(base_url=server.url, timeout=60) as client:
        assert client.get("").status_code == 200
        assert not posterior_within(2.0, client)
        assert client.get("/api/runs").json()["total"] == 25
        assert posterior_within(60.0, client)


def test_the_posterior_comes_without_a_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.view.desk.PATIENCE", 0.1)
    with serving(sl.load_study(folder)) as server, httpx.Client(base_url=server.url, timeout=60) as client:
        assert client.get("").status_code == 200
        assert posterior_within(60.0, client)


def test_a_study_that_was_edited_is_noticed(folder: Path, client: httpx.Client) -> None:
    settled(client)
    assert not client.get("/api/state").json()["edited"]
    path = folder / "study.yaml"
    path.write_text(path.read_text("utf-8").replace('"seed": 1', '"seed": 2'), encoding="utf-8")
    for _ in range(50):
        if client.get("/api/state").json()["edited"]:
            break
        threading.Event().wait(0.1)
    else:
        raise AssertionError("it was not noticed")


def test_a_result_that_was_made_again_is_shown(
    folder: Path, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The study is run again without one of its runs while the page is open."""
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    before = settled(client)
    study = sl.load_study(folder)
    with study.runs.ledger() as ledger:
        ledger.exclude(study.runs.design_keys[3], "looks wrong")
    sl.run_study(study, executor=sl.InProcess())
    for _ in range(200):
        after = client.get("/api/posterior").json()
        if len(after["history"]) > len(before["history"]) and after["source"] == "stored":
            break
        threading.Event().wait(0.1)
    summary = json.loads((folder / "summary.json").read_text("utf-8"))
    assert after["mean"]["E"] == pytest.approx(summary["inputs"]["E"]["mean"], rel=2e-3)
    assert after["history"][-1]["runs"] == 23
    rows = client.get("/api/runs").json()
    run = client.get("/api/run", params={"row": rows["state"].index("excluded")}).json()
    assert run["excluded"] == "looks wrong"


def test_an_error_leaves_the_page_when_its_cause_has_gone(folder: Path, client: httpx.Client) -> None:
    settled(client)
    with client.stream("GET", "/events") as stream:
        states = (json.loads(line[6:]) for line in stream.iter_lines() if line.startswith("data: "))
        assert next(states)["problem"] == ""
        (folder / "ledger.sqlite").rename(folder / "away.sqlite")
        assert "ledger.sqlite" in next(one for one in states if one["problem"])["problem"]
        (folder / "away.sqlite").rename(folder / "ledger.sqlite")
        assert next(one for one in states if not one["problem"])["ok"] == 24


def test_draws_sampled_again_are_judged_by_all_of_them(folder: Path, client: httpx.Client) -> None:
    """Letting go of a slider gives what `what-if` gives, by weights or new draws alike."""
    settled(client)
    asked = {"priors": {"E": {"normal": [380.0, 12.0]}}}
    found = client.post("/api/ask", json={"assumptions": asked, "again": True}).json()
    (answer,) = sl.what_if(sl.load_study(folder), [{"prior": asked["priors"]}]).answers
    assert found["by"] == answer.by
    assert found["k_hat"] == pytest.approx(answer.k_hat)
    assert found["mean"]["E"] == pytest.approx(float(answer.draws.mean[0]))  # type: ignore[union-attr]
    assert len(found["draws"]["E"]) == 2000


def test_a_damaged_ledger_is_told(folder: Path, client: httpx.Client) -> None:
    settled(client)
    (folder / "ledger.sqlite").write_bytes(b"rubbish" * 1000)
    for _ in range(50):
        problem = client.get("/api/state").json()["problem"]
        if problem:
            break
        threading.Event().wait(0.1)
    assert "ledger.sqlite" in problem


def test_a_study_without_runs(folder: Path) -> None:
    (folder / "ledger.sqlite").unlink()
    (folder / "summary.json").unlink()
    with serving(sl.load_study(folder)) as server, httpx.Client(base_url=server.url) as client:
        posterior = client.get("/api/posterior").json()
        assert posterior["why_none"] == "too few forward runs have ended yet"
        assert client.get("/api/runs").json()["total"] == 0
        refused = client.post("/api/ask", json={"assumptions": {"noise": 2.0}})
        assert "too few forward runs have ended yet" in refused.json()["error"]
