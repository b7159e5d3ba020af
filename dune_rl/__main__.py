"""`python -m dune_rl`: the commands."""

import shutil
import sys
import textwrap

from dune_rl.commands.pages import PAGES


def main() -> int:
    """Print the commands; the exit code is 0, or 2 if something else was asked for."""
    lines = ["dune_rl: off-road navigation among moving actors", ""]
    longest, width = max(map(len, PAGES)), shutil.get_terminal_size().columns
    for name, page in PAGES.items():
        command = f"  python -m dune_rl.{name:<{longest}}  "
        lines += textwrap.wrap(
            page.title,
            max(width, 2 * len(command)),
            initial_indent=command,
            subsequent_indent=" " * len(command),
        )
    lines += ["", "Each has --help. First steps: python -m dune_rl.train +experiment=quick"]
    asked = [word for word in sys.argv[1:] if word not in ("-h", "--help")]
    if asked:
        print(f"python -m dune_rl takes no words ({asked[0]!r}): choose a command", file=sys.stderr)
    print("\n".join(lines), file=sys.stderr if asked else sys.stdout)
    return 2 if asked else 0


if __name__ == "__main__":
    sys.exit(main())
