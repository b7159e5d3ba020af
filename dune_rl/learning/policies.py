"""Built-in policies: references to compare with, and the policies that drive as a training begins."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.drivers import DRIVERS, driver_policies
from dune_rl.learning.group_policy import GroupPolicy, Policy
from dune_rl.learning.policy_spec import PolicySpec

_SPEED_AND_HEADING = 2
# Of the top speed, at which bodies that cannot turn on the spot turn.
_TURNING_SHARE = 0.5
# Where they turn again: at this distance from the middle of their tightest curve, over its radius.
_OUTSIDE = 1.1
_WARMUP_NOISE = 0.1
_WARMUP_RANDOM_SHARE = 0.3


def go_to_goal_fault(spec: PolicySpec) -> str | None:
    """Why `go_to_goal` cannot act for a group of this spec; None where it can."""
    if len(spec.high) != _SPEED_AND_HEADING:
        return f"it outputs a speed and a heading, and the action has {len(spec.high)} components"
    if _goal_key(spec) is None:
        return "it needs the sensor goal" + ("" if spec.turning else " or goal_direction")
    return None


def _goal_key(spec: PolicySpec) -> str | None:
    """The sensor that tells where the goal is; a body that cannot turn on the spot needs the distance."""
    if "goal" in spec.sizes:
        return "goal"
    return "goal_direction" if "goal_direction" in spec.sizes and spec.turning is None else None


def built_in_policy(name: str, env: EnvBase, seed: int = 0) -> Policy:
    """A reference policy for every group of `env`; raises ConfigError where it cannot act.

    `name` is go_to_goal, random, or one of the drivers that read the simulation, `DRIVERS`.
    """
    if name in DRIVERS:
        return act_in_turn(driver_policies(name, env, seed))
    specs = {group: PolicySpec.of(env, group) for group in env.group_map}
    if name == "random":
        return act_in_turn(
            [UniformRandom(group, spec, seed + index) for index, (group, spec) in enumerate(specs.items())]
        )
    return act_in_turn([GoToGoal(group, spec) for group, spec in specs.items()])


def act_in_turn(policies: Sequence[Policy]) -> Policy:
    """A policy that applies the policies of several groups one after another."""

    def act(observation: TensorDictBase) -> TensorDictBase:
        for policy in policies:
            observation = policy(observation)
        return observation

    return act


class GoToGoal:
    """Turns the agents of `group` towards their goals and drives straight at them, through obstacles.

    Bodies that cannot turn on the spot keep moving, and drive straight on while the goal lies inside their
    tightest curve, which they would circle for ever (Dubins 1957).

    Raises ConfigError where the group observes no goal, or its action is no speed and heading.
    """

    def __init__(self, group: str, spec: PolicySpec) -> None:
        fault = go_to_goal_fault(spec)
        if fault is not None:
            raise ConfigError(
                f"go_to_goal cannot act for the group {group}: {fault}; take policy=random, in training "
                "learning.warm_up=random, or another robot.action or sensors"
            )
        self._group, self._key = group, _goal_key(spec)
        self._top_speed = spec.high[0]
        self._turning = spec.turning
        self._least_share = _TURNING_SHARE if self._turning else 0.0

    def action(self, observation: TensorDictBase) -> Tensor:
        """Action (..., G, 2): the goal's heading, and the part of the top speed that points at the goal."""
        goal = observation.get((self._group, "observation", self._key))
        if self._key == "goal":
            distance, heading = goal[..., :2].unbind(-1)
        else:
            distance, heading = goal[..., 2], torch.atan2(goal[..., 1], goal[..., 0])
        speed = self._top_speed * heading.cos().clamp(min=self._least_share)
        if self._turning is not None:
            radius, rear = self._turning
            ahead, aside = distance * heading.cos() + rear, distance * heading.sin().abs() - radius
            inside = torch.hypot(ahead, aside) < _OUTSIDE * math.hypot(radius, rear)
            heading = torch.where(inside, 0.0, heading)
        return torch.stack([speed, heading], -1)

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        return observation.set((self._group, "action"), self.action(observation))


