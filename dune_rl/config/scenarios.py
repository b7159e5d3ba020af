"""What `scenario=NAME` and lists of actors compose: settings of several options in one word."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from hydra.core.config_loader import ConfigLoader
from omegaconf import OmegaConf

from dune_rl.bodies.registry import BODIES
from dune_rl.config.expand import merged
from dune_rl.config.hydra_session import compose_config, compose_words, to_plain
from dune_rl.config.overrides import ParsedOverrides, option_names
from dune_rl.worlds.registry import WORLDS

SCENARIO = "scenario"
# Sections of which a scenario chooses an option: a saved run's settings of another option are no use there.
_CHOSEN = ("world", "actors")


def has_scenario(request: ParsedOverrides) -> bool:
    """Whether the overrides choose a scenario."""
    return any(override.key_or_group == SCENARIO for override in request.groups)


def drop_groups_without_body(data: dict[str, Any], named: Iterable[str] = ()) -> None:
    """Leave out what a scenario changes of actors that other `actors` were chosen in place of.

    Such groups have no body. Those that are `named` by an override stay, so that the check says what lacks.
    """
    actors = data.get("actors")
    if isinstance(actors, Mapping):
        data["actors"] = {name: group for name, group in actors.items() if name in named or _has_body(group)}


def drop_values_of_other_world(data: dict[str, Any], named: Iterable[str] = ()) -> None:
    """Leave out what a scenario changes of its world, where another one was chosen that has no such setting.

    Settings that are `named` stay, so that the check says what lacks.
    """
    world = data.get("world")
    if not isinstance(world, Mapping) or not isinstance(name := world.get("name"), str):
        return
    known = WORLDS.settings_class(name) if name in WORLDS.names() else None
    if known is not None:
        fields = {*known.model_fields, *named}
        data["world"] = {key: value for key, value in world.items() if key in fields}


def _has_body(group: Any) -> bool:
    if not isinstance(group, Mapping):
        return True
    body = group.get("body")
    return "name" in body if isinstance(body, Mapping) else body is not None


def named_in(section: str, request: ParsedOverrides) -> set[str]:
    """The parts of a section that an override changes, such as the groups of `actors`."""
    keys = (str(override.key_or_group).split(".") for override in request.values)
    return {key[1] for key in keys if key[0] == section and len(key) > 1}


def change_saved(saved: Mapping[str, Any], name: str, request: ParsedOverrides) -> dict[str, Any]:
    """Saved settings, changed by the scenario of the overrides alone, composed with the file `name`.

    World and actors are the scenario's; of other sections it changes the values that it states.
    """
    alone = replace(request, groups=tuple(o for o in request.groups if o.key_or_group == SCENARIO), values=())
    with_it = to_plain(compose_config(name, alone))
    without = to_plain(compose_config(name, replace(alone, groups=())))
    changes = _difference(without, with_it)
    chosen = {key: with_it[key] for key in _CHOSEN if key in changes}
    return {**merged(saved, {key: each for key, each in changes.items() if key in saved}), **chosen}


def _difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `after` that `before` has otherwise or not at all."""
    found: dict[str, Any] = {}
    for key, value in after.items():
        earlier = before.get(key)
        if isinstance(value, Mapping) and isinstance(earlier, Mapping):
            if inner := _difference(earlier, value):
                found[key] = inner
        elif key not in before or value != earlier:
            found[key] = value
    return found


def describe_shared_groups(request: ParsedOverrides) -> list[str]:
    """Faults of lists of actors, as `actors=[orca,follow]`: groups that two of the options have.

    Composed, the second one would change the first one's group, or be the same group again.
    """
    faults = []
    for override in request.groups:
        options = override.value() if override.key_or_group == "actors" else None
        owners: dict[str, str] = {}
        listed = [str(option) for option in options] if isinstance(options, list) else []
        for option in dict.fromkeys(listed):
            if listed.count(option) > 1:
                faults.append(
                    f"actors: {option} is listed more than once; list it once, and for more of them set "
                    f"{' or '.join(f'actors.{name}.count' for name in _groups_of(option))}"
                )
            for name, group in _groups_of(option).items():
                if owners.setdefault(name, option) != option:
                    faults.append(
                        f"actors: {owners[name]} and {option} are both of a group {name}; leave one of them "
                        f"out, and add its group by another name: '+actors.NAME={{body: {_body_name(group)}, "
                        f"count: {group.get('count', 1)}, controller: {_controller_name(group)}}}'"
                    )
    return faults


def _groups_of(option: str) -> dict[str, Mapping[str, Any]]:
    """The groups of an option of actors."""
    composed = OmegaConf.to_container(compose_words(f"actors/{option}"), resolve=True)
    assert isinstance(composed, dict)
    groups = (composed.get("actors") or {}).items()
    return {str(name): group for name, group in groups if isinstance(group, Mapping) and _has_body(group)}


def _body_name(group: Mapping[str, Any]) -> Any:
    body = group["body"]
    return body["name"] if isinstance(body, Mapping) else body


def _controller_name(group: Mapping[str, Any]) -> Any:
    controller = group.get("controller", "external")
    return controller.get("name", controller) if isinstance(controller, Mapping) else controller


def names_options(actors: Any, loader: ConfigLoader) -> bool:
    """Whether `actors`, as set in Python, is a list of names of options, and not of bodies."""
    if not isinstance(actors, list | tuple) or not all(isinstance(each, str) for each in actors):
        return False
    options, bodies = option_names(loader, "actors"), BODIES.names()
    return bool(actors) and (any(each in options for each in actors) or not any(e in bodies for e in actors))
