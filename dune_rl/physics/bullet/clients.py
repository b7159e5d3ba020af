"""PyBullet clients: opened with little memory, and used again."""

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.bullet.memory import returned_zero_pages
from dune_rl.physics.process_memory import return_free_memory
from dune_rl.physics.stderr import suppress_stderr

with suppress_stderr():
    import pybullet

# The client of the scene that was closed last: where worlds differ between episodes, scenes are closed and
# built in turn. One is enough for that; others would hold memory for nothing.
_spare: list[int] = []


def open_client() -> int:
    """A client in DIRECT mode without bodies; raises PhysicsError if PyBullet opens no more."""
    while _spare:
        client = _spare.pop()
        if pybullet.isConnected(client):
            return client
    with returned_zero_pages():
        client = int(pybullet.connect(pybullet.DIRECT))
    if client < 0:
        raise PhysicsError("PyBullet opened no further client in this process; use fewer scenes")
    return client


def release_client(client: int) -> None:
    """Remove all that a client holds; close it unless it is kept for the next scene."""
    if client in _spare or not pybullet.isConnected(client):
        return
    if not _spare:
        pybullet.resetSimulation(physicsClientId=client)
        _spare.append(client)
        return
    pybullet.disconnect(client)
    return_free_memory()
