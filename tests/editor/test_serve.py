"""The server talks to its own page alone."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from unittest import mock

import pytest
import viser
import websockets.asyncio.server
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from kit1000.dataset.reader import Dataset
from kit1000.editor.serve import HOST, Options, serving
from kit1000.errors import InputError, InternalError

TUNNEL = "http://localhost:9000"


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    with serving(None) as (served, _):
        yield served


def get(port: int, path: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(HOST, port, timeout=10)
    connection.request("GET", path)
    return connection.getresponse()


@pytest.mark.parametrize("name", [HOST, "localhost"])
def test_the_own_page_is_accepted(server: viser.ViserServer, name: str) -> None:
    assert shake(server.get_port(), f"http://{name}:{server.get_port()}") == 101


@pytest.mark.parametrize(
    "origin",
    [None, "null", "https://example.org", "http://{host}:{other}", "http://{host}", "http://{host}.example.org:{port}"],
)
def test_any_other_origin_is_refused_before_anything_is_sent(server: viser.ViserServer, origin: str | None) -> None:
    port = server.get_port()
    named = origin and origin.format(host=HOST, port=port, other=port + 1)
    assert shake(port, named) == 403


def test_only_loopback_is_bound(server: viser.ViserServer) -> None:
    assert server.get_host() == HOST
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # sends nothing; tells the address of the outer interface
        outer = probe.getsockname()[0]
    if outer == HOST:
        pytest.skip("no other interface on this machine")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((outer, server.get_port()), timeout=5)


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5cx", "/nothing.html"])
def test_no_path_leads_out_of_the_page(server: viser.ViserServer, path: str) -> None:
    assert get(server.get_port(), path).status == 404


def test_no_other_page_may_frame_this_one(server: viser.ViserServer) -> None:
    answer = get(server.get_port(), "/")
    assert answer.status == 200
    assert answer.headers["X-Frame-Options"] == "DENY"
    assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]


def test_no_public_address_is_made(server: viser.ViserServer) -> None:
    with mock.patch.object(viser._viser, "ViserTunnel", side_effect=AssertionError("a tunnel was opened")):
        assert server.request_share_url() is None


def test_a_taken_port_is_refused(server: viser.ViserServer) -> None:
    with pytest.raises(InputError, match="is taken"), serving(server.get_port()):
        pass


def test_the_command_prints_one_address_and_ctrl_c_ends_it(mini: Path, tmp_path: Path) -> None:
    scene_id = Dataset(mini).split("test").scene_ids[0]
    words = [sys.executable, "-m", "kit1000", "edit", str(mini), "--scene", scene_id, "--snap", "none"]
    page = subprocess.Popen(
        [*words, "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # tests run in the background ignore Ctrl-C
    )
    try:
        assert page.stdout is not None
        first = page.stdout.readline().decode()
        port = int(re.match(rf"http://{HOST}:(\d+) ", first)[1])  # type: ignore[index]
        assert get(port, "/").status == 200
        page.send_signal(signal.SIGINT)
        rest, errors = page.communicate(timeout=60)
    finally:
        page.kill()
    assert page.returncode == 0
    assert errors == b""
    assert rest.decode() == f"{tmp_path}: 0 of 1 parts confirmed\n"
    events = [json.loads(line)["event"] for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert events == ["open", "close"]


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_a_wrong_port_is_refused(port: int) -> None:
    with pytest.raises(InputError, match=f"1 to 65535, got {port}"), serving(port):
        pass


def test_a_server_whose_guard_is_gone_does_not_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after an upgrade of viser that serves in another way."""
    from viser.infra import _infra

    elsewhere = mock.Mock(wraps=websockets)
    elsewhere.asyncio.server.serve = websockets.asyncio.server.serve
    monkeypatch.setattr(_infra, "websockets", elsewhere)
    with pytest.raises(InternalError, match="unchecked"), serving(None):
        pass


def test_a_refused_page_is_told_once_in_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with serving(None) as (server, _):
        assert [shake(server.get_port(), TUNNEL) for _ in range(2)] == [403, 403]
        port = server.get_port()
    told = capsys.readouterr().err
    assert told.count(f"refused a page at {TUNNEL}") == 1
    assert f"ssh -L {port}:127.0.0.1:{port}" in told


def test_a_method_that_reads_shapes_makes_a_session_with_shapes() -> None:
    known = {
        snap: Options(Path(), "s", Path(), snap=snap).header("d").shapes for snap in ("registration", "a:b", "none")
    }
    assert not any(known.values())
    assert Options(Path(), "s", Path(), snap="registration-known").header("d").shapes


PROTOCOL = f"viser-v{viser.__version__}"


def shake(port: int, origin: str | None) -> int:
    """HTTP status of a handshake: 101 where it is accepted."""

    async def go() -> int:
        try:
            async with connect(f"ws://{HOST}:{port}", origin=origin, subprotocols=[PROTOCOL], proxy=None):  # type: ignore[arg-type, list-item]
                return 101
        except InvalidStatus as refused:
            return refused.response.status_code

    return asyncio.run(go())
