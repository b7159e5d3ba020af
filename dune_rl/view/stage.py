"""One scene, driven by a policy."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.schema import ViewConf
from dune_rl.env.pictures import Pictures
from dune_rl.view.drivers import driver, ending

Picture = NDArray[np.uint8]


class Stage:
    """The scene of `conf`, its rover's readings, and pictures of it."""

    def __init__(self, conf: ViewConf) -> None:
        self.conf = conf
        self._env = make_torchrl_env(conf, 1, conf.seed)
        self.batch = self._env.batch
        self.pictures = Pictures(self.batch)
        self._make_policy = driver(conf, self._env)

    def drive(self) -> Iterator[TensorDictBase]:
        """What is observed at the start of an episode and after each step, to its end."""
        self._env.batch.reseed(self.conf.seed)
        policy = self._make_policy()
        now = self._env.reset()
        yield now
        while True:
            now = self._env.step(policy(now))["next"]
            yield now
            if bool(now["done"]):
                return

    def readings(self) -> dict[str, NDArray[Any]]:
        """The rover's readings by name, without the axis of scenes."""
        return {name: value[0] for name, value in self.batch.observe().items()}

    def behind(self, width: int, height: int) -> Picture:
        """The rover from behind."""
        return self.pictures.from_behind(0, width, height, self.conf.samples)

    def orbit(self) -> Picture:
        """The whole place."""
        next(self.drive())
        return self.pictures.of_the_place(0, self.conf.width, self.conf.height, max(2, self.conf.samples))

    def status(self, steps: int) -> list[str]:
        """Where the episode is after so many steps, in a few lines."""
        batch = self.batch
        goal = float(np.hypot(*(batch.goals_w[0] - batch.motion.position_w[0, :2])))
        return [
            f"{steps / self.conf.physics.control_hz:5.1f} s",
            f"speed {batch.motion.velocity_b[0, 0]:5.2f} m/s",
            f"goal {goal:6.2f} m",
            f"slope {np.rad2deg(batch.motion.tilt()[0]):4.0f}°",
            f"collisions {self._metrics()['collisions']:.0f}",
        ]

    def ending(self) -> str:
        """How the episode ended."""
        return ending(self._metrics())

    def _metrics(self) -> dict[str, float]:
        return dict(zip(self.batch.metric_names, self.batch.metrics()[0].tolist(), strict=True))

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._env.close()
