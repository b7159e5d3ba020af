"""`python -m dune_rl.episode_sets`: lists, makes and checks episode sets."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dune_rl.commands.command_line import describe_user_error
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import closest

if TYPE_CHECKING:
    from dune_rl.evaluation.episode_sets.recipes import SetRecipe


# Options of sets from settings.
_OF_OWN_SETS = ("episodes", "sites", "farthest", "seed")


def run(words: Sequence[str]) -> None:
    """List, make or check sets, as the command line says."""
    parsed = parse(words)
    {"list": _list, "make": _make, "check": _check}[parsed.command](parsed)


def parse(words: Sequence[str]) -> Namespace:
    """The words of a command line: its `command`, the `names` of sets, and `settings` (key=value)."""
    parser = ArgumentParser(prog="python -m dune_rl.episode_sets", add_help=False)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", add_help=False)
    make = commands.add_parser("make", add_help=False)
    make.add_argument("names", nargs="*")
    make.add_argument("--out", type=Path, default=Path("episode_sets"))
    for name in _OF_OWN_SETS:
        make.add_argument(f"--{name}", type=float if name == "farthest" else int)
    commands.add_parser("check", add_help=False).add_argument("names", nargs="*")
    parsed, unknown = parser.parse_known_args(words)
    if any("=" not in word or word.startswith("-") for word in unknown):
        parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    # argparse takes words after an option for unknown ones.
    names = [*getattr(parsed, "names", ()), *unknown]
    parsed.names = [word for word in names if "=" not in word]
    parsed.settings = [word for word in names if "=" in word]
    return parsed


def _list(_: Namespace) -> None:
    from dune_rl.evaluation.episode_sets.files import read_episode_set, set_names

    for name in set_names():
        header = read_episode_set(name).header
        print(f"{name:<22} {header.sha256[:12]}  {header.description}")


def _make(parsed: Namespace) -> None:
    from dune_rl.evaluation.episode_sets.files import write_episode_set
    from dune_rl.evaluation.episode_sets.recipes import generate_episodes

    recipes = named_recipes(parsed)
    for recipe in recipes:
        for suffix in (".json", ".csv"):
            if (parsed.out / f"{recipe.name}{suffix}").exists():
                raise ConfigError(f"{parsed.out / recipe.name}{suffix} exists; choose another --out")
    for recipe in recipes:
        episodes = generate_episodes(recipe)
        # The world without a seed is one site.
        header = recipe.header(len({one.world_seed for one in episodes}), parsed.out)
        try:
            written = write_episode_set(parsed.out, header, episodes)
        except OSError as error:
            raise ConfigError(describe_user_error(error) or str(error)) from error
        print(f"{parsed.out / recipe.name}.json  {written.header.sha256}", flush=True)


def named_recipes(parsed: Namespace) -> list["SetRecipe"]:
    """The recipes that the command line names, or the one of its settings."""
    from dune_rl.evaluation.episode_sets.own_recipe import own_recipe
    from dune_rl.evaluation.episode_sets.recipes import all_recipes

    if parsed.settings:
        if len(parsed.names) != 1:
            raise ConfigError(f"settings are for one set: make NAME {parsed.settings[0]} ...")
        chosen = {name: getattr(parsed, name) for name in _OF_OWN_SETS}
        given = {name: value for name, value in chosen.items() if value is not None}
        return [own_recipe(parsed.names[0], parsed.settings, **given)]
    unused = [name for name in _OF_OWN_SETS if getattr(parsed, name) is not None]
    if unused:
        raise ConfigError(f"--{unused[0]} is for a set of your own; add its settings: +world=NAME")
    recipes = all_recipes()
    for name in parsed.names:
        if name not in recipes:
            near = closest(name, recipes)
            meant = f"did you mean {near}? For one" if near else "for one"
            raise ConfigError(f"there is no recipe {name!r}; {meant} of your own give settings: +world=NAME")
    return [recipes[name] for name in parsed.names or recipes]


def _check(parsed: Namespace) -> None:
    from dune_rl.evaluation.episode_sets.apply import faulty_episodes
    from dune_rl.evaluation.episode_sets.files import read_episode_set, set_names

    faults = []
    for name in parsed.names or set_names():
        found = faulty_episodes(read_episode_set(name), overrides=parsed.settings)
        print(f"{name:<22} {len(found)} faults", flush=True)
        faults += [f"{name}: {fault}" for fault in found]
    if faults:
        raise ConfigError("\n".join(faults))
