"""The generated reference of settings: complete, and of the schema and conf/*.yaml."""

import re
from collections.abc import Iterator

import generated_pages
import pytest
from conf_comments import option_summary, read_comments
from documents import DOCS
from page_sources import expand_page
from pydantic import Field
from realism_tables import faults_table
from settings_tables import Section, Setting, as_code, read_section, render_section

from dune_rl.config.commands import BenchmarkConf, EvaluateConf, ViewConf
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core import paths
from dune_rl.core.settings import Settings
from dune_rl.sensors.settings import SensorSettings


def all_sections() -> Iterator[Section]:
    for command in (*generated_pages.COMMANDS, "engines", "report", "trajectory"):
        yield generated_pages.command_settings(command)
    for name in generated_pages.SECTIONS:
        yield generated_pages.section_settings(name)
    for kind in generated_pages.KINDS:
        yield generated_pages.part_settings(kind)
    for name in generated_pages.ALGORITHMS:
        yield generated_pages.algorithm_settings(name)
    yield generated_pages.common_learning_settings()
    yield generated_pages.sensor_settings()
    yield generated_pages.environment_settings()
    yield generated_pages.group_settings()
    yield generated_pages.spawn_settings()
    yield generated_pages.metrics_settings()


# Of settings that several algorithms have, those of the first.
SETTINGS = {
    setting.path: setting for section in reversed(list(all_sections())) for setting in section.all_settings()
}


class InnerConf(Settings):
    """An inner section.

    With a second paragraph.
    """

    share: float = Field(0.5, gt=0.0, le=1.0)


class OuterConf(Settings):
    """A class for these tests."""

    count: int = Field(ge=1, description="how many")
    pair: tuple[float, float] = (0.0, 1.0)
    inner: InnerConf = InnerConf(share=0.25)
    other: InnerConf | None = None


def test_rows_have_type_range_default_and_meaning() -> None:
    section = read_section(OuterConf, "outer", {"inner.share": "how much"})
    rows = {setting.path: setting for setting in section.all_settings()}
    assert rows["outer.count"] == Setting("outer.count", "*required*", "whole number ≥ 1", "how many")
    assert rows["outer.pair"].allowed == "2 of: number"
    # The default is that of the section, not of its class.
    assert rows["outer.inner.share"] == Setting("outer.inner.share", "`0.25`", "number > 0, ≤ 1", "how much")
    assert rows["outer.other"].allowed == "section, or `null`"
    text = render_section(section, 2)
    assert "## `outer.inner`\n\nAn inner section.\n\n| setting |" in text
    assert as_code("{a: 1} | b <c>") == "`{a: 1}` \\| b \\<c>"
    assert as_code("`a | b` * c") == "`a \\| b` \\* c"


def test_every_setting_says_what_it_means() -> None:
    assert [path for path, setting in SETTINGS.items() if not setting.meaning] == []
    for name in ("every", "channel", "lidar", "camera", "imu"):
        assert "|  |" not in faults_table(name)


def test_every_option_says_what_it_is() -> None:
    for file in sorted(paths.conf_folder().glob("*/*.yaml")):
        assert len(option_summary(file)) > 5, file


def leaves(value: object, path: str = "") -> Iterator[str]:
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from leaves(inner, f"{path}.{key}" if path else key)
    else:
        yield path


@pytest.mark.parametrize("model", [Conf, ViewConf, EvaluateConf, BenchmarkConf])
def test_every_setting_of_a_command_is_in_the_reference(model: type[Settings]) -> None:
    environment = compose(Conf, ["+world=flat"]).model_dump(mode="json")
    own = set(model.model_fields) - set(environment)
    tagged = {"world": "world=flat", "robot": "robot=rover_zero"}
    environment["robot"] = environment["agents"].pop("rover")["body"]
    shown = set(SETTINGS)
    for name in sorted(own):
        assert name in shown, name
    for path in leaves(environment):
        section, _, rest = path.partition(".")
        # Chosen by the option's name; terms and groups have headings of their own.
        if rest in ("name", "") or path.startswith(("metrics.terms", "agents", "task.")):
            continue
        if section == "sensors" and path.rpartition(".")[2] in SensorSettings.model_fields:
            continue
        assert f"{tagged.get(section, section)}.{rest}" in shown, path


def test_comments_stand_behind_settings_and_above_sections() -> None:
    comments = read_comments("robot/rover_zero")
    assert comments["heading.kp"] == "proportional gain [1/s]"
    assert comments["mounts"].startswith("default positions of sensors: ")
    assert "battery.idle_w" in comments and "drive" not in comments


def test_the_defaults_are_those_of_the_files() -> None:
    assert (
        SETTINGS["learning.batch_size"].default
        == f"`{compose(Conf, ['+world=flat']).learning.model_dump()['batch_size']}`"
    )
    assert SETTINGS["sensors.lidar.range_m"].default == "`12.0`"


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: str(page.relative_to(DOCS)))
def test_pages_expand(page: object) -> None:
    assert isinstance(page, type(DOCS))
    text = expand_page(page.read_text(), page, {}, generated_pages.generated_part)
    assert "<!-- generated" not in text and "<!-- include" not in text
    for table in re.findall(r"^(?:\|.*\n)+", text, flags=re.MULTILINE):
        cells = {len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}
        assert len(cells) == 1, table[:300]


def test_an_unknown_part_is_an_error() -> None:
    with pytest.raises(KeyError):
        generated_pages.generated_part("nothing", 2)
