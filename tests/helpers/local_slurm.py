"""A Slurm for tests: the one that runs here, or daemons of one's own with a node that is this machine."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from local_ports import free_port

_CONF = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmdPort={node_port}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=2
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
KillWait=30
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
NodeName=node NodeHostname={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory=1000 State=UNKNOWN
PartitionName=main Nodes=node Default=YES MaxTime=INFINITE State=UP
"""
_PATIENCE_S = 60.0


@contextmanager
def slurm(folder: Path) -> Iterator[dict[str, str]]:
    """The environment variables with which Slurm's commands find the cluster; skips where there is none."""
    if shutil.which("sbatch") is None:
        pytest.skip("without Slurm (Debian: slurm-wlm and munge)")
    if _is_ready(os.environ):
        yield dict(os.environ)
        return
    if os.geteuid() != 0 or not all(map(shutil.which, ("munged", "slurmctld", "slurmd"))):
        pytest.skip("no Slurm is running, and only root can start one, with slurmctld, slurmd and munged")
    with ExitStack() as stack:
        yield _start(folder, stack)


def _start(folder: Path, stack: ExitStack) -> dict[str, str]:
    conf = folder / "slurm.conf"
    ports = {"port": free_port(), "node_port": free_port()}
    cores = len(os.sched_getaffinity(0))
    conf.write_text(_CONF.format(folder=folder, host=socket.gethostname(), cores=cores, **ports))
    (folder / "state").mkdir()
    (folder / "spool").mkdir()
    key = folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    files = {
        "key": key,
        "seed": folder / "munge.seed",
        "pid": folder / "munge.pid",
        "log": folder / "munge.log",
    }
    daemons = (
        # As root, in a folder that is not its own.
        ["munged", "--force", "--foreground", f"--socket={folder}/munge.socket"]
        + [f"--{name}-file={file}" for name, file in files.items()],
        ["slurmctld", "-D", "-c", "-f", str(conf)],
        ["slurmd", "-D", "-c", "-N", "node", "-f", str(conf)],
    )
    environment = {**os.environ, "SLURM_CONF": str(conf)}
    log = stack.enter_context((folder / "daemons.txt").open("w"))
    for words in daemons:
        daemon = subprocess.Popen(words, stdout=log, stderr=log, env=environment)
        stack.callback(_end, daemon)
    # Of a test that failed.
    stack.callback(subprocess.run, ["scancel", "--partition=main"], env=environment, check=False)
    end = time.monotonic() + _PATIENCE_S
    while not _is_ready(environment):
        assert time.monotonic() < end, (folder / "daemons.txt").read_text()
        time.sleep(0.5)
    return environment


def _end(daemon: subprocess.Popen[bytes]) -> None:
    daemon.terminate()
    try:
        daemon.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()


def _is_ready(environment: Mapping[str, str]) -> bool:
    found = subprocess.run(
        ["sinfo", "-h", "-o", "%T"], env=dict(environment), capture_output=True, text=True, check=False
    )
    return found.returncode == 0 and bool({"idle", "mixed", "allocated"} & {*found.stdout.split()})
