"""Positions of samples in the picture: in rows, or anywhere."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, changes, expand
from tracer.view.camera import Raster, Spans

Covered: TypeAlias = tuple[Ints, Ints, Ints, Ints]
"""Spans of samples in which objects may be seen: which object, the index of the span's y among
those of the samples, the first sample, and how many there are."""


class Rows(NamedTuple):
    """Samples in rows, from the picture's upper left corner.

    The unit is the pixel of the raster that gives their rays: for a `Lattice` that is a finer
    one, with the lattice's columns and rows in every pixel of the picture.

    Attributes
    ----------
    y : (rows,)
        Ascending.
    x : (columns,)
        Ascending, one pixel apart.
    shift : (rows,)
        How far each row is moved to the right.
    """

    y: Floats
    x: Floats
    shift: Floats

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size * self.y.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return np.add.outer(self.shift * raster.step_u, raster.across(self.x)).ravel()

    def positions(self) -> tuple[Floats, Floats]:
        """x and y of all samples."""
        return np.add.outer(self.shift, self.x).ravel(), self.y.repeat(self.x.size)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def covered(self, spans: Callable[[Floats, float], Spans]) -> Covered:
        """Spans of objects, given the function from rows and their height to `spans`."""
        owner, row, left, right = spans(self.y, 0.0)
        columns = self.x.size
        first = self.x[0] + self.shift[row]
        start = np.ceil(left - first).astype(np.intp)
        stop = np.floor(right - first).astype(np.intp) + 1
        start.clip(0, columns, out=start)
        stop.clip(0, columns, out=stop)
        return owner, row, row * columns + start, np.maximum(stop - start, 0)


class Scattered(NamedTuple):
    """Samples anywhere, sorted pixel by pixel, and downwards in each.

    Attributes
    ----------
    y, x : (n,)
        In pixels from the picture's upper left corner.
    row : (n,)
        The row of pixels each is in.
    pixel : (n,)
        A number for each pixel: row * (2 * `beside` + 1) + column.
    beside : int
        All columns are less, to either side.
    """

    y: Floats
    x: Floats
    row: Ints
    pixel: Floats
    beside: int

    @classmethod
    def of(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Positions, in any order, as samples; and which position each sample has."""
        row, beside = np.floor(y), ceil(np.abs(x).max(initial=0)) + 1
        pixel = row * (2 * beside + 1) + np.floor(x)
        # One number for pixel and height is sorted several times as fast as three.
        order = np.argsort(pixel + (y - row) / 2, kind="stable")
        return cls(y[order], x[order], row[order].astype(np.intp), pixel[order], beside), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return raster.across(self.x)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        return self.x[index], self.y[index]

    def covered(self, spans: Callable[[Floats, float], Spans]) -> Covered:
        """Spans of objects, given the function from rows and their height to `spans`."""
        tops = self.row[changes(self.row)]
        owner, row, left, right = spans(tops.astype(np.float64), 1.0)
        # Whole pixels: so samples are sorted.
        beside, begin = self.beside, tops[row] * (2 * self.beside + 1)
        first, last = (begin + np.clip(np.floor(m), -beside, beside) for m in (left, right))
        start = self.pixel.searchsorted(first)
        stop = self.pixel.searchsorted(last, side="right")
        span, sample = expand(np.maximum(stop - start, 0), start)
        return owner[span], sample, sample, np.ones_like(sample)


Samples: TypeAlias = Rows | Scattered
"""Positions in the picture through which rays are traced."""
