"""Shading: the radiance that hits reflect to the eye, summed over the lights that reach them.

Each light adds I (kd max(0, n.l) + ks (n.h)^p) (see `light_geometry` for the model and its
symbols).  All radiance is linear RGB.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, find
from tracer.geometry.shape import NO_AXIS
from tracer.trace.hits import Hits
from tracer.trace.light_geometry import LightGeometry

# Number of different values of `Hits.face_axis`, which is a part of `Shading.visibility_ids`.
_FACE_AXES = NO_AXIS + 1


class ChannelRadiance(NamedTuple):
    """The radiance of hits in one color channel, summed over the lights."""

    channel: int  # 0 for red, 1 for green, 2 for blue
    diffuse: Shaped[Floats, "n"]
    specular: Shaped[Floats, "n"]


class Shading:
    """The radiance that n hits reflect towards the eye, summed over lights that are added."""

    # For each hit, an integer that encodes the object, the axis of its face, and the lights that
    # are visible from the hit.  The array is empty unless `with_ids` is true.
    visibility_ids: Shaped[Ints, "ids"]

    def __init__(self, hits: Hits, *, with_ids: bool) -> None:
        self._hits = hits
        self._with_ids = with_ids
        self._is_glossy = hits.get_object_values(hits.scene.is_glossy)
        # Sums over lights of I n.l and of I (n.h)^p in each color channel.  The first is None
        # before the first light, and the second before the first highlight.
        self._diffuse_sum: Floats | None = None
        self._specular_sum: Floats | None = None
        self.visibility_ids = np.zeros(0, dtype=np.intp)
        if with_ids:
            self.visibility_ids = _FACE_AXES * hits.hit_object + hits.face_axis

    def add(self, geometry: LightGeometry, is_lit: Shaped[Bools, "lights n"]) -> None:
        """Add the reflected light of a batch of lights.

        `is_lit` is True where the light reaches the hit, because the surface faces the light and
        nothing blocks it.  The lights must be added in the order of the scene, because the order
        affects `visibility_ids`.
        """
        for light_index, is_hit_lit in enumerate(is_lit):
            if self._with_ids:
                # Multiplying by an odd number never shifts a light's bit out of the integer, so
                # all lights affect the id, even if there are more lights than bits.
                self.visibility_ids = self.visibility_ids * 3 + is_hit_lit
            if is_hit_lit.any():
                self._add_light(geometry, light_index, is_hit_lit)

    def _add_light(
        self, geometry: LightGeometry, light_index: int, is_lit: Shaped[Bools, "n"]
    ) -> None:
        """Add what the hits where `is_lit` is True reflect of one light to the two sums."""
        intensity = geometry.lights.intensity[light_index]
        distance = np.sqrt(geometry.squared_distance[light_index])
        cosine = np.zeros(is_lit.size)
        np.divide(geometry.n_dot_l[light_index], distance, out=cosine, where=is_lit)
        self._diffuse_sum = _add_scaled(self._diffuse_sum, intensity, cosine)
        highlight_index = find(is_lit & self._is_glossy)
        if highlight_index.size:
            strength = np.zeros(is_lit.size)
            strength[highlight_index] = geometry.compute_highlight_strength(
                light_index, highlight_index
            )
            self._specular_sum = _add_scaled(self._specular_sum, intensity, strength)

    def compute_channels(self) -> Iterator[ChannelRadiance]:
        """Yield the radiance of all hits, channel by channel; nothing if no hit is lit."""
        if self._diffuse_sum is None:
            return
        hits = self._hits
        scene = hits.scene
        for channel, diffuse_sum in enumerate(self._diffuse_sum):
            diffuse = hits.get_object_values(scene.diffuse[channel]) * diffuse_sum
            if self._specular_sum is None:
                specular = np.zeros(diffuse.size)
            else:
                specular_color = hits.get_object_values(scene.specular[channel])
                specular = specular_color * self._specular_sum[channel]
            yield ChannelRadiance(channel=channel, diffuse=diffuse, specular=specular)

    def compute_radiance(
        self, out: Shaped[Floats, "3 samples"] | None = None
    ) -> Shaped[Floats, "3 samples"]:
        """Compute the radiance towards the eye at each sample; 0 for samples without a hit.

        If `out` is given, it must contain zeros; it is filled and returned.
        """
        out = np.zeros((3, self._hits.samples.size)) if out is None else out
        for channel, diffuse, specular in self.compute_channels():
            out[channel][self._hits.sample_index] = diffuse + specular
        return out


def _add_scaled(
    total: Shaped[Floats, "3 n"] | None,
    intensity: Shaped[Floats, "3"],
    factor: Shaped[Floats, "n"],
) -> Shaped[Floats, "3 n"]:
    """Return `total` plus the intensity of a light, times a factor for each hit.

    Before the first light, `total` is None, which stands for 0.  Otherwise it is changed in place.
    """
    if total is None:  # faster than creating zeros and adding to them
        return np.multiply.outer(intensity, factor)
    for channel_total, channel_intensity in zip(total, intensity.tolist(), strict=True):
        channel_total += channel_intensity * factor
    return total
