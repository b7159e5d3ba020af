"""A live page's server answers its own page, and refuses other web pages."""

import http.client
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from dune_rl.core.errors import ConfigError
from dune_rl.rendering.web.origin_check import find_refusal
from dune_rl.rendering.web.server import LOCALHOST, open_server, stop_server


@pytest.fixture(name="port")
def _port(_viser: None) -> Iterator[int]:
    """The port of a server that is open."""
    server = open_server(LOCALHOST, 0, "a page")
    yield server.get_port()
    stop_server(server)


def connect(port: int, name: str, origin: str | None) -> Any:
    """A WebSocket to the server, as a browser opens it for a page of `origin` at a host of this `name`."""
    from viser import __version__
    from websockets.sync.client import connect

    return connect(
        f"ws://{name}:{port}",
        sock=socket.create_connection((LOCALHOST, port)),
        origin=origin,
        subprotocols=[f"viser-v{__version__}"],
    )


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_the_page_itself_and_programs_are_accepted(port: int, name: str) -> None:
    for origin in (f"http://{name}:{port}", None):
        with connect(port, name, origin) as opened:
            # The page's theme, say.
            assert opened.recv(timeout=30)


@pytest.mark.parametrize(
    ("name", "origin"),
    [
        ("127.0.0.1", "https://site.example"),
        # Pages of other servers of this machine, and of files.
        ("127.0.0.1", "http://127.0.0.1:1"),
        ("127.0.0.1", "http://localhost:{port}"),
        ("127.0.0.1", "https://127.0.0.1:{port}"),
        ("localhost", "null"),
        # A foreign name that is resolved to this machine.
        ("site.example", "http://site.example:{port}"),
        ("site.example", None),
    ],
)
def test_other_pages_are_refused(port: int, name: str, origin: str | None) -> None:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus) as refused:
        connect(port, name, origin and origin.format(port=port))
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize(
    ("name", "status"), [("localhost:{port}", 200), ("site.example:{port}", 403), (None, 403)]
)
def test_the_page_is_served_under_names_of_this_machine(port: int, name: str | None, status: int) -> None:
    asked = http.client.HTTPConnection(LOCALHOST, port, timeout=30)
    asked.putrequest("GET", "/", skip_host=True)
    if name:
        asked.putheader("Host", name.format(port=port))
    asked.endheaders()
    assert asked.getresponse().status == status
    asked.close()


@pytest.mark.parametrize(
    ("host", "name", "is_known"),
    [
        ("0.0.0.0", "192.168.1.7", True),
        ("0.0.0.0", "[fe80::1]", True),
        ("0.0.0.0", socket.gethostname(), True),
        ("0.0.0.0", "site.example", False),
        ("Robot.lan", "robot.lan", True),
        ("127.0.0.1", "127.0.0.1.site.example", False),
        ("127.0.0.1", "[", False),
    ],
)
def test_addresses_and_names_of_this_machine_are_known(host: str, name: str, is_known: bool) -> None:
    given = f"{name}:8080"
    assert (find_refusal(host, [given], []) is None) == is_known
    assert (find_refusal(host, [given], [f"http://{given}"]) is None) == is_known
    assert find_refusal(host, [given], [f"http://{given}", "http://site.example"]) is not None


def test_a_viser_that_cannot_be_guarded_is_not_used(_viser: None, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = []

    class OtherServer:
        def __init__(self, *_: object, **__: object) -> None: ...

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr("viser.ViserServer", OtherServer)
    with pytest.raises(ConfigError, match="let other web pages use the page"):
        open_server(LOCALHOST, 0, "a page")
    assert len(stopped) == 1
