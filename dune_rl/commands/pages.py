"""The `--help` of every command, which is shown without loading what the command itself needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dune_rl.core import plugins
from dune_rl.core.paths import conf_folder

HelpRows = Sequence[tuple[str, str]]

# The groups of options (folders of conf/) to which installed packages add, and the entry points that do.
_ENTRY_POINTS: Mapping[str, str] = {
    "world": "dune_rl.worlds",
    "robot": "dune_rl.robots",
    "learning": "dune_rl.algorithms",
}
# Blanks on both sides of two columns.
_MARGINS = 8


@dataclass(frozen=True)
class HelpPage:
    """The text of `--help`: what the command does, how it is called, what can be set, and a closing note.

    With `options`, the groups of options of an environment are listed, too, and if the command `learns`,
    those of `learning`.
    """

    title: str
    usage: HelpRows
    settings: HelpRows
    closing: str
    options: bool = True
    learns: bool = False


def option_group_rows() -> list[tuple[str, str]]:
    """A row of help for each group of options, the world first; parts of installed packages among them."""
    rows = []
    for folder in sorted(path for path in conf_folder().iterdir() if path.is_dir()):
        if folder.name == "experiment":
            continue
        options = {path.stem for path in folder.glob("*.yaml")}
        if folder.name in _ENTRY_POINTS:
            options |= set(plugins.entry_points_by_name(_ENTRY_POINTS[folder.name]))
        name = "+world=NAME" if folder.name == "world" else f"{folder.name}=NAME"
        rows.append((name, ", ".join(sorted(options))))
    return sorted(rows, key=lambda row: not row[0].startswith("+"))


def _rows_of_groups(page: HelpPage) -> list[tuple[str, str]]:
    return [row for row in option_group_rows() if page.learns or row[0] != "learning=NAME"]


def show_help(page: HelpPage) -> None:
    """Print the page on standard output."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    console.print(f"[bold]{page.title}[/bold]")
    for lines in (page.usage, [*(_rows_of_groups(page) if page.options else ()), *page.settings]):
        names, meanings = (max(map(len, column)) for column in zip(*lines, strict=True))
        if lines is page.usage and names + meanings + _MARGINS > console.width:
            # Beside commands, meanings would be columns of single words.
            console.print()
            for name, meaning in lines:
                console.print(f"  [cyan]{escape(name)}[/cyan]\n      {escape(meaning)}")
            continue
        table = Table(box=None, show_header=False, padding=(0, 2))
        table.add_column(style="cyan", no_wrap=True, min_width=names)
        table.add_column()
        for name, meaning in lines:
            table.add_row(escape(name), escape(meaning))
        console.print()
        console.print(table)
    console.print(f"\n{page.closing}", markup=False)


