"""Visibility: the nearest surface at sample positions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, changes, indices, ranges, spread
from tracer.view.samples import Samples, Scattered
from tracer.view.view import Group, Shape, View, Visible

# Pixels along each side of the squares at whose borders runs of scattered samples end.
_TILE = 4.0


def visible(view: View, samples: Samples) -> Visible:
    """The nearest surface at each sample; at exactly equal distances, the first in the file."""
    groups = _fragments(view, samples)
    return _hits(view, samples, _seen(view, groups, _nearest(samples, groups)))


def visible_and_hidden(view: View, samples: Samples) -> tuple[Visible, Visible]:
    """The `visible` surfaces, and all that are hidden behind them."""
    groups = _fragments(view, samples)
    nearest = _nearest(samples, groups)
    hidden = [g.where((g.t > nearest.take(g.sample)) & (g.t < np.inf)) for g in groups]
    seen = _seen(view, groups, nearest)
    return _hits(view, samples, seen), _hits(view, samples, hidden)


class _Fragments(NamedTuple):
    """Pairs (sample, object): where rays meet objects, hidden or not.

    Attributes
    ----------
    shape : Spheres or Boxes
    counts : (spans,), or None
        Spans are samples that follow each other in one row, paired with one object; None if each
        has one sample.
    owner : (spans,)
        An object of that shape.
    g : (spans,)
        The second component of the rays' directions.
    sample, s, t : (n,)
        Which sample, the first component of its ray's direction, and the distance in
        units of the direction's length, infinite for a miss.
    detail : (n,)
        See `Spheres.hit`.
    """

    shape: Shape
    counts: Ints | None
    owner: Ints
    g: Floats
    sample: Ints
    s: Floats
    t: Floats
    detail: NDArray[Any]

    def where(self, mask: Bools) -> _Fragments:
        """The pairs where the mask holds."""
        index = indices(mask)
        if index.size == mask.size:
            return self
        shape, counts, owner, g, *pairs = self
        if counts is None:
            owner, g = owner.take(index), g.take(index)
        else:
            counts = np.diff(index.searchsorted(counts.cumsum()), prepend=0)
        return _Fragments(shape, counts, owner, g, *(values.take(index) for values in pairs))

    def runs(self, samples: Samples, ahead: Floats) -> Ints:
        """The first hit of each run, see `Group`; `ahead` (n,): how far ahead of the eye they are.

        Runs of scattered samples end at the borders of squares and of octaves of depth: towards a
        horizon neighbours are far apart, and a packet of them would meet all objects.
        """
        begins = changes(self.detail) if self.shape.flat else np.zeros(ahead.size, dtype=np.bool_)
        if self.counts is None:
            x, y = samples.at(self.sample)
            begins |= changes(self.owner, np.floor(y), np.floor(x / _TILE), np.frexp(ahead)[1])
        else:
            begins[(self.counts.cumsum() - self.counts)[self.counts > 0]] = True
            begins[1:] |= np.diff(self.sample) > 1  # what hides samples in between
        return indices(begins)


def _fragments(view: View, samples: Samples) -> list[_Fragments]:
    """Find all pairs of samples and objects that spans do not rule out, for each shape."""
    raster, found = view.raster, []
    s, down = samples.across(raster), raster.down(samples.y)
    for shape in view.shapes:
        owner, row, first, counts = samples.covered(shape, view)
        sample = first if counts is None else ranges(first, counts)
        g, across = down.take(row), s.take(sample)
        t, detail = shape.hit(raster, owner, g, across, counts)
        found.append(_Fragments(shape, counts, owner, g, sample, across, t, detail))
    return found


def _nearest(samples: Samples, groups: list[_Fragments]) -> Floats:
    """The distance (n,) of each sample's nearest fragment."""
    # Larger than any distance, and less than the infinity of what misses.
    nearest = np.full(samples.size, np.finfo(np.float64).max)
    for group in groups:
        np.minimum.at(nearest, group.sample, group.t)
    return nearest


def _seen(view: View, groups: list[_Fragments], nearest: Floats) -> list[_Fragments]:
    """Of all fragments those that are seen, given the distance of each sample's nearest."""
    first = [group.where(group.t == nearest.take(group.sample)) for group in groups]
    if sum(g.t.size for g in first) == np.count_nonzero(nearest < np.finfo(np.float64).max):
        return first
    # Of those that share a sample, the first in the file.
    index = view.surfaces.file_index
    places = [spread(index.take(g.owner), g.counts) for g in first]
    least = np.full(nearest.size, index.size)
    for group, place in zip(first, places, strict=True):
        np.minimum.at(least, group.sample, place)
    return [g.where(m == least.take(g.sample)) for g, m in zip(first, places, strict=True)]


def _hits(view: View, samples: Samples, fragments: list[_Fragments]) -> Visible:
    """Visible of fragments that are seen."""
    raster = view.raster
    parts = [part for part in fragments if part.t.size]
    ends = np.cumsum([0] + [part.t.size for part in parts]).tolist()
    p, groups, none = np.empty((3, ends[-1])), [], np.zeros(0, dtype=np.intp)
    for part, start, end in zip(parts, ends, ends[1:], strict=False):
        here = p[:, start:end]
        np.multiply(part.t, part.s, out=here[0])
        np.multiply(part.t, spread(part.g, part.counts), out=here[1])
        np.multiply(part.t, raster.depth, out=here[2])
        first = part.runs(samples, here[2])
        counts, owner = np.diff(first, append=end - start), spread(part.owner, part.counts)[first]
        surface = part.shape.surface(raster, owner, counts, here, part.t, part.detail)
        groups.append(Group(part.shape, slice(start, end), part.sample, counts, owner, *surface))
    first = np.concatenate([none, [0], *(group.counts for group in groups)]).cumsum()
    sample = np.concatenate([none, *(group.sample for group in groups)])
    x, y = samples.at(sample.take(first[:-1]))
    return Visible(
        view=view,
        p=p,
        groups=groups,
        sample=sample,
        first=first,
        owner=np.concatenate([none, *(group.owner for group in groups)]),
        row=y.astype(np.intp),
        column=x.astype(np.intp),
        scattered=isinstance(samples, Scattered),
    )
