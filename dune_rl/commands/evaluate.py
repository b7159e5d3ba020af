"""`python -m dune_rl.evaluate`: run the episodes, show the tables and write the results folder."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dune_rl.commands import command_line
from dune_rl.config.commands import RAY, EvaluateConf, Processes
from dune_rl.config.compose import override_value
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_writable
from dune_rl.core.paths import unused_folder
from dune_rl.core.suggestions import typed_word
from dune_rl.learning.checkpoint import interpreting, read_policy_file

if TYPE_CHECKING:
    from dune_rl.evaluation.running import EvaluationPlan

_DEFAULT_EPISODES = 100
_DEFAULT_SAMPLE = 16
_SEEDS_SHOWN = 3
_OTHER_LIBRARIES = (".onnx", ".zip")


def run(words: Sequence[str]) -> None:
    """Evaluate, go on with an evaluation, or verify one, as the command line says."""
    parsed = command_line.parse_arguments(words)
    chosen = [
        key for key in ("verify", "resume", "join") if override_value(parsed.overrides, key) is not None
    ]
    if chosen:
        _run_on_folder(parsed, chosen[0])
    elif parsed.cfg:
        command_line.print_settings(_compose(parsed))
    else:
        conf = _compose(parsed)
        if conf.cross_play:
            _cross_play(conf, command_line.config_folders(parsed))
        else:
            _evaluate(conf)


def _run_on_folder(parsed: Namespace, action: str) -> None:
    allowed = (action, {"verify": "sample", "resume": "processes", "join": "out"}[action], "policy")
    others = [word for word in parsed.overrides if word.partition("=")[0] not in allowed]
    if others:
        raise ConfigError(
            f"{action}=FOLDER has the settings of its folder; leave {others[0]} out "
            f"(it takes {allowed[1]}={'FOLDER' if action == 'join' else 'N'})"
        )
    folder = Path(str(override_value(parsed.overrides, action)))
    if not folder.exists():
        raise ConfigError(f"{action}={folder}: there is no such folder")
    given = override_value(parsed.overrides, "policy")
    trusted = [str(each) for each in (given if isinstance(given, list) else [given])]
    if action == "join":
        _join(folder, override_value(parsed.overrides, "out"), trusted)
        return
    number = override_value(parsed.overrides, allowed[1])
    on_ray = action == "resume" and number == RAY
    if number is not None and not on_ray and (not isinstance(number, int) or number < 1):
        raise ConfigError(f"{allowed[1]} must be a whole number of at least 1 (got {number})")
    if action == "verify":
        _verify(folder, _DEFAULT_SAMPLE if number is None else number, trusted)
    else:
        _resume(folder, number, trusted)


def _compose(parsed: Namespace) -> EvaluateConf:
    """The settings, with those that an episode set determines, and the number of episodes."""
    from dune_rl.config.checks import validate
    from dune_rl.evaluation.episode_sets.apply import compose_on_set
    from dune_rl.evaluation.protocols.settings import check_protocol_overrides, settings_of_protocol

    overrides = parsed.overrides
    protocol = override_value(overrides, "protocol")
    if protocol is not None:
        check_protocol_overrides(str(protocol), overrides)
    saved, folders = _saved_settings(overrides), command_line.config_folders(parsed)
    conf, episode_set = compose_on_set(EvaluateConf, overrides, folders, saved)
    if conf.protocol is not None:
        return settings_of_protocol(conf)
    episodes = conf.episodes
    if episode_set is not None:
        number = episode_set.header.episodes
        if episodes is not None and episodes > number:
            raise ConfigError(f"set={conf.set} has {number} episodes, fewer than episodes={episodes}")
        episodes = number if episodes is None else episodes
    data = {**conf.model_dump(mode="json"), "episodes": episodes or _DEFAULT_EPISODES}
    return validate(EvaluateConf, data)


def _saved_settings(overrides: Sequence[str]) -> Mapping[str, Any] | None:
    """The settings of the run of the first checkpoint; None without one."""
    given = override_value(overrides, "checkpoint")
    checkpoints = given if isinstance(given, list) else [] if given is None else [given]
    for each in checkpoints:
        if str(each).endswith(_OTHER_LIBRARIES):
            raise ConfigError(
                f"checkpoint={each} is a file of another library; write {typed_word('policy', each)}"
            )
    if not checkpoints:
        return None
    file, content = read_policy_file(Path(str(checkpoints[0])))
    saved: Mapping[str, Any] = content["config"]
    with interpreting(file):
        evaluation = (saved.get("learning") or {}).get("evaluation") or {}
        if seeds := evaluation.get("world_seeds"):
            # The worlds that the run kept for evaluations, unless others are asked for.
            drawn = {"name": "integers", "low": seeds[0], "high": seeds[1]}
            saved = {**saved, "randomisation": {**(saved.get("randomisation") or {}), "world_seed": drawn}}
    return saved


def _evaluate(conf: EvaluateConf) -> None:
    # Only now, since loading PyTorch and the physics engine takes seconds.
    from dune_rl.evaluation.datasets.writing import plan_with_dataset
    from dune_rl.evaluation.folder import ResultsFolder, check_free_for_results
    from dune_rl.evaluation.provenance import describe_provenance
    from dune_rl.evaluation.run_plan import prepare_run, run_plan
    from dune_rl.evaluation.running import EvaluationPlan
    from dune_rl.ros.bag import check_bags

    plan = EvaluationPlan.of_settings(conf)
    out = Path(conf.out) if conf.out else default_folder(plan)
    check_writable(out)
    check_free_for_results(out, overwrite=conf.overwrite)
    plan = plan_with_dataset(plan, out)
    if conf.bag is not None:
        if Path(conf.bag).resolve().is_relative_to(out.resolve()):
            raise ConfigError(
                f"bag={conf.bag} lies in out={out}, which holds results alone; choose another folder"
            )
        names = [source.name for source in plan.sources]
        check_bags(Path(conf.bag), names, plan.part_of(conf), plan.scenes, overwrite=conf.overwrite)
    # Before the folder is made: a policy that does not fit leaves nothing behind.
    prepared = prepare_run(plan)
    console = command_line.make_console()
    command_line.print_world_notes(console, conf, fixes_starts=conf.set is not None)
    provenance = describe_provenance(plan)
    _note_sites_of_training(conf, provenance)
    _note_other_rates(plan)
    with ResultsFolder.create(out, conf, provenance, overwrite=conf.overwrite) as folder:
        run_plan(plan, folder, prepared, console, conf.processes)


def _note_sites_of_training(conf: EvaluateConf, provenance: Mapping[str, Any]) -> None:
    for policy in provenance["policies"]:
        seeds = policy["sites_of_training"]
        if seeds:
            more = f" and {len(seeds) - _SEEDS_SHOWN} others" if len(seeds) > _SEEDS_SHOWN else ""
            command_line.print_error(
                f"note: {policy['name']} was trained on sites of {conf.set} "
                f"(world.seed {', '.join(map(str, seeds[:_SEEDS_SHOWN]))}{more}): its results there are not "
                "those of unseen sites"
            )


def _note_other_rates(plan: "EvaluationPlan") -> None:
    """Say which policies decide more or less often here than they learned to."""
    now = plan.conf.physics.action_repeat
    for source in plan.sources:
        then = None if source.file is None else _trained_repeat(source.file)
        if then not in (None, now):
            command_line.print_error(
                f"note: {source.name} was trained with physics.action_repeat={then}, and decides here with "
                f"{now}"
            )


def _trained_repeat(path: Path) -> int | None:
    """How many control steps an action was held when the policy of a file was trained; None if unknown."""
    if path.suffix == ".onnx":
        from dune_rl.learning.onnx_policy import OnnxPolicy

        described = OnnxPolicy(path).description
        try:
            return round(described["decision_s"] / described["control_step_s"])
        except (KeyError, TypeError, ArithmeticError):
            return None
    file, content = read_policy_file(path)
    with interpreting(file):
        repeat: int = (content["config"].get("physics") or {}).get("action_repeat", 1)
    return repeat


def _cross_play(conf: EvaluateConf, config_dirs: Sequence[str]) -> None:
    from dune_rl.evaluation.actor_populations import find_populations
    from dune_rl.evaluation.cross_play import begin_cross_play, run_cross_play
    from dune_rl.evaluation.running import EvaluationPlan

    populations = find_populations(conf, config_dirs)
    out = Path(conf.out) if conf.out else default_folder(EvaluationPlan.of_settings(conf))
    check_writable(out)
    begin_cross_play(conf, populations, out, overwrite=conf.overwrite)
    run_cross_play(out, command_line.make_console(), trusted=(*conf.policy, *conf.against))


def _resume(path: Path, processes: Processes | None, trusted: Sequence[str]) -> None:
    from dune_rl.evaluation.cross_play import is_cross_play, run_cross_play

    if is_cross_play(path):
        run_cross_play(path, command_line.make_console(), processes, trusted)
        return
    from dune_rl.config.checks import validate
    from dune_rl.evaluation.datasets.writing import plan_with_dataset
    from dune_rl.evaluation.folder import ResultsFolder, read_provenance, read_settings
    from dune_rl.evaluation.provenance import check_same_sources
    from dune_rl.evaluation.run_plan import prepare_run, run_plan
    from dune_rl.evaluation.running import EvaluationPlan

    provenance = read_provenance(path)
    if provenance.get("complete"):
        # As a job that is requeued after its end asks for.
        print(f"{path} is a complete evaluation: there is nothing to do")
        return
    conf = read_settings(path)
    if processes is not None:
        # As they are checked when they are given at once.
        conf = validate(EvaluateConf, {**conf.model_dump(mode="json"), "processes": processes})
    plan = EvaluationPlan.of_settings(conf)
    check_same_sources(plan, provenance, path, trusted)
    plan = plan_with_dataset(plan, path)
    prepared = prepare_run(plan)
    with ResultsFolder.reopen(path) as folder:
        run_plan(plan, folder, prepared, command_line.make_console(), conf.processes)


def _join(path: Path, out: object, trusted: Sequence[str]) -> None:
    from dune_rl.evaluation.parts import join_parts

    joined = Path(str(out)) if out else path.with_name(f"{path.resolve().name}_joined")
    check_writable(joined)
    join_parts(path, joined, command_line.make_console(), trusted)


def _verify(path: Path, sample: int, trusted: Sequence[str]) -> None:
    from dune_rl.evaluation.folder import read_provenance, read_settings
    from dune_rl.evaluation.provenance import check_same_sources
    from dune_rl.evaluation.running import EvaluationPlan
    from dune_rl.evaluation.verify import verify_folder

    provenance = read_provenance(path)
    # Bags are not written again.
    plan = EvaluationPlan.of_settings(read_settings(path).model_copy(update={"bag": None}))
    check_same_sources(plan, provenance, path, trusted)
    verify_folder(path, plan, sample, command_line.make_console())


def default_folder(plan: "EvaluationPlan") -> Path:
    """A folder that no other evaluation has: evaluations/<date>_<policy>_<set or world>."""
    cases = plan.conf.world.name if plan.episode_set is None else plan.episode_set.name
    protocol = [] if plan.conf.protocol is None else [plan.conf.protocol]
    return unused_folder(Path("evaluations"), datetime.now(), [plan.sources[0].name, cases, *protocol])
