"""An episode in 3D as one file: a page that plays by itself, or an animated glTF."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dune_rl.core.files import write_atomically
from dune_rl.env.live.view import SceneView
from dune_rl.env.pictures import Pictures
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import quaternions
from dune_rl.rendering.moving_mesh import PosedMesh, RayMesh
from dune_rl.rendering.web.gltf import GltfFile
from dune_rl.rendering.web.scene import WebScene, name_parts
from dune_rl.rendering.web.server import LOCALHOST, open_server, stop_server
from dune_rl.rendering.web.surfaces import body_surfaces, sky_surface, world_surfaces
from dune_rl.reporting.views.episode import EpisodeView

# The sphere of the sky has facets, which lie within it.
_SKY_MARGIN = 1.02


def write_html(view: EpisodeView, path: Path) -> Path:
    """An episode as a page (HTML) that needs no server and no network."""
    # viser records what it would send: the server has no visitors.
    server = open_server(LOCALHOST, 0, "dune_rl")
    try:
        record = server.get_scene_serializer()
        scene = SceneView(view.simulation, WebScene(server), view.group, view.row)
        for steps, _ in enumerate(_episode(view)):
            if steps:
                record.insert_sleep(_step_s(view))
            else:
                scene.begin()
            scene.update()
        page = record.as_html()
    finally:
        stop_server(server)
    with write_atomically(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def write_gltf(view: EpisodeView, path: Path) -> Path:
    """An episode as an animated glTF 2.0 (GLB), with the light of pictures on ground and objects.

    The sky is a sphere about the world, as small as can be: the first view of most viewers shows all of it.
    """
    pictures, parts = Pictures(view.simulation), dict[str, _PartTrack]()
    count = 0
    for count, _ in enumerate(_episode(view), 1):
        for name, part in name_parts(pictures.bodies_by_name(0)):
            parts.setdefault(name, _PartTrack()).add(count - 1, part)
    file = GltfFile()
    baked, media = pictures.scenery(0)
    world = world_surfaces(baked, tone_mapped=True)
    file.add_node("ground_and_objects", file.add_mesh(world))
    middle, radius_m = _bounding_sphere(np.concatenate([each.corners.reshape(-1, 3) for each in world]))
    sky = sky_surface(baked, media.haze, _SKY_MARGIN * radius_m, tone_mapped=True)
    file.add_node("sky", file.add_mesh([sky]), middle)
    times_s = np.linspace(0.0, (count - 1) * _step_s(view), count)
    meshes: dict[RayMesh, int] = {}
    bodies: dict[str, int] = {}
    for name, track in parts.items():
        body = name.partition("/")[0]
        if body not in bodies:
            bodies[body] = file.add_node(body)
        track.write(file, name.replace("/", "_"), bodies[body], times_s, meshes)
    content = file.to_bytes()
    with write_atomically(path) as temporary:
        temporary.write_bytes(content)
    return path


SCENE_WRITERS: dict[str, tuple[str, Callable[[EpisodeView, Path], Path]]] = {
    "html": ("html", write_html),
    "gltf": ("glb", write_gltf),
}


def _episode(view: EpisodeView) -> Iterator[bool]:
    """The steps of an episode, at most `longest_s` of it."""
    longest = round(view.conf.longest_s / _step_s(view))
    for steps, done in enumerate(view.run()):
        yield done
        if steps >= longest:
            return


def _bounding_sphere(points: Array) -> tuple[Array, float]:
    """Middle (3,) and radius [m] of a sphere about points (N, 3)."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle, float(np.linalg.norm(points - middle, axis=1).max())


def _step_s(view: EpisodeView) -> float:
    return 1.0 / view.conf.physics.decision_hz


@dataclass
class _PartTrack:
    """Poses of a part of a body at the steps at which it is there, and the meshes that it shows."""

    steps: list[int] = field(default_factory=list)
    positions: list[Array] = field(default_factory=list)
    rotations: list[Array] = field(default_factory=list)
    shown: list[RayMesh] = field(default_factory=list)

    def add(self, step: int, part: PosedMesh) -> None:
        self.steps.append(step)
        self.positions.append(part.position.copy())
        self.rotations.append(part.rotation.copy())
        self.shown.append(part.solid)

    def write(self, file: GltfFile, name: str, body: int, times_s: Array, meshes: dict[RayMesh, int]) -> None:
        """Add the part's node and its animation to a file; `meshes` are the numbers of those that it has."""
        node = file.add_node(name, None, self.positions[0], self.rotations[0], parent=body)
        positions, turns = np.array(self.positions), _continuous(quaternions(np.array(self.rotations)))
        times = times_s[self.steps]
        if np.ptp(positions, axis=0).any():
            file.animate(node, "translation", times, positions)
        if np.ptp(turns, axis=0).any():
            file.animate(node, "rotation", times, turns)
        for number, solid in enumerate(dict.fromkeys(self.shown)):
            if solid not in meshes:
                meshes[solid] = file.add_mesh(body_surfaces(solid.shape))
            child = file.add_node(f"{name}_{number}", meshes[solid], parent=node)
            is_shown = np.zeros(len(times_s), bool)
            is_shown[[step for step, mesh in zip(self.steps, self.shown, strict=True) if mesh is solid]] = (
                True
            )
            if not is_shown.all():
                # glTF has no visibility that can be animated.
                changes = np.flatnonzero(np.append(True, is_shown[1:] != is_shown[:-1]))
                scales = np.repeat(is_shown[changes, None], 3, axis=1)
                file.animate(child, "scale", times_s[changes], scales, steps=True)


def _continuous(turns: Array) -> Array:
    """Quaternions (T, 4) of the same rotations, of which neighbours are near each other."""
    flips = np.einsum("ti,ti->t", turns[1:], turns[:-1]) < 0.0
    signs = np.append(1.0, np.where(flips, -1.0, 1.0).cumprod())
    return turns * signs[:, None]
