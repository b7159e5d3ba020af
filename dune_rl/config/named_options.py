"""Options that a group names and changes, as in `actors.walker.task=adversarial` with one of its weights."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from dune_rl.config.hydra_session import compose_config
from dune_rl.config.overrides import ParsedOverrides, sweep_values

# What a group of agents names an option for, or has settings of.
_SECTIONS = ("body", "controller", "sensors", "task", "metrics")
# A controller with one of these is a policy or files, which have no name.
_NAMELESS = ("checkpoint", "group", "trajectory")
_SECTION = re.compile(rf"((?:agents|actors)\.[^.]+\.(?:{'|'.join(_SECTIONS)}))(\..+)?")
_OF_NO_OPTION = re.compile(rf".+\.controller\.(?:{'|'.join(_NAMELESS)})(\..+)?")


def keep_named_options(name: str, request: ParsedOverrides) -> ParsedOverrides:
    """The overrides, in which a change of a setting does not take the place of the option's name.

    To Hydra an option's name is a text, which a setting below it would replace. Where both are given, in
    any order, or the text stands in the file `name` or what it includes, the name becomes the setting `name`
    beside the changes: `actors.walker.task={name: adversarial, rewards: ...}`.
    """
    changed = {match[1] for each in request.values if (match := _match(each)) and match[2]}
    if not changed:
        return request
    chosen = {str(each.key_or_group): each for each in request.values if _names_option(each)}
    rest = [each for each in request.values if str(each.key_or_group) not in changed & chosen.keys()]
    words: list[str] = []
    if unchosen := sorted(changed - chosen.keys()):
        config = compose_config(name, replace(request, values=tuple(_not_below(rest, changed))))
        for section in unchosen:
            if isinstance(option := OmegaConf.select(config, section), str):
                words.append(f"++{section}={_as_settings(section, option)}")
    for section in sorted(changed & chosen.keys()):
        options = ",".join(_as_settings(section, each.value()) for each in sweep_values(chosen[section]))
        # What else the section had belongs to another option.
        words += [f"++{section}=null", f"++{section}={options}"]
    parser = OverridesParser.create()
    named = [parser.parse_override(word) for word in words]
    others = _not_below(rest, changed)
    below = [each for each in rest if each not in others]
    return replace(request, values=(*others, *named, *below))


def name_options(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`changes` of settings, in which what is changed of an option that `data` names has its name."""
    out = dict(changes)
    for place in ("agents", "actors"):
        groups, changed = data.get(place), changes.get(place)
        if isinstance(groups, Mapping) and isinstance(changed, Mapping):
            out[place] = {group: _named(groups.get(group), settings) for group, settings in changed.items()}
    return out


def _named(before: Any, settings: Any) -> Any:
    if not (isinstance(before, Mapping) and isinstance(settings, Mapping)):
        return settings
    out = dict(settings)
    for section in _SECTIONS:
        option, value = before.get(section), settings.get(section)
        if isinstance(option, str) and isinstance(value, Mapping) and value.keys().isdisjoint(_NAMELESS):
            out[section] = {"name": option, **value}
    return out


def _match(override: Override) -> re.Match[str] | None:
    key = str(override.key_or_group)
    return None if override.is_delete() or _OF_NO_OPTION.fullmatch(key) else _SECTION.fullmatch(key)


def _names_option(override: Override) -> bool:
    """Whether an override names an option, or lists the sensors that are enabled."""
    match = _match(override)
    if match is None or match[2]:
        return False
    return all(not isinstance(each.value(), dict | None) for each in sweep_values(override))


def _as_settings(section: str, value: Any) -> str:
    """An option, or a list of sensors, as settings in Hydra's form."""
    if isinstance(value, list) and section.endswith(".sensors"):
        return f"{{enabled: [{','.join(map(str, value))}]}}"
    name = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'{{name: "{name}"}}'


def _not_below(values: list[Override], sections: set[str]) -> list[Override]:
    return [each for each in values if not ((match := _match(each)) and match[2] and match[1] in sections)]
