"""Refusal of requests that other web pages make to a live page's server (CWE-1385, DNS rebinding).

A browser lets any web page open a WebSocket to a server of this machine, and says in the Origin header which
page it is. A foreign name that is resolved to this machine's address stands in the Host header.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from ipaddress import ip_address
from threading import Event, Lock
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

_one_at_a_time = Lock()


def find_refusal(host: str, hosts: list[str], origins: list[str]) -> str | None:
    """Why a server on `host` refuses a request with these Host and Origin headers; None if it does not.

    The host has to be localhost, `host`, this machine's name or any IP address, which nobody else can let
    lead here. An origin has to be that of the page at this host, over plain HTTP as it is served.
    """
    try:
        (given,) = hosts
        name = urlsplit(f"//{given}").hostname or ""
    except ValueError:
        return "the request names no host"
    if name not in {"localhost", host.lower(), socket.gethostname().lower()} and not _is_address(name):
        return f"{name} is not known to lead here: open the page by localhost or this machine's IP address"
    if any(origin.lower() != f"http://{given}".lower() for origin in origins):
        return "other web pages have no access to this one"
    return None


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def refuse_foreign_requests(host: str) -> Iterator[Event]:
    """Within this context, let a viser server that starts on `host` refuse requests of other web pages.

    Yields an event that is set once a server has started so. viser has no setting for this (1.1.1): it calls
    `websockets.asyncio.server.serve`, in a thread, before its constructor returns. In this time the call is
    replaced by one with another `process_request`.
    """
    from websockets.asyncio import server

    serve, guarded = server.serve, Event()

    def serve_own_page(*args: Any, process_request: Any = None, **settings: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            headers = request.headers
            refusal = find_refusal(host, headers.get_all("Host"), headers.get_all("Origin"))
            if refusal is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
            return process_request(connection, request) if process_request else None

        guarded.set()
        return serve(*args, process_request=process, **settings)

    with _one_at_a_time, patch.object(server, "serve", serve_own_page):
        yield guarded
