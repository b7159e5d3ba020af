"""Collected batches, one agent group at a time."""

from tensordict import TensorDict, TensorDictBase


def select_group(batch: TensorDictBase, group: str) -> TensorDictBase:
    """What a collected batch (M scenes, T steps) holds of the G agents of `group`, with batch size (M, T, G).

    Entries are "observation", "action", "done" and so on, and the same under
    "next" after the step. An agent is "done" after the step at its own end or
    at its episode's, so that no sequence goes on into the next episode; "done"
    before the step marks an agent that ended earlier in this episode and idles.
    """
    now, after = batch.get(group), batch.get(("next", group))
    ended = batch.get(("next", "done")).unsqueeze(-2)
    following = TensorDict(dict(after.items()) | {"done": after.get("done") | ended}, after.batch_size)
    return TensorDict(dict(now.items()) | {"next": following}, now.batch_size)


def agent_sequences(group_batch: TensorDictBase) -> TensorDictBase:
    """The steps of each agent in order, batch size (M * G, T), from what `select_group` gives."""
    steps = group_batch.batch_size[1]
    return group_batch.permute(0, 2, 1).reshape(-1, steps)
