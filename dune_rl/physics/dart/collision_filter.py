"""Collision filter of a DART scene, and the contacts between its bodies."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations
from typing import Any

from dune_rl.physics.dart.kinematics import DartKinematics
from dune_rl.physics.dart.loading import add_shape, weld_massless_body
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.dart.statics import LinkMaterial, StaticGeometry
from dune_rl.physics.dart.tyres import tyre_name

Links = dict[LinkMaterial, list[Any]]


class CollisionFilter:
    """Disables collision between excluded pairs of bodies, and reports contacts.

    To be created after `DartRobot.load`; it adds bodies to the skeletons. A contact between links of two
    robots has the product of their friction coefficients, which DART has no place for. So every robot but the
    last gets contact proxies: copies of its links' collision shapes for each `LinkMaterial` of the robots
    after it, which collide with those links only.
    """

    def __init__(
        self,
        robots: Sequence[DartRobot],
        static_geometry: StaticGeometry,
        kinematics: DartKinematics,
        first_number: int,
        engine_filter: Any,
    ) -> None:
        self._robots, self._first_number = robots, first_number
        self._static_geometry, self._kinematics = static_geometry, kinematics
        self._engine_filter = engine_filter
        self._disable_pair = engine_filter.addBodyNodePairToBlackList
        self._proxies: list[Any] = []
        self.rebuild()

    def rebuild(self) -> None:
        """Compute pairs and proxies anew, after bodies were added or removed.

        The pairs of a body that is removed must be forgotten: another one may get its address.
        """
        self.refresh_shapes()
        for proxy in self._proxies:
            proxy.remove()
        self._engine_filter.removeAllBodyNodePairsFromBlackList()
        robots, static_geometry, kinematics = self._robots, self._static_geometry, self._kinematics
        statics, moving = static_geometry.skeleton.getBodyNodes(), kinematics.skeleton.getBodyNodes()
        self._disable_pairs(moving, statics)
        links = [_links_by_material(robot) for robot in robots]
        for index, (robot, own) in enumerate(zip(robots, links, strict=True)):
            for material, bodies in own.items():
                enabled = []
                if material.role == "ground_link":
                    enabled.append(static_geometry.foot_ground[index])
                elif material.role == "hull":
                    enabled.append(static_geometry.hull_ground[index])
                if _collides_with_obstacles(material, robot):
                    enabled += [static_geometry.obstacles[material], *kinematics.bodies[material]]
                self._disable_pairs(bodies, [body for body in (*statics, *moving) if body not in enabled])
        self._proxies = self._add_contact_proxies(robots, links)
        self._disable_pairs(self._proxies, [*statics, *moving])
        self._reported = [*static_geometry.obstacles.values(), *moving, *self._proxies]

    def refresh_shapes(self) -> None:
        """Include shapes that were added to bodies since the last contacts, and drop references to shapes."""
        self.__dict__.pop("_numbers", None)

    @cached_property
    def _numbers(self) -> dict[Any, int]:
        """Body numbers by shape; ground has none."""
        numbers = self._static_geometry.numbers | self._kinematics.numbers
        for number, robot in enumerate(self._robots, start=self._first_number):
            for body in robot.skeleton.getBodyNodes():
                numbers |= dict.fromkeys(body.getShapeNodes(), number)
        return numbers

    def _add_contact_proxies(self, robots: Sequence[DartRobot], links: Sequence[Links]) -> list[Any]:
        """Enable collision between links of different robots, with the product of their coefficients."""
        outer = [
            {
                material: [body for body in bodies if any(map(_collides, body.getShapeNodes()))]
                for material, bodies in own.items()
                if _collides_with_obstacles(material, robot)
            }
            for robot, own in zip(robots, links, strict=True)
        ]
        proxies: list[Links] = []
        for index, own in enumerate(outer):
            later = dict.fromkeys(material for other in outer[index + 1 :] for material in other)
            proxies.append(
                {
                    other: [
                        _add_contact_proxy(link, material.friction * other.friction)
                        for material in own
                        for link in own[material]
                    ]
                    for other in later
                }
            )
        for one, other in combinations(range(len(robots)), 2):
            others = [*_flatten(links[other]), *_flatten(proxies[other])]
            self._disable_pairs(_flatten(links[one]), others)
            for material, bodies in proxies[one].items():
                enabled = outer[other].get(material, ())
                self._disable_pairs(bodies, [body for body in others if body not in enabled])
        return [body for own in proxies for body in _flatten(own)]

    def _disable_pairs(self, ones: Iterable[Any], others: Sequence[Any]) -> None:
        for one in ones:
            for other in others:
                self._disable_pair(one, other)

    def contacts(self, robot: int, result: Any) -> set[int]:
        """Numbers of the bodies, without ground, that robot `robot` touches in a collision result."""
        # A result always has contacts with ground, so this test is what saves time.
        if not any(map(result.inCollision, self._reported)):
            return set()
        numbers, own, found = self._numbers, self._first_number + robot, set[int]()
        for contact in result.getContacts():
            one = numbers.get(contact.collisionObject1.getShapeFrame())
            other = numbers.get(contact.collisionObject2.getShapeFrame())
            if one == own and other is not None:
                found.add(other)
            elif other == own and one is not None:
                found.add(one)
        return found


def _links_by_material(robot: DartRobot) -> Links:
    """The links that have a shape."""
    spec, links = robot.spec, dict[LinkMaterial, list[Any]]()
    materials = dict.fromkeys(spec.ground_links, LinkMaterial("ground_link", spec.ground_friction))
    materials |= dict.fromkeys(map(tyre_name, spec.tyres), LinkMaterial("tyre", spec.ground_friction))
    hull = LinkMaterial("hull", spec.hull_friction)
    for body in robot.skeleton.getBodyNodes():
        if body.getNumShapeNodes():
            links.setdefault(materials.get(body.getName(), hull), []).append(body)
    return links


def _collides_with_obstacles(material: LinkMaterial, robot: DartRobot) -> bool:
    return material.role != "ground_link" or robot.spec.ground_links_meet_obstacles


def _collides(node: Any) -> bool:
    return bool(node.hasCollisionAspect())


def _flatten(links: Links) -> list[Any]:
    return [body for bodies in links.values() for body in bodies]


def _add_contact_proxy(link: Any, friction: float) -> Any:
    """Weld a body with the link's collision shapes, and another friction coefficient, to the link."""
    proxy = weld_massless_body(link)
    for node in filter(_collides, link.getShapeNodes()):
        add_shape(proxy, node.getShape(), friction).setRelativeTransform(node.getRelativeTransform())
    return proxy
