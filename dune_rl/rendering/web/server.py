"""The web server of a live view: viser's, on one address."""

import contextlib
import errno
import io
import socket
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.rendering.web.origin_check import refuse_foreign_requests

# viser's ViserServer.
Server = Any

LOCALHOST = "127.0.0.1"
FIRST_PORT, LAST_PORT = 8080, 65_535


def require_viser(setting: str) -> None:
    """Raise ConfigError, which says what `setting` needs, where viser is missing or too old."""
    try:
        import viser.uplot  # noqa: F401
    except ImportError:
        raise ConfigError(f"{setting} needs viser: pip install 'dune_rl[live]'") from None


def open_server(host: str, port: int, title: str, *, announces: bool = False) -> Server:
    """A server on `host` and `port`; 0 is any free port. Raises ConfigError where it cannot listen there.

    It refuses requests of other web pages (`find_refusal`).
    Where it `announces` itself, it writes its address to the terminal, and who comes and goes.
    """
    from viser import ViserServer

    check_address(host, port)
    # It writes a banner in any case.
    banner = contextlib.nullcontext() if announces else contextlib.redirect_stdout(io.StringIO())
    with banner, refuse_foreign_requests(host) as guarded:
        server = ViserServer(host, port, label=title, verbose=announces)
    if not guarded.is_set():
        stop_server(server)
        raise ConfigError(
            "this version of viser would let other web pages use the page: pip install 'viser==1.1.1'"
        )
    if port not in (0, server.get_port()):
        stop_server(server)
        raise ConfigError(_taken(host, port))
    # Its share button would open the page to the internet.
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


def stop_server(server: Server) -> None:
    """Stop a server, without its farewell on the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def free_port(host: str = LOCALHOST, first: int = FIRST_PORT) -> int:
    """The first free port of a host from `first` on; raises ConfigError where 100 are taken."""
    for port in range(first, first + 100):
        with contextlib.suppress(ConfigError):
            check_address(host, port)
            return port
    raise ConfigError(f"the ports {first} to {first + 99} of {host} are all taken: end what listens there")


def check_address(host: str, port: int) -> None:
    """Raise ConfigError, which says what to do, unless a server can listen on `port` of `host`."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(_taken(host, port)) from None
        if error.errno == errno.EACCES:
            raise ConfigError(f"port={port} is reserved for the system: give one from 1024 on") from None
        raise ConfigError(
            f"host={host} is no address of this machine: give {LOCALHOST}, or 0.0.0.0 for all of them"
        ) from None


def _taken(host: str, port: int) -> str:
    other = port + 1 if port < LAST_PORT else FIRST_PORT
    return f"port={port} of {host} is taken: give another, such as port={other}, or end what listens there"
