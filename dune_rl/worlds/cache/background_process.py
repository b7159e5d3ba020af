"""Builds worlds into the cache: `python -m dune_rl.worlds.cache.background_process PARENT`.

Standard input has the settings of one world per line (JSON). The process ends with its input, with the
process PARENT, or after a minute without work.
"""

import os
import queue
import sys
import threading
import warnings

_NICENESS = 10
_IDLE_S = 60.0
_LOOK_S = 1.0


def main() -> None:
    """Serve standard input; ends the process."""
    parent = int(sys.argv[1])
    os.nice(_NICENESS)
    lines: queue.Queue[bytes] = queue.Queue()
    # Before the long imports, so that the end of the parent is noticed in them.
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    from dune_rl.worlds.appearance import precompute_appearance
    from dune_rl.worlds.cache.store import requested, shared_store

    warnings.simplefilter("ignore")
    store = shared_store()
    while True:
        try:
            line = lines.get(timeout=_IDLE_S)
        except queue.Empty:
            # An ordinary end would wait for the thread that reads.
            os._exit(0)
        try:
            conf, seen = requested(line)
            if not store.is_kept(conf, seen=seen):
                world = store.get(conf)
                if seen:
                    precompute_appearance(world)
        # Who needs the world meets the fault, and is told of it.
        except Exception:
            continue


def _listen(lines: "queue.Queue[bytes]") -> None:
    for line in sys.stdin.buffer:
        lines.put(line)
    # At once, even in the middle of a world: half an entry is never in place.
    os._exit(0)


def _watch(parent: int) -> None:
    # A process forked from the parent may hold the input open when the parent is killed.
    stop = threading.Event()
    while os.getppid() == parent:
        stop.wait(_LOOK_S)
    os._exit(0)


if __name__ == "__main__":
    main()