class WarmupPolicy(TensorDictModuleBase):
    """`GoToGoal` with noise, and uniformly random in a share of steps: a learner's first experience.

    Random actions alone reach one goal in ten episodes of 2,000 steps, and a
    learner that has hardly met a goal learns to keep away from everything.
    """

    def __init__(self, group: str, spec: PolicySpec) -> None:
        super().__init__()
        self.in_keys = [(group, "observation", _goal_key(spec))]
        self.out_keys = [(group, "action")]
        self._group = group
        self._go_to_goal = GoToGoal(group, spec)
        self.register_buffer("_low", torch.tensor(spec.low))
        self.register_buffer("_high", torch.tensor(spec.high))

    @torch.no_grad()
    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        action = self._go_to_goal.action(observation)
        width = self._high - self._low
        noisy = action + _WARMUP_NOISE * width * torch.randn_like(action)
        random = self._low + width * torch.rand_like(action)
        at_random = torch.rand_like(action[..., :1]) < _WARMUP_RANDOM_SHARE
        chosen = torch.where(at_random, random, noisy).clamp(self._low, self._high)
        return observation.set((self._group, "action"), chosen)


class UniformRandom(TensorDictModuleBase):
    """Draws every action of `group` uniformly within its bounds.

    It draws with a generator of its own `seed`; without one with torch's global generator, as a learner's
    warm-up does.
    """

    def __init__(self, group: str, spec: PolicySpec, seed: int | None = None) -> None:
        super().__init__()
        self.in_keys: list[Any] = [(group, "observation", key) for key in spec.keys[:1]]
        self.out_keys = [(group, "action")]
        self._group = group
        self._generator = None if seed is None else torch.Generator().manual_seed(seed)
        self.register_buffer("_low", torch.tensor(spec.low))
        self.register_buffer("_width", torch.tensor(spec.high) - torch.tensor(spec.low))

    @torch.no_grad()
    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes (group, "action"); of the observation it uses the batch size alone."""
        shape = (*observation.get(self._group).batch_size, len(self._low))
        share = torch.rand(shape, generator=self._generator)
        return observation.set((self._group, "action"), self._low + share * self._width)


class WarmUp:
    """The warm-up of each group of agents: a scripted policy, or random actions, for some frames.

    `groups` are those that are warmed up in the present phase. The phase ends with the warm-up of any of
    them, as groups that warm up for fewer frames then act by their learner's policy beside the others.
    """

    def __init__(self, learners: Mapping[str, Algorithm]) -> None:
        self._learners = learners
        self._is_random = False
        self.groups: frozenset[str] = frozenset()

    def goes_on(self, frames: int) -> bool:
        """Whether another than the learners' policies drives after `frames`, at least in one group."""
        return bool(self._warmed_up(frames))

    def is_over(self, frames: int) -> bool:
        """Whether the present phase of the warm-up is over after `frames`."""
        return self._warmed_up(frames) != self.groups

    @property
    def stage(self) -> int:
        """The number of the present phase, from 1 on; 0 where the learners' policies alone drive."""
        if not self.groups:
            return 0
        return 1 + sum(learner.warmup_frames > 0 for learner in self._learners.values()) - len(self.groups)

    def begin_phase(self, frames: int) -> dict[str, TensorDictModuleBase]:
        """The policies of the warm-up that drive after `frames`, by group; none where it is over."""
        self.groups = self._warmed_up(frames)
        found: dict[str, TensorDictModuleBase] = {}
        for group in sorted(self.groups):
            learner = self._learners[group]
            found[group] = learner.warmup_policy() or UniformRandom(group, learner.context.spec)
        self._is_random = all(isinstance(policy, UniformRandom) for policy in found.values())
        return found

    def learners_policies(self) -> dict[str, GroupPolicy]:
        """The learners' policies of the groups that are not warmed up in the present phase."""
        return {
            group: learner.policy for group, learner in self._learners.items() if group not in self.groups
        }

    def describe(self, frames: int) -> str | None:
        """The warm-up after `frames`, "scripted" or "random"; None where the learners' policies drive."""
        if not self.goes_on(frames):
            return None
        return "random" if self._is_random else "scripted"

    def _warmed_up(self, frames: int) -> frozenset[str]:
        return frozenset(group for group, learner in self._learners.items() if frames < learner.warmup_frames)
