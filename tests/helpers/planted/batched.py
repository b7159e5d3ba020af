"""TorchRL environments of batch size [3]: a sound one, and one for each fault."""

import warnings
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

ENDS = ("done", "terminated", "truncated")


class Sound(EnvBase):
    """Points on a line, moved by their actions; an episode ends after two steps."""

    batch_locked = True

    def __init__(self) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([3]))
        place = Bounded(-9.0, 9.0, (3, 1), dtype=torch.float32)
        self.observation_spec = Composite({"place": place}, shape=(3,))
        self.action_spec = Bounded(-1.0, 1.0, (3, 1), dtype=torch.float32)
        self.reward_spec = Unbounded((3, 1), dtype=torch.float32)
        ends = {key: Categorical(2, dtype=torch.bool, shape=(3, 1)) for key in ENDS}
        self.done_spec = Composite(ends, shape=(3,))
        self._place = torch.zeros(3, 1)
        self._steps = torch.zeros(3, 1)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = torch.ones(3, 1, dtype=torch.bool)
        if tensordict is not None:
            mask = tensordict.get("_reset", mask)
        self._place = torch.where(mask, torch.zeros(3, 1), self._place)
        self._steps = torch.where(mask, torch.zeros(3, 1), self._steps)
        nobody = torch.zeros(3, 1, dtype=torch.bool)
        ends = {"done": nobody, "terminated": nobody.clone(), "truncated": nobody.clone()}
        return TensorDict({**self._observation(), **ends}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._place = self._place + tensordict["action"]
        self._steps = self._steps + 1
        late = self._steps >= 2
        ends = {"done": late, "terminated": torch.zeros_like(late), "truncated": late.clone()}
        return TensorDict({**self._observation(), "reward": self._place.clone(), **ends}, self.batch_size)

    def _observation(self) -> dict[str, Any]:
        return {"place": self._place.clone()}

    def _set_seed(self, seed: int | None) -> None:
        pass


class GivesFloat64(Sound):
    def _observation(self) -> dict[str, Any]:
        return {"place": self._place.double()}


class GivesNaN(Sound):
    def _observation(self) -> dict[str, Any]:
        return {"place": self._place * torch.nan}


class LeavesItsBounds(Sound):
    def _observation(self) -> dict[str, Any]:
        return {"place": self._place + 10.0}


class GivesMore(Sound):
    def _observation(self) -> dict[str, Any]:
        return {**super()._observation(), "extra": self._place.clone()}


class GivesLess(Sound):
    def _observation(self) -> dict[str, Any]:
        return {}


class Warns(Sound):
    def _observation(self) -> dict[str, Any]:
        warnings.warn("something is odd", stacklevel=1)
        return super()._observation()
