"""A world as SDF: ground, objects, sun, sky and physics."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.gazebo.elements import UniqueNames, add, add_pose, make_system, words
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.painted_mesh import PaintedMesh, PaintedPart, paint_prop
from dune_rl.geometry.arrays import Array, Bytes
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.baked_scenery import smooth_normals
from dune_rl.rendering.light import Light, LightConf, linear_to_srgb
from dune_rl.rendering.scenery import Segment
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.appearance import build_scenery, with_own_sun
from dune_rl.worlds.importing.sdf.elements import Role, role_attribute
from dune_rl.worlds.world import Prop, World

# Systems of Gazebo that a world with robots needs: the name of each, and of its library.
_SYSTEMS = (
    ("Physics", "physics"),
    ("UserCommands", "user-commands"),
    ("SceneBroadcaster", "scene-broadcaster"),
    ("Sensors", "sensors"),
    ("Imu", "imu"),
)
# Where ground has several surfaces, their borders are along triangles of at most this side.
_BORDER_M = 0.5
_SUN, _SUN_HEIGHT_M = "sun", 30.0
_WATER_TRANSPARENCY = 0.35
# Bits of what collides: ground and decks, and all else. A robot's wheels may collide with either alone.
GROUND_BIT, OBSTACLE_BIT = 1, 2


def make_world(
    name: str,
    world: World,
    weather: WeatherConf,
    physics: PhysicsConf,
    meshes: MeshFolder,
    others: Iterable[str] = (),
) -> Element:
    """The <world> element called `name`; its meshes are written into `meshes`.

    No model has the name of one of the `others` that are to be added.
    """
    element = Element("world", name=name)
    engine = add(element, "physics", name="default", type="ode")
    add(engine, "max_step_size", words([1.0 / physics.physics_hz]))
    add(engine, "real_time_factor", 1)
    add(engine, "real_time_update_rate", physics.physics_hz)
    for system, library in _SYSTEMS:
        plugin = make_system(system, library)
        element.append(plugin)
        if system == "Sensors":
            add(plugin, "render_engine", "ogre2")
    add(element, "gravity", words([0.0, 0.0, -GRAVITY_MPS2]))
    _add_light(element, with_own_sun(world, weather).sunlight)
    names = UniqueNames()
    for each in (_SUN, *others):
        names.make(each)
    _add_ground(element, names.make("ground"), world, meshes)
    for prop in world.props:
        _add_prop(element, names.make(prop.name), prop, world, meshes)
    return element


def _add_light(world: Element, conf: LightConf) -> None:
    light = Light.from_conf(conf)
    scene = add(world, "scene")
    add(scene, "ambient", words([*np.clip(light.from_sky, 0.0, 1.0), 1.0]))
    add(scene, "background", words([*linear_to_srgb(light.horizon), 1.0]))
    add(scene, "sky")
    add(scene, "shadows", conf.shadows)
    sun = add(world, "light", name=_SUN, type="directional")
    add_pose(sun, (0.0, 0.0, _SUN_HEIGHT_M))
    add(sun, "cast_shadows", conf.shadows)
    add(sun, "intensity", words([conf.brightness]))
    add(sun, "diffuse", words([*conf.sun_colour, 1.0]))
    add(sun, "specular", words([0.2, 0.2, 0.2, 1.0]))
    add(sun, "direction", words(-light.to_sun))


def _add_ground(world: Element, name: str, its: World, meshes: MeshFolder) -> None:
    """Add the ground, a pair of visual and collision for each surface on it."""
    link = _add_static(world, name, np.zeros(3), "ground")
    picture = (linear_to_srgb(build_scenery(its).ground[::-1]) * 255.0 + 0.5).astype(np.uint8)
    if its.surfaces is None:
        path = meshes.write_obj(name, _ground_mesh(its.terrain, picture, None))
        _add_shapes(link, "all", path, its.friction, GROUND_BIT)
        return
    terrain = _refine(its.terrain)
    vertices, faces = terrain.mesh()
    numbers = its.surfaces.at(vertices[faces, :2].mean(axis=1))
    for number in np.unique(numbers).tolist():
        surface = its.surfaces.surfaces[number]
        mesh = _ground_mesh(terrain, picture, numbers == number)
        path = meshes.write_obj(f"{name} {surface.name}", mesh)
        _add_shapes(link, surface.name, path, surface.friction, GROUND_BIT, surface.restitution)


def _ground_mesh(terrain: HeightField, picture: Bytes, chosen: NDArray[np.bool_] | None) -> PaintedMesh:
    """The `chosen` faces of the ground, None: all, under a `picture` of all of it."""
    vertices, faces = terrain.mesh()
    if chosen is not None:
        used, index = np.unique(faces[chosen], return_inverse=True)
        vertices, faces = vertices[used], index.reshape(-1, 3).astype(np.int32)
    xmin, xmax, ymin, ymax = terrain.extent
    uv = (vertices[:, :2] - [xmin, ymin]) / [xmax - xmin, ymax - ymin]
    normals = smooth_normals(terrain, vertices[:, :2]).astype(np.float64)
    return PaintedMesh(vertices, (PaintedPart(faces, picture=picture, uv=uv[faces]),), normals)


def _refine(terrain: HeightField) -> HeightField:
    """The same ground, its cells divided into such of at most `_BORDER_M`."""
    parts = int(np.ceil(terrain.spacing_m / _BORDER_M - 1e-9))
    rows, columns = (parts * (side - 1) + 1 for side in terrain.heights.shape)
    spacing = terrain.spacing_m / parts
    x, y = (start + spacing * np.arange(n) for start, n in zip(terrain.origin, (columns, rows), strict=True))
    heights = terrain.height(np.stack(np.meshgrid(x, y), axis=-1))
    return HeightField(heights, spacing, terrain.origin)


def _add_prop(world: Element, name: str, prop: Prop, its: World, meshes: MeshFolder) -> None:
    low, high = prop.vertices.min(axis=0), prop.vertices.max(axis=0)
    # Whole millimetres, so that text loses nothing of it.
    origin = np.round((low + high) / 2, 3)
    role: Role | None = None if not prop.solid else "deck" if prop.drivable else "obstacle"
    link = _add_static(world, name, origin, role)
    mesh = paint_prop(prop, origin)
    path = meshes.write_obj(name, mesh)
    bit = GROUND_BIT if prop.drivable else OBSTACLE_BIT
    visual = _add_shapes(link, "all", path, _friction(prop, its, origin) if prop.solid else None, bit)
    if mesh.colour is not None:
        add_material(visual, mesh.colour)
    if prop.segment_class == Segment.WATER:
        add(visual, "transparency", _WATER_TRANSPARENCY)


def _friction(prop: Prop, world: World, place: Array) -> float:
    """The friction of a solid prop: that of wheels on it if it is drivable, in a world of surfaces."""
    if world.surfaces is None or not prop.drivable:
        return world.friction
    if prop.surface is not None:
        return world.surfaces.surfaces[world.surfaces.number(prop.surface)].friction
    return world.surfaces.surfaces[int(world.surfaces.at(place[:2]))].friction


def _add_static(world: Element, name: str, position: Array, role: Role | None) -> Element:
    """Add a static model, and return its link; `role` is what the package's own importer takes it for."""
    model = add(world, "model", name=name, **role_attribute(role))
    add(model, "static", True)
    add_pose(model, position)
    return add(model, "link", name="link")


