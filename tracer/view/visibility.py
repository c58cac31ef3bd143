"""What is seen: the nearest surface at sample positions on rows of the picture."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.antialias.lattice import Covered, Samples, Scattered
from tracer.arrays import (
    Bools,
    Floats,
    Index,
    Ints,
    Triple,
    changes,
    dot,
    entries,
    indices,
    pick,
    rows,
    select,
    spread,
)
from tracer.scene.model import Surfaces
from tracer.shapes.intersection import Disc, box_hit, disc_in_row, sphere_hit
from tracer.view.camera import Raster
from tracer.view.outlines import Outlines, boxes_around, outlines_of

__all__ = ["Group", "Hits", "View", "view_of", "visible", "visible_and_behind"]

# With more objects than this behind each other, fewer samples are taken at a time: memory grows
# with the pairs of both.
_LAYERS = 8.0

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5

# Slopes (`View.slope`) of boxes are known, and kept within these limits; spheres have the least.
# What crosses another surface at a slope that is steeper still may be missed.
_LEAST_SLOPE, _MOST_SLOPE = 32.0, 8192.0

# Samples farther apart, in pixels, across or in depth, are no neighbours.
_GAP = 4.0

# In place of the axis of a box's face, for spheres.
_NO_FACE = 3

# With this many samples or more, an object is worth arrays of its own, with its data as numbers.
_LARGE = 16384


class View(NamedTuple):
    """A scene as it is seen from the eye: what all rows share.

    Attributes
    ----------
    raster : Raster
    surfaces : Surfaces
    outlines : Outlines
    eye_inside : (n,)
        Of all surfaces, spheres first, those that are seen from inside.
    slope : (n,)
        Of all surfaces: by how much, at most, the distance from the eye changes from a pixel to the
        next, in sizes of a pixel at that distance; one over the least cosine of incidence.
    layers : float
        How many objects at most lie behind a sample, on average over any row.
    """

    raster: Raster
    surfaces: Surfaces
    outlines: Outlines
    eye_inside: Bools
    slope: Floats
    layers: float

    def at_once(self, samples: int) -> int:
        """How many samples to take at a time: fewer where many objects lie behind each other."""
        return max(1, int(samples * min(1.0, _LAYERS / max(self.layers, 1.0))))


def view_of(raster: Raster, surfaces: Surfaces) -> View:
    """Prepare surfaces to be seen from a raster's eye."""
    outlines, eye = outlines_of(raster, surfaces), raster.eye
    in_box = boxes_around(eye, surfaces.min_pt, surfaces.max_pt)
    eye_inside = np.concatenate([outlines.power <= 0, in_box])
    return View(
        raster=raster,
        surfaces=surfaces,
        outlines=outlines,
        eye_inside=eye_inside,
        slope=_slopes(surfaces, eye, in_box),
        layers=outlines.frames.layers(),
    )


def _slopes(surfaces: Surfaces, eye: Floats, inside: Bools) -> Floats:
    """`View.slope`, from the eye's height over faces and the distance of their farthest corner."""
    low, high = surfaces.min_pt - eye, surfaces.max_pt - eye
    farthest = np.sqrt(np.maximum(low * low, high * high).sum(axis=1))
    heights = np.where(inside[:, None], np.minimum(-low, high), np.maximum(low, -high))
    least = np.min(heights, axis=1, initial=np.inf, where=heights > 0)
    boxes = np.clip(farthest / least, _LEAST_SLOPE, _MOST_SLOPE)
    return np.append(np.full(surfaces.sphere_count, _LEAST_SLOPE), boxes)


class Group(NamedTuple):
    """Some of the hits: on one large object, or on many small ones.

    What is the same for all of them is a number; the rest are arrays (n,).

    Attributes
    ----------
    part : slice
        Their places among the hits.
    sample : (n,)
        Which sample.
    owner : int, or (spans,)
        Which object they see (spheres first): one, or one for each span.
    counts : (spans,), or None
        How many samples each span has: those in one row that see one object; None: one each.
    face
        Of boxes, the axis of the face: a number, or (n,); `_NO_FACE` for spheres.
    sign, level
        Of faces: whether they look up (1) or down (-1) that axis, and their coordinate on it.
    n : three
        The unit normal towards the eye, in the camera's axes.
    lift
        What the intersection yields for free: of boxes n . (eye - p), the eye's height over the
        face; of spheres -n . d, with the ray's direction d.  A number, or (n,).
    """

    part: slice
    sample: Ints
    owner: Index
    counts: Ints | None
    face: Index
    sign: Floats
    level: Floats
    n: Triple
    lift: Floats

    @property
    def flat(self) -> bool:
        """Whether these are faces of boxes."""
        return not (isinstance(self.face, int) and self.face == _NO_FACE)

    def spread(self, values: Any) -> Any:
        """Values of spans, repeated for each of their samples; of one object, as they are."""
        return spread(values, self.counts)

    def of(self, values: NDArray[Any]) -> Any:
        """Values of objects, spheres first, for each of the samples that see them."""
        return self.spread(values[self.owner])


