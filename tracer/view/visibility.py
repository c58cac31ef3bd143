"""Visibility: the nearest surface at sample positions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Index, Ints, changes, expand, indices, select
from tracer.view.samples import Samples, Scattered
from tracer.view.view import Group, Shape, View, Visible

# Runs of scattered samples end at the borders of squares of so many pixels.
_TILE = 4.0

# With this many samples or more, an object is worth arrays of its own, with its data as numbers.
_LARGE = 16384


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
    owner : int, or (spans,)
        An object of that shape.
    g : (spans,)
        The second component of the rays' directions.
    span : (n,)
        Which span each lies in; of scattered samples, each in its own.
    sample, s, t : (n,)
        Which sample, the first component of its ray's direction, and the distance in
        units of the direction's length, infinite for a miss.
    detail : (n,)
        See `Spheres.hit`.
    """

    shape: Shape
    owner: Index
    g: Floats
    span: Ints
    sample: Ints
    s: Floats
    t: Floats
    detail: NDArray[Any]

    def where(self, mask: Bools) -> _Fragments:
        """The pairs where the mask holds."""
        index = indices(mask)
        if index.size == mask.size:
            return self
        shape, owner, g, *pairs = self
        return _Fragments(shape, owner, g, *(values.take(index) for values in pairs))


def _fragments(view: View, samples: Samples) -> list[_Fragments]:
    """Find all pairs of samples and objects that spans do not rule out."""
    raster, found = view.raster, []
    s, down = samples.across(raster), raster.down(samples.y)
    for shape in view.shapes:
        owners, rows, first, counts = samples.covered(shape, view)
        size = np.bincount(owners, counts, minlength=len(view.surfaces))
        small = indices((size[owners] < _LARGE) & (counts > 0))
        parts: list[tuple[Index, Ints]] = [(owners[small], small)] if small.size else []
        parts += [(i, indices(owners == i)) for i in indices(size >= _LARGE).tolist()]
        for owner, part in parts:
            span, sample = expand(counts[part], first[part])
            g, across = down[rows[part]], s.take(sample)
            t, detail = shape.hit(raster, owner, g, across, span)
            found.append(_Fragments(shape, owner, g, span, sample, across, t, detail))
    return found


def _nearest(samples: Samples, groups: list[_Fragments]) -> Floats:
    """The distance (n,) of each sample's nearest fragment."""
    # Larger than any distance, and less than the infinity of what misses.
    nearest = np.full(samples.size, np.finfo(np.float64).max)
    for group in groups:
        if isinstance(group.owner, int):
            # No sample meets the same object twice, so there is no need for minimum.at.
            nearest[group.sample] = np.minimum(nearest.take(group.sample), group.t)
        else:
            np.minimum.at(nearest, group.sample, group.t)
    return nearest


def _seen(view: View, groups: list[_Fragments], nearest: Floats) -> list[_Fragments]:
    """Of all fragments those that are seen, given the distance of each sample's nearest."""
    first = [group.where(group.t == nearest.take(group.sample)) for group in groups]
    if sum(g.t.size for g in first) == np.count_nonzero(nearest < np.finfo(np.float64).max):
        return first
    # Of those that share a sample, the first in the file.
    index = view.surfaces.file_index
    places = [np.broadcast_to(select(index[g.owner], g.span), g.t.shape) for g in first]
    least = np.full(nearest.size, index.size)
    for group, place in zip(first, places, strict=True):
        np.minimum.at(least, group.sample, place)
    return [g.where(m == least.take(g.sample)) for g, m in zip(first, places, strict=True)]


def _hits(view: View, samples: Samples, fragments: list[_Fragments]) -> Visible:
    """Visible of fragments that are seen."""
    raster = view.raster
    parts = [group for group in fragments if group.t.size]
    ends = np.cumsum([0] + [part.t.size for part in parts]).tolist()
    p, groups = np.empty((3, ends[-1])), []
    for part, start, end in zip(parts, ends, ends[1:], strict=False):
        here, owner, span = p[:, start:end], part.owner, part.span
        np.multiply(part.t, part.s, out=here[0])
        np.multiply(part.t, select(part.g, span), out=here[1])
        np.multiply(part.t, raster.depth, out=here[2])
        surface = part.shape.surface(raster, owner, span, here, part.t, part.detail)
        groups.append(Group(part.shape, slice(start, end), part.sample, owner, span, *surface))
    first, owner, begin = _runs(samples, groups, p[2])
    x, y = samples.at(begin)
    return Visible(
        view=view,
        p=p,
        groups=groups,
        first=np.append(first, p.shape[1]),
        owner=owner,
        row=y.astype(np.intp),
        column=x.astype(np.intp),
        scattered=isinstance(samples, Scattered),
    )


def _runs(samples: Samples, groups: list[Group], ahead: Floats) -> tuple[Ints, Ints, Ints]:
    """Runs of hits, as in `Visible.first`: the first hit, object, and first sample of each.

    `ahead` (n,): how far ahead of the eye hits are.
    """
    none = np.zeros(0, dtype=np.intp)
    firsts, owners, begins = [none], [none], [none]
    for group in groups:
        same: list[Any] = [4 * group.face + group.sign, group.span]
        if isinstance(samples, Scattered):
            tile = np.floor(samples.x[group.sample] / _TILE)
            # Towards a horizon neighbours are far apart: a packet of them would meet all objects.
            octave = np.frexp(ahead[group.part])[1]
            same[1:] = samples.row[group.sample], tile, group.spread(group.owner), octave
        first = indices(changes(*(m for m in same if np.ndim(m))))
        firsts.append(first + group.part.start)
        owners.append(np.broadcast_to(group.spread(group.owner), group.sample.shape)[first])
        begins.append(group.sample[first])
    return np.concatenate(firsts), np.concatenate(owners), np.concatenate(begins)
