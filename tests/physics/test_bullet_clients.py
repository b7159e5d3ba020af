"""PyBullet's clients: using one again changes nothing."""

import pybullet
import pytest
from scenes import SUBSTEPS, Company, box, plane, rover_body, walker

import dune_rl.physics.bullet.client as clients
from dune_rl.physics.bullet.scene import BulletScene


@pytest.fixture
def no_spare_client():
    """No client waits to be used again."""
    while clients._spare:
        pybullet.disconnect(clients._spare.pop())


def drive(size_m: float = 0.4) -> tuple[bytes, int]:
    """States of a rover that drives into a box, and the client that it did so in."""
    walls = [plane(), box((1.0, 0.1), size_m, 2.0, 1.0)]
    company = Company(BulletScene, [rover_body()], walls, [walker()])
    company.place([0.0, 0.0, 0.13], actors=[[0.0, 0.9, 0.0, 0.0]])
    states = []
    for step in range(40):
        company.robots[0].set_command([4.0, 5.0, 4.0, 5.0])
        company.step(SUBSTEPS, [[0.0, 0.9 - 0.02 * step, 0.0, 0.0]])
        states.append(company.states.tobytes())
    client = company.scene._client
    company.scene.close()
    return b"".join(states), client


def test_a_scene_in_a_used_client_gives_the_same_bytes_as_in_a_fresh_one(no_spare_client):
    fresh, client = drive()
    # It was kept, and others were in it in the meantime.
    different, same = drive(size_m=0.9)
    assert same == client and different != fresh
    again, same = drive()
    assert same == client
    assert again == fresh


def test_one_client_is_kept_and_others_are_closed(no_spare_client):
    opened = [clients.open_client() for _ in range(3)]
    for client in opened:
        clients.release_client(client)
        clients.release_client(client)
    assert clients._spare == opened[:1]
    assert [bool(pybullet.isConnected(client)) for client in opened] == [True, False, False]
    assert clients.open_client() == opened[0]
    pybullet.disconnect(opened[0])


def test_a_spare_client_that_was_closed_elsewhere_is_not_used(no_spare_client):
    client = clients.open_client()
    clients.release_client(client)
    pybullet.disconnect(client)
    other = clients.open_client()
    assert pybullet.isConnected(other)
    pybullet.disconnect(other)
