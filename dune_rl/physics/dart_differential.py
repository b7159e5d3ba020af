"""Differentials in DART: two joints of a body that turn opposite to each other."""

from typing import Any

from dune_rl.physics.dart_library import dartpy
from dune_rl.physics.interface import Coupling


SHARE = 1.0


class Differential:
    """Keeps a body at the mean of its two arms, of which the second hangs on the first: see `dart_joints.chain`.

    What turns freely is then one joint, between the arms, and the body follows
    half of that, which the engine does exactly. What holds the body acts back on the joint
    between the arms, a step later: the body is light beside what it stands on.
    """

    def __init__(self, robot: Any, coupling: Coupling, timestep_s: float) -> None:
        self._robot, self._timestep_s = robot, timestep_s
        self._body = robot.getJoint(coupling.leader).getIndexInSkeleton(0)
        self._between = robot.getJoint(coupling.follower).getIndexInSkeleton(0)
        self._both = [self._body, self._between]

    def before(self) -> None:
        """Lead the body, in the physics step to come, to where its arms will be."""
        robot, step = self._robot, self._timestep_s
        body, between = robot.getPositions(self._both).tolist()
        rate = robot.getVelocity(self._between)
        held = robot.getJointConstraintImpulses()[self._body] / step
        speed = -(between / 2 + body) / step - rate / 2
        robot.setCommands(self._both, [speed, held / 2 * SHARE])