def _add_shapes(
    link: Element, name: str, path: str, friction: float | None, bit: int, restitution: float = 0.0
) -> Element:
    """Add a mesh as a visual, which is returned, and with a `friction` as a collision as well."""
    kinds = ("visual",) if friction is None else ("collision", "visual")
    for kind in kinds:
        holder = add(link, kind, name=f"{name}_{kind}")
        add(add(add(holder, "geometry"), "mesh"), "uri", path)
        if kind == "collision" and friction is not None:
            add_surface(holder, friction, bit=bit, restitution=restitution)
    return holder


def add_surface(
    collision: Element,
    friction: float,
    *,
    along_axle: float | None = None,
    bit: int | None = None,
    restitution: float = 0.0,
) -> None:
    """Add the surface of a collision; a wheel's friction `along_axle`, the y axis of its link, may differ.

    It collides with what has the same `bit`, None: with all.
    """
    surface = add(collision, "surface")
    add_friction(add(add(surface, "friction"), "ode"), "mu", friction, along_axle)
    if bit is not None:
        add(add(surface, "contact"), "collide_bitmask", bit)
    if restitution:
        add(add(surface, "bounce"), "restitution_coefficient", words([restitution]))


def add_friction(parent: Element, first: str, friction: float, along_axle: float | None) -> None:
    """Add the coefficients of a wheel, `first` along its axle and `mu2` ahead, or of what has one alone."""
    add(parent, first, words([friction if along_axle is None else along_axle]))
    add(parent, "mu2", words([friction]))
    if along_axle is not None:
        add(parent, "fdir1", "0 1 0")


def add_material(visual: Element, colour: tuple[float, float, float]) -> None:
    """Add a plain matt colour (sRGB)."""
    material = add(visual, "material")
    for kind in ("ambient", "diffuse"):
        add(material, kind, words([*colour, 1.0]))
    add(material, "specular", words([0.05, 0.05, 0.05, 1.0]))
