"""Point-goal navigation: settings of where it starts, what it earns and when it ends."""

from dune_rl.settings import Settings
from dune_rl.tasks.rewards import RewardConf
from dune_rl.tasks.spawn import SpawnConf
from dune_rl.tasks.terminations import TerminationConf
from dune_rl.tasks.walking import WalkingConf


class PointGoalConf(Settings):
    """The paper's task; `walking` is what actors that are agents are rewarded for."""

    spawn: SpawnConf = SpawnConf()
    reward: RewardConf = RewardConf()
    termination: TerminationConf = TerminationConf()
    walking: WalkingConf = WalkingConf()
