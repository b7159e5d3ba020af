"""What the agents of a group are made of: the interface of their bodies."""

from collections.abc import Sequence
from typing import Protocol

from dune_rl.env.proximity import Outline
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.interface import PhysicsRobot
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.robots.robot import BodyMotion
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.state.state import EnergyState, Motion

Engines = Sequence[PhysicsRobot]


class Body(Protocol):
    """The equal bodies of N agents, `count` in each scene, rows scene after scene.

    `motion` is their state after the last `read` or `read_start`, and `poses` (N, 4 or 6) begin with x, y, z
    [m] and yaw [rad]. `engines` are the physics robots, one per row; none for bodies that physics does not
    simulate.
    """

    count: int
    motion: Motion
    # Whether the state of the joints is to be read too, for sensors or metrics.
    reads_joints: bool

    @property
    def poses(self) -> Array: ...

    @property
    def description(self) -> BodyDescription:
        """What is constant of the bodies."""
        ...

    @property
    def outline(self) -> Outline:
        """The shape in plan view."""
        ...

    @property
    def energy(self) -> EnergyState | None:
        """Motor work in the last control step, and the battery; None unless it is measured."""
        ...

    def action_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the action, each (A,)."""
        ...

    def rest_action(self) -> Array:
        """Action (A,) at which the body stands still."""
        ...

    def carrier(self) -> SensorCarrier:
        """The body as a carrier of sensors."""
        ...

    def mesh(self) -> MovingMesh:
        """What the sensors of others see."""
        ...

    def reset(self, mask: Flags) -> None:
        """Clear the history of the bodies in `mask` (N,)."""
        ...

    def read_start(self, mask: Flags, engines: Engines) -> None:
        """Read the start states in `mask` (N,)."""
        ...

    def command(self, actions: Array, known: BodyMotion, engines: Engines) -> None:
        """Act for a control step by `actions` (N, A); `known` is the motion that the controllers measure."""
        ...

    def read(self, engines: Engines) -> list[tuple[int, int]]:
        """Read the states after a physics step; returns contacts as pairs of row and body number."""
        ...
