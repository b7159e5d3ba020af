"""Images in observations: how they are packed, kept and encoded."""

from functools import partial
from pathlib import Path

import pytest
import torch
from point_mass import PointMass
from tensordict import TensorDict
from training import assert_halves_make_a_whole, small, trainer

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.encoders import ImageEncoder
from dune_rl.learning.networks.policy import Architecture, make_policy_network
from dune_rl.learning.networks.settings import ReplayConf
from dune_rl.learning.policy_spec import PartSpec, PolicySpec
from dune_rl.learning.sac.replay import TransitionCodec, check_memory
from dune_rl.learning.saved_policies import load_policy

RGB = PartSpec((16, 20, 3), True, 0.0, 255.0)
CLASSES = PartSpec((16, 20, 1), True, 0.0, 7.0)
DEPTH = PartSpec((6, 40, 1), False, 0.0, 100.0)
SPEC = PolicySpec(
    {"goal": 2, "lidar": 16},
    (-1.0, -1.0),
    (1.0, 1.0),
    ("lidar",),
    {"rgb": RGB, "classes": CLASSES, "depth": DEPTH},
)
MAKE_ENV = partial(PointMass, image=(12, 16, 3))
CONVOLUTIONS = small(image_channels=(4, 4), image_features=8)


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
    vectors, images = SPEC.unpack(SPEC.pack(seen))
    assert torch.equal(vectors, torch.cat([seen["goal"], seen["lidar"]], -1))
    for name, image in zip(("rgb", "classes", "depth"), images, strict=True):
        assert image.dtype == seen[name].dtype
        assert torch.equal(image, seen[name])


def test_spec_of_an_environment_with_a_camera_survives_a_file():
    spec = PolicySpec.of(MAKE_ENV(2, 0), "rover")
    assert spec.images == {"camera_rgb": PartSpec((12, 16, 3), True, 0.0, 255.0)}
    assert spec.keys == ["goal", "imu", "lidar", "velocity", "camera_rgb"]
    assert PolicySpec.from_plain(spec.plain()) == spec


def test_rows_keep_both_observations_of_a_step_byte_for_byte():
    codec = TransitionCodec(SPEC, n_steps=2)
    now, after = observations(2, 5), observations(2, 5, seed=1)
    done = torch.zeros(2, 5, 1, dtype=torch.bool)
    done[0, 2] = True
    batch = TensorDict(
        {
            "observation": now,
            "action": torch.rand(2, 5, 2),
            "done": torch.zeros(2, 5, 1, dtype=torch.bool),
            "next": {"observation": after, "reward": torch.ones(2, 5, 1), "terminated": done, "done": done},
        },
        [2, 5],
    )
    rows = codec.encode(batch)
    assert rows.dtype == torch.uint8 and rows.shape == (10, codec.width)
    seen: list[torch.Tensor] = []

    def encode(packed):
        seen.append(SPEC.unpack(packed)[1][0])
        return packed.floats[:, :1]

    decoded = codec.decode(rows, encode, 1.0)
    # Two steps on, but not beyond the end of an episode or of the batch.
    later = torch.tensor([[1, 2, 2, 4, 4], [1, 2, 3, 4, 4]])
    chosen = after["rgb"][torch.arange(2)[:, None], later].flatten(0, 1)
    first, second = seen if torch.equal(seen[0], now["rgb"].flatten(0, 1)) else seen[::-1]
    assert torch.equal(first, now["rgb"].flatten(0, 1))
    assert torch.equal(second, chosen)
    assert decoded["next", "terminated"].flatten().tolist() == [False, True, True] + [False] * 7
    vectors, _ = SPEC.unpack(codec.observations(rows))
    assert torch.equal(vectors, SPEC.unpack(SPEC.pack(now))[0].flatten(0, 1))


@pytest.mark.parametrize("image", [RGB, CLASSES, DEPTH, PartSpec((64, 64, 3), True, 0.0, 255.0)])
def test_every_kind_of_image_becomes_finite_features(image):
    encoder = ImageEncoder(image, (8, 8, 8), 12)
    draws = torch.rand(2, 3, *image.shape) * image.high
    pixels = draws.to(torch.uint8) if image.uint8 else draws
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
    policy = make_policy_network(SPEC, Architecture((16,), scan_channels=4))
    seen = observations(4)
    features = policy[0](seen.clone())["features"]
    other = seen.clone()
    other["rgb"] = 255 - other["rgb"]
    changed = policy[0](other)["features"] != features
    assert changed.any()
    assert not changed[:, : -3 * 64].any(), "vectors and scans stay as they are"


@pytest.mark.slow
def test_a_camera_alone_is_enough():
    env = make_torchrl_env(compose(Conf, ["+world=flat", "sensors=[camera]"]), 2, 0)
    spec = PolicySpec.of(env, "rover")
    policy = GroupPolicy("rover", spec, make_policy_network(spec, Architecture((8,))))
    rollout = env.rollout(3, policy, break_when_any_done=False)
    assert rollout["rover", "observation", "camera_rgb"].shape == (2, 3, 1, 64, 64, 3)
    env.close()


@pytest.mark.slow
def test_halves_make_a_whole_with_a_camera(tmp_path: Path):
    assert_halves_make_a_whole(MAKE_ENV, tmp_path, CONVOLUTIONS, frames=1024, half=700)


def test_a_policy_for_another_picture_is_named(tmp_path: Path):
    trainer(tmp_path / "run", CONVOLUTIONS, make_env=MAKE_ENV).train(stop_after_frames=128)
    env = PointMass(1, 0, image=(6, 16, 3))
    with pytest.raises(CheckpointError, match="camera_rgb has 12 by 16 pixels of 3 there, 6 by 16 pixels"):
        load_policy(tmp_path / "run", env)


def test_a_replay_buffer_that_no_memory_holds_is_refused_with_one_that_fits():
    many = 10**12
    with pytest.raises(ConfigError, match=r"Set learning\.replay\.capacity=\d+ or less") as caught:
        check_memory(ReplayConf(capacity=many), 8000, many)
    fits = int(str(caught.value).rpartition("capacity=")[2].split()[0])
    check_memory(ReplayConf(capacity=fits), 8000, many)
    check_memory(ReplayConf(capacity=many), 8000, 1000)
    check_memory(ReplayConf(capacity=many, storage="disk"), 8000, many)