class Hits(NamedTuple):
    """What is seen.

    Attributes
    ----------
    raster : Raster
    p : (3, n)
        Points seen from the eye, in the camera's axes.
    groups : list of Group
    first : (runs + 1,)
        Where each run of points begins, through all groups, and the end of the last.  A run is on
        one object and one face, in one row of samples; or, if these are scattered, in one row of
        pixels, with no gap of more than `_GAP`.
    owner : (runs,)
        The object that each run sees.
    row, column : (runs,)
        The pixel that each begins in.
    scattered : bool
        Whether the samples are.
    """

    raster: Raster
    p: Floats
    groups: list[Group]
    first: Ints
    owner: Ints
    row: Ints
    column: Ints
    scattered: bool

    @property
    def own(self) -> Ints:
        """The object (n,) that each point lies on."""
        return self.owner.repeat(np.diff(self.first))

    @property
    def sample(self) -> Ints:
        """The sample (n,) that each point is seen by."""
        return np.concatenate([np.zeros(0, dtype=np.intp), *(g.sample for g in self.groups)])

    def distance_and_cosine(self, group: Group) -> tuple[Floats, Floats]:
        """Distance from the eye, and cosine between the normal and the way to the eye, (n,)."""
        x, y, z = self.p[:, group.part]
        distance = np.sqrt(dot((x, y, z), (x, y, z)))
        if group.flat:
            return distance, group.lift / distance
        return distance, group.lift * z / (distance * self.raster.depth)

    def points(self, index: Ints | slice) -> Triple:
        """Some of the points in the scene's axes."""
        return self.raster.point_to_scene(rows(self.p, index))


def visible(view: View, samples: Samples) -> Hits:
    """The nearest surface at each sample; at exactly equal distances, the first in the file."""
    groups = _fragments(view, samples)
    return _hits(view, samples, _seen(view, groups, _nearest(samples, groups)))


def visible_and_behind(view: View, samples: Samples, size: float) -> tuple[Hits, Hits]:
    """What is `visible`, and what is so close behind it that the two may cross nearby.

    Nearby is within the cell of the sample, a square of `size` pixels around it.
    """
    groups = _fragments(view, samples)
    nearest = _nearest(samples, groups)
    seen = _seen(view, groups, nearest)
    behind = _close_behind(view, samples, groups, seen, nearest, size)
    return _hits(view, samples, seen), _hits(view, samples, behind)


class _Fragments(NamedTuple):
    """Pairs (sample, object): where rays meet objects, hidden or not.

    Attributes
    ----------
    sphere : bool
    owner : int, or (spans,)
        A sphere or a box, spheres first.
    row, counts : (spans,)
        See `Covered`.
    sample, s, t : (n,)
        Which sample, the first component of its ray's direction, and the distance in
        units of the direction's length, infinite for a miss.
    detail : (n,)
        Of spheres, the `rise` of `sphere_hit`; of boxes, the axis of the face.
    """

    sphere: bool
    owner: Index
    row: Ints
    counts: Ints | None
    sample: Ints
    s: Floats
    t: Floats
    detail: NDArray[Any]

    def where(self, mask: Bools) -> _Fragments:
        """The pairs where the mask holds."""
        return self.take(indices(mask))

    def take(self, index: Ints) -> _Fragments:
        """Some of the pairs, in order."""
        if index.size == self.t.size:
            return self
        if self.counts is None:
            spans = self._replace(owner=select(self.owner, index), row=self.row[index])
        else:
            ends = index.searchsorted(self.counts.cumsum())
            spans = self._replace(counts=np.diff(ends, prepend=0))
        return spans._replace(
            sample=self.sample.take(index),
            s=self.s.take(index),
            t=self.t.take(index),
            detail=self.detail.take(index),
        )

    def of_rows(self, values: Floats) -> Floats:
        """Values of rows, for each of the samples."""
        return spread(values[self.row], self.counts)

    def slope(self, view: View) -> Any:
        """`View.slope`, for each of the samples that see the object."""
        return spread(view.slope[self.owner], self.counts)


