"""What is seen: the nearest surface at sample positions on rows of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster
from tracer.intersection import Bools, Triple, box_hit, sphere_hit
from tracer.pencil import Outlines, Spans, expand
from tracer.scene import Floats, Ints, Surfaces

__all__ = ["Hits", "Samples", "View", "grid", "visible"]

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5


@dataclass(frozen=True, slots=True)
class Samples:
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
    y, x = np.arange(top, bottom) + 0.5, np.arange(left, right) + 0.5
    return Samples(y, np.repeat(np.arange(y.size), columns), np.tile(x, y.size), columns)


@dataclass(frozen=True, slots=True)
class View:
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


@dataclass(frozen=True, slots=True)
class Hits:
    """What is seen, one entry for each sample that meets a surface.

    Attributes
    ----------
    sample, owner : (n,)
        Which sample, and which object it sees (spheres first).
    face : (n,)
        Of a box, the axis of the face; 3 for spheres.
    t : (n,)
        Distance in units of the direction's length.
    direction, p, n : three (n,)
        The ray's direction (not normalised), the point, put back onto the
        surface, and the unit normal towards the eye.
    """

    sample: Ints
    owner: Ints
    face: Ints
    t: Floats
    direction: Triple
    p: Triple
    n: Triple


def visible(view: View, samples: Samples) -> Hits:
    """Nearest surface at each sample; of exactly equal ones the first in the file."""
    balls = _sphere_fragments(view, samples)
    boxes = _box_fragments(view, samples)
    nearest = np.full(samples.x.size, np.inf)
    np.minimum.at(nearest, balls.sample, balls.t)
    np.minimum.at(nearest, boxes.sample, boxes.t)
    balls = balls.take(np.flatnonzero((balls.t == nearest[balls.sample]) & (balls.t < np.inf)))
    boxes = boxes.take(np.flatnonzero((boxes.t == nearest[boxes.sample]) & (boxes.t < np.inf)))
    spheres = len(view.surfaces.radius)
    if balls.t.size + boxes.t.size > np.count_nonzero(nearest < np.inf):
        order = np.concatenate([view.order[balls.owner], view.order[boxes.owner + spheres]])
        sample = np.concatenate([balls.sample, boxes.sample])
        ranked = np.lexsort((order, sample))
        first = np.zeros(sample.size, dtype=np.bool_)
        first[ranked] = np.diff(sample[ranked], prepend=-1) != 0
        boxes = boxes.take(np.flatnonzero(first[balls.t.size :]))
        balls = balls.take(np.flatnonzero(first[: balls.t.size]))
    p, n = _on_spheres(view, balls)
    q, m = _on_boxes(view, boxes)
    return Hits(
        np.concatenate([balls.sample, boxes.sample]),
        np.concatenate([balls.owner, boxes.owner + spheres]),
        np.concatenate([balls.face, boxes.face]),
        np.concatenate([balls.t, boxes.t]),
        _join(balls.direction, boxes.direction),
        _join(p, q),
        _join(n, m),
    )


@dataclass(frozen=True, slots=True)
class _Fragments:
    """Pairs (sample, object): where a ray meets an object, whatever is before it."""

    sample: Ints
    owner: Ints
    face: Ints
    t: Floats
    direction: Triple

    def take(self, index: Ints) -> _Fragments:
        x, y, z = self.direction
        return _Fragments(
            self.sample[index],
            self.owner[index],
            self.face[index],
            self.t[index],
            (x[index], y[index], z[index]),
        )


def _sphere_fragments(view: View, samples: Samples) -> _Fragments:
    raster, lines = view.raster, view.outlines
    spans = lines.sphere_spans(samples.y, _PAD)
    start, counts = samples.within(spans)
    # What is constant along a row is computed once a span.
    g = raster.down(samples.y[spans.row])
    hypot = np.sqrt(g * g + raster.depth * raster.depth)
    u, v, w = (m[spans.owner] for m in lines.center)
    radius = lines.radius[spans.owner]
    aside = (v * raster.depth - w * g) / hypot
    ahead = (v * g + w * raster.depth) / hypot
    chord2 = (radius - aside) * (radius + aside)
    span, place = expand(counts)
    sample = start[span] + place
    s = raster.across(samples.x[sample])
    t = sphere_hit(
        s, hypot[span], u[span], ahead[span], chord2[span], lines.power[spans.owner][span]
    )
    face = np.full(sample.size, 3)
    return _Fragments(sample, spans.owner[span], face, t, _directions(raster, s, g, span))


def _box_fragments(view: View, samples: Samples) -> _Fragments:
    raster, surfaces = view.raster, view.surfaces
    spans = view.outlines.box_spans(samples.y, _PAD)
    start, counts = samples.within(spans)
    span, place = expand(counts)
    sample = start[span] + place
    s = raster.across(samples.x[sample])
    d = _directions(raster, s, raster.down(samples.y[spans.row]), span)
    low = surfaces.min_pt[spans.owner] - raster.eye
    high = surfaces.max_pt[spans.owner] - raster.eye
    t, face = box_hit(
        d,
        (low[:, 0][span], low[:, 1][span], low[:, 2][span]),
        (high[:, 0][span], high[:, 1][span], high[:, 2][span]),
    )
    return _Fragments(sample, spans.owner[span], face, t, d)


def _directions(raster: Raster, s: Floats, g: Floats, span: Ints) -> Triple:
    """Ray directions in the scene's axes, from (s, g, depth) in the camera's."""
    u, v, w = raster.axes.tolist()
    x, y, z = (s * u[k] + (g * v[k] + raster.depth * w[k])[span] for k in range(3))
    return x, y, z


def _on_spheres(view: View, hits: _Fragments) -> tuple[Triple, Triple]:
    """Points and normals; the point is c + r n, so that it lies on the sphere."""
    surfaces, eye = view.surfaces, view.raster.eye.tolist()
    radius = surfaces.radius[hits.owner]
    inverse = 1 / surfaces.radius[hits.owner]
    flip = np.where(view.eye_inside[hits.owner], -1.0, 1.0)
    p, n = [], []
    for k, d in enumerate(hits.direction):
        center = surfaces.center[:, k]
        normal = (hits.t * d - (center - eye[k])[hits.owner]) * inverse
        p.append(center[hits.owner] + radius * normal)
        n.append(flip * normal)
    return (p[0], p[1], p[2]), (n[0], n[1], n[2])


def _on_boxes(view: View, hits: _Fragments) -> tuple[Triple, Triple]:
    """Points and normals; the point's coordinate is exactly that of the face."""
    surfaces, eye = view.surfaces, view.raster.eye.tolist()
    inside = view.eye_inside[hits.owner + len(surfaces.radius)]
    p = [eye[k] + hits.t * d for k, d in enumerate(hits.direction)]
    n = [np.zeros(hits.t.size) for _ in range(3)]
    for k, d in enumerate(hits.direction):
        at = np.flatnonzero(hits.face == k)
        owner = hits.owner[at]
        backward = d[at] < 0
        p[k][at] = np.where(
            backward != inside[at], surfaces.max_pt[owner, k], surfaces.min_pt[owner, k]
        )
        n[k][at] = np.where(backward, 1.0, -1.0)
    return (p[0], p[1], p[2]), (n[0], n[1], n[2])


def _join(a: Triple, b: Triple) -> Triple:
    x, y, z = (np.concatenate([i, j]) for i, j in zip(a, b, strict=True))
    return x, y, z
