"""Real scenes with something done to them: faults that a count must see, and a fall, which is none."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import PhysicsScene, SceneSpec

_EVERY = 20
_FAR_M = 0.15
_KICK_MPS2 = 50.0


class Untouched:
    """The scene as it is; it counts the control steps since its robot was put down."""

    raised_m = 0.0

    def __init__(self, scene: PhysicsScene, mass_kg: float) -> None:
        self._scene, self._mass_kg = scene, mass_kg
        self.steps = 0

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        x, y, z = position_w
        self._scene.place([x, y, z + self.raised_m], quaternion, kinematic_poses)
        self.steps = 0

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        self.steps += 1
        self._scene.step(count, commands, kinematic_poses)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)


class Raised(Untouched):
    """The robot is put down high in the air, and falls."""

    raised_m = 3.0


class Kicked(Untouched):
    """Once a second a force from nowhere gives the robot 2.5 m/s in one control step."""

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        if self.steps % _EVERY == _EVERY - 1:
            self._scene.push([0.6 * _KICK_MPS2 * self._mass_kg, 0.0, 0.8 * _KICK_MPS2 * self._mass_kg])
        super().step(count, commands, kinematic_poses)


class Teleported(Untouched):
    """Once a second the robot is elsewhere, without ever having moved fast."""

    def body_state(self) -> tuple[float, ...]:
        x, *others = self._scene.body_state()
        return (x + _FAR_M * (self.steps // _EVERY), *others)


Maker = Callable[[str], Any]


def tampered(kind: type[Untouched], scene_class: Maker, mass_kg: float) -> Maker:
    """`scene_class`, with every scene made `kind`."""

    def make_of(backend: str) -> Any:
        make = scene_class(backend)

        def make_scene(spec: SceneSpec) -> Untouched:
            return kind(make(spec), mass_kg)

        return make_scene

    return make_of