def _fragments(view: View, samples: Samples) -> list[_Fragments]:
    """All pairs of samples and objects that the outlines do not rule out."""
    s = samples.across(view.raster)
    return [*_sphere_fragments(view, samples, s), *_box_fragments(view, samples, s)]


def _nearest(samples: Samples, groups: list[_Fragments]) -> Floats | None:
    """The distance (n,) of each sample's nearest fragment; None if all are of one large object."""
    if len(groups) == 1 and isinstance(groups[0].owner, int):
        return None
    # Larger than any distance, and less than the infinity of what misses.
    nearest = np.full(samples.size, np.finfo(np.float64).max)
    for group in groups:
        if isinstance(group.owner, int):
            # No sample meets the same object twice, so there is no need for minimum.at.
            nearest[group.sample] = np.minimum(nearest.take(group.sample), group.t)
        else:
            np.minimum.at(nearest, group.sample, group.t)
    return nearest


def _seen(view: View, groups: list[_Fragments], nearest: Floats | None) -> list[_Fragments]:
    """Of all fragments those that are seen, given the distance of each sample's nearest."""
    if nearest is None:
        # Nothing can hide a lone object.
        return [groups[0].where(groups[0].t < np.inf)]
    first = [group.where(group.t == nearest.take(group.sample)) for group in groups]
    seen = np.count_nonzero(nearest < np.finfo(np.float64).max)
    return first if sum(g.t.size for g in first) == seen else _first_of_equals(view, first)


def _close_behind(
    view: View,
    samples: Samples,
    groups: list[_Fragments],
    seen: list[_Fragments],
    nearest: Floats | None,
    size: float,
) -> list[_Fragments]:
    """Fragments as close behind the nearest of their samples as `visible_and_behind` says."""
    if nearest is None:
        return []
    raster = view.raster
    pixel = size * max(raster.step_u, raster.step_v)
    ahead = np.full(samples.size, _LEAST_SLOPE)
    for group in seen:
        ahead[group.sample] = group.slope(view)
    behind = []
    for group in groups:
        first = nearest[group.sample]
        # From a pixel's centre to where the two cross, each distance changes by at most its slope
        # times half the diagonal.
        step = 2 * pixel * np.maximum(ahead[group.sample], group.slope(view))
        # No direction is shorter than `depth`, so this keeps all that is close enough; the lengths
        # of directions are then computed for these few alone.
        most = first * (1 + 2 * step / raster.depth)
        at = indices((group.t > first) & (group.t < most))
        _, y = samples.at(group.sample[at])
        s, g, first = group.s[at], raster.down(y), first[at]
        gap = (group.t[at] - first) * np.sqrt(s * s + (g * g + raster.depth**2))
        behind.append(group.take(at[gap < step[at] * first]))
    return behind


def _first_of_equals(view: View, groups: list[_Fragments]) -> list[_Fragments]:
    """Of fragments that share a sample, only those of the first object in the file."""
    sample = np.concatenate([group.sample for group in groups])
    place = view.surfaces.file_index
    orders = (spread(place[group.owner], group.counts) for group in groups)
    order = np.concatenate(
        [np.broadcast_to(o, group.t.shape) for o, group in zip(orders, groups, strict=True)]
    )
    ranked = np.lexsort((order, sample))
    first = np.zeros(sample.size, dtype=np.bool_)
    first[ranked] = changes(sample[ranked])
    ends = np.cumsum([group.t.size for group in groups])[:-1]
    return [group.where(mask) for group, mask in zip(groups, np.split(first, ends), strict=True)]


def _groups(covered: Covered, objects: int) -> Iterator[tuple[Index, Covered]]:
    """Where each large object may be seen, then all small ones together.

    Yields
    ------
    owner
        The large object, or the owner (spans,) of each span.
    covered
        The spans.
    """
    size = np.bincount(covered.owner, covered.counts, minlength=objects)
    large = indices(size >= _LARGE).tolist()
    for owner in large:
        yield owner, covered.take(indices(covered.owner == owner))
    rest = size[covered.owner] < _LARGE
    if covered.counts is not None:
        rest &= covered.counts > 0
    if rest.any():
        small = covered.take(indices(rest))
        yield small.owner, small


