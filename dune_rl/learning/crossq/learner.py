"""CrossQ as a learner of one agent group: soft actor-critic with another loss."""

from functools import partial

import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor
from torchrl.modules import BatchRenorm1d
from torchrl.objectives import CrossQLoss

from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.crossq.settings import CrossqConf
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.sac.gradient_step import GradientStep, make_action_value
from dune_rl.learning.sac.learner import MaximumEntropyLearner


class BatchRenorm(BatchRenorm1d):
    """TorchRL's layer, in float32, whose correction stays complete after its warm-up.

    TorchRL 0.14 does not keep the bound on the count of batches: the correction is doubled after twice the
    warm-up, and so on.
    """

    def forward(self, x: Tensor) -> Tensor:
        normalised: Tensor = super().forward(x.float())
        self.num_batches_tracked.copy_(self.num_batches_tracked.clamp(max=self.warmup_steps))
        return normalised


class CrossqStep(GradientStep):
    """A gradient step with critics that see a batch's observations and later observations together.

    Their batch statistics are then those of both, which is what targets would otherwise be needed for.
    """

    _conf: CrossqConf
    # Of Adam, as in the paper.
    _betas = (0.5, 0.999)

    def _make_loss(
        self, actor: ProbabilisticTensorDictSequential, spec: PolicySpec, features: int, key: str
    ) -> CrossQLoss:
        conf = self._conf
        norm = partial(BatchRenorm, momentum=conf.norm_momentum, warmup_steps=conf.norm_warm_up)
        return CrossQLoss(
            actor,
            make_action_value(spec, features, conf.hidden, self._device, key, norm),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=conf.initial_entropy_coefficient,
            target_entropy=self._target_entropy_of(spec),
        )

    def _evaluate_critics(self, batch: TensorDict) -> Tensor:
        critic = self.loss.qvalue_network.eval()
        found = []
        for number in range(2):
            with self.loss.qvalue_network_params[number].to_module(critic):
                found.append(critic(batch.clone(recurse=False))["state_action_value"])
        critic.train()
        return torch.stack(found)

    def _update_targets(self) -> None:
        """There are none."""


class Crossq(MaximumEntropyLearner):
    """CrossQ (Bhatt et al. 2024) with the replay buffer, the warm-up and the policy of `sac`.

    The actor has no batch normalisation, as the policy's normaliser scales what it reads, and is updated as
    often as the critics.
    """

    step_class = CrossqStep

    def __init__(self, context: LearnerContext, conf: CrossqConf) -> None:
        super().__init__(context, conf)
