"""The scene of a live view as nodes of viser: what stands still once, what moves by its poses."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import quaternions
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.light import Light, linear_to_srgb
from dune_rl.rendering.moving_mesh import PosedMesh, RayMesh
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.web.gltf import GltfFile, Surface
from dune_rl.rendering.web.grass import place_tufts, tuft_surface
from dune_rl.rendering.web.server import Server
from dune_rl.rendering.web.surfaces import body_surfaces, sky_surface, world_surfaces

Colour = tuple[int, int, int]
Values = NDArray[np.floating]

_SKY_RADIUS_M, _FARTHEST_M, _NEAREST_M = 1_500.0, 4_000.0, 0.05
_SUN_AWAY_M = 100.0
# Light that shadows of bodies take from the ground.
_SHADOW = 0.45
# Haze of this optical depth hides a surface.
_HIDING_DEPTH = 3.0
_FOV_RAD = 0.9
# A browser may report a position of its camera so many steps late.
_MOST_GIVEN = 60
_GRASS = {"/world/grass_in_sun": True, "/world/grass_in_shade": False}


def name_parts(bodies: Mapping[str, Sequence[PosedMesh]]) -> Iterator[tuple[str, PosedMesh]]:
    """The parts of all bodies with their names, such as rover_0/3."""
    for name, parts in bodies.items():
        for number, part in enumerate(parts):
            yield f"{name}/{number}", part


@dataclass
class _Part:
    """The node of a part of a body, its meshes, and the mesh that it shows now."""

    frame: Any
    meshes: dict[RayMesh, Any] = field(default_factory=dict)
    shown: RayMesh | None = None


@dataclass
class _Visit:
    """The first position (3,) of a visitor's camera, the offset (3,) from its target [m] that the visitor
    chose, or else that of `show_to`, and the last positions that the camera was given.
    """

    first: Array
    offset: Array
    given: deque[Array] = field(default_factory=lambda: deque(maxlen=_MOST_GIVEN))


class WebScene:
    """The 3D scene of a `server`'s page: a baked world, bodies that move, and lines and points."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._world: BakedScenery | None = None
        self._parts: dict[str, _Part] = {}
        self._drawn: dict[str, Any] = {}
        self._visits: dict[int, _Visit] = {}
        server.on_client_disconnect(lambda client: self._visits.pop(client.client_id, None))
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        camera = server.initial_camera
        camera.near, camera.far, camera.fov = _NEAREST_M, _FARTHEST_M, _FOV_RAD

    def show_world(self, baked: BakedScenery, media: ParticipatingMedia) -> None:
        """Show a world in its light, in place of the one before."""
        if baked is self._world:
            return
        self._world = baked
        scene = self._server.scene
        # Of the ground alone: props have the shadows that are baked.
        ground, *rest = world_surfaces(baked)
        scene.add_glb("/world/ground", _glb([ground]), cast_shadow=False, receive_shadow=_SHADOW)
        if any(len(each.corners) for each in rest):
            scene.add_glb("/world/objects", _glb(rest), cast_shadow=False, receive_shadow=False)
        else:
            scene.remove_by_name("/world/objects")
        self._show_grass(media.foliage, baked)
        sky = sky_surface(baked, media.haze, _SKY_RADIUS_M)
        scene.add_glb("/sky", _glb([sky]), cast_shadow=False, receive_shadow=False)
        self._light_bodies(baked.light)
        if media.haze is not None:
            colour = _bytes(media.haze.colour)
            scene.configure_fog(0.0, _HIDING_DEPTH / media.haze.extinction, color=colour)
        else:
            scene.configure_fog(0.0, 1.0, enabled=False)

    def _show_grass(self, grass: Foliage | None, baked: BakedScenery) -> None:
        scene = self._server.scene
        for name in _GRASS:
            scene.remove_by_name(name)
        if grass is None:
            return
        tufts = place_tufts(grass, baked)
        for name, in_sun in _GRASS.items():
            these = tufts.in_sun == in_sun
            if these.any():
                scene.add_batched_glb(
                    name,
                    _glb([tuft_surface(baked.light, grass.height_m, in_sun=in_sun)]),
                    tufts.wxyzs[these],
                    tufts.positions[these],
                    batched_scales=tufts.scales[these],
                    cast_shadow=False,
                    receive_shadow=False,
                )

    def _light_bodies(self, light: Light) -> None:
        """Sun and sky as `Light.shade` has them: three.js divides light by pi where surfaces reflect it."""
        sun, sun_strength = _colour_and_strength(light.sun)
        sky, sky_strength = _colour_and_strength(light.from_sky)
        ground = _bytes(light.from_ground / sky_strength)
        scene = self._server.scene
        scene.add_light_directional(
            "/lights/sun",
            color=sun,
            intensity=np.pi * sun_strength,
            cast_shadow=light.shadows,
            position=_SUN_AWAY_M * light.to_sun,
        )
        scene.add_light_hemisphere(
            "/lights/sky", sky_color=sky, ground_color=ground, intensity=np.pi * sky_strength
        )

    def load_looks(self, looks: Mapping[str, Sequence[RayMesh]]) -> None:
        """Send the meshes that bodies of one part show one after another, so that none is missed later."""
        for name, meshes in looks.items():
            for mesh in meshes:
                self._load_mesh(f"{name}/0", mesh)

    def show_bodies(self, bodies: Mapping[str, Sequence[PosedMesh]]) -> None:
        """Pose the bodies, and hide those that are not there."""
        parts = dict(name_parts(bodies))
        if parts:
            turns = quaternions(np.array([part.rotation for part in parts.values()]))
            for (name, part), turn in zip(parts.items(), turns[:, [3, 0, 1, 2]], strict=True):
                self._show_part(name, part, turn)
        for name in self._parts.keys() - parts.keys():
            _set(self._parts[name].frame, visible=False)

    def _show_part(self, name: str, part: PosedMesh, wxyz: Array) -> None:
        self._load_mesh(name, part.solid)
        node = self._parts[name]
        _set(node.frame, visible=True)
        if not np.array_equal(node.frame.position, part.position):
            node.frame.position = part.position
        if not np.array_equal(node.frame.wxyz, wxyz):
            node.frame.wxyz = wxyz
        if node.shown is not part.solid:
            _set(node.meshes[part.solid], visible=True)
            if node.shown is not None:
                _set(node.meshes[node.shown], visible=False)
            node.shown = part.solid

    def _load_mesh(self, name: str, mesh: RayMesh) -> None:
        """Send a mesh of a part, unless it has been sent; it is not shown yet."""
        scene = self._server.scene
        if name not in self._parts:
            self._parts[name] = _Part(scene.add_frame(f"/bodies/{name}", show_axes=False, visible=False))
        meshes = self._parts[name].meshes
        if mesh not in meshes:
            path = f"/bodies/{name}/mesh_{len(meshes)}"
            meshes[mesh] = scene.add_glb(path, _glb(body_surfaces(mesh.shape)), visible=False)

    def show_lines(self, name: str, ends: Array, colour: Colour, width: float = 2.0) -> None:
        """Show line segments (N, 2, 3) [m] in one colour, `width` in pixels."""
        if name not in self._drawn:
            nothing = np.zeros((1, 2, 3), np.float32)
            self._drawn[name] = self._server.scene.add_line_segments(
                f"/{name}", nothing, colour, thickness=width, thickness_units="screen", visible=False
            )
        self._redraw(name, ends.astype(np.float32))

    def show_points(self, name: str, points: Array, near: Array, colour: Colour, size_m: float) -> None:
        """Show points (N, 3) [m] in one colour. They are sent in 16 bits a number, about `near` (3,)."""
        if name not in self._drawn:
            self._drawn[name] = self._server.scene.add_point_cloud(
                f"/{name}",
                np.zeros((1, 3), np.float16),
                colour,
                point_size=size_m,
                point_shape="circle",
                point_shading="flat",
                visible=False,
            )
        self._redraw(name, (points - near).astype(np.float16))
        if len(points):
            self._drawn[name].position = near

    def _redraw(self, name: str, points: Values) -> None:
        node = self._drawn[name]
        if len(points) and not np.array_equal(node.points, points):
            node.points = points
        _set(node, visible=len(points) > 0)

    def look(self, eye: Array, target: Array) -> None:
        """Where those who open the page look from."""
        camera = self._server.initial_camera
        camera.position, camera.look_at = eye, target

    def show_to(self, client: Any, eye: Array, target: Array) -> None:
        """Let a visitor look from `eye` (3,) at `target` (3,) [m], and from there on `follow`."""
        camera = client.camera
        visit = self._visits.setdefault(client.client_id, _Visit(camera.position, eye - target))
        visit.offset = eye - target
        camera.position, camera.look_at = eye, target

    def follow(self, target: Array, free_eye: Callable[[Array], Array]) -> None:
        """Let all who look see `target` (3,) [m], from the side and the distance that each has chosen.

        `free_eye` moves an eye (3,) [m] to where nothing hides the target.
        """
        for number, client in self._server.get_clients().items():
            camera, visit = client.camera, self._visits.get(number)
            if visit is None:
                continue
            # A slow browser reports earlier positions again, after it was given another.
            earlier = np.array([visit.first, *visit.given])
            is_ours = bool((np.abs(earlier - camera.position).max(axis=1) < 1e-3).any())
            if not is_ours:
                visit.offset = camera.position - camera.look_at
            eye = free_eye(target + visit.offset)
            visit.given.append(eye)
            if not (
                np.allclose(camera.look_at, target, atol=1e-4)
                and np.allclose(camera.position, eye, atol=1e-4)
            ):
                camera.position, camera.look_at = eye, target


def _glb(surfaces: Sequence[Surface]) -> bytes:
    file = GltfFile(y_up=False)
    file.add_node("mesh", file.add_mesh(surfaces))
    return file.to_bytes()


def _set(node: Any, *, visible: bool) -> None:
    if node.visible != visible:
        node.visible = visible


def _bytes(linear: Values) -> Colour:
    red, green, blue = (linear_to_srgb(np.asarray(linear)) * 255.0).round().astype(int).tolist()
    return red, green, blue


def _colour_and_strength(linear: Values) -> tuple[Colour, float]:
    """A colour whose largest part is full, and what it is multiplied by."""
    strength = float(np.max(linear))
    return _bytes(linear / strength), strength
