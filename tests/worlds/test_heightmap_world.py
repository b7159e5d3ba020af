"""Worlds from maps of heights: every format, their scales and their directions, bad files refused."""

import struct

import numpy as np
import pytest
import tifffile
from mesh_worlds import rover_in
from PIL import Image
from pydantic import ValidationError
from simulations import act, motion_of_group
from world_files import SHARED_WORLDS, ground_height

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.importing.heightmap_world import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.imported_world import ImportedWorld


def samples(rows: int = 81, columns: int = 101) -> np.ndarray:
    """Of 20 by 16 m, the first row at the north."""
    x, y = np.linspace(-10, 10, columns), np.linspace(8, -8, rows)
    return ground_height(np.stack(np.meshgrid(x, y), axis=-1))


def build(path, **settings) -> ImportedWorld:
    return build_heightmap(HeightmapConf(path=str(path), **({"size_m": (20.0, 16.0)} | settings)))


def matches(world: ImportedWorld, tolerance: float = 0.003, shift: float = 0.0) -> None:
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=1e-9)
    xy = np.random.default_rng(0).uniform([-10, -8], [10, 8], (3000, 2))
    assert np.abs(world.terrain.height(xy) - ground_height(xy) - shift).max() < tolerance


def write_tiff(path, values, scale=None, keys=None, missing=None, **options) -> None:
    tags = []
    if scale is not None:
        tags.append((33550, "d", 3, (*scale, 0.0), True))
    if keys is not None:
        tags.append((34735, "H", len(keys), keys, True))
    if missing is not None:
        tags.append((42113, "s", 0, missing, True))
    tifffile.imwrite(path, values, extratags=tags, metadata=None, **options)


METRES, DEGREES = (1, 1, 0, 1, 1024, 0, 1, 1), (1, 1, 0, 1, 1024, 0, 1, 2)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_npy_and_tiff_hold_metres(tmp_path, kind):
    np.save(tmp_path / "m.npy", samples().astype(kind))
    matches(build(tmp_path / "m.npy"))
    write_tiff(tmp_path / "m.tif", samples().astype(kind))
    matches(build(tmp_path / "m.tif"))


def test_png_with_16_bits_is_scaled_by_its_relief(tmp_path):
    grey = np.round((samples() + 0.4) / 0.8 * 65535).astype(np.uint16)
    Image.fromarray(grey).save(tmp_path / "m.png")
    matches(build(tmp_path / "m.png", relief_m=0.8), shift=0.4)
    low = float(samples().min())
    matches(build(tmp_path / "m.png", relief_m=0.8, lowest_m=low))
    with pytest.raises(WorldError, match=r"is an image: set world.relief_m"):
        build(tmp_path / "m.png")


def test_8_bits_and_colour_are_warned_of(tmp_path):
    grey = np.round((samples() + 0.4) / 0.8 * 255).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "m.png")
    with pytest.warns(WorldWarning, match="has 8 bits per sample"):
        matches(build(tmp_path / "m.png", relief_m=0.8), tolerance=0.006, shift=0.4)
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(tmp_path / "c.png")
    with pytest.warns(WorldWarning, match="is a colour image"):
        matches(build(tmp_path / "c.png", relief_m=0.8), tolerance=0.006, shift=0.4)


def test_a_geotiff_tells_its_size_unless_in_degrees(tmp_path):
    write_tiff(tmp_path / "m.tif", samples(), scale=(0.2, 0.2), keys=METRES)
    matches(build(tmp_path / "m.tif", size_m=None))
    write_tiff(tmp_path / "d.tif", samples(), scale=(0.2, 0.2), keys=DEGREES)
    with pytest.raises(WorldError, match=r"does not contain its size in metres: set world.size_m"):
        build(tmp_path / "d.tif", size_m=None)
    matches(build(tmp_path / "d.tif"))


@pytest.mark.parametrize(
    "options", [{"compression": "zlib"}, {"tile": (16, 16)}, {"bigtiff": True}, {"byteorder": ">"}]
)
def test_tiff_of_other_layouts(tmp_path, options):
    write_tiff(tmp_path / "m.tif", samples().astype(np.float32), **options)
    matches(build(tmp_path / "m.tif"))


def test_bands_after_the_first_are_left_out(tmp_path):
    write_tiff(
        tmp_path / "m.tif",
        np.stack([samples(), samples() * 9]),
        photometric="minisblack",
        planarconfig="separate",
    )
    with pytest.warns(WorldWarning, match="several bands"):
        matches(build(tmp_path / "m.tif"))


@pytest.mark.parametrize("missing", [-9999.0, np.nan, -3.4e38])
def test_samples_without_a_height_are_filled_smoothly(tmp_path, missing):
    values = samples()
    values[30:36, 40:48] = missing
    write_tiff(tmp_path / "m.tif", values, missing="-9999")
    with pytest.warns(WorldWarning, match=r"0.6% of its samples have no height"):
        matches(build(tmp_path / "m.tif"), tolerance=0.15)


def test_relief_and_lowest_point_of_metric_maps_can_be_set(tmp_path):
    np.save(tmp_path / "m.npy", samples() + 1200.0)
    world = build(tmp_path / "m.npy", relief_m=2.0)
    assert (world.terrain.heights.min(), world.terrain.heights.max()) == pytest.approx((0.0, 2.0))
    world = build(tmp_path / "m.npy", lowest_m=0.0)
    assert world.terrain.heights.min() == pytest.approx(0.0)
    assert np.ptp(world.terrain.heights) == pytest.approx(np.ptp(samples()), abs=1e-6)


