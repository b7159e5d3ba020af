"""A small valid sample of every format that is read, and the public way by which commands read it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
import trimesh
from PIL import Image
from report_runs import episode_rows, write_evaluation, write_rows, write_sweep, write_training
from rich.console import Console
from textured_files import pictured, quadrants
from training import small, trainer
from urdf_files import write_cart
from world_files import SHARED_WORLDS, Y_UP, box, bumpy_ground, dae_text, ground_height, obj_text, write_yard

from dune_rl.commands.report import ReportConf, make_report
from dune_rl.config.build import build_robot, make_simulation, make_torchrl_env
from dune_rl.config.commands import EvaluateConf, ViewConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import assets_folder
from dune_rl.evaluation.cross_play import is_cross_play
from dune_rl.evaluation.episode_sets.apply import compose_on_set
from dune_rl.evaluation.episode_sets.files import checksum
from dune_rl.evaluation.folder import ResultsFolder, read_provenance, read_settings
from dune_rl.evaluation.provenance import check_same_sources
from dune_rl.evaluation.running import EvaluationPlan
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.learning.saved_policies import load_policy
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.markdown.file import rewrite_file
from dune_rl.reporting.reading import read_inputs
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.sensors.perception.motion_forecast import read_forecast
from dune_rl.worlds.cache.store import WorldStore, world_key
from dune_rl.worlds.importing.actor_files import read_actor_file
from dune_rl.worlds.importing.heightmap_world import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf
from dune_rl.worlds.inspection.build import InspectionConf
from strangers.watch import Sample

REAL_WORLDS = {
    "agriculture": SHARED_WORLDS / "agriculture_world.dae",
    "marsyard": next(SHARED_WORLDS.glob("marsyard*/dem/*.tif"), SHARED_WORLDS / "marsyard.tif"),
}

WORLD = """<?xml version="1.0"?><sdf version="1.9"><world name="w">
<light name="sun" type="directional"><pose>0 0 9 0 0 0</pose><direction>-1 0 -1</direction></light>
<include><uri>model://inner</uri><pose>3 1 0 0 0 1</pose></include>
<model name="plane"><static>true</static><link name="l"><collision name="c"><geometry><plane>
<normal>0 0 1</normal><size>10 10</size></plane></geometry>
<surface><friction><ode><mu>0.8</mu></ode></friction></surface></collision>
</link></model><model name="a"><static>1</static><pose>1 2 0.5 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>1 1 1</size></box></geometry></collision><collision name="d"><geometry><cylinder>
<radius>0.3</radius><length>2</length></cylinder></geometry></collision></link></model>
<model name="m"><static>1</static><pose>-3 2 0 0 0 0</pose><link name="l"><collision name="c"><geometry><mesh>
<uri>box.obj</uri><scale>1 1 1</scale></mesh></geometry></collision></link></model>
<actor name="walker"><script><loop>true</loop><trajectory id="0" type="walking">
<waypoint><time>0</time><pose>-1 -1 0 0 0 0</pose></waypoint>
<waypoint><time>4</time><pose>1 -1 0 0 0 0</pose></waypoint></trajectory></script></actor>
</world></sdf>"""
INNER = """<sdf version="1.9"><model name="i"><static>1</static><link name="l"><collision name="c"><geometry>
<sphere><radius>0.4</radius></sphere></geometry></collision></link></model></sdf>"""


def _ground_and_crate() -> dict[str, trimesh.Trimesh]:
    return {"Terrain": bumpy_ground(3.0, 3.0, 0.5), "Crate": box(1, 1, -0.5, (1, 1, 1.5))}


def _mesh(kind: str) -> Callable[[Path], Sample]:
    def make(folder: Path) -> Sample:
        path = write_yard(folder, kind, _ground_and_crate())
        return Sample({path: kind}, lambda: build_mesh(MeshConf(path=str(path))))

    return make


def _textured(kind: str) -> Callable[[Path], Sample]:
    """A mesh with a picture: beside it, in a .png and an .mtl, or in the file itself."""

    def make(folder: Path) -> Sample:
        ground = bumpy_ground(3.0, 3.0, 0.5)
        picture, path, uv = quadrants().resize((8, 8)), folder / f"pictured.{kind}", ground.vertices[:, :2]
        picture.save(folder / "picture.png")
        files = {path: kind, folder / "picture.png": "png"}
        if kind == "dae":
            turned = ground.copy().apply_transform(Y_UP).apply_scale(100.0)
            path.write_text(dae_text({"Terrain": turned}, picture="picture.png"))
        elif kind == "glb":
            trimesh.Scene([pictured(ground.apply_transform(Y_UP), uv, picture, kind, "a")]).export(path)
            files = {path: kind}
        else:
            head = "mtllib a.mtl"
            lines = obj_text({"Terrain": ground}, head, "a").splitlines()
            texture = [f"vt {x / 6 + 0.5:.3f} {y / 6 + 0.5:.3f}" for x, y in uv]
            faces = [
                "f " + " ".join(f"{corner}/{corner}" for corner in line.split()[1:])
                if line.startswith("f ")
                else line
                for line in lines
            ]
            path.write_text("\n".join([*faces[:1], *texture, *faces[1:]]) + "\n")
            (folder / "a.mtl").write_text("newmtl a\nKd 0.5 0.5 0.5\nmap_Kd picture.png\n")
            files[folder / "a.mtl"] = "text"
        return Sample(files, lambda: build_mesh(MeshConf(path=str(path))))

    return make


def _sdf(folder: Path) -> Sample:
    (folder / "inner").mkdir()
    (folder / "inner" / "model.sdf").write_text(INNER)
    (folder / "box.obj").write_text(obj_text({"Box": box(0, 0, 0, (1, 1, 1))}))
    path = folder / "w.sdf"
    path.write_text(WORLD)
    files = {path: "sdf", folder / "inner" / "model.sdf": "sdf"}
    return Sample(files, lambda: build_sdf(SdfConf(path=str(path))))


def _heights(kind: str) -> Callable[[Path], Sample]:
    def make(folder: Path) -> Sample:
        path = folder / f"h.{kind}"
        x, y = np.linspace(-10, 10, 31), np.linspace(8, -8, 25)
        heights = ground_height(np.stack(np.meshgrid(x, y), axis=-1))
        if kind == "tif":
            # As GeoTIFFs have them: the size of a pixel, and the marker of missing heights.
            tags = [(33550, 12, 3, (0.7, 0.7, 0.0), True), (42113, 2, 6, "-9999", True)]
            tifffile.imwrite(path, heights.astype(np.float32), extratags=tags, compression="zlib")
        elif kind == "npy":
            np.save(path, heights)
        else:
            Image.fromarray(np.round((heights + 0.4) * 8e4).astype(np.uint16)).save(path)
        size = None if kind == "tif" else (20.0, 16.0)
        conf = HeightmapConf(path=str(path), size_m=size, relief_m=1.0 if kind == "png" else None)
        return Sample({path: kind}, lambda: build_heightmap(conf))

    return make


def _real(source: Path, kind: str) -> Callable[[Path], Sample]:
    """A file of one of the worlds of others, large as those are."""

    def make(folder: Path) -> Sample:
        path = folder / source.name
        shutil.copy(source, path)
        if kind == "tif":
            return Sample({path: kind}, lambda: build_heightmap(HeightmapConf(path=str(path))))
        return Sample({path: kind}, lambda: build_mesh(MeshConf(path=str(path))))

    return make


def _surfaces(folder: Path) -> Sample:
    heights, path = folder / "h.npy", folder / "surfaces.png"
    np.save(heights, np.zeros((9, 9)))
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8) % 2).save(path)
    conf = HeightmapConf(path=str(heights), size_m=(20.0, 16.0), surface_map=str(path))
    return Sample({path: "png"}, lambda: build_heightmap(conf))


def _urdf(folder: Path) -> Sample:
    path = write_cart(folder)
    shell = path.parent.parent / "meshes" / "shell.obj"
    conf = compose_environment("flat", (), {"actors": "none"})

    def read() -> None:
        robot = UrdfConf(path=str(path))
        build_robot(robot, 1)
        # Engines read what the robot was made into.
        agents = {name: group.model_copy(update={"body": robot}) for name, group in conf.agents.items()}
        simulation = make_simulation(conf.model_copy(update={"agents": agents}), 1, 0)
        try:
            simulation.reset()
        finally:
            simulation.close()

    return Sample({path: "urdf", shell: "obj"}, read)


_ACTORS_CSV = "actor,loop,delay_s,time_s,x_m,y_m,z_m,yaw_rad\n" + "".join(
    f"a,true,0,{t},{t},0,0,0\n" for t in range(5)
)
_ACTORS_JSON = {
    "actors": [
        {
            "name": "a",
            "loop": False,
            "delay_s": 0.5,
            "times_s": [0, 1, 2],
            "poses": [[0, 0, 0, 0], [1, 0, 0, 0], [2, 1, 0, 1]],
        }
    ]
}


def _actors(kind: str) -> Callable[[Path], Sample]:
    def make(folder: Path) -> Sample:
        path = folder / f"actors.{kind}"
        path.write_text({"csv": _ACTORS_CSV, "json": json.dumps(_ACTORS_JSON), "sdf": WORLD}[kind])
        return Sample({path: kind}, lambda: read_actor_file(path))

    return make


_OPTION = """# @package _global_
seed: 4
task:
  terminations:
    time_limit: {max_steps: 40}
