"""Export of a trained policy as an ONNX file, which is compared with the policy."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import Field

from dune_rl.clients.policy_interface import PolicyInterface
from dune_rl.commands import command_line
from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_free, sha256_of, write_atomically
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import split_word
from dune_rl.core.version import VERSION
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.learning.onnx_file import ActingNetwork, check_exporter, onnx_model, sample_inputs
from dune_rl.learning.onnx_policy import open_session
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import describe_selection, saved_policy_in

# Compared observations, in batches of these; and those of which each is timed.
_COMPARED, _BATCH, _TIMED = 10_000, 500, 300
# Above this share of an action's range, two actions are no longer the same.
_TOLERANCE = 1e-5


class PolicyConf(Settings):
    """Settings of a policy's export."""

    checkpoint: str = Field(min_length=1)
    out: str = Field(min_length=1)
    group: str | None = Field(None, min_length=1)
    overwrite: bool = False


def parse_words(words: Sequence[str]) -> PolicyConf:
    """The settings among the words of a command line; `ConfigError` where they are not valid."""
    values = {}
    for word in words:
        key, equals, values[key] = split_word(word.lstrip("+"))
        if not equals:
            raise ConfigError(f"cannot read {word!r}; write key=value (see --help)")
    conf = validate(PolicyConf, values)
    if Path(conf.out).suffix != ".onnx":
        raise ConfigError(f"out={conf.out} must end in .onnx")
    return conf


def export_policy(conf: PolicyConf) -> None:
    """Write the file that the settings ask for; raises ConfigError where it acts otherwise."""
    out = Path(conf.out)
    check_free(out, overwrite=conf.overwrite)
    check_exporter()
    file, content = read_policy_file(Path(conf.checkpoint))
    groups = sorted(content["groups"])
    if conf.group is None and len(groups) > 1:
        raise ConfigError(f"{file} has policies of {', '.join(groups)}; choose one: group=NAME")
    if conf.group is not None and conf.group not in groups:
        raise ConfigError(f"{file} has no policy of {conf.group!r}; it has {', '.join(groups)}")
    group = conf.group or groups[0]
    saved = saved_policy_in(file, content, group)
    interface = PolicyInterface.of_run(saved.spec, group, content["config"])
    description = {
        "version": VERSION,
        "policy": describe_selection(content),
        "sha256": sha256_of(file),
        **interface.model_dump(mode="json"),
    }
    acting, model = onnx_model(saved.make_network(), saved.spec, description)
    compared = _compare(model, acting, saved.spec)
    out.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(out) as temporary:
        temporary.write_bytes(model)
    action = " and ".join(each.name for each in interface.action)
    lines = [
        f"{out}: {group}, {description['policy']}",
        f"inputs: {', '.join(acting.inputs)}",
        f"outputs: {', '.join(acting.outputs)} ({action}), every {interface.decision_s:g} s",
        compared,
    ]
    console = command_line.make_console()
    for line in lines:
        command_line.print_line(console, line)


def _compare(model: bytes, acting: ActingNetwork, spec: PolicySpec) -> str:
    """A line on how far both act alike; raises ConfigError where they do not."""
    try:
        session = open_session(model)
    except ImportError:
        return "not compared with the checkpoint: onnxruntime is not installed"
    except ValueError as error:
        raise ConfigError(
            f"onnxruntime does not run the policy, so no file was written: {error}; "
            "install the version of constraints.txt, or report this"
        ) from None
    most, generator_state = 0.0, torch.get_rng_state()
    # Components of a memory are between -1 and 1.
    ranges = [np.subtract(spec.high, spec.low) if name == "action" else 2.0 for name in acting.outputs]
    torch.manual_seed(0)
    for _ in range(_COMPARED // _BATCH):
        given = sample_inputs(acting, spec, _BATCH)
        with torch.no_grad():
            wanted = acting(*given)
        found = session.run(None, _inputs_by_name(acting, given))
        for one, other, size in zip(wanted, found, ranges, strict=True):
            # Not `max`, which passes over NaN.
            most = float(np.maximum(most, (np.abs(one.numpy() - other) / size).max()))
    single = _inputs_by_name(acting, sample_inputs(acting, spec, 1))
    torch.set_rng_state(generator_state)
    begun = time.perf_counter()
    for _ in range(_TIMED):
        session.run(None, single)
    took_ms = 1e3 * (time.perf_counter() - begun) / _TIMED
    if not most <= _TOLERANCE:
        raise ConfigError(
            f"in ONNX the policy acts otherwise (by up to {most:.2g} of an action's range), so no file was "
            "written; keep to the checkpoint, and report this"
        )
    return (
        f"actions differ by at most {most:.1g} of their range over {_COMPARED:,} observations; "
        f"{took_ms:.2f} ms each, one thread"
    )


def _inputs_by_name(acting: ActingNetwork, given: Sequence[torch.Tensor]) -> dict[str, Any]:
    return {name: value.numpy() for name, value in zip(acting.inputs, given, strict=True)}
