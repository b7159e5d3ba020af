"""Builds worlds into the cache: `python -m dune_rl.worlds.cache.background_process PARENT`.

Standard input has the settings of one world per line (JSON). The process exits at the end of its input, when
the process PARENT ends, and after a minute without work.
"""

import os
import queue
import sys
import threading
import warnings

_NICENESS = 10
_IDLE_S = 60.0
_POLL_S = 1.0


def main() -> None:
    """Build the worlds that standard input requests; exits the process."""
    parent = int(sys.argv[1])
    os.nice(_NICENESS)
    lines: queue.Queue[bytes] = queue.Queue()
    # The threads start before the slow imports, so that the end of the parent is noticed during these.
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    from dune_rl.worlds.appearance import precompute_appearance
    from dune_rl.worlds.cache.store import decode_request, shared_store

    warnings.simplefilter("ignore")
    store = shared_store()
    while True:
        try:
            line = lines.get(timeout=_IDLE_S)
        except queue.Empty:
            # `sys.exit` would wait for the thread that reads.
            os._exit(0)
        try:
            conf, with_appearance = decode_request(line)
            if not store.is_cached(conf, with_appearance=with_appearance):
                world = store.get(conf)
                if with_appearance:
                    precompute_appearance(world)
        # The process that needs the world raises the same error to its user.
        except Exception:
            continue


def _listen(lines: "queue.Queue[bytes]") -> None:
    for line in sys.stdin.buffer:
        lines.put(line)
    # Even while a world is built: entries are written atomically.
    os._exit(0)


def _watch(parent: int) -> None:
    # A process forked from the parent may hold the input open when the parent is killed.
    stop = threading.Event()
    while os.getppid() == parent:
        stop.wait(_POLL_S)
    os._exit(0)


if __name__ == "__main__":
    main()
