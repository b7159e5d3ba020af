"""Makes the files of this version that later versions must read: a run with a population, and an episode set.

`python tests/helpers/make_release_files.py FOLDER` writes them into FOLDER/release_VERSION, a folder of a few
100 KB; `tests/learning/test_releases.py` reads those in `tests/data`. Make them once for each release.
"""

import subprocess
import sys
from pathlib import Path

import dune_rl

TRAIN = """
+world=flat actors=external_walkers seed=1 total_frames=128 film=false run_dir=run
task.terminations.time_limit.max_steps=20 learning.hidden=[8] learning.warm_up=random
learning.learning_starts=32 learning.batch_size=16 learning.replay.capacity=64 learning.precision=float32
learning.collector.mode=serial learning.collector.scenes=2 learning.collector.steps=16
learning.evaluation.every_frames=128 learning.evaluation.episodes=2 learning.evaluation.scenes=2
learning.evaluation.tracks=0
learning.population.probability=0.5 learning.population.every_frames=32 learning.population.size=2
"""
EPISODE_SET = "make tiny-v1 +world=flat --sites 1 --episodes 4 --out ."
# Of the run what later versions read: neither pictures, nor TensorBoard's events, nor Hydra's notes.
_LEFT_OUT = ("*.png", "events.*", ".hydra/*")


def main() -> None:
    """Write the files of the present version."""
    folder = Path(sys.argv[1]).absolute() / f"release_{dune_rl.__version__}"
    folder.mkdir(parents=True)
    for command, words in (("train", TRAIN), ("episode_sets", EPISODE_SET)):
        subprocess.run([sys.executable, "-m", f"dune_rl.{command}", *words.split()], cwd=folder, check=True)
    for pattern in _LEFT_OUT:
        for path in (folder / "run").glob(pattern):
            path.unlink()
    (folder / "run" / ".hydra").rmdir()


if __name__ == "__main__":
    main()
