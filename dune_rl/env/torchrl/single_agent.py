"""A transform of the TorchRL environment: flat keys for one agent."""

from typing import Any

from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite, TensorSpec
from torchrl.envs.transforms import Transform

_ENDS = ("done", "terminated", "truncated")


class SingleAgent(Transform):
    """Transform to flat keys for one agent: observation names, `action`, `reward` and end flags.

    It removes the group key and the agent axis; the end flags are those of the root. `metrics` is flat too
    if an `EpisodeMetrics` comes first. Raises ValueError unless the environment has one external agent.
    """

    invertible = True

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[], in_keys_inv=["action"], out_keys_inv=["action"])
        self._group: str | None = None

    @property
    def group(self) -> str:
        """Name of the agent's group."""
        if self._group is None:
            parent = self.parent
            groups = parent.base_env.group_map
            if [len(agents) for agents in groups.values()] != [1]:
                names = ", ".join(agent for agents in groups.values() for agent in agents)
                raise ValueError(f"SingleAgent needs one agent, but the environment has {names}")
            self._group = next(iter(groups))
        return self._group

    def _flatten(self, tensordict: TensorDictBase) -> TensorDictBase:
        group = tensordict.pop(self.group, None)
        if group is None:
            return tensordict
        for key, value in group.items():
            if key == "observation" and isinstance(value, TensorDictBase):
                for name, part in value.items():
                    tensordict.set(name, part.squeeze(1))
            elif key not in (*_ENDS, "action"):
                tensordict.set(key, value.squeeze(1))
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._flatten(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._flatten(tensordict_reset)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action", None)
        if action is None:
            return tensordict
        shape = [*tensordict.batch_size, 1]
        inner = TensorDict({"action": action.unsqueeze(1)}, batch_size=shape)
        return tensordict.exclude("action").set(self.group, inner)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Replace the group's specs by those of the flat keys."""
        output_spec = output_spec.clone()
        observation = output_spec["full_observation_spec"]
        group = observation[self.group]
        seen = group["observation"]
        flat: dict[str, Any] = dict(seen.items()) if isinstance(seen, Composite) else {"observation": seen}
        flat |= {key: spec for key, spec in group.items() if key != "observation"}
        flat = {key: _squeezed(spec) for key, spec in flat.items()}
        shape = observation.shape
        output_spec["full_observation_spec"] = Composite(flat, shape=shape)
        reward = output_spec["full_reward_spec"][self.group, "reward"]
        output_spec["full_reward_spec"] = Composite({"reward": _squeezed(reward)}, shape=shape)
        ends = {key: output_spec["full_done_spec"][key] for key in _ENDS}
        output_spec["full_done_spec"] = Composite(ends, shape=shape)
        return output_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Replace the group's action spec by that of the flat key."""
        input_spec = input_spec.clone()
        action = input_spec["full_action_spec"][self.group, "action"]
        shape = input_spec["full_action_spec"].shape
        input_spec["full_action_spec"] = Composite({"action": _squeezed(action)}, shape=shape)
        return input_spec


def _squeezed(spec: TensorSpec) -> TensorSpec:
    return spec.squeeze(1)
