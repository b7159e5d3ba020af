"""Who meets whom in a DART scene, and who touches whom."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from dune_rl.physics.dart.bodies import Capsules, Kind, Surroundings
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import DartRobot

# DART has no body without mass; beside this, a grain of sand weighs a ton.
_MASS_KG, _MOMENT_KGM2 = 1e-9, 1e-12

Links = dict[Kind, list[Any]]


class Meetings:
    """Parts the bodies of a scene that do not meet, and tells which of the others touch.

    It comes after `DartRobot.place`, and adds to the skeletons: where two
    robots meet there is no body to hold the product of their coefficients.
    So each robot but the last has the collision shapes of its links once more
    for each `Kind` of links of robots after it: shells, which meet these alone.
    """

    def __init__(
        self,
        robots: Sequence[DartRobot],
        surroundings: Surroundings,
        capsules: Capsules,
        first_robot: int,
        collision_filter: Any,
    ) -> None:
        self._robots, self._first_robot = robots, first_robot
        self._surroundings, self._capsules = surroundings, capsules
        self._blacklist = collision_filter.addBodyNodePairToBlackList
        statics, moving = surroundings.skeleton.getBodyNodes(), capsules.skeleton.getBodyNodes()
        self._part(moving, statics)
        links = [_links(robot) for robot in robots]
        for number, (robot, own) in enumerate(zip(robots, links, strict=True)):
            for kind, bodies in own.items():
                grounds = surroundings.for_feet if kind.stands else surroundings.for_hull
                met = [grounds[number]]
                if _is_outer(kind, robot):
                    met += [surroundings.obstacles[kind], *capsules.bodies[kind]]
                self._part(bodies, [body for body in (*statics, *moving) if body not in met])
        shells = self._shells(robots, links)
        self._part(shells, [*statics, *moving])
        self._telling = [*surroundings.obstacles.values(), *moving, *shells]

    def look_again(self) -> None:
        """Take note of shapes that bodies have got since."""
        self.__dict__.pop("_numbers", None)

    @cached_property
    def _numbers(self) -> dict[Any, int]:
        """Numbers of the bodies of all shapes; the ground has none."""
        numbers = self._surroundings.numbers | self._capsules.numbers
        for number, robot in enumerate(self._robots, start=self._first_robot):
            for body in robot.skeleton.getBodyNodes():
                numbers |= dict.fromkeys(body.getShapeNodes(), number)
        return numbers

    def _shells(self, robots: Sequence[DartRobot], links: Sequence[Links]) -> list[Any]:
        """Have links of different robots meet, with the product of their coefficients."""
        outer = [
            {kind: [*filter(_is_solid, bodies)] for kind, bodies in own.items() if _is_outer(kind, robot)}
            for robot, own in zip(robots, links, strict=True)
        ]
        shells: list[Links] = []
        for number, own in enumerate(outer):
            after = dict.fromkeys(kind for other in outer[number + 1 :] for kind in other)
            shells.append(
                {
                    met: [_shell(link, kind.friction * met.friction) for kind in own for link in own[kind]]
                    for met in after
                }
            )
        for one, other in combinations(range(len(robots)), 2):
            theirs = [*_all(links[other]), *_all(shells[other])]
            self._part(_all(links[one]), theirs)
            for kind, worn in shells[one].items():
                met = outer[other].get(kind, ())
                self._part(worn, [body for body in theirs if body not in met])
        return [shell for worn in shells for shell in _all(worn)]

    def _part(self, ones: Iterable[Any], others: Sequence[Any]) -> None:
        for one in ones:
            for other in others:
                self._blacklist(one, other)

    def touched(self, robot: int, result: Any) -> list[int]:
        """Numbers of the bodies that a robot, counted from 0, touches in the engine's last `result`."""
        # The ground, of which there is always something, does not tell.
        if not any(map(result.inCollision, self._telling)):
            return []
        numbers, own, found = self._numbers, self._first_robot + robot, set()
        for contact in result.getContacts():
            one = numbers.get(contact.collisionObject1.getShapeFrame())
            other = numbers.get(contact.collisionObject2.getShapeFrame())
            if one == own and other is not None:
                found.add(other)
            elif other == own and one is not None:
                found.add(one)
        return sorted(found)


def _links(robot: DartRobot) -> Links:
    """The links that have a shape."""
    spec, found = robot.spec, dict[Kind, list[Any]]()
    for body in robot.skeleton.getBodyNodes():
        if body.getNumShapeNodes():
            stands = body.getName() in spec.ground_links
            kind = Kind(stands, spec.ground_friction if stands else spec.hull_friction)
            found.setdefault(kind, []).append(body)
    return found


def _is_outer(kind: Kind, robot: DartRobot) -> bool:
    """Whether a robot's links of a kind meet more than the ground."""
    return not kind.stands or robot.spec.ground_links_meet_obstacles


def _is_solid(link: Any) -> bool:
    return any(node.hasCollisionAspect() for node in link.getShapeNodes())


def _all(links: Links) -> list[Any]:
    return [body for bodies in links.values() for body in bodies]


def _shell(link: Any, friction: float) -> Any:
    _, shell = link.createWeldJointAndBodyNodePair()
    shell.setInertia(dartpy.dynamics.Inertia(_MASS_KG, np.zeros(3), _MOMENT_KGM2 * np.eye(3)))
    for node in link.getShapeNodes():
        if node.hasCollisionAspect():
            copy = shell.createShapeNode(node.getShape())
            copy.setRelativeTransform(node.getRelativeTransform())
            copy.createCollisionAspect()
            copy.createDynamicsAspect().setFrictionCoeff(friction)
    return shell