def test_spacing_and_pixels_that_are_not_square(tmp_path):
    np.save(tmp_path / "m.npy", samples(81, 51))
    matches(build(tmp_path / "m.npy"), tolerance=0.012)
    np.save(tmp_path / "f.npy", samples())
    coarse = build(tmp_path / "f.npy", spacing_m=0.5)
    assert coarse.terrain.spacing_m == 0.5
    matches(coarse, tolerance=0.02)
    with pytest.raises(WorldError, match="makes more than"):
        build(tmp_path / "f.npy", spacing_m=0.01)


def test_a_large_map_is_made_coarser(tmp_path):
    np.save(tmp_path / "m.npy", samples(1601, 2001).astype(np.float32))
    world = build(tmp_path / "m.npy")
    assert 350_000 < world.terrain.heights.size <= 400_000
    xy = np.random.default_rng(0).uniform([-9.5, -7.5], [9.5, 7.5], (500, 2))
    assert np.abs(world.terrain.height(xy) - ground_height(xy)).max() < 0.01


def test_what_is_no_map_is_refused_in_words(tmp_path):
    def refused(name: str, data: bytes, match: str) -> None:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(WorldError, match=match) as caught:
            build(tmp_path / name, relief_m=1.0)
        assert len(str(caught.value).splitlines()) <= 2

    noise = np.random.default_rng(0).bytes(4000)
    refused("m.asc", b"1 2 3", "has the ending .asc; heights are read from .tif, .tiff, .png, .npy")
    for name in ("m.tif", "m.png", "m.npy"):
        refused(name, noise, "no height map that can be read")
        refused(name, b"", "no height map that can be read")
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (4000000, 4000000), }"
    header += b" " * (118 - len(header) - 1) + b"\n"
    refused(
        "huge.npy",
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header,
        "claims numbers of shape .4000000, 4000000., and is too short",
    )
    header = header.replace(b"<f8", b"|O ").replace(b"(4000000, 4000000)", b"(4, 4)            ")
    refused(
        "code.npy",
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header,
        "no height map that can be read",
    )
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0)
    refused("bomb.png", png + b"\0" * 60, "no height map that can be read")
    np.save(tmp_path / "line.npy", np.zeros(9))
    with pytest.raises(WorldError, match=r"samples of shape \(9,\)"):
        build(tmp_path / "line.npy")
    np.save(tmp_path / "nan.npy", np.full((9, 9), np.nan))
    with pytest.raises(WorldError, match="no sample with a height"):
        build(tmp_path / "nan.npy")
    with pytest.raises(WorldError, match="there is no file"):
        build(tmp_path / "none.npy")
    np.save(tmp_path / "m.npy", samples())
    with pytest.raises(WorldError, match=r"set world.size_m"):
        build(tmp_path / "m.npy", size_m=None)
    with pytest.raises(WorldError, match=r"a map of 0.1 by 16 m cannot be a world"):
        build(tmp_path / "m.npy", size_m=(0.1, 16))


def test_a_tiff_that_claims_more_than_it_holds_is_refused(tmp_path):
    write_tiff(tmp_path / "m.tif", samples(64, 64))
    data = bytearray((tmp_path / "m.tif").read_bytes())
    with tifffile.TiffFile(tmp_path / "m.tif") as file:
        offset = file.pages[0].tags["ImageLength"].offset
    for rows in (5_000, 60_000):
        data[offset + 8 : offset + 10] = struct.pack("<H", rows)
        (tmp_path / "c.tif").write_bytes(bytes(data))
        with pytest.raises(WorldError, match=r"claims|samples"):
            build(tmp_path / "c.tif")


@pytest.mark.parametrize(
    "wrong", [{"path": ""}, {"spacing_m": 0}, {"relief_m": 0}, {"size_m": (1,)}, {"friction": 9}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        HeightmapConf(**({"path": "x"} | wrong))


@pytest.mark.skipif(not SHARED_WORLDS.is_dir(), reason="the worlds of others are not here")
def test_the_mars_yard():
    path = SHARED_WORLDS / "marsyard2022_terrain" / "dem" / "marsyard2022_terrain_hm.tif"
    world = build(path, size_m=(50.0, 50.0))
    assert world.terrain.heights.shape == (257, 257)
    assert world.extent == (-25, 25, -25, 25)
    assert world.terrain.heights.min() == pytest.approx(0.0144, abs=1e-3)
    assert world.terrain.heights.max() == pytest.approx(4.8208, abs=1e-3)
    grid = np.arange(-24.95, 25, 0.1)
    slope = np.rad2deg(world.terrain.slope(np.stack(np.meshgrid(grid, grid), axis=-1)))
    np.testing.assert_allclose(np.percentile(slope, [50, 90, 99]), [10.8, 27.5, 58.0], atol=1.0)
    place = Spawner(world, SpawnConf(), 0.45).sample(np.random.default_rng(0))
    assert np.rad2deg(world.terrain.slope(np.array([place.x, place.y]))) <= 25.0
    simulation = rover_in(world)
    for _ in range(20):
        act(simulation)
    position = motion_of_group(simulation).position_w[0]
    assert 0.0 < float(position[2] - world.terrain.height(position[:2])) < 0.5
    simulation.close()
