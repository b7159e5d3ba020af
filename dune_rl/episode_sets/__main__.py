"""`python -m dune_rl.episode_sets`: lists, makes and checks episode sets."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from dune_rl.errors import DuneError


def main() -> None:
    """Run the command line; ends the process."""
    parser = ArgumentParser(prog="python -m dune_rl.episode_sets", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="the sets of the package, with their checksums")
    make = commands.add_parser("make", help="make sets again from their recipes (builds all their sites)")
    make.add_argument("names", nargs="*", help="which sets; none: all")
    make.add_argument("--out", type=Path, default=Path("episode_sets"), help="the folder to write to")
    check = commands.add_parser("check", help="start every episode of sets, and report what is not free")
    check.add_argument("names", nargs="*", help="which sets, by name or path; none: all of the package")
    parsed = parser.parse_args()
    try:
        {"list": _list, "make": _make, "check": _check}[parsed.command](parsed)
    except DuneError as error:
        from dune_rl.command import exit_with_error

        exit_with_error(str(error))


def _list(_: Namespace) -> None:
    from dune_rl.episode_sets.files import read_episode_set, set_names

    for name in set_names():
        header = read_episode_set(name).header
        print(f"{name:<22} {header.sha256[:12]}  {header.description}")


def _make(parsed: Namespace) -> None:
    from dune_rl.command import describe_user_error
    from dune_rl.episode_sets.files import write_episode_set
    from dune_rl.episode_sets.generate import all_recipes, generate_episodes
    from dune_rl.errors import ConfigError
    from dune_rl.suggestions import one_of

    recipes = all_recipes()
    unknown = [name for name in parsed.names if name not in recipes]
    if unknown:
        raise ConfigError(f"there is no recipe {unknown[0]!r}; choose {one_of(list(recipes))}")
    for name in parsed.names or recipes:
        for suffix in (".json", ".csv"):
            if (parsed.out / f"{name}{suffix}").exists():
                raise ConfigError(f"{parsed.out / name}{suffix} exists; choose another --out")
    for name in parsed.names or recipes:
        episodes = generate_episodes(recipes[name])
        header = recipes[name].header(len({one.world_seed for one in episodes}))
        try:
            written = write_episode_set(parsed.out, header, episodes)
        except OSError as error:
            raise ConfigError(describe_user_error(error) or str(error)) from error
        print(f"{parsed.out / name}.json  {written.header.sha256}", flush=True)


def _check(parsed: Namespace) -> None:
    from dune_rl.episode_sets.check import faulty_episodes
    from dune_rl.episode_sets.files import read_episode_set, set_names
    from dune_rl.errors import ConfigError

    faults = []
    for name in parsed.names or set_names():
        found = faulty_episodes(read_episode_set(name))
        print(f"{name:<22} {len(found)} faults", flush=True)
        faults += [f"{name}: {fault}" for fault in found]
    if faults:
        raise ConfigError("\n".join(faults))


if __name__ == "__main__":
    main()
