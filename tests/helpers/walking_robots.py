"""A walking robot under commands, as the environment drives it: controller, servos, physics."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from scenes import STEP_S, SUBSTEPS, Backend, Stage, about, plane

from dune_rl.geometry.frames import roll_pitch_yaw
from dune_rl.physics.shapes import StaticBody
from dune_rl.robots.hyperdog import HyperDog, HyperDogConf


class Walk:
    """A dog on flat ground, or on what `statics` are, put down at `quaternion` and let settle."""

    def __init__(
        self,
        backend: Backend,
        conf: HyperDogConf | None = None,
        statics: Sequence[StaticBody] | None = None,
        quaternion: np.ndarray | None = None,
        yaw: float = 0.0,
    ) -> None:
        self.robot = HyperDog(conf or HyperDogConf(), 1)
        self.stage = Stage(backend, statics or [plane()], robot=self.robot.body)
        turned = about([0, 0, 1], yaw) if quaternion is None else quaternion
        self.robot.reset(np.array([True]))
        self.stage.place([0.0, 0.0, self.robot.description.standing_height_m + 0.005], turned)
        self.commands = np.array([self.robot.body.rest_commands()])
        self.stage.step(2 * SUBSTEPS, self.commands[0])

    @property
    def roll_pitch_yaw(self) -> np.ndarray:
        return np.array(roll_pitch_yaw(self.stage.rotation))

    def step(self, *action: float, count: int = 1) -> None:
        """`count` control steps of an action."""
        for _ in range(count):
            rotation = self.stage.rotation
            motion = SimpleNamespace(
                velocity_b=(self.stage.velocity @ rotation)[None],
                angular_b=(self.stage.angular @ rotation)[None],
                roll_pitch_yaw=self.roll_pitch_yaw[None],
            )
            self.commands = self.robot.commands(np.array([action]), motion, STEP_S)
            self.stage.step(SUBSTEPS, self.commands[0])

    def walk(self, speed: float, heading: float, count: int) -> tuple[np.ndarray, float]:
        """Way gone (3,) [m] and yaw turned [rad] in `count` control steps, while it keeps on its feet."""
        start, yaw, turned = self.stage.position, self.roll_pitch_yaw[2], 0.0
        for _ in range(count):
            self.step(speed, heading)
            now = self.roll_pitch_yaw[2]
            turned += (now - yaw + np.pi) % (2 * np.pi) - np.pi
            yaw = now
        return self.stage.position - start, turned
