"""PPO of Stable-Baselines3 on a batch of scenes: pip install stable-baselines3, then run this file.

`DuneVecEnv` is a Stable-Baselines3 `VecEnv` over Gymnasium's vector environment: all scenes are stepped
together in this process, several times as fast as `make_vec_env` steps them one by one.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import dune_rl


class DuneVecEnv(VecEnv):
    """All scenes of a `gym_vector_env` as the environments of a `VecEnv`."""

    def __init__(self, world: str, num_envs: int, **settings: Any) -> None:
        self.batch = dune_rl.gym_vector_env(world, num_envs, autoreset_mode="same_step", **settings)
        super().__init__(num_envs, self.batch.single_observation_space, self.batch.single_action_space)
        self._actions = np.zeros(self.batch.action_space.shape, np.float32)

    def reset(self) -> Any:
        """Start new episodes in all scenes, the first of the seed if `seed` was called."""
        seed = self._seeds[0]
        self._reset_seeds()
        observations, _ = self.batch.reset(seed=seed)
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (M, A) of the next `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all scenes; scenes whose episodes end begin the next ones."""
        observations, rewards, terminated, truncated, infos = self.batch.step(self._actions)
        each: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for scene in np.flatnonzero(terminated | truncated).tolist():
            final = infos["final_info"]
            each[scene] = {name: value[scene] for name, value in final.items() if not name.startswith("_")}
            each[scene]["terminal_observation"] = infos["final_obs"][scene]
            each[scene]["TimeLimit.truncated"] = bool(truncated[scene] and not terminated[scene])
        return observations, rewards.astype(np.float32), terminated | truncated, each

    def close(self) -> None:
        """Free the physics engine's memory."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The batch's attribute, once for each scene."""
        return [getattr(self.batch, attr_name, None) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the batch."""
        setattr(self.batch, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the batch, and return its result for each scene."""
        result = getattr(self.batch, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No scene has a wrapper."""
        return [False for _ in self._get_indices(indices)]


def main(arguments: Sequence[str] | None = None) -> PPO:
    """Train, and return the learner."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="flat")
    parser.add_argument("--scenes", type=int, default=16)
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--rollout", type=int, default=128, help="steps of each scene between two updates")
    chosen = parser.parse_args(arguments)
    envs = VecMonitor(DuneVecEnv(chosen.world, chosen.scenes))
    envs.seed(0)
    settings = {"n_steps": chosen.rollout, "batch_size": chosen.rollout * chosen.scenes // 8, "seed": 0}
    model = PPO("MultiInputPolicy", envs, **settings, device="cpu", verbose=1)
    model.learn(chosen.frames)
    envs.close()
    return model


if __name__ == "__main__":
    main()
