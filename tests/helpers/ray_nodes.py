"""A Ray cluster of several nodes on this machine, for tests."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def ray_nodes(
    monkeypatch: pytest.MonkeyPatch, number: int, cpus: int = 1, head_cpus: int | None = None
) -> Iterator[list[Any]]:
    """Nodes of `cpus` each, the head first, which RAY_ADDRESS names inside the context; skips without Ray."""
    pytest.importorskip("ray", reason="no Ray: pip install 'dune_rl[ray]'")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    # Nodes have the modules of tests from their surroundings, as on a cluster.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    from ray.cluster_utils import Cluster

    head = {"include_dashboard": False, "include_log_monitor": False, "no_monitor": True}
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": cpus if head_cpus is None else head_cpus, **head}
    )
    try:
        others = [cluster.add_node(num_cpus=cpus) for _ in range(number - 1)]
        monkeypatch.setenv("RAY_ADDRESS", cluster.address)
        yield [cluster.head_node, *others]
    finally:
        cluster.shutdown()


def kill_node(node: Any, process: str = "raylet") -> None:
    """End a node as a power cut does; its workers end with it."""
    os.kill(node.all_processes[process][0].process.pid, signal.SIGKILL)
