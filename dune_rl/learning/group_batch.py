"""Collected batches, one agent group at a time."""

import torch
from tensordict import TensorDict, TensorDictBase

# Under a group, what a policy of `PopulationPolicy` adds: whether a past policy acted, bool (M, T, G, 1).
PAST = "acted_by_past"


def acted_by_past(batch: TensorDictBase, group: str) -> torch.Tensor | None:
    """Flags (M, T) of steps in which a past policy acted for `group`; None where none ever does."""
    flags = batch.get((group, PAST), None)
    return None if flags is None else flags[..., 0, 0]


def select_group(batch: TensorDictBase, group: str) -> TensorDictBase:
    """What a collected batch (M scenes, T steps) holds of the G agents of `group`, with batch size (M, T, G).

    Entries are "observation", "action", "done" and so on, and the same under
    "next" after the step. An agent is "done" after the step at its own end or
    at its episode's, so that no sequence goes on into the next episode; "done"
    before the step marks an agent that ended earlier in this episode, or has not come yet, and idles, and one
    that acted by a past policy, of which nothing is learned.
    """
    now, after = batch.get(group), batch.get(("next", group))
    past = now.get(PAST, None)
    if past is not None:
        # A copy of the shell: the batch itself is left as it is.
        now = now.exclude(PAST).set("done", now.get("done") | past)
    ended = batch.get(("next", "done")).unsqueeze(-2)
    following = TensorDict(dict(after.items()) | {"done": after.get("done") | ended}, after.batch_size)
    return TensorDict(dict(now.items()) | {"next": following}, now.batch_size)


def agent_sequences(group_batch: TensorDictBase) -> TensorDictBase:
    """The steps of each agent in order, batch size (M * G, T), from what `select_group` gives."""
    steps = group_batch.batch_size[1]
    return group_batch.permute(0, 2, 1).reshape(-1, steps)