actors:
  walker: {count: 2}
weather: {fog_visibility_m: 30.0}
"""


def _yaml(folder: Path) -> Sample:
    (folder / "conf" / "experiment").mkdir(parents=True)
    path = folder / "conf" / "experiment" / "mine.yaml"
    path.write_text(_OPTION)
    return Sample(
        {path: "yaml"},
        lambda: compose(
            Conf, ["+world=flat", "actors=social_force", "+experiment=mine"], [str(folder / "conf")]
        ),
    )


_WORDS = (
    "+world=flat\nactors=social_force\nseed=3\n'sensors=[lidar,imu,goal,velocity]'\nlearning.gamma=0.98\n"
)


def _command_line(folder: Path) -> Sample:
    path = folder / "words.txt"
    path.write_text(_WORDS)

    def read() -> None:
        words = [
            word.strip("'") for word in path.read_bytes().decode("utf-8", "replace").splitlines() if word
        ]
        # No command line has null bytes.
        compose(Conf, [word.replace("\0", "") for word in words])

    return Sample({path: "text"}, read)


def _policy(folder: Path) -> Sample:
    path = folder / "policy.pt"
    shutil.copy(assets_folder().parent / "experiments" / "flat" / "seed1" / "policy.pt", path)
    first = read_policy_file(path)[1]["config"]
    env = make_torchrl_env(compose(ViewConf, (), (), first), 1, 0)

    def read() -> None:
        compose(ViewConf, (), (), read_policy_file(path)[1]["config"])
        load_policy(path, env)

    return Sample({path: "pt"}, read)


def _checkpoint(folder: Path) -> Sample:
    run = folder / "run"
    trainer(run, small(hidden=(8, 8)), total_frames=1024).train()
    files = {run / "checkpoint.pt": "pt"} | {path: "npy" for path in run.glob("replay-*.npy")}
    before = folder / "before"
    shutil.copytree(run, before)

    def read() -> None:
        # Of a resumed run all files but these change.
        for path in before.iterdir():
            if run / path.name not in files:
                shutil.copy(path, run / path.name)
        trainer(run, small(hidden=(8, 8)), total_frames=2048, resume=run)

    return Sample(files, read)


def _forecast(folder: Path) -> Sample:
    path = folder / "forecast.npz"
    shutil.copy(next((assets_folder() / "forecasts").glob("*.npz")), path)
    return Sample({path: "npz"}, lambda: read_forecast(str(path), 0.05))


def _episode_set(folder: Path) -> Sample:
    sets = assets_folder() / "episode_sets"
    path, rows = folder / "mine-v1.json", folder / "mine-v1.csv"
    header = json.loads((sets / "flat-v1.json").read_text())
    path.write_text(json.dumps(header))
    rows.write_bytes((sets / "flat-v1.csv").read_bytes())

    def read() -> None:
        # As a stranger would, who can compute a checksum, too.
        try:
            text = rows.read_bytes().decode().replace("\r\n", "\n")
            found = json.loads(path.read_bytes())
            path.write_text(json.dumps(found | {"sha256": checksum(found, text)}))
        except (ValueError, TypeError, AttributeError, RecursionError):
            pass
        compose_on_set(EvaluateConf, ["policy=go_to_goal", f"set={path}"], (), None)

    return Sample({path: "json", rows: "csv"}, read)


def _cache(folder: Path) -> Sample:
    store = WorldStore(folder / "cache", 2**30)
    conf = InspectionConf(seed=1)
    store.get(conf)
    assert store.cache is not None
    path = store.cache.entry(world_key(conf))

    def read() -> None:
        world = store.get(conf)
        world.clearance(np.zeros((3, 2)))

    return Sample({path: "npz"}, read)


def _evaluation(folder: Path) -> Sample:
    rows = [row for policy in ("a", "b") for row in episode_rows(policy, 6)]
    path = write_evaluation(folder / "evaluation", rows)
    steps = [
        {"policy": "a", "agent": "rover_0", "episode": 0, "x_m": x, "y_m": 0, "speed_mps": 1, "time_s": x}
        for x in range(5)
    ]
    write_rows(path / "steps.csv", steps)
    forms = {"config.yaml": "yaml", "provenance.json": "json", "episodes.csv": "csv", "steps.csv": "csv"}
    return Sample({path / name: form for name, form in forms.items()}, lambda: _read_report(path))


def _read_report(path: Path) -> None:
    inputs = read_inputs([path])
    if not inputs.usable:
        raise ConfigError("; ".join(note.text for note in inputs.skipped))
    collect_comparisons(inputs.evaluations)


def _report(folder: Path) -> Sample:
    sample = _evaluation(folder)
    path = folder / "evaluation"
    run = write_training(folder / "run", 1)
    files = dict(sample.files) | {run / "metrics.csv": "csv", run / "config.yaml": "yaml"}
    conf = ReportConf(out=str(folder / "report"), overwrite=True)
    return Sample(files, lambda: make_report([path, run], conf, Console(file=None, quiet=True)))


def _runs(folder: Path) -> Sample:
    run, sweep = write_training(folder / "run", 1), write_sweep(folder / "sweep", ["0.9", "0.99", "0.5"])
    files = {run / "metrics.csv": "csv", run / "config.yaml": "yaml", sweep / "multirun.yaml": "yaml"}
    job = next(path for path in sorted(sweep.iterdir()) if path.is_dir())
    files |= {job / ".hydra" / name: "yaml" for name in ("overrides.yaml", "hydra.yaml")}

    def read() -> None:
        inputs = read_inputs([run, sweep])
        if not inputs.usable:
            raise ConfigError("; ".join(note.text for note in inputs.skipped))

    return Sample(files, read)


_PAGE = """# A page

