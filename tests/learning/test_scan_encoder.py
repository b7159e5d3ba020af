"""The convolutions round a scan, and what they learn from."""

from pathlib import Path

import pytest
import torch
from training import make_sac

from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.encoders import ScanEncoder
from dune_rl.learning.networks.policy import Architecture, Features, make_policy_network
from dune_rl.learning.policy_spec import PartSpec, PolicySpec

SPEC = PolicySpec(
    {"goal": 2, "lidar": 32, "lidar_past": 32, "velocity": 2},
    (-1.0, -3.0),
    (1.0, 3.0),
    ("lidar", "lidar_past"),
)


def test_turned_scans_give_turned_features() -> None:
    torch.manual_seed(0)
    encoder = ScanEncoder(PartSpec((2, 32)), 4)
    scans = torch.rand(3, 5, 2, 32)
    one, other = encoder(scans), encoder(scans.roll(6, -1))
    assert one.shape == (3, 5, encoder.size) == (3, 5, 4 * 16)
    rings = (each.unflatten(-1, (4, 16)) for each in (one, other))
    torch.testing.assert_close(next(rings).roll(3, -1), next(rings))


def test_scans_of_one_direction_are_compared() -> None:
    torch.manual_seed(1)
    encoder = ScanEncoder(PartSpec((2, 32)), 4)
    scans = torch.rand(1, 2, 32)
    other = scans.clone()
    other[0, 1, 8] += 1.0
    change = (encoder(scans) - encoder(other))[0].unflatten(-1, (4, 16)).abs().sum(0)
    # Segment 8 reaches no more than four segments on either side.
    assert change[2:7].sum() > 0
    assert change[:2].sum() + change[7:].sum() < 1e-5


@pytest.mark.parametrize("channels", [0, 4])
def test_without_scans_or_channels_vectors_pass_unchanged(channels: int) -> None:
    spec = SPEC if channels == 0 else PolicySpec({"goal": 2, "range": 1}, (-1.0,), (1.0,), ("range",))
    features = Features(spec, Architecture((8,), scan_channels=channels))
    vectors = torch.rand(2, spec.observation_size)
    assert features.size == spec.observation_size
    assert torch.equal(features(*vectors.split(list(spec.sizes.values()), -1)), features.normaliser(vectors))


def test_scans_of_unequal_length_have_convolutions_of_their_own() -> None:
    spec = PolicySpec({"far": 16, "near": 9, "other": 16}, (-1.0,), (1.0,), ("far", "near", "other"))
    features = Features(spec, Architecture((8,), scan_channels=3))
    assert len(features.scans["convolutions"]) == 2
    parts = torch.rand(2, 41).split([16, 9, 16], -1)
    assert features(*parts).shape == (2, features.size) == (2, 3 * 8 + 3 * 5)


def test_an_encoder_is_chosen_for_one_part() -> None:
    networks = {"lidar_past": {"encoder": "vector"}, "lidar": {"encoder": "scan", "channels": 2}}
    features = Features(SPEC, Architecture((8,), scan_channels=4, networks=networks))
    assert features.size == 4 + 2 * 16 + 32
    with pytest.raises(ConfigError, match=r"learning\.networks\.lidr encodes no part .*mean lidar\?"):
        Features(SPEC, Architecture((8,), networks={"lidr": {"encoder": "vector"}}))


def test_the_encoder_learns_from_the_critics_alone(tmp_path: Path) -> None:
    torch.manual_seed(0)
    sac = make_sac(SPEC, tmp_path, hidden=(16,), scan_channels=4)
    rows = torch.rand(64, sac._codec.width) + 0.1
    step, features = sac._step, sac.policy.network[0].module
    random_state = torch.get_rng_state()
    encoder = list(features.parameters())
    loss = step.loss(sac._codec.decode(rows, features.encode, 1.0))["loss_qvalue"]
    expected = torch.autograd.grad(loss, encoder)
    torch.set_rng_state(random_state)
    seen: list[torch.Tensor] = []
    take = step.optimiser.step
    step.optimiser.step = lambda: (seen.extend(w.grad.clone() for w in encoder if w.grad is not None), take())  # type: ignore[assignment,func-returns-value]
    before = [weight.detach().clone() for weight in encoder]
    sac._learn([rows])
    for ours, theirs in zip(seen, expected, strict=True):
        torch.testing.assert_close(ours, theirs)
    assert all(not torch.equal(old, new) for old, new in zip(before, encoder, strict=True))


def test_a_policy_keeps_its_encoder() -> None:
    policy = make_policy_network(SPEC, Architecture((8,), scan_channels=4))
    assert any("convolutions" in key for key in policy.state_dict())
    plain = Architecture((8,), scan_channels=4).plain()
    assert Architecture.from_plain(plain) == Architecture((8,), scan_channels=4)
