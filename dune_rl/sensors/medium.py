"""What a LiDAR's beams meet on their way: haze, which loses returns and gives false ones, and tall grass."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.foliage import BatchedFoliage, Foliage
from dune_rl.rendering.participating_media import BeamMedia, ParticipatingMedia, grass_albedo
from dune_rl.rendering.scenery import Segment, luminance
from dune_rl.sensors.draws import draw, uniform
from dune_rl.sensors.sensor import Mount, mount_position
from dune_rl.state.state import GroupState

# Beam and receiver hardly overlap any nearer.
_OVERLAP_M = 0.5
# The false returns of an endless beam, were nothing lost on the way, are extinction times this: a choice,
# by which one beam in twenty gives one where visibility is 50 m.
_BACKSCATTER_M = 0.8
_TABLE = 512
# How bright haze looks beside matt surfaces.
_HAZE_LUMINANCE = 0.05


class RangeEffect(Protocol):
    """Something that changes ranges; what it ends has a `segment`, None where things stay as they are."""

    @property
    def segment(self) -> Segment | None:
        """The segment of what ends a beam earlier."""
        ...

    @property
    def luminance(self) -> float:
        """Brightness of what ends a beam earlier."""
        ...

    def applied(self, ranges: Floats, now: GroupState) -> Floats:
        """`ranges` (M, N) [m] of N beams on each rover, as they are then; they depend on the moment alone."""
        ...


class InHaze:
    """Beams in fog or dust of `extinction` [1/m].

    The light of a return falls by exp(-2 * extinction * range), Beer and Lambert's law there and back, beside
    the inverse square of the LiDAR equation. A receiver that needs one photon, where q = (range_m / range)²
    is the mean number that makes returns from `range_m` as likely as not in clear air, misses it with a
    chance of 2^-q. So of those that return in clear air, (1 - 2^(-q * exp(-2 * extinction * range))) / (1 -
    2^-q) still do.

    The haze itself gives a false return nearer than the true one where its own first photon comes from: after
    Rasshofer, Spies and Spies (2011), from range r at a rate that goes as extinction * exp(-2 * extinction *
    r) / r² beyond the overlap of beam and receiver. What is lost in haze leaves `range_m`, as what never was
    there.
    """

    segment: Segment | None = Segment.SKY
    luminance = _HAZE_LUMINANCE

    def __init__(self, extinction: float, name: str, range_m: float, min_range_m: float) -> None:
        self._extinction, self._name, self._range_m = extinction, name, np.float32(range_m)
        start = max(_OVERLAP_M, min_range_m)
        self._places = np.linspace(start, max(range_m, start), _TABLE)
        rate = extinction * np.exp(-2 * extinction * self._places) / self._places**2
        rate *= _BACKSCATTER_M * _OVERLAP_M
        steps = np.diff(self._places) * (rate[1:] + rate[:-1]) / 2
        # Mean number of photons from nearer than each place.
        self._photons = np.concatenate([[0.0], np.cumsum(steps)])

    def applied(self, ranges: Floats, now: GroupState) -> Floats:
        """`ranges` (M, N) [m] in the haze."""
        chance = draw(uniform, now.episode, f"{self._name} haze loss", ranges.shape[1])
        seen = np.where(chance < self.return_share(ranges), ranges, self._range_m)
        chance = draw(uniform, now.episode, f"{self._name} backscatter", ranges.shape[1])
        photons = -np.log1p(-chance)
        false = np.nonzero(photons < self._photons[-1])
        place = np.interp(photons[false], self._photons, self._places).astype(np.float32)
        # Nothing comes from behind what the beam has met.
        seen[false] = np.where(place < ranges[false], place, seen[false])
        return seen

    def return_share(self, ranges: Floats) -> Floats:
        """Share (...) of the returns from `ranges` (...) [m] that come through."""
        photons = np.square(self._range_m / np.maximum(ranges, np.float32(1e-3)))
        left = photons * np.exp(ranges * np.float32(-2 * self._extinction))
        share: Floats = (1.0 - np.exp2(-left)) / (1.0 - np.exp2(-photons))
        return share


class InGrass:
    """Beams of `directions_b` (N, 3) from `mount_b` (3,) that end at a blade, by chance and path length.

    Each step draws anew how deep a beam goes, as blades that move in the wind would have it.
    """

    segment: Segment | None = Segment.VEGETATION

    def __init__(
        self,
        foliage: Foliage | BatchedFoliage,
        name: str,
        directions_b: NDArray[np.floating],
        mount_b: Mount,
        min_range_m: float,
    ) -> None:
        self._foliage, self._name, self._min_range_m = foliage, name, np.float32(min_range_m)
        self._directions_b, self._mount_b = directions_b.astype(np.float32), mount_position(mount_b)
        self.luminance = float(luminance(grass_albedo()))

    def applied(self, ranges: Floats, now: GroupState) -> Floats:
        """`ranges` (M, N) [m], shortened where a blade is met."""
        if self._foliage.none:
            return ranges
        origins = (now.motion.position_w + now.motion.rotation @ self._mount_b).astype(np.float32)
        directions = self._directions_b @ now.motion.rotation.transpose(0, 2, 1).astype(np.float32)
        chance = draw(uniform, now.episode, f"{self._name} grass", ranges.shape[1])
        depths = -np.log1p(-chance)
        met = self._foliage.beam_ranges(origins, directions.reshape(-1, 3), ranges.ravel(), depths.ravel())
        return np.minimum(ranges, np.maximum(met.reshape(ranges.shape), self._min_range_m))


def effects_of(
    air: ParticipatingMedia | BeamMedia,
    name: str,
    directions_b: NDArray[np.floating],
    mount_b: Mount,
    limits_m: tuple[float, float],
) -> list[InGrass | InHaze]:
    """What the air does to beams whose ranges lie between two `limits_m`; `name` tells their draws apart."""
    least, most = limits_m
    found: list[InGrass | InHaze] = []
    if air.foliage is not None:
        found.append(InGrass(air.foliage, name, directions_b, mount_b, least))
    if air.haze is not None:
        found.append(InHaze(air.haze.extinction, name, most, least))
    return found
