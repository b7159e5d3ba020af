"""Ports of this machine that tests may listen on."""

import socket


def free_port() -> int:
    """A port of localhost that nobody listens on, as the system chooses it: tests side by side get others."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])
