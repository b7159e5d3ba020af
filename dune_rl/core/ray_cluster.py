"""A connection to a Ray cluster, on which training collects and evaluations run. Needs the extra `ray`."""

import importlib.util
import logging
import os
import signal
import socket
import threading
from typing import Any

from dune_rl.core.errors import ConfigError, TrainingError

# How long the cluster's head may take to accept a connection [s].
_ANSWER_S = 5.0


def check_installed(setting: str) -> None:
    """Raise ConfigError unless Ray is installed, which `setting` (KEY=VALUE) asks for."""
    found = importlib.util.find_spec("ray")
    # A folder of that name, where the command runs, counts as a package without a file of its own.
    if found is None or found.origin is None:
        raise ConfigError(f"{setting} needs Ray: pip install 'dune_rl[ray]'")


def is_elsewhere() -> bool:
    """Whether RAY_ADDRESS names a cluster, as `ray job submit` does; otherwise one starts on this machine."""
    return bool(os.environ.get("RAY_ADDRESS"))


def check_usable(setting: str) -> None:
    """Raise ConfigError unless Ray is installed, and a cluster answers at RAY_ADDRESS where that is set.

    `setting` (KEY=VALUE) asks for Ray. No cluster is started, and no connection stays open.
    """
    check_installed(setting)
    if is_elsewhere():
        RayCluster(setting, cpus=1).close()


def _check_answers(address: str) -> None:
    """Raise OSError if nothing accepts a connection at `address`, where that is HOST:PORT."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER_S).close()


class RayCluster:
    """The Ray cluster at RAY_ADDRESS or, without that, one of `cpus` CPUs on this machine until `close`.

    A program that has called `ray.init` itself keeps its cluster. Ray sends no statistics of its use, opens
    no dashboard and prints nothing. Raises ConfigError where Ray, which `setting` asks for, is not installed,
    and where no cluster answers.
    """

    def __init__(self, setting: str, cpus: int) -> None:
        check_installed(setting)
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        logging.getLogger("ray").setLevel(logging.ERROR)
        import ray

        self._is_ours = not ray.is_initialized()
        if self._is_ours:
            # Ray prints what happens to nodes into the output of others, and has no public switch for that.
            ray._private.worker._worker_logs_enabled = False
            is_main = threading.current_thread() is threading.main_thread()
            before = signal.getsignal(signal.SIGTERM)
            here: dict[str, Any] = {"address": "local", "num_cpus": cpus, "include_dashboard": False}
            try:
                # Ray itself tries without end to reach a head that is not there.
                _check_answers(os.environ.get("RAY_ADDRESS", ""))
                ray.init(configure_logging=False, log_to_driver=False, **({} if is_elsewhere() else here))
            except (OSError, RuntimeError, ValueError) as error:
                where = f"at RAY_ADDRESS={os.environ['RAY_ADDRESS']}" if is_elsewhere() else "on this machine"
                reason = str(error.__cause__ or error).strip().splitlines()[-1]
                raise ConfigError(
                    f"no Ray cluster can be used {where} ({reason}); start one by `ray start`, or unset "
                    "RAY_ADDRESS for one on this machine alone"
                ) from error
            finally:
                if is_main:
                    # Ray takes SIGTERM for itself.
                    signal.signal(signal.SIGTERM, before)
        self._head: str = ray.get_runtime_context().gcs_address

    def check(self) -> None:
        """Raise TrainingError where the head does not answer, or no node with a CPU is left."""
        try:
            # Ray itself waits a minute for a head that is gone, and then ends this whole process.
            _check_answers(self._head)
        except OSError as error:
            raise TrainingError(f"the head of the Ray cluster, {self._head}, is gone ({error})") from error
        if not self.cpus():
            raise TrainingError("no node of the Ray cluster is left")

    def cpus(self) -> int:
        """CPUs of all nodes that live, busy ones too."""
        import ray

        return sum(int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"])

    def close(self) -> None:
        """End what runs on the cluster for this process, and the cluster too if it was started here."""
        import ray

        if self._is_ours:
            ray.shutdown()