def _sphere_fragments(view: View, samples: Samples, s: Floats) -> Iterator[_Fragments]:
    raster, outlines = view.raster, view.outlines
    if not outlines.radius.size:
        return
    covered = samples.covered(partial(outlines.sphere_spans, pad=_PAD))
    for owner, part in _groups(covered, outlines.radius.size):
        row, counts, sample = part.row, part.counts, part.samples()
        # What is constant along a row is computed once a span.
        disc = disc_in_row(
            raster.down(samples.y[row]),
            raster.depth,
            pick(outlines.center, owner),
            outlines.radius[owner],
            outlines.power[owner],
        )
        across = s.take(sample)
        t, rise = sphere_hit(across, Disc(*(spread(m, counts) for m in disc)))
        yield _Fragments(True, owner, row, counts, sample, across, t, rise)


def _box_fragments(view: View, samples: Samples, s: Floats) -> Iterator[_Fragments]:
    raster, surfaces = view.raster, view.surfaces
    if not len(surfaces.min_pt):
        return
    covered = samples.covered(partial(view.outlines.box_spans, pad=_PAD))
    eye = raster.eye.tolist()
    for owner, part in _groups(covered, len(surfaces.min_pt)):
        row, counts, sample = part.row, part.counts, part.samples()
        across = s.take(sample)
        t, axis = box_hit(
            _directions(raster, across, raster.down(samples.y[row]), counts),
            _seen_from(eye, surfaces.min_pt[owner], counts),
            _seen_from(eye, surfaces.max_pt[owner], counts),
        )
        owner = owner + surfaces.sphere_count
        yield _Fragments(False, owner, row, counts, sample, across, t, axis)


def _seen_from(eye: list[float], points: Floats, counts: Ints | None) -> Triple:
    """One point (3,), or points (spans, 3) repeated for their samples, seen from the eye."""
    x, y, z = (spread(points[..., k] - eye[k], counts) for k in range(3))
    return x, y, z


def _directions(raster: Raster, s: Floats, g: Floats, counts: Ints | None) -> Triple:
    """Ray directions in the scene's axes, from (s, g, depth) in the camera's."""
    u, v, w = raster.axes.tolist()
    x, y, z = (s * u[k] + spread(g * v[k] + raster.depth * w[k], counts) for k in range(3))
    return x, y, z


def _faces(
    view: View, samples: Samples, group: _Fragments
) -> Iterator[tuple[_Fragments, Index, Floats]]:
    """Fragments, the axis of the face, and whether that looks up (1) or down (-1).

    If there are many of boxes, they are split by face; spheres have `_NO_FACE`.
    """
    if group.sphere:
        yield group, _NO_FACE, np.ones(())
        return
    down = [_looks_down(view, samples, group, axis) for axis in range(3)]
    if group.t.size < _LARGE:
        faces = group.detail.astype(np.intp)
        yield group, faces, np.where(np.choose(faces, down), -1.0, 1.0)
        return
    for axis in range(3):
        on_axis = group.detail == axis
        for sign, looks in ((-1.0, down[axis]), (1.0, ~down[axis])):
            if looks.any():
                part = group.where(on_axis & looks)
                if part.t.size:
                    yield part, axis, np.asarray(sign)


def _looks_down(view: View, samples: Samples, group: _Fragments, axis: int) -> Bools:
    """Whether the faces of boxes that may be seen across an axis look down: one answer, or (n,)."""
    raster, surfaces, owner = view.raster, view.surfaces, group.owner
    inside = view.eye_inside[owner]
    # From outside, the face that looks towards the eye is seen; from inside, that ahead of the ray.
    low = surfaces.min_pt[owner - surfaces.sphere_count, axis]
    down = spread(raster.eye[axis] < low, group.counts)
    if inside.any():
        g = raster.down(samples.y)
        u, v, w = raster.axes[:, axis].tolist()
        ahead = group.s * u + group.of_rows(g * v + raster.depth * w) > 0
        down = np.where(spread(inside, group.counts), ahead, down)
    return np.asarray(down)


