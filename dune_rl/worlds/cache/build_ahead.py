"""Builds worlds into the disk cache: `python -m dune_rl.worlds.cache.build_ahead PARENT`.

Standard input has the settings of one world per line (JSON). The process exits at the end of its input, when
the process PARENT has ended, and after a minute without work.
"""

import os
import signal
import sys
import warnings
from contextlib import suppress

from dune_rl.worlds.appearance import precompute_appearance
from dune_rl.worlds.cache.store import decode_request, shared_store

_NICENESS = 10
_IDLE_S = 60


def main() -> None:
    """Build the worlds that standard input requests."""
    parent = int(sys.argv[1])
    os.nice(_NICENESS)
    warnings.simplefilter("ignore")
    store = shared_store()
    while True:
        # The alarm ends the process.
        signal.alarm(_IDLE_S)
        line = sys.stdin.readline()
        signal.alarm(0)
        # A fork of the parent may hold the input open when the parent is killed.
        if not line or os.getppid() != parent:
            return
        # The process that needs the world raises the same error to its user.
        with suppress(Exception):
            conf, with_appearance = decode_request(line)
            if not store.is_cached(conf, with_appearance=with_appearance):
                world = store.get(conf)
                if with_appearance:
                    precompute_appearance(world)


if __name__ == "__main__":
    main()