PAGES: Mapping[str, HelpPage] = {
    "train": HelpPage(
        "Train a rover to drive to goals off the road.",
        (
            ("python -m dune_rl.train +world=inspection", "train; settings follow"),
            ("python -m dune_rl.train +experiment=quick", "a taste: some minutes"),
            ("python -m dune_rl.train resume=runs/NAME", "go on with a run"),
            (
                "python -m dune_rl.train +world=flat run_dir=runs/NAME resume=auto",
                "begin it, or go on with it",
            ),
            ("python -m dune_rl.train -m +world=flat seed=1,2", "a sweep: a folder a job"),
        ),
        (
            ("+experiment=NAME", "a study's settings in one word"),
            ("seed=N", "of everything drawn at random"),
            ("total_frames=N", "control steps in all"),
            ("device=cpu|cuda", "of the learner"),
            ("run_dir=FOLDER", "folder of the run"),
            ("task.terminations.time_limit.max_steps=N", "length of an episode"),
            ("learning.collector.workers=N", "processes that step environments"),
            ("learning.collector.scenes=N", "scenes in each process"),
            ("learning.batch_size=N", "transitions in an update"),
        ),
        (
            "conf/ holds every setting with its meaning and unit. To see what a command would\n"
            "use, add --cfg job. Own options go in a folder of the same shape as conf/:\n"
            "--config-dir FOLDER. docs/ has the rest."
        ),
        learns=True,
    ),
    "evaluate": HelpPage(
        "Measure a policy on numbered episodes.",
        (
            ("python -m dune_rl.evaluate checkpoint=runs/NAME set=inspection-v1", "on an episode set"),
            ("python -m dune_rl.evaluate checkpoint=runs/NAME", "on the world of its run"),
            ("python -m dune_rl.evaluate policy=random +world=flat", "a built-in policy"),
            ("python -m dune_rl.evaluate checkpoint=[A,B] against=go_to_goal", "several, in pairs"),
            ("python -m dune_rl.evaluate resume=FOLDER", "go on where one was cut off"),
            ("python -m dune_rl.evaluate join=FOLDER", "join the parts (part=1/16) in a folder"),
            ("python -m dune_rl.evaluate verify=FOLDER", "repeat a sample of its rows"),
        ),
        (
            ("checkpoint=PATH", "a run's folder, or a file of weights; [A,B] are several"),
            ("policy=NAME", "a built-in one (go_to_goal, planner, dwa, ...), FILE.onnx or MODULE:FUNCTION"),
            ("against=NAME", "likewise, to compare with in pairs"),
            ("set=NAME", "an episode set: python -m dune_rl.episode_sets list"),
            ("episodes=N", "how many to run"),
            ("protocol=NAME", "paper or dune_code: runs of 10 minutes, as the paper's"),
            ("runs=N", "with a protocol: how many; run_steps=N, of how many steps each"),
            ("cross_play=true", "each policy among each of populations=[NAME,RUN] of actors"),
            ("seed=N", "of the episodes"),
            ("scenes=N", "episodes side by side in each process"),
            (
                "processes=N",
                "processes that share them; no result depends on it; ray: those of a Ray cluster",
            ),
            ("steps=true", "a row for each step too; steps=N for each N-th"),
            ("actor_steps=true", "with steps: rows of walkers too"),
            ("dataset=NAME-v0", "also a Minari dataset of all transitions, for offline learning"),
            ("bag=FOLDER", "a ROS 2 bag of each episode, as standard messages; needs dune_rl[ros]"),
            ("out=FOLDER", "of the results; overwrite=true replaces what is there"),
            ("sample=N", "with verify: how many episodes to repeat"),
        ),
        (
            "A checkpoint brings the settings of its run; what you write changes them. Equal\n"
            "seeds and settings give every policy the same episodes, so that results pair."
        ),
    ),
    "drive": HelpPage(
        "Let a trained policy drive a robot over live topics of ROS 2, or play a bag into it.",
        (
            ("python -m dune_rl.drive checkpoint=runs/NAME", "drive by /cmd_vel, until Ctrl-C"),
            ("python -m dune_rl.drive policy=policy.onnx dry_run=true", "print commands, and send none"),
            (
                "python -m dune_rl.drive checkpoint=runs/NAME topics.lidar=/front/scan",
                "a scan of another name",
            ),
            ("python -m dune_rl.drive bag=FOLDER checkpoint=runs/NAME", "its actions for a bag, as CSV"),
        ),
        (
            ("checkpoint=PATH", "a run's folder, or a file of weights"),
            ("policy=FILE.onnx", "in its place, a file of python -m dune_rl.export"),
            (
                "topics.READING=TOPIC",
                "of a part of the observation, where it is not the default in docs/how_to/ros.md",
            ),
            ("robot=NAME", "whose topics, where there are those of several, such as rover_0"),
            ("base=FRAME", "frame of the robot's body; else base_link"),
            ("period_s=S", "between two actions; else that of the bag or of the policy's run"),
            ("max_age_s=S", "live: age of a message or a pose at which the robot stops; 0.5"),
            ("wait_s=S", "live: how long it waits for topics at the start; 10"),
            ("max_speed_mps=V", "live: limit; likewise max_yaw_rate_radps and max_acceleration_mps2"),
            ("dry_run=true", "live: prints commands, and sends none"),
            ("once=true", "live: ends at the first goal; duration_s=S after that time"),
            ("stamped=true", "live: /cmd_vel is a TwistStamped"),
            ("sim_time=false", "live: this machine's time, also where there is a /clock"),
            ("domain=N", "live: of DDS; else ROS_DOMAIN_ID, or 0"),
            ("network=NAME", "live: localhost, any, or an interface; peers=[HOST,...] without multicast"),
            ("bag=FOLDER", "a rosbag2 folder (MCAP or SQLite)"),
            ("out=FILE.csv", "of a bag's actions; else they are printed; overwrite=true replaces it"),
        ),
        "ROS is not needed; rosbags and, for live topics, Cyclone DDS are: pip install 'dune_rl[ros]'.",
        options=False,
    ),
    "forecast": HelpPage(
        "Learn where the agents will be that a robot tracks.",
        (
            ("python -m dune_rl.forecast +world=mixed actors.walker.count=8", "among eight walkers"),
            ("python -m dune_rl.forecast +world=inspection robot=leo_rover", "of another robot"),
        ),
        (
            ("policy=NAME", "the driver: dwa, planner, go_to_goal, ..."),
            ("episodes=N", "that it drives"),
            ("scenes=N", "episodes side by side"),
            ("seed=N", "of the episodes and of the fit"),
            ("updates=N", "of the fit"),
            ("held_out=F", "share of the episodes, the last ones, on which errors are measured"),
            ("out=FOLDER", "of the forecast; else forecasts/DATE_WORLD"),
        ),
        (
            "To use it, give sensors.agent_tracks.forecast=FOLDER to train, evaluate\n"
            "and view. sensors.agent_tracks.forecast=persons is that of the package."
        ),
    ),
    "report": HelpPage(
        "Make a report of training runs, evaluations and sweeps: a page, figures and tables.",
        (
            ("python -m dune_rl.report runs/A evaluations/B", "of these folders"),
            ("python -m dune_rl.report evaluations", "of all folders in it"),
            ("python -m dune_rl.report runs/sweep_NAME", "of a sweep"),
            ("python -m dune_rl.report into=README.md", "the tables that a Markdown file asks for"),
        ),
        (
            ("out=FOLDER", "of the report; else reports/DATE_NAMES"),
            ("overwrite=true", "replaces the report that is there"),
            ("title=TEXT", "of the page"),
            ("failures=N", "episodes at most that are run again for pictures of how they failed; 0: none"),
            ("into=FILE.md", "the file whose tables are written anew, in place of a report"),
        ),
        "The page is one file that needs no network. What cannot be used is named there, and left out.",
        options=False,
    ),
    "episode_sets": HelpPage(
        "List, check and make episode sets.",
        (
            ("python -m dune_rl.episode_sets list", "the sets of the package, with their checksums"),
            ("python -m dune_rl.episode_sets check NAME", "start every episode, and report what is not free"),
            ("python -m dune_rl.episode_sets make", "the package's sets again; builds all their sites"),
            ("python -m dune_rl.episode_sets make mine-v1 +world=NAME --episodes 50", "a set of your own"),
            (
                "python -m dune_rl.episode_sets make barn +world=sdf 'world.path=DIR/*.world'",
                "an episode in each file; 'start=[x,y,degrees]' 'goal=[x,y]': all from there to there",
            ),
        ),
        (
            ("--out FOLDER", "of make: the folder to write to; else episode_sets"),
            (
                "--episodes N",
                "of a set of your own, likewise below: how many; else 100, or one for each file",
            ),
            ("--sites N", "of a generated world; else 1, its world.seed"),
            ("--farthest M", "largest distance of a goal from its start [m]"),
            ("--seed N", "of all that episodes draw; else 0"),
        ),
        "check takes names or paths of sets, none for all of the package, and settings of the\n"
        "robot, such as robot=leo_rover.",
    ),
    "view": HelpPage(
        "Render a world, its agents and their sensors.",
        (
            ("python -m dune_rl.view +world=inspection", "a contact sheet and a video"),
            ("python -m dune_rl.view +world=inspection view=orbit", "the world from above"),
            ("python -m dune_rl.view +world=inspection view=map", "its map"),
            ("python -m dune_rl.view checkpoint=runs/NAME view=video", "a video of a trained policy"),
            ("python -m dune_rl.view checkpoint=runs/NAME view=map", "its tracks on the map"),
            ("python -m dune_rl.view checkpoint=runs/NAME view=map set=NAME episode=N", "an evaluated one"),
            ("python -m dune_rl.view checkpoint=runs/NAME view=live", "a page to watch and drive in"),
        ),
        (
            ("view=NAME", "sheet, video, both, orbit, map, live, html or gltf"),
            ("checkpoint=PATH", "folder of a run, or file of weights, of the policy"),
            ("policy=NAME", "a built-in one (go_to_goal, planner, dwa, ...) instead of a checkpoint"),
            ("agent=NAME", "agent to follow, such as rover_1; default: the first"),
            ("seed=N", "seed of the episode"),
            ("set=NAME episode=N", "an episode of a set, by its number there"),
            ("longest_s=S", "largest length of the video, of html and of gltf"),
            ("width=N height=N", "size of the video"),
            ("episodes=N", "number of episodes on the map"),
            ("port=N host=HOST", "of view=live: its address; else 8080 of this machine alone"),
            ("out=FOLDER", "folder of the files"),
        ),
        "No display and no GPU are needed: the processor renders the pictures. live and html need\n"
        "pip install 'dune_rl[live]', and live a browser.",
    ),
    "ros": HelpPage(
        "Run a scene on live topics of ROS 2, without ROS: sensors go out, /cmd_vel and goals come in.",
        (
            ("python -m dune_rl.ros +world=inspection", "in real time, for programs on this machine"),
            ("python -m dune_rl.ros checkpoint=runs/NAME speed=5", "with the sensors of a run, faster"),
            ("python -m dune_rl.ros +world=flat network=any domain=7", "for other machines, too"),
        ),
        (
            ("checkpoint=PATH", "a run's folder, or a file of weights, whose settings are used"),
            ("seed=N episode=N", "of the first episode"),
            ("speed=F", "of the clock, in multiples of real time; 0: as fast as it goes"),
            ("on_end=NAME", "when an episode is over: stay, or reset to the next start"),
            ("command_timeout_s=S", "age of the last command at which a robot stops"),
            ("stamped=true", "/cmd_vel is a TwistStamped"),
            ("duration_s=S", "ends after that time of the simulation"),
            ("domain=N", "of DDS; else ROS_DOMAIN_ID, or 0"),
            ("network=NAME", "localhost, any, or an interface's name or address"),
            ("peers=[HOST,...]", "machines that are found without multicast"),
        ),
        (
            "docs/how_to/ros.md has the topics, and how to let a machine with ROS 2 in. A message on\n"
            "/reset (std_msgs/Empty) begins the next episode. Needs pip install 'dune_rl[ros]'."
        ),
    ),
    "trajectory": HelpPage(
        "Plan the trajectory of an actor through way-points on a world's ground, and write it to a file.",
        (
            ('python -m dune_rl.trajectory world=NAME waypoints="[[0,0],[4,2]]" out=actor.sdf', "for Gazebo"),
            (
                'python -m dune_rl.trajectory world=FILE.dae waypoints="[[0,0],[4,2]]" out=actor.csv',
                "of a file",
            ),
        ),
        (
            (
                "world=NAME",
                "an option, with its settings world.SETTING=VALUE; or a file (SDF, mesh, map of heights)",
            ),
            ("waypoints=[[X,Y],...]", "two or more [m]; a cubic spline leads through them"),
            ("out=FILE", "an SDF <actor> (.sdf), .csv or .json"),
            ("velocity=V", "along the ground [m/s]; else 1"),
            ("mode=MODE", "back_and_forth (default), loop (a closed way) or once"),
            ("pauses_s=S", "at every way-point, or [S,S,...] at each [s]"),
            ("delay_s=S", "before the start of each round [s]"),
            ("spacing_m=M", "between the poses [m]; else 0.05"),
            ("radius_m=M", "the least distance from obstacles [m]; else 0.25"),
            ("max_slope_deg=A", "the steepest ground [degrees]; else 35"),
            ("max_water_m=M", "the deepest water [m]; else 0"),
            ("name=NAME", "of the actor; else walker"),
            ("skin=FILE", "of an SDF: the mesh that Gazebo draws; else its walking actor"),
            ("animation=FILE", "likewise the motion; else the skin's"),
            ("origin_height_m=M", "likewise of the mesh's origin above its feet [m]"),
            ("picture=FILE.png", "of the way on the map; else beside out"),
            ("overwrite=true", "replaces the files that are there"),
        ),
        "Way-points and stretches between them that cannot be walked are named, and nothing is written.",
        options=False,
    ),
    "export": HelpPage(
        "Write a trained policy as an ONNX file, or a world, its actors and robots for Gazebo.",
        (
            (
                "python -m dune_rl.export checkpoint=runs/NAME out=policy.onnx",
                "the best policy of a run, compared with the file",
            ),
            ("python -m dune_rl.export world=inspection out=FOLDER", "a world and its actors as SDF"),
            (
                "python -m dune_rl.export world=inspection robot=rover_zero out=FOLDER",
                "with the robot where an episode starts",
            ),
            ("python -m dune_rl.export robot=leo_rover out=FOLDER", "a robot alone, as SDF and URDF"),
        ),
        (
            ("checkpoint=PATH", "a run's folder, or a policy or checkpoint file; needs dune_rl[export]"),
            ("group=NAME", "of a policy: whose, where there are several"),
            ("seed=N", "of a world: of the episode whose start and actors are written"),
            ("duration_s=S", "of a world: how long its actors are followed; else 60"),
            ("out=PATH", "the file (.onnx), or the folder"),
            ("overwrite=true", "replaces the file or the export that is there"),
        ),
        "A policy takes none but these settings, and drives by python -m dune_rl.evaluate policy=FILE.onnx.\n"
        "More on Gazebo in docs/how_to/gazebo.md.",
    ),
    "benchmark": HelpPage(
        "Measure the cost of a step; JSON lines.",
        (
            ("python -m dune_rl.benchmark", "inspection, two walkers"),
            ("python -m dune_rl.benchmark world=flat actors=none", "another environment"),
            ("python -m dune_rl.benchmark parts=[groups]", "four robots against one"),
        ),
        (
            ("scenes=N", "scenes stepped as one batch"),
            ("rounds=N", "rounds in which everything compared takes its turn"),
            ("steps=N", "control steps of every scene in a turn"),
            (
                "parts=[environment]",
                "environment, cameras, sensors, terrain, new_world, world_memory, groups, actors, processes, "
                "engines, learning, sizes",
            ),
            ("worlds=N", "new worlds that the part world_memory enters"),
            ("processes=[1,2]", "numbers of processes at once, one after the other"),
        ),
        "Ratios compare times of one run, so they hold on a busy machine, too.",
    ),
    "engines": HelpPage(
        "Compare the physics engines; Markdown tables.",
        (
            ("python -m dune_rl.engines", "equal commands in both, then minutes of random driving"),
            ("python -m dune_rl.engines parts=[stability] minutes=1", "one part, shorter"),
        ),
        (
            ("parts=[agreement]", "agreement, stability"),
            ("engines=[bullet,dart]", "engines of the part stability"),
            ("robots=[rover_zero]", "options of robot"),
            (
                "places=[flat,slope,inspection]",
                "worlds of the part agreement; slope is a plane of 15 degrees",
            ),
            ("worlds=[flat]", "worlds of the part stability"),
            ("minutes=N", "simulated time in each world, over all scenes"),
            ("scenes=N", "scenes stepped together"),
            ("seed=N", "seed of starts and random commands"),
        ),
        "Equal settings give equal tables.",
    ),
    "robots": HelpPage(
        "Check a URDF: print the robot's derived values, or what is wrong.",
        (
            ("python -m dune_rl.robots FILE.urdf", "with the defaults"),
            ("python -m dune_rl.robots FILE.urdf robot.drive.kind=skid_steer", "with settings"),
        ),
        (("robot.SETTING=VALUE", "a setting of conf/robot/urdf.yaml; robot. may be left out"),),
        "More in docs/how_to/bring_a_robot.md.",
        options=False,
    ),
    "doctor": HelpPage(
        "Check a machine: what is missing, whether it computes what others do, and how fast.",
        (
            ("python -m dune_rl.doctor", "check this machine"),
            ("python -m dune_rl.doctor out=here.json", "also write what it computes to a file"),
            ("python -m dune_rl.doctor reference=here.json", "on another machine: compare with that file"),
        ),
        (
            ("out=FILE.json", "a file of versions, digests of short drives and the speed"),
            ("reference=FILE.json", "such a file of another machine; else that of the package"),
        ),
        "The exit code is 2 where something is to be mended.",
        options=False,
    ),
}