def _hit(
    view: View,
    samples: Samples,
    part: _Fragments,
    face: Index,
    sign: Floats,
    place: slice,
    p: Floats,
) -> Group:
    """The hits of one group of fragments; fills in their points `p` (3, n), seen from the eye."""
    raster, outlines, surfaces = view.raster, view.outlines, view.surfaces
    np.multiply(part.t, part.s, out=p[0])
    np.multiply(part.t, part.of_rows(raster.down(samples.y)), out=p[1])
    np.multiply(part.t, raster.depth, out=p[2])
    owner = part.owner
    if part.sphere:
        inverse = spread(1 / outlines.radius[owner], part.counts)
        center = (spread(m[owner], part.counts) for m in outlines.center)
        n = [(q - c) * inverse for q, c in zip(p, center, strict=True)]
        if view.eye_inside[owner].any():
            flip = spread(np.where(view.eye_inside[owner], -1.0, 1.0), part.counts)
            n = [flip * m for m in n]
        level, lift = np.zeros(()), part.detail * inverse
    else:
        # The same face for all boxes, or one for each sample.
        one = isinstance(face, int)
        own = owner if one else spread(owner, part.counts)
        box = own - surfaces.sphere_count
        low, high = entries(surfaces.min_pt, box, face), entries(surfaces.max_pt, box, face)
        inside = view.eye_inside[own]
        level = np.where(inside == (sign > 0), low, high)
        lift = sign * (raster.eye[face] - level)
        if one:
            level, lift = spread(level, part.counts), spread(lift, part.counts)
        n = [np.asarray(sign * axis[face]) for axis in raster.axes]
    return Group(
        part=place,
        sample=part.sample,
        owner=owner,
        counts=part.counts,
        face=face,
        sign=sign,
        level=level,
        n=(n[0], n[1], n[2]),
        lift=lift,
    )


def _hits(view: View, samples: Samples, fragments: list[_Fragments]) -> Hits:
    """Hits of fragments that are seen, in groups, face by face."""
    faces = [face for group in fragments if group.t.size for face in _faces(view, samples, group)]
    ends = np.cumsum([0] + [part.t.size for part, *_ in faces]).tolist()
    p = np.empty((3, ends[-1]))
    groups = []
    for (part, face, sign), start, end in zip(faces, ends, ends[1:], strict=False):
        place = slice(start, end)
        groups.append(_hit(view, samples, part, face, sign, place, p[:, place]))
    first, owner, begin = _runs(view.raster, samples, groups, p[2])
    x, y = samples.at(begin)
    return Hits(
        raster=view.raster,
        p=p,
        groups=groups,
        first=np.append(first, p.shape[1]),
        owner=owner,
        row=y.astype(np.intp),
        column=x.astype(np.intp),
        scattered=isinstance(samples, Scattered),
    )


def _runs(
    raster: Raster, samples: Samples, groups: list[Group], ahead: Floats
) -> tuple[Ints, Ints, Ints]:
    """Runs of hits, as in `Hits.first`: the first hit, the object, and the first sample of each.

    `ahead` (n,): how far ahead of the eye hits are.
    """
    none = np.zeros(0, dtype=np.intp)
    firsts, owners, begins = [none], [none], [none]
    if isinstance(samples, Scattered):
        gap = _GAP * max(raster.step_u, raster.step_v) / raster.depth
        apart = np.diff(samples.x, prepend=0) > _GAP
        piece = np.cumsum(apart | changes(samples.row))
    for group in groups:
        # Of faces, one number for the axis and the side.
        faces = [4 * group.face + group.sign] if np.ndim(group.face) else []
        if group.counts is None:
            w = ahead[group.part]
            jump = np.cumsum(np.abs(np.diff(w, prepend=w[:1])) > gap * w)
            first = _starts([0], piece[group.sample], jump, group.owner, *faces)
            owner = select(group.owner, first)
        else:
            span = indices(group.counts)
            first, owner = (group.counts.cumsum() - group.counts)[span], select(group.owner, span)
            if faces:
                every = _starts(first, *faces)
                owner = select(owner, first.searchsorted(every, side="right") - 1)
                first = every
        firsts.append(first + group.part.start)
        owners.append(np.broadcast_to(owner, first.shape))
        begins.append(group.sample[first])
    return np.concatenate(firsts), np.concatenate(owners), np.concatenate(begins)


def _starts(some: Ints | list[int], *numbers: Any) -> Ints:
    """Where any of the numbers (n,) changes, and at `some` places."""
    starts = changes(*(m for m in numbers if np.ndim(m)))
    starts[some] = True
    return indices(starts)
