"""Physics without an engine: rovers that are where a test puts them, and touch what it says."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from dune_rl.env.batch import Batch
from numpy.typing import NDArray

from dune_rl.config.build import build_world
from dune_rl.config.compose import compose_environment
from dune_rl.physics.interface import SceneSpec
from dune_rl.robots.rover_zero.robot import RoverZero


class PuppetScene:
    """A `PhysicsScene` of one robot, itself; a test sets its `state` (13,) and contacts `touching`.

    It keeps the forces that are applied to it in `pushes`.
    """

    def __init__(self, spec: SceneSpec) -> None:
        self.spec = spec
        self.state = np.zeros(13)
        self.touching: list[int] = []
        self.pushes: list[list[float]] = []
        self.robots = (self,)

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self.state = np.array([*position_w, *quaternion, *[0.0] * 6])

    def reset(self, kinematic_poses: NDArray[np.float64]) -> None:
        self.touching = []

    def step(self, count: int, kinematic_poses: NDArray[np.float64]) -> None:
        pass

    def set_command(self, commands: Sequence[float]) -> None:
        pass

    def apply_force(self, force_w: Sequence[float]) -> None:
        self.pushes.append(list(force_w))

    def body_state(self) -> tuple[float, ...]:
        return tuple(self.state.tolist())

    def drive_state(self) -> tuple[float, ...]:
        return (0.0,) * (3 * len(self.spec.robots[0].drive_joints))

    def work_j(self) -> float:
        return 0.0

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return (0.0,) * len(joints)

    def contacts(self) -> Sequence[int]:
        return self.touching

    def close(self) -> None:
        pass

    def put(self, x: float, y: float, yaw: float = 0.0, z: float = 0.125) -> None:
        """Stand upright and still at (x, y, z) [m] with `yaw` [rad]."""
        self.state = np.array([x, y, z, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2), *[0.0] * 6])


def puppet_batch(
    world: str = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any
) -> tuple[Batch, list[PuppetScene]]:
    """A batch that has been reset, and its puppets; `settings` as for `dune_rl.make`."""
    asked: Mapping[str, Any] = {"actors": "none"} | settings
    conf = compose_environment(world, (), asked)
    puppets: list[PuppetScene] = []

    def make_scene(spec: SceneSpec) -> PuppetScene:
        puppets.append(PuppetScene(spec))
        return puppets[-1]

    batch = Batch(
        world=build_world(conf.world),
        make_robot=lambda scenes: RoverZero(conf.robot, scenes),
        make_scene=make_scene,
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        weather=conf.weather,
        num_scenes=num_scenes,
        seed=seed,
    )
    batch.reset()
    return batch, puppets
