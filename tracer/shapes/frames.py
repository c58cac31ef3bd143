"""Bounds of objects in the picture: rectangles, and spans of rows of pixels."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, expand, indices
from tracer.view.camera import Raster

# Bins of rows in which objects are counted.
_BINS = 1 << 14


class Spans(NamedTuple):
    """Intervals of rows of the picture that objects cover.

    Attributes
    ----------
    owner : (n,)
        The object.
    row : (n,)
        Index into the rows asked for; ascending.
    left, right : (n,)
        In pixels from the picture's left edge, clipped to one pixel beyond either edge.
    """

    owner: Ints
    row: Ints
    left: Floats
    right: Floats

    @classmethod
    def clipped(
        cls, owner: Ints, row: Ints, left: Floats, right: Floats, pad: float, width: int
    ) -> Spans:
        """Spans, some of them empty (left > right), widened by `pad` and sorted by row."""
        # One column more than the picture has on either side: antialiasing looks there.  An object
        # that is beside the picture in one row may enter it before the next: its span there is
        # empty, at the rim, but not left out.
        keep = indices(left <= right)
        keep = keep[row[keep].argsort(kind="stable")]
        low, high = -1.0, width + 1.0
        left, right = np.clip(left[keep] - pad, low, high), np.clip(right[keep] + pad, low, high)
        return cls(owner[keep], row[keep], left, right)


class Frames(NamedTuple):
    """Bounding rectangles of objects in the picture.

    Attributes
    ----------
    top, bottom, left, right : (n,)
        In pixels; off the picture, or upside down, for what is not in view.
    """

    top: Floats
    bottom: Floats
    left: Floats
    right: Floats

    @classmethod
    def joined(cls, *frames: Frames) -> Frames:
        """The rectangles of several, one after the other."""
        return cls(*map(np.concatenate, zip(*frames, strict=True)))

    def take(self, index: Bools) -> Frames:
        """Some of them."""
        return Frames(*(m[index] for m in self))

    def in_picture(self, raster: Raster) -> Bools:
        """Objects (n,) that may be seen if nothing hides them."""
        seen: Bools = (self.top <= raster.height + 1) & (self.bottom >= -1)
        return seen & (self.left <= raster.width + 1) & (self.right >= -1)

    def extent(self, raster: Raster) -> Floats:
        """Width plus height (n,), on the window; infinite for what is beside or behind the eye."""
        sides = (self.right - self.left) * raster.step_u + (self.bottom - self.top) * raster.step_v
        return np.where(sides >= 0, sides, np.inf)

    def window(self, raster: Raster) -> tuple[slice, slice]:
        """Rows and columns of the picture outside of which nothing is seen."""
        seen = self.take(self.in_picture(raster))

        def between(low: Floats, high: Floats, size: int) -> slice:
            if not low.size:
                return slice(0, 0)
            first, last = (min(max(m, 0.0), size) for m in (low.min() - 1, high.max() + 1))
            return slice(int(first), ceil(last))

        return (
            between(seen.top, seen.bottom, raster.height),
            between(seen.left, seen.right, raster.width),
        )

    def layers(self, raster: Raster) -> float:
        """Bound on how many objects lie behind a pixel, on average over the fullest row."""
        seen, (width, height) = self.take(self.in_picture(raster)), (raster.width, raster.height)
        wide = np.clip(seen.right + 1, 0, width) - np.clip(seen.left - 1, 0, width)
        first, last = (m.clip(0, height).astype(np.int64) for m in (seen.top, seen.bottom + 1))
        # Rows are counted in bins, mostly of one row each: a picture may be 2^28 rows high.
        bins = min(height, _BINS)
        first, last = first * bins // height, -(-last * bins // height)
        begun, ended = (np.bincount(m, wide, bins + 1) for m in (first, last))
        return float(np.cumsum(begun - ended)[:bins].max() / width)

    def pairs_in_pixel(self, raster: Raster) -> float:
        """Mean number of (ordered) pairs of silhouettes in a pixel, if these lay at random."""
        top, bottom = (m.clip(0, raster.height) for m in (self.top, self.bottom))
        # A silhouette about as wide as it is high runs through some 4 * height pixels.
        share = 4 * np.maximum(bottom - top, 0) / (raster.width * raster.height)
        return float(share.sum() ** 2 - (share**2).sum())

    def rows(self, raster: Raster, rows: Floats, height: float, pad: float) -> tuple[Ints, Ints]:
        """Pairs (object, row) with some of the row in the object's frame, if in the picture."""
        top, bottom = self.top - pad - height, self.bottom + pad
        beside = (self.left - pad > raster.width + 1) | (self.right + pad < -1)
        at = indices((top <= rows[-1]) & (bottom >= rows[0]) & ~beside)
        first = rows.searchsorted(top[at])
        last = rows.searchsorted(bottom[at], side="right")
        which, row = expand(np.maximum(last - first, 0), first)
        return at[which], row
