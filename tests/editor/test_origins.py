"""Pages behind a tunnel or a proxy: the page and the terminal say why it stays empty, and --origin lets it in."""

from __future__ import annotations

import gzip
import http.client

import pytest

from kit1000.editor.serve import HOST, serving
from kit1000.errors import InputError
from tests.samples.handshakes import shake

TUNNEL = "http://localhost:9000"


def page(port: int, packed: bool) -> bytes:
    connection = http.client.HTTPConnection(HOST, port, timeout=10)
    connection.request("GET", "/", headers={"Accept-Encoding": "gzip"} if packed else {})
    answer = connection.getresponse()
    body = answer.read()
    assert len(body) == int(answer.headers["Content-Length"])
    return gzip.decompress(body) if packed else body


@pytest.mark.parametrize("packed", [False, True])
def test_the_page_knows_its_addresses_and_explains_itself_elsewhere(packed: bool) -> None:
    with serving(None) as (server, _):
        port = server.get_port()
        text = page(port, packed).decode()
    assert f'const allowed = ["http://127.0.0.1:{port}", "http://localhost:{port}"];' in text
    assert f"ssh -L {port}:127.0.0.1:{port}" in text
    assert "--origin ORIGIN" in text
    assert text.index("location.origin") < text.index("</head>")


def test_a_refused_page_is_told_once_in_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with serving(None) as (server, _):
        assert [shake(server.get_port(), TUNNEL) for _ in range(2)] == [403, 403]
    told = capsys.readouterr().err
    assert told.count(f"refused a page at {TUNNEL}") == 1
    assert f"--origin {TUNNEL} lets it in" in told


def test_an_origin_that_is_named_is_let_in_and_no_other() -> None:
    with serving(None, [TUNNEL, "https://robots.example.org"]) as (server, _):
        port = server.get_port()
        assert shake(port, TUNNEL) == 101
        assert shake(port, "https://robots.example.org") == 101
        assert shake(port, f"http://localhost:{port}") == 101
        assert shake(port, "http://localhost:9001") == 403
        assert TUNNEL in page(port, False).decode()


@pytest.mark.parametrize("origin", ["localhost:9000", "http://localhost:9000/", "*", "http://a b", "ftp://x"])
def test_an_origin_has_the_form_of_a_browser(origin: str) -> None:
    with pytest.raises(InputError, match="expected scheme, host and port"), serving(None, [origin]):
        pass
