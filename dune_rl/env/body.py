"""What the agents of a group are made of: the interface of their bodies."""

from collections.abc import Sequence
from dataclasses import dataclass

from dune_rl.env.proximity import Outline
from dune_rl.env.randomised_properties import EpisodeVariation
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.physics.interface import PhysicsScene
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.shapes import KinematicShape
from dune_rl.rendering.moving_mesh import MovingMesh, PosedMesh, RayMesh
from dune_rl.robots.robot import BodyMotion
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.state.state import EnergyState, Motion
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.world import World


@dataclass(frozen=True)
class SceneBodies:
    """Robots and kinematic bodies of each scene, both in the order of the groups."""

    robots: tuple[RobotBody, ...] = ()
    kinematics: tuple[KinematicShape, ...] = ()

    def __add__(self, other: "SceneBodies") -> "SceneBodies":
        return SceneBodies(self.robots + other.robots, self.kinematics + other.kinematics)


class Body:
    """The equal bodies of N agents, `count` in each scene, rows scene after scene.

    Methods without `NotImplementedError` do nothing by default.

    `motion` is their state after the last `read` or `read_start`, and `poses` (N, 4 or 6) begin with x, y, z
    [m] and yaw [rad]. `first` is the number of a scene's first body among those of its kind, robots or
    kinematic bodies.
    """

    count: int
    first: int
    description: BodyDescription
    # The shape in plan view.
    outline: Outline
    # Radius [m] of the room that a body needs where it starts.
    footprint_radius_m: float
    motion: Motion
    poses: Array
    # Whether the state of the joints is to be read too, for sensors or metrics.
    reads_joints: bool

    @property
    def energy(self) -> EnergyState | None:
        """Motor work in the last control step, and the battery; None unless it is measured."""
        return None

    def action_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the action, each (A,)."""
        raise NotImplementedError

    def rest_action(self) -> Array:
        """Action (A,) at which the body stands still."""
        raise NotImplementedError

    def vehicle(self) -> Unicycle:
        """The model of the body for behaviours that output a speed and a heading."""
        raise NotImplementedError

    def carrier(self) -> SensorCarrier:
        """The body as a carrier of sensors."""
        raise NotImplementedError

    def mesh(self) -> MovingMesh:
        """What the sensors of others see."""
        raise NotImplementedError

    def pictures(self, row: int) -> list[PosedMesh]:
        """What pictures show of a body now."""
        raise NotImplementedError

    def looks(self, row: int) -> Sequence[RayMesh]:
        """The meshes that `pictures` has of a body one after another; none where it is the same each time."""
        return ()

    def joint_angles(self, row: int) -> dict[str, float]:
        """Angles [rad] of the joints of a robot by name; empty for kinematic bodies."""
        return {}

    def shapes(self, names: tuple[str, ...]) -> SceneBodies:
        """The bodies of a scene in physics, one for each of the agents' `names`."""
        raise NotImplementedError

    def outline_points(self, scene: int) -> Array:
        """Points (P, 2) [m] from which starts on paths keep their distance."""
        raise NotImplementedError

    # -- a new episode ----------------------------------------------------------------------------

    def reset(self, mask: Flags) -> None:
        """Clear the history of the bodies in `mask` (N,)."""

    def bind(self, scene: int, physics: PhysicsScene) -> None:
        """Take the bodies of a scene from its physics, which may have been built anew."""
        raise NotImplementedError

    def turned_to_free_way(self, scene: int, poses: Array) -> Array:
        """The start `poses` (G, 4) of a scene; bodies that cannot turn on the spot face a free way."""
        return poses

    def place(self, scene: int, poses: Array) -> None:
        """Put the bodies of a scene at `poses` (G, 4: x, y, z, yaw), at rest; `read_start` must follow."""
        raise NotImplementedError

    def touch_ground(self, scene: int, world: World, variation: EpisodeVariation) -> None:
        """Set contacts and latency of a scene's robots by the episode's `variation`, after `place`."""

    def read_start(self, mask: Flags) -> None:
        """Read the start states in `mask` (N,)."""
        raise NotImplementedError

    # -- a step -----------------------------------------------------------------------------------

    def come(self, row: int, pose: Array) -> None:
        """Put a parked body at a `pose` (4), at rest; `read_start` must follow."""
        raise NotImplementedError("these bodies do not come and go")

    def park(self, rows: Counts) -> None:
        """Take the bodies in `rows` (K,) out of their scenes, until the next `place` or `come`."""
        raise NotImplementedError("these bodies do not come and go")

    def teleport(self, rows: Counts) -> None:
        """Put the bodies in `rows` (K,) where they are now in physics as well, between control steps."""

    def command(self, actions: Array, known: BodyMotion) -> None:
        """Act for a control step by `actions` (N, A); `known` is the motion that the controllers measure."""
        raise NotImplementedError

    def hold_back(self, scenes: Counts, poses: Array) -> None:
        """Set the bodies of `scenes` (S,) to `poses` (S, G, 6), where robots blocked them."""

    def read(self) -> list[tuple[int, int]]:
        """Read the states after a physics step; returns contacts as pairs of row and body number."""
        raise NotImplementedError
