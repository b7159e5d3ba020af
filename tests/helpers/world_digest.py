"""A world as one number, in a file of its own that takes no time to import."""

import hashlib

from dune_rl.worlds.world import World


def digest(world: World) -> str:
    """A hash of everything that physics and cameras get."""
    sums = hashlib.sha256(world.terrain.heights.tobytes())
    for p in world.props:
        flags = (p.name, p.kind, p.solid, p.drivable, p.colour)
        sums.update(repr(flags).encode() + p.vertices.tobytes() + p.faces.tobytes())
    return sums.hexdigest()
