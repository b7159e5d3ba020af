"""Changes of settings beside the names of the options that they change."""

from pathlib import Path

import pytest

from dune_rl.config.compose import check_sweep, compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.sensors.conf import observed_names

LEARNING = ["+world=flat", "+experiment=multi_agent"]
WEIGHT = "actors.walker.task.rewards.blocking.weight=0.5"


def weights(words: list[str], config_dirs: tuple[str, ...] = ()) -> dict[str, float]:
    task = compose(Conf, words, config_dirs).groups[-1].task
    assert task is not None
    return {name: term.weight for name, term in task.rewards.items()}


@pytest.mark.parametrize("order", [1, -1])
def test_a_weight_changes_the_task_that_is_named_beside_it(order: int) -> None:
    words = ["actors.walker.task=adversarial", WEIGHT][::order]
    expected = weights([*LEARNING, "actors.walker.task=adversarial"])
    assert {"hit_by_robot", "closing_in"} <= expected.keys()
    assert weights([*LEARNING, *words]) == expected | {"blocking": 0.5}


def test_a_weight_changes_the_task_that_the_option_of_actors_names() -> None:
    expected = weights(LEARNING)
    changed = weights([*LEARNING, "actors.walker.task.rewards.near_miss.weight=-2"])
    assert changed == expected | {"near_miss": -2.0}


def test_a_weight_changes_the_task_that_a_file_of_the_user_names(tmp_path: Path) -> None:
    folder = tmp_path / "actors"
    folder.mkdir()
    (folder / "mine.yaml").write_text(
        "defaults: [walkers, _self_]\nwalker: {controller: external, sensors: actor, task: adversarial}\n"
    )
    words = ["+world=flat", "actors=mine"]
    expected = weights(words, (str(tmp_path),))
    assert weights([*words, WEIGHT], (str(tmp_path),)) == expected | {"blocking": 0.5}


def test_a_setting_of_sensors_changes_those_that_are_named_beside_it() -> None:
    words = ["actors.walker.sensors=adversary", "actors.walker.sensors.neighbours.range_m=9"]
    before, after = (compose(Conf, [*LEARNING, *each]).groups[-1].sensors for each in (words[:1], words))
    assert before is not None and after is not None
    assert list(after) == list(before)
    found = after["neighbours"].model_dump()
    assert found == before["neighbours"].model_dump() | {"range_m": 9.0}
    assert found["goals"]


def test_another_body_keeps_nothing_of_the_one_before() -> None:
    words = ["+world=flat", "actors.walker.body=cow"]
    plain, changed = (
        compose(Conf, [*words, *each]).groups[-1].body.model_dump()
        for each in ([], ["actors.walker.body.max_slope_deg=20"])
    )
    assert changed == plain | {"max_slope_deg": 20.0}


def test_a_group_of_agents_may_name_its_body_and_change_it() -> None:
    words = ["+world=flat", "agents={rover: {body: leo_rover}}", "agents.rover.body.looks=figure"]
    with pytest.raises(ConfigError, match=r"agents\.rover\.body\.looks"):
        compose(Conf, words)
    sensors = ["agents.rover.sensors=default", "agents.rover.sensors.lidar.n_beams=64"]
    found = compose(Conf, [*words[:2], *sensors]).groups[0]
    assert found.body.name == "leo_rover" and found.sensors is not None
    assert found.sensors["lidar"].n_beams == 64


@pytest.mark.parametrize("order", [1, -1])
def test_a_behaviour_is_changed_where_it_is_named(order: int) -> None:
    name, reaction = "actors.walker.controller=social_force", "actors.walker.controller.reaction=curious"
    plain, changed = (
        compose(Conf, ["+world=flat", *words]).model_dump()["agents"]["walker"]["controller"]
        for words in ([name], [name, reaction][::order])
    )
    assert plain["name"] == "social_force" and plain["reaction"] != "curious"
    assert changed == plain | {"reaction": "curious"}


def test_a_policy_takes_the_place_of_a_behaviour() -> None:
    words = [
        "+world=flat",
        "actors.walker.controller.checkpoint=FILE",
        "actors.walker.controller.group=walker",
    ]
    controller = compose(Conf, words).model_dump()["agents"]["walker"]["controller"]
    assert controller == {"checkpoint": "FILE", "group": "walker"}


def test_options_are_swept_beside_a_change() -> None:
    words = check_sweep([*LEARNING, "actors.walker.task=adversarial,indifferent", WEIGHT])
    # Hydra hands each value to a job, which composes its own words.
    swept = "actors.walker.task=adversarial,indifferent"
    assert {swept, "++" + WEIGHT} <= set(words)
    jobs = [[word.replace(swept, swept.replace(",indifferent", "")) for word in words]]
    assert weights(jobs[0])["blocking"] == 0.5


def test_settings_in_python_change_the_option_that_the_actors_name() -> None:
    expected = compose_environment("flat", ["actors=learning_walkers"]).groups[-1].task
    change = {"walker": {"task": {"rewards": {"near_miss": {"weight": -2.0}}}}}
    task = compose_environment("flat", ["actors=learning_walkers"], {"actors": change}).groups[-1].task
    assert expected is not None and task is not None
    assert task.rewards.keys() == expected.rewards.keys()
    assert task.rewards["near_miss"].weight == -2.0


@pytest.mark.slow
def test_a_saved_task_is_changed_where_it_is() -> None:
    saved = compose(Conf, [*LEARNING, "actors.walker.task=adversarial"]).model_dump(mode="json")
    task = compose(Conf, [WEIGHT], (), saved).groups[-1].task
    assert task is not None
    assert task.rewards["blocking"].weight == 0.5 and "hit_by_robot" in task.rewards


def test_a_list_of_sensors_is_changed_beside_it() -> None:
    words = ["actors.walker.sensors=[goal,neighbours]", "actors.walker.sensors.neighbours.number=2"]
    sensors = compose(Conf, [*LEARNING, *words]).groups[-1].sensors
    assert sensors is not None and observed_names(sensors) == ["goal", "neighbours"]
    assert sensors["neighbours"].model_dump()["number"] == 2


@pytest.mark.slow(all_but=["words[2-9]*"])
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["actors.walker.task=3", WEIGHT], r"actors\.walker\.task: there is no task '3'; choose"),
        (["actors.walker.task=", WEIGHT], r"actors\.walker\.task: there is no task ''; choose"),
        (["actors.walker.task=[adversarial]", WEIGHT], r"did you mean adversarial\?"),
        (
            ["learning.hidden=[16]", "learning.hidden.foo=2"],
            r"inside of a list.*: learning\.hidden=\[16\] learning\.hidden\.foo=2$",
        ),
        (
            ["actors.walker.task.rewards=[]", WEIGHT],
            r"inside of a list.*: actors\.walker\.task\.rewards=\[\]",
        ),
    ],
)
def test_what_is_no_option_is_told_beside_a_change(words: list[str], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        compose(Conf, [*LEARNING, *words])


def test_a_training_in_which_no_episode_ends_is_refused() -> None:
    foe = "body: person, path: {}, controller: external, sensors: adversary, task: adversarial"
    words = ["+world=flat", f"agents={{foe: {{{foe}}}}}"]
    with pytest.raises(ConfigError, match=r"^agents\.foe\.task\.terminations: no episode ends") as error:
        compose(Conf, words)
    remedy = str(error.value).split("'")[1]
    assert compose(Conf, [*words, remedy]).groups[0].task is not None
