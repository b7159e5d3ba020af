"""Trained policies as ONNX files, which act without PyTorch and without this package."""

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from importlib.util import find_spec
from io import StringIO
from typing import Any

import torch
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import GRUModule

from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.policy import FEATURES, MEMORY
from dune_rl.learning.policy_spec import PolicySpec

# The name under which an ONNX file keeps the description of its policy, as JSON.
METADATA = "dune_rl"
ACTION, MEMORY_AFTER = "action", "next_memory"
# Observations that an export is traced with; files take any number.
_TRACED = 2


class ActingNetwork(nn.Module):
    """The most likely actions (N, A) for N observations, as a network of tensors alone.

    `inputs` names what `forward` takes: the parts of the observation (N, ...), in the order of `spec`, and
    the memory (N, 1, units) of a recurrent policy, zeros where an episode begins. `outputs` names what it
    returns: the action and the memory after it. Raises ConfigError for a network of other modules than ours.
    """

    _middle: Tensor
    _half_range: Tensor

    def __init__(self, network: TensorDictModuleBase, spec: PolicySpec) -> None:
        super().__init__()
        self._steps = list(_leaves(network))
        self._modules_of_steps = nn.ModuleList(self._steps)
        self.memory_units = next((each.gru.hidden_size for each in self._steps if _is_memory(each)), 0)
        self.inputs = [*spec.keys, *([MEMORY] if self.memory_units else [])]
        self.outputs = [ACTION, *([MEMORY_AFTER] if self.memory_units else [])]
        self.register_buffer("_middle", spec.middle)
        self.register_buffer("_half_range", spec.half_range)

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """The `outputs` for the `inputs`."""
        values: dict[Any, Tensor] = dict(zip(self.inputs, given, strict=True))
        for step in self._steps:
            if _is_memory(step):
                features, after = step.gru(
                    values[FEATURES].unsqueeze(1), values[MEMORY].transpose(0, 1).contiguous()
                )
                values[FEATURES], values[MEMORY_AFTER] = features.squeeze(1), after.transpose(0, 1)
            elif isinstance(step, ProbabilisticTensorDictModule):
                # The mode of the tanh-normal over the action's bounds.
                values[ACTION] = self._middle + self._half_range * torch.tanh(values["loc"])
            else:
                found = step.module(*(values[key] for key in step.in_keys))
                values |= zip(step.out_keys, found if isinstance(found, tuple) else (found,), strict=True)
        return tuple(values[name] for name in self.outputs)


def _leaves(module: nn.Module) -> Iterator[Any]:
    if isinstance(module, TensorDictSequential):
        for each in module.module:
            yield from _leaves(each)
    else:
        yield module


def _is_memory(module: nn.Module) -> bool:
    return isinstance(module, GRUModule)


def sample_inputs(network: ActingNetwork, spec: PolicySpec, count: int) -> list[Tensor]:
    """Random inputs of `network` for `count` observations, in its order, drawn from PyTorch's generator."""
    made = []
    for key in spec.keys:
        part = spec.part(key)
        shape = (count, *part.shape)
        if part.uint8:
            made.append(torch.randint(int(part.low), int(part.high) + 1, shape, dtype=torch.uint8))
        elif key in spec.images:
            made.append(part.low + (part.high - part.low) * torch.rand(shape))
        else:
            made.append(torch.randn(shape).abs() if key in spec.ranges else torch.randn(shape))
    if network.memory_units:
        made.append(torch.rand(count, 1, network.memory_units) * 2 - 1)
    return made


def check_exporter() -> None:
    """Raise ConfigError where the packages that write ONNX files are not installed."""
    if find_spec("onnx") is None or find_spec("onnxscript") is None:
        raise ConfigError("an ONNX file needs onnx and onnxscript: pip install 'dune_rl[export]'")


def onnx_model(
    network: TensorDictModuleBase, spec: PolicySpec, description: Mapping[str, Any]
) -> tuple[ActingNetwork, bytes]:
    """A policy that acts as its most likely behaviour does, as a network and as the content of an ONNX file.

    `description` is kept in it under `METADATA`. Raises ConfigError for a network that ONNX has no form for.
    """
    check_exporter()
    import onnx

    acting = ActingNetwork(network, spec).eval()
    given = tuple(sample_inputs(acting, spec, _TRACED))
    batch = torch.export.Dim("batch")
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        # The exporter prints its progress, and warns of what does not concern a user.
        with warnings.catch_warnings(), redirect_stdout(StringIO()), torch.no_grad():
            warnings.simplefilter("ignore")
            with set_exploration_type(ExplorationType.DETERMINISTIC):
                program = torch.onnx.export(
                    acting,
                    given,
                    input_names=acting.inputs,
                    output_names=acting.outputs,
                    dynamo=True,
                    dynamic_shapes=(tuple({0: batch} for _ in given),),
                    verbose=False,
                )
    except Exception as error:
        reason = str(error.__cause__ or error).splitlines()[0]
        raise ConfigError(f"the policy's network cannot be exported to ONNX: {reason}") from error
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
    assert program is not None
    model = program.model_proto
    onnx.helper.set_model_props(model, {METADATA: json.dumps(description)})
    return acting, model.SerializeToString()
