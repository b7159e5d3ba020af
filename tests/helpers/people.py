"""People in front of sensors."""

from dune_rl.bodies.person import PersonConf
from dune_rl.rendering.moving_mesh import MovingMesh


def meshes_of(people: tuple[PersonConf, ...]) -> list[MovingMesh]:
    """The mesh of each person; equal people share theirs."""
    made: dict[PersonConf, MovingMesh] = {}
    return [made.setdefault(person, person.mesh()) for person in people]
