"""What is seen: the nearest surface at sample positions on rows of the picture."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.camera import Raster
from tracer.groups import Bools, Index, Triple, dot, runs, select, spread
from tracer.intersection import box_hit, sphere_hit
from tracer.pencil import Outlines, Spans
from tracer.scene import Floats, Ints, Surfaces

__all__ = ["Group", "Hits", "Samples", "View", "grid", "visible"]

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5

# Surfaces may cross within a pixel if their distance is less than so many pixels' size.
_CLOSE = 8.0

# Samples farther apart, in pixels, are no neighbours.
_GAP = 4.0

# From so many samples on, an object is worth arrays of its own, with its data as numbers.
_LARGE = 16384


class Samples(NamedTuple):
    """Sample positions, row by row, in pixels from the picture's upper left corner.

    Attributes
    ----------
    y : (rows,)
        Ascending.
    row, x : (n,)
        Index into `y`, ascending, and position along the row, ascending in each.
    columns : int
        If positive, every row holds so many samples, a pixel apart; else they
        lie anywhere.
    """

    y: Floats
    row: Ints
    x: Floats
    columns: int = 0

    def within(self, spans: Spans) -> tuple[Ints, Ints]:
        """First sample in each span, and the number of samples there."""
        if self.columns:
            start = np.ceil(spans.left - self.x[0]).astype(np.intp)
            stop = np.floor(spans.right - self.x[0]).astype(np.intp) + 1
            np.clip(start, 0, self.columns, out=start)
            np.clip(stop, 0, self.columns, out=stop)
            base = spans.row * self.columns
            return base + start, np.maximum(stop - start, 0)
        # Rows one after the other on one axis, wide enough apart never to meet.
        stride = 4 * (np.abs(self.x).max(initial=0) + 2)
        key = self.row * stride + self.x
        start = np.searchsorted(key, spans.row * stride + spans.left)
        stop = np.searchsorted(key, spans.row * stride + spans.right, side="right")
        return start, np.maximum(stop - start, 0)


def grid(top: int, bottom: int, left: int, right: int) -> Samples:
    """The centres of a rectangle of pixels."""
    columns = right - left
    y = np.arange(top, bottom, dtype=np.float64) + 0.5
    x = np.arange(left, right, dtype=np.float64) + 0.5
    return Samples(y, np.repeat(np.arange(y.size), columns), np.tile(x, y.size), columns)


class View(NamedTuple):
    """A scene as it is seen from the eye: what all rows share.

    Attributes
    ----------
    raster : Raster
    surfaces : Surfaces
    outlines : Outlines
    eye_inside : (n,)
        Of all surfaces, spheres first, those that are seen from inside.
    order : (n,)
        Their places in the file.
    """

    raster: Raster
    surfaces: Surfaces
    outlines: Outlines
    eye_inside: Bools
    order: Ints


class Group(NamedTuple):
    """Some of the hits: on one large object, or on many small ones.

    What is the same for all of them is a number; the rest are arrays (n,).

    Attributes
    ----------
    part : slice
        Their places among the hits.
    sample : (n,)
        Which sample.
    owner
        Which object it sees (spheres first).
    face
        Of a box, the axis of the face; 3 for spheres.
    t : (n,)
        Distance in units of the direction's length.
    direction, n : three each
        The ray's direction (not normalised), and the unit normal towards the eye.
    first : (runs + 1,)
        Where each run begins: neighbouring samples of one row that see one object.
    """

    part: slice
    sample: Ints
    owner: Index
    face: int
    t: Floats
    direction: Triple
    n: Triple
    first: Ints


class Hits(NamedTuple):
    """What is seen.

    Attributes
    ----------
    p : (3, n)
        Points, put back onto the surface that they lie on.
    groups : list of Group
    first : (runs + 1,)
        Where each run begins, of those of all groups.
    owner : (runs,)
        The object that each run sees.
    row, column : (runs,)
        The pixel that each begins in.
    """

    p: Floats
    groups: list[Group]
    first: Ints
    owner: Ints
    row: Ints
    column: Ints

    @property
    def own(self) -> Ints:
        """The object (n,) that each point lies on."""
        return np.repeat(self.owner, np.diff(self.first))


def visible(view: View, samples: Samples, close: Bools | None = None, size: float = 1.0) -> Hits:
    """Nearest surface at each sample; of exactly equal ones the first in the file.

    `close` (n,), if given, is set where a second surface lies so near behind
    the first that they may change places within `size` pixels.
    """
    groups = [*_sphere_fragments(view, samples), *_box_fragments(view, samples)]
    if len(groups) == 1 and isinstance(groups[0].owner, int):
        # Nothing can hide a lone object.
        groups = [groups[0].where(groups[0].t < np.inf)]
    else:
        groups = _nearest(view, samples, groups, close, size)
    parts = [part for group in groups if group.t.size for part in _faces(group)]
    ends = np.cumsum([0] + [part.t.size for part, _ in parts]).tolist()
    p = np.empty((3, ends[-1]))
    hits = []
    for (part, face), start, end in zip(parts, ends, ends[1:], strict=False):
        of = _on_spheres if part.sphere else _on_boxes
        owner, n = of(view, part, face, p[:, start:end])
        hits.append(
            Group(
                slice(start, end),
                part.sample,
                owner,
                face,
                part.t,
                part.direction,
                n,
                part.first,
            )
        )
    return _hits(samples, p, hits)


class _Fragments(NamedTuple):
    """Pairs (sample, object): where rays meet objects, whatever is before them."""

    sphere: bool
    sample: Ints
    owner: Index
    axis: Ints
    t: Floats
    direction: Triple
    first: Ints

    def where(self, mask: Bools) -> _Fragments:
        """Those where the mask holds."""
        index = np.flatnonzero(mask)
        if index.size == mask.size:
            return self
        x, y, z = self.direction
        return _Fragments(
            self.sphere,
            self.sample[index],
            select(self.owner, index),
            self.axis if self.sphere else self.axis[index],
            self.t[index],
            (x[index], y[index], z[index]),
            np.searchsorted(index, self.first),
        )


def _nearest(
    view: View, samples: Samples, groups: list[_Fragments], close: Bools | None, size: float
) -> list[_Fragments]:
    """Of all fragments those that are seen; sets `close` as `visible` says."""
    # Larger than any distance, and less than the infinity of what misses.
    nearest = np.full(samples.x.size, np.finfo(np.float64).max)
    for i, group in enumerate(groups):
        if isinstance(group.owner, int):
            # No sample meets the same object twice.
            before = nearest[group.sample] if i else np.finfo(np.float64).max
            nearest[group.sample] = np.minimum(before, group.t)
        else:
            np.minimum.at(nearest, group.sample, group.t)
    if close is not None:
        for group in groups:
            first = nearest[group.sample]
            step = _CLOSE * size * max(view.raster.step_u, view.raster.step_v)
            gap = (group.t - first) * np.sqrt(dot(group.direction, group.direction))
            close[group.sample[(gap > 0) & (gap < step * first)]] = True
    groups = [group.where(group.t == nearest[group.sample]) for group in groups]
    seen = np.count_nonzero(nearest < np.finfo(np.float64).max)
    if sum(group.t.size for group in groups) > seen:
        groups = _first_of_equals(view, groups)
    return groups


def _first_of_equals(view: View, groups: list[_Fragments]) -> list[_Fragments]:
    """Of fragments that share a sample, only those of the first object in the file."""
    spheres = len(view.surfaces.radius)
    sample = np.concatenate([group.sample for group in groups])
    orders = (view.order[group.owner + (0 if group.sphere else spheres)] for group in groups)
    order = np.concatenate(
        [np.broadcast_to(o, group.t.shape) for o, group in zip(orders, groups, strict=True)]
    )
    ranked = np.lexsort((order, sample))
    first = np.zeros(sample.size, dtype=np.bool_)
    first[ranked] = np.diff(sample[ranked], prepend=-1) != 0
    ends = np.cumsum([group.t.size for group in groups])[:-1]
    return [group.where(mask) for group, mask in zip(groups, np.split(first, ends), strict=True)]


def _groups(spans: Spans, counts: Ints, objects: int) -> Iterator[tuple[Index, Ints]]:
    """Spans of each large object, then of all small ones together.

    Yields
    ------
    owner
        The large object, or the owner (spans,) of each span.
    spans
        Which spans.
    """
    size = np.bincount(spans.owner, counts, minlength=objects)
    large = np.flatnonzero(size >= _LARGE).tolist()
    for owner in large:
        yield owner, np.flatnonzero(spans.owner == owner)
    rest = np.flatnonzero((size[spans.owner] < _LARGE) & (counts > 0))
    if rest.size:
        yield spans.owner[rest], rest


def _sphere_fragments(view: View, samples: Samples) -> Iterator[_Fragments]:
    raster, lines = view.raster, view.outlines
    spans = lines.sphere_spans(samples.y, _PAD)
    start, counts = samples.within(spans)
    for owner, span in _groups(spans, counts, len(lines.radius)):
        many = counts[span]
        # What is constant along a row is computed once a span.
        g = raster.down(samples.y[spans.row[span]])
        hypot = np.sqrt(g * g + raster.depth * raster.depth)
        u, v, w = (m[owner] for m in lines.center)
        radius = lines.radius[owner]
        aside = (v * raster.depth - w * g) / hypot
        ahead = (v * g + w * raster.depth) / hypot
        chord2 = (radius - aside) * (radius + aside)
        sample = runs(start[span], many)
        s = raster.across(samples.x[sample])
        t = sphere_hit(
            s,
            np.repeat(hypot, many),
            spread(u, many),
            np.repeat(ahead, many),
            np.repeat(chord2, many),
            spread(lines.power[owner], many),
        )
        d = _directions(raster, s, g, many)
        yield _Fragments(True, sample, spread(owner, many), sample, t, d, _first(many))


def _box_fragments(view: View, samples: Samples) -> Iterator[_Fragments]:
    raster, surfaces = view.raster, view.surfaces
    spans = view.outlines.box_spans(samples.y, _PAD)
    start, counts = samples.within(spans)
    eye = raster.eye.tolist()
    for owner, span in _groups(spans, counts, len(surfaces.min_pt)):
        many = counts[span]
        sample = runs(start[span], many)
        g = raster.down(samples.y[spans.row[span]])
        d = _directions(raster, raster.across(samples.x[sample]), g, many)
        t, axis = box_hit(
            d,
            _seen_from(eye, surfaces.min_pt[owner], many),
            _seen_from(eye, surfaces.max_pt[owner], many),
        )
        yield _Fragments(False, sample, spread(owner, many), axis, t, d, _first(many))


def _seen_from(eye: list[float], points: Floats, counts: Ints) -> Triple:
    """One point (3,), or points (spans, 3) each so many times, seen from the eye."""
    x, y, z = (spread(points[..., k] - eye[k], counts) for k in range(3))
    return x, y, z


def _first(counts: Ints) -> Ints:
    """Where each of some runs begins, and where the last ends."""
    return np.concatenate([[0], np.cumsum(counts)])


def _directions(raster: Raster, s: Floats, g: Floats, counts: Ints) -> Triple:
    """Ray directions in the scene's axes, from (s, g, depth) in the camera's."""
    u, v, w = raster.axes.tolist()
    x, y, z = (s * u[k] + np.repeat(g * v[k] + raster.depth * w[k], counts) for k in range(3))
    return x, y, z


def _faces(group: _Fragments) -> Iterator[tuple[_Fragments, int]]:
    """Boxes face by face, each with its axis; spheres as they are, with 3."""
    if group.sphere:
        yield group, 3
        return
    for axis in range(3):
        on_axis = group.axis == axis
        if not on_axis.any():
            continue
        backward = group.direction[axis] < 0
        for mask in (on_axis & backward, on_axis & ~backward):
            part = group.where(mask)
            if part.t.size:
                yield part, axis


def _on_spheres(view: View, part: _Fragments, _: int, p: Floats) -> tuple[Index, Triple]:
    """Objects and normals; fills in the points c + r n, so that they lie on the spheres."""
    surfaces, eye, owner = view.surfaces, view.raster.eye.tolist(), part.owner
    radius = surfaces.radius[owner]
    inverse = 1 / radius
    n = []
    for k, d in enumerate(part.direction):
        center = surfaces.center[owner, k]
        normal = part.t * d
        normal -= center - eye[k]
        normal *= inverse
        np.multiply(radius, normal, out=p[k])
        p[k] += center
        n.append(normal)
    inside = view.eye_inside[owner]
    if inside.any():
        flip = np.where(inside, -1.0, 1.0)
        n = [flip * normal for normal in n]
    return owner, (n[0], n[1], n[2])


def _on_boxes(view: View, part: _Fragments, axis: int, p: Floats) -> tuple[Index, Triple]:
    """Objects and normals; fills in points that lie exactly in a face's plane."""
    surfaces, eye = view.surfaces, view.raster.eye.tolist()
    for k, d in enumerate(part.direction):
        if k != axis:
            np.multiply(part.t, d, out=p[k])
            p[k] += eye[k]
    owner = part.owner + len(surfaces.radius)
    sign = -1.0 if part.direction[axis][0] > 0 else 1.0
    low, high = surfaces.min_pt[part.owner, axis], surfaces.max_pt[part.owner, axis]
    p[axis] = np.where(view.eye_inside[owner] == (sign > 0), low, high)
    n = [np.asarray(sign if k == axis else 0.0) for k in range(3)]
    return owner, (n[0], n[1], n[2])


def _hits(samples: Samples, p: Floats, groups: list[Group]) -> Hits:
    """Put the runs of all groups one after the other."""
    none = np.zeros(0, dtype=np.intp)
    firsts, owners, begins = [none], [none], [none]
    piece = None if samples.columns else np.cumsum(np.diff(samples.x, prepend=0) > _GAP)
    for group in groups:
        first = group.first[np.flatnonzero(np.diff(group.first))]
        if piece is not None:
            # Samples in a row may be far apart.
            gaps = np.flatnonzero(np.diff(piece[group.sample])) + 1
            first = np.union1d(first, gaps)
        firsts.append(first + group.part.start)
        owners.append(np.broadcast_to(select(group.owner, first), first.shape))
        begins.append(group.sample[first])
    begin = np.concatenate(begins)
    return Hits(
        p,
        groups,
        np.append(np.concatenate(firsts), p.shape[1]),
        np.concatenate(owners),
        samples.y[samples.row[begin]].astype(np.intp),
        samples.x[begin].astype(np.intp),
    )
