"""Images in observations: how they are packed, kept and encoded."""

from functools import partial
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from test_learning import SMALL, assert_halves_make_a_whole, trainer

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose
from dune_rl.errors import CheckpointError, ConfigError
from dune_rl.learning.image_encoder import ImageEncoder
from dune_rl.learning.layout import Image, Layout
from dune_rl.learning.networks import Architecture, make_policy
from dune_rl.learning.policies import load_policy
from dune_rl.learning.replay import ReplayConf, Transitions, check_memory

RGB = Image((16, 20, 3), True, 0.0, 255.0)
CLASSES = Image((16, 20, 1), True, 0.0, 7.0)
DEPTH = Image((6, 40, 1), False, 0.0, 100.0)
LAYOUT = Layout(
    {"goal": 2, "lidar": 16},
    (-1.0, -1.0),
    (1.0, 1.0),
    ("lidar",),
    {"rgb": RGB, "classes": CLASSES, "depth": DEPTH},
)
SENSORS = ["sensors=[camera,goal,velocity]", "sensors.camera.width=16", "sensors.camera.height=12"]
SETTINGS = compose(["+world=flat", *SENSORS, "task.termination.max_steps=60"])
MAKE_ENV = partial(make_torchrl_env, SETTINGS)


def observations(*shape: int, seed: int = 0) -> TensorDict:
    torch.manual_seed(seed)
    parts = {
        "goal": torch.rand(*shape, 2),
        "lidar": torch.rand(*shape, 16) + 0.1,
        "rgb": torch.randint(0, 256, (*shape, *RGB.shape), dtype=torch.uint8),
        "classes": torch.randint(0, 8, (*shape, *CLASSES.shape), dtype=torch.uint8),
        "depth": torch.rand(*shape, *DEPTH.shape) * 100,
    }
    return TensorDict(parts, shape)


def test_what_is_packed_is_unpacked_unchanged():
    seen = observations(3, 2)
    vectors, images = LAYOUT.unpack(LAYOUT.pack(seen))
    assert torch.equal(vectors, torch.cat([seen["goal"], seen["lidar"]], -1))
    for name, image in zip(("rgb", "classes", "depth"), images, strict=True):
        assert image.dtype == seen[name].dtype
        assert torch.equal(image, seen[name])


def test_layout_of_an_environment_with_a_camera_survives_a_file():
    env = MAKE_ENV(2, 0)
    layout = Layout.of(env)
    assert layout.images == {"camera_rgb": Image((12, 16, 3), True, 0.0, 255.0)}
    assert layout.keys == ["goal", "velocity", "camera_rgb"]
    assert Layout.from_plain(layout.plain()) == layout
    env.close()


def test_rows_keep_both_observations_of_a_step_byte_for_byte():
    transitions = Transitions(LAYOUT, n_steps=2)
    now, after = observations(2, 5), observations(2, 5, seed=1)
    done = torch.zeros(2, 5, 1, dtype=torch.bool)
    done[0, 2] = True
    batch = TensorDict(
        {
            **now,
            "action": torch.rand(2, 5, 2),
            "next": {**after, "reward": torch.ones(2, 5, 1), "terminated": done, "done": done},
        },
        [2, 5],
    )
    rows = transitions.rows(batch)
    assert rows.dtype == torch.uint8 and rows.shape == (10, transitions.width)
    seen: list[torch.Tensor] = []

    def encode(packed):
        seen.append(LAYOUT.unpack(packed)[1][0])
        return packed.floats[:, :1]

    learnt = transitions.batch(rows, encode, 1.0)
    # Two steps on, but not beyond the end of an episode or of the batch.
    later = torch.tensor([[1, 2, 2, 4, 4], [1, 2, 3, 4, 4]])
    chosen = after["rgb"][torch.arange(2)[:, None], later].flatten(0, 1)
    first, second = seen if torch.equal(seen[0], now["rgb"].flatten(0, 1)) else seen[::-1]
    assert torch.equal(first, now["rgb"].flatten(0, 1))
    assert torch.equal(second, chosen)
    assert learnt["next", "terminated"].flatten().tolist() == [False, True, True] + [False] * 7
    assert torch.equal(transitions.vectors(rows), LAYOUT.unpack(LAYOUT.pack(now))[0].flatten(0, 1))


