"""Random rollouts of a simulation, and the digest of all that they show."""

import hashlib

import numpy as np
from simulations import act, metrics, observation

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation


class Rollout:
    """A rollout that is advanced in parts: a hash of all that external agents observe, earn and are measured.

    It begins with a reset; scenes whose episodes end are reset.
    """

    def __init__(self, simulation: VectorSimulation, seed: int = 1) -> None:
        self._simulation = simulation
        self._rng = np.random.default_rng(seed)
        self._hash = hashlib.sha256()
        simulation.reset()

    def advance(self, steps: int) -> None:
        simulation = self._simulation
        for _ in range(steps):
            step = act(simulation, **{group.name: self._actions(group) for group in simulation.external})
            if step.done.any():
                simulation.reset(step.done)
            for group in simulation.external:
                outcome = step.groups[group.name]
                seen = [*observation(simulation, group.name).values(), metrics(simulation, group.name)]
                for value in (*seen, outcome.reward, outcome.terminated, outcome.truncated):
                    self._hash.update(value.tobytes())

    def _actions(self, group: AgentGroup) -> np.ndarray:
        low, high = group.action_bounds
        if group.action_size == 2:
            # Mostly ahead, so that obstacles are met.
            low, high = np.array([0.2 * high[0], -1.0]), np.array([high[0], 1.0])
        return self._rng.uniform(low, high, (len(group.done), group.action_size))

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


def digest_of(simulation: VectorSimulation, steps: int) -> str:
    """The digest of a rollout of `steps` control steps."""
    rollout = Rollout(simulation)
    rollout.advance(steps)
    return rollout.digest
