"""A transform that asks a driver for the costs of all commands in the states that a policy meets."""

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from dune_rl.core.seeding import stream
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.geometry.arrays import Array
from dune_rl.learning.drivers import BoundDriver

# Under "next" and a group: costs of the commands in the state before the step.
TEACHER_COSTS = "teacher_costs"
# Chance of a burst of random actions to begin at a decision, and its length in decisions.
_BURST_CHANCE = 0.05
_BURST_LENGTHS = (2, 8)
# In metres of level way: the price of an action at the opposite bound, for teachers without costs.
_DEVIATION_COST = 8.0


class TeacherLabels(Transform):
    """Transform that adds (`next`, `group`, "teacher_costs"), (M, G, C): costs of C actions before a step.

    `commands` (C, A) are the actions. Costs are those of the driver `teacher`; of a driver without costs, the
    squared distance from its action, in shares of the bounds. Added are `change_cost` times how much a
    command differs from the last action, and `standing_cost` for commands of no speed, turns on the spot
    included. Labels are the costs above the least one, at most `max_cost`. In a `share` of the episodes
    the teacher drives, in the others the policy, whose actions the teacher is told. In a `noise_share` of the
    policy's episodes, and twice that of the teacher's, there are bursts of random actions, from which both
    must find back.
    """

    def __init__(
        self, group: str, teacher: str, commands: Array, max_cost: float, change_cost: float,
        standing_cost: float, share: float, noise_share: float,
    ) -> None:  # fmt: skip
        super().__init__(in_keys_inv=[(group, "action")])
        self._name, self._teacher, self._commands = group, teacher, commands
        self._max_cost, self._change_cost = max_cost, change_cost
        self._standing_costs = np.where(commands[:, 0] == 0.0, standing_cost, 0.0)
        self._share, self._noise_share = share, noise_share
        self._driver: BoundDriver | None = None

    def _bind(self) -> BoundDriver:
        if self._driver is None:
            self._simulation = simulation_in(self.container)
            self._group = self._simulation.group(self._name)
            self._driver = BoundDriver(self._teacher, self._simulation, self._group)
            self._rng = stream(self._simulation.seed, f"teacher of {self._name}")
            rows = self._group.num_rows
            self._teaches, self._is_noisy = np.zeros((2, rows), bool)
            self._burst_left = np.zeros(rows, np.int64)
            self._burst = np.zeros((rows, self._commands.shape[1]))
            self._costs = np.zeros((rows, len(self._commands)), np.float32)
        return self._driver

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        driver = self._bind()
        shape = (self._simulation.num_scenes, self._group.count, -1)
        begins = self._simulation.state.groups[self._name].episode.steps == 0
        self._begin(begins)
        own = tensordict.get((self._name, "action")).numpy().reshape(len(begins), -1)
        best = None if driver.has_costs else driver.act()
        costs = driver.costs(self._commands, self._max_cost) if best is None else self._deviations(best)
        if self._change_cost > 0.0 or self._standing_costs.any():
            costs = costs + self._change_cost * self._changes() + self._standing_costs
            costs = np.minimum(costs - costs.min(axis=1, keepdims=True), self._max_cost)
        if best is None:
            best = self._commands[costs.argmin(axis=1)]
        self._costs = costs.astype(np.float32).reshape(shape)
        actions = np.where(self._teaches[:, None], best, own)
        actions = self._disturb(actions).astype(np.float32)
        driver.record(actions)
        return tensordict.set((self._name, "action"), torch.from_numpy(actions.reshape(shape)))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict.get(self._name).set(TEACHER_COSTS, torch.from_numpy(self._costs))
        return next_tensordict

    def _begin(self, begins: Array) -> None:
        """Draw who drives in the episodes that begin."""
        count = int(begins.sum())
        if count:
            self._teaches[begins] = self._rng.random(count) < self._share
            chance = self._noise_share * (1 + self._teaches[begins])
            self._is_noisy[begins] = self._rng.random(count) < chance
            self._burst_left[begins] = 0

    def _disturb(self, actions: Array) -> Array:
        rows = len(actions)
        starts = self._is_noisy & (self._burst_left == 0) & (self._rng.random(rows) < _BURST_CHANCE)
        count = int(starts.sum())
        self._burst_left[starts] = self._rng.integers(*_BURST_LENGTHS, count)
        self._burst[starts] = self._commands[self._rng.integers(len(self._commands), size=count)]
        actions = np.where((self._burst_left > 0)[:, None], self._burst, actions)
        self._burst_left = np.maximum(self._burst_left - 1, 0)
        return actions

    def _changes(self) -> Array:
        """How much each command differs from the last action, (N, C) [m/s and rad]."""
        low, high = self._group.action_bounds
        last = self._simulation.state.groups[self._name].last_action
        assert last is not None
        before = low + 0.5 * (last + 1.0) * (high - low)
        found: Array = np.abs(self._commands - before[:, None]).sum(axis=2)
        return found

    def _deviations(self, actions: Array) -> Array:
        low, high = self._group.action_bounds
        apart = (self._commands - actions[:, None]) / (high - low)
        return np.minimum(4.0 * _DEVIATION_COST * (apart**2).sum(axis=2), self._max_cost)

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """Add the costs, which are of a step, as its reward is."""
        shape = (*reward_spec[self._name].shape, len(self._commands))
        reward_spec[self._name, TEACHER_COSTS] = Unbounded(shape, dtype=torch.float32)
        return reward_spec