@pytest.mark.parametrize("image", [RGB, CLASSES, DEPTH, Image((64, 64, 3), True, 0.0, 255.0)])
def test_every_kind_of_image_becomes_finite_features(image):
    encoder = ImageEncoder(image, (8, 8, 8), 12)
    draws = torch.rand(2, 3, *image.shape) * image.high
    pixels = draws.to(torch.uint8) if image.whole_bytes else draws
    features = encoder(pixels)
    assert features.shape == (2, 3, 12)
    assert features.isfinite().all() and features.std() > 0
    assert torch.equal(encoder(pixels[1])[2], features[1, 2]) or torch.allclose(
        encoder(pixels[1])[2], features[1, 2], atol=1e-6
    )


def test_classes_are_told_apart_by_kind_not_by_number():
    encoder = ImageEncoder(CLASSES, (4,), 3)
    scaled = encoder._scaled(torch.tensor([0, 7], dtype=torch.uint8).reshape(2, 1, 1, 1))
    assert scaled.flatten(1).tolist() == [[1.0] + [0.0] * 7, [0.0] * 7 + [1.0]]


def test_brightness_and_distance_are_scaled_to_their_ranges():
    rgb = ImageEncoder(RGB, (4,), 3)._scaled(torch.tensor([[0, 255]], dtype=torch.uint8))
    assert rgb.tolist() == [[-2.0, 2.0]]
    depth = ImageEncoder(DEPTH, (4,), 3)._scaled(torch.tensor([0.0, 1.0, 100.0]))
    assert depth[0] == -2.0 and depth[2] == pytest.approx(2.0)
    assert -1.5 < depth[1] < -1.0, "the first metre is worth more than a hundredth"


def test_a_policy_sees_the_picture():
    policy = make_policy(LAYOUT, Architecture((16,), scan_channels=4))
    seen = observations(4)
    features = policy[0](seen.clone())["features"]
    other = seen.clone()
    other["rgb"] = 255 - other["rgb"]
    changed = policy[0](other)["features"] != features
    assert changed.any()
    assert not changed[:, : -3 * 64].any(), "vectors and scans stay as they are"


def test_a_camera_alone_is_enough():
    env = make_torchrl_env(compose(["+world=flat", "sensors=[camera]"]), 2, 0)
    policy = make_policy(Layout.of(env), Architecture((8,)))
    rollout = env.rollout(3, policy, break_when_any_done=False)
    assert rollout["camera_rgb"].shape == (2, 3, 64, 64, 3)
    env.close()


def test_halves_make_a_whole_with_a_camera(tmp_path: Path):
    assert_halves_make_a_whole(MAKE_ENV, tmp_path)


def test_a_policy_for_another_picture_is_named(tmp_path: Path):
    trainer(tmp_path / "run", sac=SMALL, make_env=MAKE_ENV).train(stop_after_frames=128)
    other = compose(["+world=flat", *SENSORS, "sensors.camera.height=16"])
    with pytest.raises(CheckpointError, match="camera_rgb has 12 by 16 pixels of 3 there, 16 by 16 pixels"):
        load_policy(tmp_path / "run", Layout.of(make_torchrl_env(other, 1, 0)))


def test_a_replay_buffer_that_no_memory_holds_is_refused_with_one_that_fits():
    transitions = Transitions(LAYOUT)
    many = 10**12
    with pytest.raises(ConfigError, match=r"Set learning\.replay\.capacity=\d+ or less") as caught:
        check_memory(ReplayConf(capacity=many), transitions, many)
    fits = int(str(caught.value).rpartition("capacity=")[2].split()[0])
    check_memory(ReplayConf(capacity=fits), transitions, many)
    check_memory(ReplayConf(capacity=many), transitions, 1000)
    check_memory(ReplayConf(capacity=many, storage="disk"), transitions, many)
