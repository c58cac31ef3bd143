"""Visibility: the nearest surface at sample positions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, changes, indices, ranges, repeat_runs
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape

# Pixels along each side of the squares at whose borders runs of scattered samples end.
_TILE = 4.0


def nearest_hits(prepared: PreparedScene, samples: Samples) -> Hits:
    """The nearest surface at each sample; at exactly equal distances, the first in the file."""
    groups = _candidates(prepared, samples)
    return _hits(prepared, samples, _seen(prepared, groups, _nearest(samples, groups)))


def nearest_and_hidden(prepared: PreparedScene, samples: Samples) -> tuple[Hits, Hits]:
    """The `nearest_hits`, and the hits hidden behind them."""
    groups = _candidates(prepared, samples)
    nearest = _nearest(samples, groups)
    hidden = [g.where((g.t > nearest.take(g.sample)) & (g.t < np.inf)) for g in groups]
    seen = _seen(prepared, groups, nearest)
    return _hits(prepared, samples, seen), _hits(prepared, samples, hidden)


class _Candidates(NamedTuple):
    """Pairs (sample, object): where rays meet objects, hidden or not.

    Attributes
    ----------
    shape : Spheres or Boxes
    counts : (spans,), or None
        Spans are samples that follow each other in one row, paired with one object; None if each
        has one sample.
    obj : (spans,)
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
    obj: Ints
    g: Floats
    sample: Ints
    s: Floats
    t: Floats
    detail: NDArray[Any]

    def where(self, mask: Bools) -> _Candidates:
        """The pairs where the mask holds."""
        index = indices(mask)
        if index.size == mask.size:
            return self
        shape, counts, obj, g, *pairs = self
        if counts is None:
            obj, g = obj.take(index), g.take(index)
        else:
            counts = np.diff(index.searchsorted(counts.cumsum()), prepend=0)
        return _Candidates(shape, counts, obj, g, *(values.take(index) for values in pairs))

    def runs(self, samples: Samples, frame: CameraFrame, ahead: Floats) -> Ints:
        """The first hit of each run, see `ShapeHits`; `ahead` (n,): their depth before the eye.

        Runs of scattered samples end at the borders of squares and of layers of depth.
        """
        begins = changes(self.detail) if self.shape.flat else np.zeros(ahead.size, dtype=np.bool_)
        if self.counts is None:
            x, y = samples.at(self.sample)
            layer = frame.layer(ahead, _TILE)
            begins |= changes(self.obj, np.floor(y), np.floor(x / _TILE), layer)
        else:
            begins[(self.counts.cumsum() - self.counts)[self.counts > 0]] = True
            begins[1:] |= np.diff(self.sample) > 1  # what hides samples in between
        return indices(begins)


def _candidates(prepared: PreparedScene, samples: Samples) -> list[_Candidates]:
    """Find all pairs of samples and objects that spans do not rule out, for each shape."""
    frame, found = prepared.frame, []
    s, down = samples.across(frame), frame.down(samples.y)
    for shape in prepared.shapes:
        obj, row, first, counts = samples.covered(shape, prepared)
        sample = first if counts is None else ranges(first, counts)
        g, across = down.take(row), s.take(sample)
        t, detail = shape.hit(frame, obj, g, across, counts)
        found.append(_Candidates(shape, counts, obj, g, sample, across, t, detail))
    return found


def _nearest(samples: Samples, groups: list[_Candidates]) -> Floats:
    """The distance (n,) of each sample's nearest candidate."""
    # Larger than any distance, and less than the infinity of what misses.
    nearest = np.full(samples.size, np.finfo(np.float64).max)
    for group in groups:
        np.minimum.at(nearest, group.sample, group.t)
    return nearest


def _seen(prepared: PreparedScene, groups: list[_Candidates], nearest: Floats) -> list[_Candidates]:
    """Of all candidates those that are seen, given the distance of each sample's nearest."""
    first = [group.where(group.t == nearest.take(group.sample)) for group in groups]
    if sum(g.t.size for g in first) == np.count_nonzero(nearest < np.finfo(np.float64).max):
        return first
    # Of those that share a sample, the first in the file.
    index = prepared.surfaces.file_index
    ranks = [repeat_runs(index.take(g.obj), g.counts) for g in first]
    least = np.full(nearest.size, index.size)
    for group, rank in zip(first, ranks, strict=True):
        np.minimum.at(least, group.sample, rank)
    return [g.where(m == least.take(g.sample)) for g, m in zip(first, ranks, strict=True)]


def _hits(prepared: PreparedScene, samples: Samples, candidates: list[_Candidates]) -> Hits:
    """Hits of candidates that are seen."""
    frame = prepared.frame
    parts = [part for part in candidates if part.t.size]
    ends = np.cumsum([0] + [part.t.size for part in parts]).tolist()
    p, groups, none = np.empty((3, ends[-1])), [], np.zeros(0, dtype=np.intp)
    for part, start, end in zip(parts, ends, ends[1:], strict=False):
        here = p[:, start:end]
        np.multiply(part.t, part.s, out=here[0])
        np.multiply(part.t, repeat_runs(part.g, part.counts), out=here[1])
        np.multiply(part.t, frame.depth, out=here[2])
        first = part.runs(samples, frame, here[2])
        counts, obj = np.diff(first, append=end - start), repeat_runs(part.obj, part.counts)[first]
        surface = part.shape.surface(frame, obj, counts, here, part.t, part.detail)
        groups.append(ShapeHits(part.shape, slice(start, end), part.sample, counts, obj, *surface))
    first = np.concatenate([none, [0], *(group.counts for group in groups)]).cumsum()
    sample = np.concatenate([none, *(group.sample for group in groups)])
    obj = np.concatenate([none, *(group.obj for group in groups)])
    return Hits(prepared, samples, p, groups, sample, first, obj)