<!-- report: table
methods: {one: evaluation}
measures: [SR, TC]
-->
<!-- end report -->
"""


def _page(folder: Path) -> Sample:
    write_evaluation(folder / "evaluation", episode_rows("a", 6))
    path = folder / "page.md"
    path.write_text(_PAGE)
    return Sample({path: "text"}, lambda: rewrite_file(path))


def _results(folder: Path) -> Sample:
    """What `verify` and `resume` read of a folder of results before they run any episode."""
    conf = compose(EvaluateConf, ["+world=flat", "policy=go_to_goal", "episodes=4"])
    (folder / "evil.py").write_text("def act(observation):\n    return 0\n")
    path = folder / "results"
    provenance = {
        "set": None,
        "policies": [EvaluationPlan.of_settings(conf).sources[0].plain()],
        "forecasts": {},
    }
    with ResultsFolder.create(path, conf, provenance, overwrite=False):
        pass
    files = {
        path / "config.yaml": "yaml",
        path / "provenance.json": "json",
        path / "episodes.part.jsonl": "text",
    }
    return Sample({file: form for file, form in files.items() if file.exists()}, lambda: _reopen(path))


def _reopen(path: Path) -> None:
    if is_cross_play(path):
        return
    provenance = read_provenance(path)
    plan = EvaluationPlan.of_settings(read_settings(path))
    check_same_sources(plan, provenance, path)
    with ResultsFolder.reopen(path) as folder:
        folder.rows()


SAMPLES: dict[str, Callable[[Path], Sample]] = {
    **{kind: _mesh(kind) for kind in ("obj", "stl", "ply", "glb", "dae")},
    **{f"textured_{kind}": _textured(kind) for kind in ("obj", "glb", "dae")},
    "sdf": _sdf,
    "urdf": _urdf,
    **{f"heights_{kind}": _heights(kind) for kind in ("tif", "png", "npy")},
    **{name: _real(path, path.suffix[1:]) for name, path in REAL_WORLDS.items() if path.exists()},
    "surfaces": _surfaces,
    **{f"actors_{kind}": _actors(kind) for kind in ("csv", "json", "sdf")},
    "yaml": _yaml,
    "command_line": _command_line,
    "policy": _policy,
    "checkpoint": _checkpoint,
    "forecast": _forecast,
    "episode_set": _episode_set,
    "cache": _cache,
    "evaluation": _evaluation,
    "report": _report,
    "runs": _runs,
    "page": _page,
    "results": _results,
}
