"""The base link of a robot in PyBullet: its state, and the external force on it."""

import math
from collections.abc import Sequence

from dune_rl.physics.base_frame import InertialFrame, Quadruple, Triple
from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.process import suppress_stderr

with suppress_stderr():
    import pybullet

# Position, quaternion, linear and angular velocity.
_State = tuple[Triple, Quadruple, Triple, Triple]


class BaseLink:
    """Reads the state of the base link of `body`, once between physics steps, and applies forces to it."""

    def __init__(self, body: LoadedBody) -> None:
        self._body = body
        self._state: _State | None = None
        self._frame: InertialFrame | None = None
        self._force: Sequence[float] | None = None

    def reset(self) -> None:
        """Drop the state and the force."""
        self._state = self._force = None

    def measure_mass_kg(self) -> float:
        """Mass of the base link, which may differ after each load, as may its centre, which is kept."""
        info = pybullet.getDynamicsInfo(self._body.handle, -1, physicsClientId=self._body.client)
        frame = InertialFrame(info[3], info[4])
        self._frame = None if frame.is_identity else frame
        mass: float = info[0]
        return mass

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._state = None

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the centre of mass, and speed [m/s] in all three directions."""
        position, _, velocity, _ = self.read()
        return position[0], position[1], math.hypot(*velocity)

    def velocity_xy(self) -> tuple[float, float]:
        """Horizontal velocity of the centre of mass [m/s]."""
        state = self._state
        velocity = (
            pybullet.getBaseVelocity(self._body.handle, self._body.client)[0] if state is None else state[2]
        )
        return velocity[0], velocity[1]

    def link_state(self) -> tuple[float, ...]:
        """See `PhysicsRobot.body_state`."""
        position, quaternion, linear, angular = self.read()
        if self._frame is not None:
            position, quaternion, linear = self._frame.link_state(position, quaternion, linear, angular)
        return (*position, *quaternion, *linear, *angular)

    def read(self) -> _State:
        """Pose and velocities of the inertial frame, read once between physics steps."""
        state = self._state
        if state is None:
            robot, client = self._body.handle, self._body.client
            self._state = state = (
                *pybullet.getBasePositionAndOrientation(robot, client),
                *pybullet.getBaseVelocity(robot, client),
            )
        return state

    def set_force(self, force_w: Sequence[float]) -> None:
        """Set what the next `take_force` returns: a force (3) [N], world frame."""
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force set by `set_force` since the last call, which is removed; None if there is none."""
        force, self._force = self._force, None
        return force

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N], world frame, to the centre of mass in the next physics step."""
        # The engine clears forces after each physics step.
        robot, client = self._body.handle, self._body.client
        centre, _ = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
        pybullet.applyExternalForce(robot, -1, force_w, centre, pybullet.WORLD_FRAME, physicsClientId=client)
