"""The server of the page: whom it answers, what it refuses, and how it notices what changes."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

import strandline as sl
from strandline.testing.studies import write_study
from strandline.view import Server, serving, show


def until(what: Callable[[], Any]) -> Any:
    """Return what a function returns once that is true."""
    end = time.monotonic() + 60.0
    while not (found := what()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)
    return found


def await_posterior(client: httpx.Client) -> None:
    client.get("/api/runs")
    until(lambda: "mean" in client.get("/api/posterior").json())


def told(stream: httpx.Response) -> Iterator[dict[str, Any]]:
    return (json.loads(line[6:]) for line in stream.iter_lines() if line.startswith("data: "))


@pytest.fixture(scope="module")
def unrun(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(sl.load_study(write_study(tmp_path_factory.mktemp("unrun") / "beam"))) as found:
        yield found


@pytest.fixture(scope="module")
def quick(unrun: Server) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=unrun.url, timeout=60) as found:
        yield found


@pytest.mark.smoke
def test_each_path_is_answered_or_refused(quick: httpx.Client) -> None:
    runs = {"/api/run?row=999": 404, "/api/run?row=-1": 400, "/api/run?row=1111111111111111": 400}
    outside = {"/page/x/../../server.py": 404, "/page/%2e%2e/server.py": 403, "/page/..%2fserver.py": 403}
    others = {"/api/nothing": 404, "/nothing": 404, "/api/picture": 404, "/page/": 403, "/api/runs?since=x": 400}
    good = dict.fromkeys(("", "/api/study", "/page/app.js", "/panels/shared.js"), 200)
    for path, status in {**runs, **outside, **others, **good}.items():
        assert quick.get(path).status_code == status, path
    for path in good:
        headers = quick.get(path).headers
        assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'self'")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert not {"server", "set-cookie"} & {*headers}
    answer = quick.post("/api/predict", json={"inputs": [1, 2]})
    assert answer.status_code == 400
    assert "inputs: got [1, 2]; expected a JSON object" in answer.json()["error"]
    for content in (b"{", b"[1]", b"\xff"):
        assert quick.post("/api/ask", content=content).status_code == 400


@pytest.mark.smoke
def test_nobody_gets_in_without_the_token(unrun: Server) -> None:
    for path in ("/", "/api/study", "/events", "/page/app.js", "/panels/shared.js", "/api/picture", "/nothing"):
        for token in ("", "/wrong", "/" + unrun.token + "x"):
            assert httpx.get(f"http://127.0.0.1:{unrun.port}{token}{path}").status_code == 403
        whole = unrun.url.rstrip("/") + path
        assert httpx.get(whole, headers={"Host": "example.org"}).status_code == 403
        assert httpx.get(whole, headers={"Origin": "http://example.org"}).status_code == 403


def test_it_listens_on_this_machine_alone(unrun: Server) -> None:
    assert unrun.url.startswith("http://127.0.0.1:")
    with socket.socket() as other:
        other.bind(("127.0.0.2", unrun.port))  # free: the server holds one address, not all


def test_a_notebook_shows_the_page(unrun: Server) -> None:
    shown = show(unrun.viewed.study, height=500)
    try:
        assert f'<iframe src="{shown.url}" title="beam" width="100%" height="500"' in shown._repr_html_()
        assert httpx.get(shown.url).status_code == 200
        assert shown.token != unrun.token
    finally:
        shown.close()
    assert "closed" in repr(shown)


@pytest.mark.smoke
def test_a_stream_that_is_still_open_when_the_server_stops_ends_in_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("strandline.view.server.TICK", 1000.0)
    study = sl.load_study(write_study(tmp_path / "beam"))
    with serving(study) as server, httpx.stream("GET", f"{server.url}events", timeout=60) as stream:
        assert next(told(stream))["problem"] == ""
        server.close()
    assert caplog.messages == []


@pytest.fixture
def client(folder: Path) -> Iterator[httpx.Client]:
    with serving(sl.load_study(folder)) as server, httpx.Client(base_url=server.url, timeout=60) as found:
        assert found.get("").status_code == 200
        yield found


def test_it_tells_of_new_runs_within_a_second_and_of_what_was_edited(folder: Path, client: httpx.Client) -> None:
    await_posterior(client)
    with client.stream("GET", "/events") as stream:
        states = told(stream)
        first, study = next(states), sl.load_study(folder)
        with study.runs.ledger() as ledger:
            ledger.exclude(study.runs.design_keys[0], "to see what happens")
        at = time.monotonic()
        changed = next(state for state in states if state["version"] > first["version"])
        assert time.monotonic() - at < 1.5
        assert (changed["ok"], changed["failed"]) == (31, 1)
    assert not client.get("/api/state").json()["edited"]
    path = folder / "study.yaml"
    path.write_text(path.read_text("utf-8").replace('"seed": 1', '"seed": 2'), encoding="utf-8")
    until(lambda: client.get("/api/state").json()["edited"])


def test_an_error_leaves_the_page_when_its_cause_has_gone(folder: Path, client: httpx.Client) -> None:
    await_posterior(client)
    with client.stream("GET", "/events") as stream:
        states = told(stream)
        assert next(states)["problem"] == ""
        (folder / "ledger.sqlite").rename(folder / "away.sqlite")
        assert "ledger.sqlite" in next(one for one in states if one["problem"])["problem"]
        (folder / "away.sqlite").rename(folder / "ledger.sqlite")
        assert next(one for one in states if not one["problem"])["ok"] == 32
    (folder / "ledger.sqlite").write_bytes(b"rubbish" * 1000)
    assert "ledger.sqlite" in until(lambda: client.get("/api/state").json()["problem"])
