"""How actors look to a ray: meshes in the actor's own frame, its origin on the ground."""

import trimesh

from dune_rl.actors.actor import ActorConf
from dune_rl.geometry.rays import RayScene


def ray_shapes(confs: tuple[ActorConf, ...]) -> list[RayScene]:
    """One ray scene per actor; actors of equal size share theirs."""
    made: dict[tuple[float, float], RayScene] = {}
    for conf in confs:
        size = (conf.radius_m, conf.height_m)
        if size not in made:
            made[size] = _capsule(*size)
    return [made[(conf.radius_m, conf.height_m)] for conf in confs]


def _capsule(radius_m: float, height_m: float) -> RayScene:
    mesh = trimesh.creation.capsule(height=height_m - 2 * radius_m, radius=radius_m, count=(24, 16))
    mesh.apply_translation([0.0, 0.0, height_m / 2 - mesh.bounds.mean(axis=0)[2]])
    return RayScene(mesh.vertices, mesh.faces)
