"""Bounding rectangles of objects in the picture, and estimates that follow from them.

Positions and lengths are in pixels, from the upper left corner of the picture; y points down.
"""

from __future__ import annotations

from math import ceil
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats
from tracer.geometry.camera import CameraFrame

# Rectangles are treated as larger by this length on each side.  It exceeds rounding errors by far.
_MARGIN = 1


class ScreenBounds(NamedTuple):
    """Bounding rectangles of n objects in the picture.

    The rectangle of an object that is not visible is outside the picture, or top > bottom.
    """

    top: Shaped[Floats, "n"]
    bottom: Shaped[Floats, "n"]
    left: Shaped[Floats, "n"]
    right: Shaped[Floats, "n"]

    @classmethod
    def from_slopes(
        cls,
        frame: CameraFrame,
        y_slopes: tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]],
        x_slopes: tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]],
    ) -> ScreenBounds:
        """Compute the rectangles from the least and the greatest slopes of rays that meet objects.

        The y slope of a ray is ray_y / depth, and its x slope is ray_x / depth (see `camera`).
        """
        top, bottom = (frame.to_picture_y(slope * frame.depth) for slope in y_slopes)
        left, right = (frame.to_picture_x(slope * frame.depth) for slope in x_slopes)
        return cls(top=top, bottom=bottom, left=left, right=right)

    def select(self, selection: Shaped[Bools, "n"] | slice) -> ScreenBounds:
        """Select rectangles by mask or slice."""
        return ScreenBounds._make(side[selection] for side in self)

    def is_in_picture(self, frame: CameraFrame) -> Shaped[Bools, "n"]:
        """Test whether the rectangle of each object, with its margin, overlaps the picture.

        If the result is False, then the object is certainly not visible.  If it is True, other
        objects may still hide the object.
        """
        is_in_rows = (self.top <= frame.height + _MARGIN) & (self.bottom >= -_MARGIN)
        is_in_columns = (self.left <= frame.width + _MARGIN) & (self.right >= -_MARGIN)
        overlaps: Bools = is_in_rows & is_in_columns
        return overlaps

    def find_visible_pixels(self, frame: CameraFrame) -> tuple[slice, slice]:
        """Find the rows and the columns of pixels outside which no object is visible.

        Both slices have a start and a stop, and may be empty.
        """
        visible = self.select(self.is_in_picture(frame))
        rows = _find_covered_pixels(visible.top, visible.bottom, frame.height)
        columns = _find_covered_pixels(visible.left, visible.right, frame.width)
        return rows, columns

    def compute_depth_complexity(self, frame: CameraFrame) -> float:
        """Compute an upper bound on the mean number of objects that the rays of a row meet.

        The bound holds for every row of pixels.  Objects behind other objects count, too.
        """
        visible = self.select(self.is_in_picture(frame))
        left = np.clip(visible.left - _MARGIN, 0, frame.width)
        right = np.clip(visible.right + _MARGIN, 0, frame.width)
        covered_width = right - left
        # From row to row, add the widths of objects that begin and subtract those that end.
        order = np.append(visible.top - _MARGIN, visible.bottom + _MARGIN).argsort()
        width_change = np.append(covered_width, -covered_width)[order]
        return float(width_change.cumsum().max(initial=0) / frame.width)

    def estimate_silhouette_pairs(self, frame: CameraFrame) -> float:
        """Estimate how many pairs of silhouettes cross the same pixel, on average over all pixels.

        The pairs (i, j) and (j, i) both count.  Objects are assumed to be as tall as they are wide,
        and to lie at random positions.
        """
        top = self.top.clip(0, frame.height)
        bottom = self.bottom.clip(0, frame.height)
        # A silhouette that is as tall as it is wide crosses about 4 * height pixels.
        crossing_probability = 4 * np.maximum(bottom - top, 0) / (frame.width * frame.height)
        return float(crossing_probability.sum() ** 2 - (crossing_probability**2).sum())


def _find_covered_pixels(
    starts: Shaped[Floats, "n"], stops: Shaped[Floats, "n"], pixel_count: int
) -> slice:
    """Find the smallest slice of pixels that covers all intervals, with their margins.

    Interval i extends from starts[i] to stops[i].  The pixels are numbered from 0 to
    pixel_count - 1, and parts of intervals outside these pixels are ignored.
    """
    start = np.clip(starts.min(initial=np.inf) - _MARGIN, 0, pixel_count)
    stop = np.clip(stops.max(initial=-np.inf) + _MARGIN, 0, pixel_count)
    return slice(int(start), ceil(stop))
