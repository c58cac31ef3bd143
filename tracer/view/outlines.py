"""Outlines of objects seen from the eye: where a row of pixels can meet them.

All rays of a picture start at the eye, and those of a pixel row lie in one
plane, so a convex object covers one interval of each row.  `Outlines` has these
intervals in closed form: the two tangents to a disc for a sphere, the
silhouette edges for a box.  What lies outside them is never looked at again.
"""

from __future__ import annotations

from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, cross, dot, each, expand, indices, pick
from tracer.scene.model import Surfaces
from tracer.shapes.intersection import disc_in_row, power_of
from tracer.view.camera import Raster

__all__ = [
    "Frames",
    "Outlines",
    "Spans",
    "box_corners",
    "boxes_around",
    "frames_of",
    "outlines_of",
    "silhouette_planes",
]

# More than all roundings of a plane's coefficients, relative to their size, and relative to what
# they were before most of it cancelled, as it does where an edge is seen nearly end-on.
_ROUNDING, _CANCELLED = 1e-12, 1e-14

# A power smaller than this part of the squared distance is little but rounding, and slopes contain
# its square root, with a relative error that is larger still.
_NEARLY_ON = 1e-14

# An edge that is seen under a smaller angle bounds nothing: its plane is too uncertain.
_LEAST_ANGLE = 1e-10

# Within so many rows of its leftmost or rightmost point a sphere's outline leans to neither side.
_NEARBY = 0.5


class Spans(NamedTuple):
    """Intervals of picture rows that objects cover.

    Attributes
    ----------
    owner : (n,)
        Which sphere or box.
    row : (n,)
        Index into the rows asked for; ascending.
    left, right : (n,)
        In pixels from the picture's left edge, clipped to one pixel beyond either edge.
    """

    owner: Ints
    row: Ints
    left: Floats
    right: Floats


class Frames(NamedTuple):
    """Bounding rectangles in the picture, of all objects: spheres first.

    Attributes
    ----------
    raster : Raster
    top, bottom, left, right : (n,)
        In pixels; off the picture, or upside down, for what is not in view.
    """

    raster: Raster
    top: Floats
    bottom: Floats
    left: Floats
    right: Floats

    def take(self, index: slice | Bools) -> Frames:
        """Some of them."""
        return Frames(self.raster, *(m[index] for m in self[1:]))

    def in_picture(self) -> Bools:
        """Which objects, spheres first, may be seen if nothing hides them."""
        raster, top, bottom, left, right = self
        seen: Bools = (top <= raster.height + 1) & (bottom >= -1)
        return seen & (left <= raster.width + 1) & (right >= -1)

    def extent(self) -> Floats:
        """Width plus height (n,), on the window; infinite for what is beside or behind the eye."""
        raster = self.raster
        sides = (self.right - self.left) * raster.step_u + (self.bottom - self.top) * raster.step_v
        return np.where(sides >= 0, sides, np.inf)

    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the picture outside of which nothing is seen."""
        seen = self.take(self.in_picture())

        def between(low: Floats, high: Floats, size: int) -> slice:
            if not low.size:
                return slice(0, 0)
            first, last = (min(max(m, 0.0), size) for m in (low.min() - 1, high.max() + 1))
            return slice(int(first), ceil(last))

        return (
            between(seen.top, seen.bottom, self.raster.height),
            between(seen.left, seen.right, self.raster.width),
        )

    def in_rows(self) -> Floats:
        """How many objects may be seen in each row of pixels (height,)."""
        return self._over_rows(np.ones(self.top.size))

    def layers(self) -> float:
        """How many objects at most lie behind a pixel, on average over the fullest row."""
        width = self.raster.width
        wide = np.clip(self.right + 1, 0, width) - np.clip(self.left - 1, 0, width)
        return float(self._over_rows(wide).max() / width)

    def _over_rows(self, weight: Floats) -> Floats:
        """Total weight (height,) of the objects that may be seen in each row of pixels."""
        height, seen = self.raster.height, self.in_picture()
        first, last = (
            np.bincount(m[seen].clip(0, height).astype(np.intp), weight[seen], height + 1)
            for m in (self.top, self.bottom + 1)
        )
        return np.asarray(np.cumsum(first - last)[:height])

    def pairs_in_pixel(self) -> float:
        """Mean number of (ordered) pairs of outlines in a pixel, if outlines lay at random."""
        top, bottom = (m.clip(0, self.raster.height) for m in (self.top, self.bottom))
        # An outline about as wide as it is high runs through some 4 * height pixels.
        share = 4 * np.maximum(bottom - top, 0) / (self.raster.width * self.raster.height)
        return float(share.sum() ** 2 - (share**2).sum())

    def rows(self, rows: Floats, height: float, pad: float) -> tuple[Ints, Ints]:
        """Pairs (object, row) with some of the row in the object's frame, if in the picture."""
        top, bottom = self.top - pad - height, self.bottom + pad
        beside = (self.left - pad > self.raster.width + 1) | (self.right + pad < -1)
        at = indices((top <= rows[-1]) & (bottom >= rows[0]) & ~beside)
        first = rows.searchsorted(top[at])
        last = rows.searchsorted(bottom[at], side="right")
        which, row = expand(np.maximum(last - first, 0), first)
        return at[which], row


class Outlines(NamedTuple):
    """What all rows share: each object's place in the camera's axes.

    Attributes
    ----------
    center, radius, power : three (s,), (s,), (s,)
        Of spheres: seen from the eye, in the camera's axes; power is
        |centre|^2 - radius^2, as in `Disc`.
    planes : three (6, b)
        Of boxes, the planes of their silhouettes, as `_silhouettes` says.
    slack : (6, b)
        By how much rounding may change what these planes say of a ray that meets the box.
    frames : Frames
        Of all objects, spheres first.
    """

    center: Triple
    radius: Floats
    power: Floats
    planes: Triple
    slack: Floats
    frames: Frames

    @property
    def raster(self) -> Raster:
        """The picture's."""
        return self.frames.raster

    def sphere_spans(self, rows: Floats, height: float = 0.0, pad: float = 0.0) -> Spans:
        """Spans of the spheres in rows that begin at `rows` (ascending, pixels from the top).

        `height`: of the rows; 0 for lines.
        """
        frames = self.frames.take(slice(0, self.radius.size))
        owner, row = frames.rows(rows, height, pad)
        left, right = self._sphere_ends(owner, rows[row])
        if height:
            # On the way down an outline goes to the left as far as its leftmost point, then to the
            # right: except where that point is, one of a row's two lines is the limit.
            left_below, right_below = self._sphere_ends(owner, rows[row] + height)
            left, right = np.minimum(left, left_below), np.maximum(right, right_below)
            widest = zip((left, right), (frames.left, frames.right), self.widest(), strict=True)
            for end, frame, place in widest:
                down = place[owner] - rows[row]
                # NaN, the place of what extends without end, is outside of no row.
                at = indices(~((down < -_NEARBY) | (down > height + _NEARBY)))
                end[at] = frame[owner[at]]
        return self._clip(owner, row, left, right, pad)

    def _sphere_ends(self, owner: Ints, y: Floats) -> tuple[Floats, Floats]:
        """Where spheres begin and end on lines at `y`; where they do not, the end comes first."""
        g, center = self.raster.down(y), pick(self.center, owner)
        disc = disc_in_row(g, self.raster.depth, center, self.radius[owner], self.power[owner])
        low, high = _tangents(disc.u, disc.w, disc.chord2, disc.power)
        hypot = np.sqrt(disc.hypot2)
        touched = indices(disc.power == 0)
        if touched.size:
            # The eye is on these: they are seen on their side of the plane that touches them there.
            u, v, w = pick(self.center, owner[touched])
            tilted, level = v * g[touched], w * self.raster.depth
            bound = -(tilted + level + _ROUNDING * (np.abs(tilted) + np.abs(level))) / (u + 0.0)
            bound /= hypot[touched]
            low[touched] = np.fmax(low[touched], np.where(u >= 0, bound, -np.inf))
            high[touched] = np.fmin(high[touched], np.where(u < 0, bound, np.inf))
        return self.raster.column(low * hypot), self.raster.column(high * hypot)

    def box_spans(self, rows: Floats, height: float = 0.0, pad: float = 0.0) -> Spans:
        """Spans of the boxes in rows: see `sphere_spans`."""
        frames = self.frames.take(slice(self.radius.size, None))
        owner, row = frames.rows(rows, height, pad)
        g = self.raster.down(rows)[row]
        low = np.full(g.size, -np.inf)
        high = np.full(g.size, np.inf)
        for k in range(6):
            slope, tilt, level = (m[k][owner] for m in self.planes)
            tilted = tilt * g
            if height:
                # On whichever line of the row more is inside.
                tilted += np.maximum(tilt * (height * self.raster.step_v), 0)
            # Inside, slope * s + tilted + level >= -slack.  With slope 0 (or -0, hence the sum) the
            # bound is infinite: all of the row, or none.
            bound = -(tilted + level + self.slack[k][owner]) / (slope + 0.0)
            np.fmax(low, bound, out=low, where=slope >= 0)
            np.fmin(high, bound, out=high, where=slope < 0)
        left = np.maximum(frames.left[owner], self.raster.column(low))
        right = np.minimum(frames.right[owner], self.raster.column(high))
        return self._clip(owner, row, left, right, pad)

    def widest(self) -> list[Floats]:
        """The heights (s,) at which spheres extend farthest to the left, and to the right.

        In pixels from the top; NaN where they extend without end.  A plane through the eye that
        touches a sphere, and is upright in the picture, does so at the height of the centre.
        """
        raster, (_, v, w) = self.raster, self.center
        heights = []
        for end, side in ((self.frames.left, 1), (self.frames.right, -1)):
            slope = raster.across(end[: v.size])
            ahead = w + side * self.radius * slope / np.sqrt(slope * slope + raster.depth**2)
            heights.append(raster.row(v / (np.where(ahead > 0, ahead, np.nan) / raster.depth)))
        return heights

    def broken(self, surfaces: Surfaces) -> Bools:
        """Boxes (b,) of whose outline a part is unknown, as the eye is too near an edge."""
        missing = ~np.any([m != 0 for m in self.planes], axis=0)
        # Flat boxes have edges of no length, which are none.
        solid = (surfaces.min_pt < surfaces.max_pt).all(axis=1)
        beside = np.isinf(self.frames.left[self.radius.size :])
        broken: Bools = missing.any(axis=0) & ~missing.all(axis=0) & beside & solid
        return broken

    def _clip(self, owner: Ints, row: Ints, left: Floats, right: Floats, pad: float) -> Spans:
        # One column more than the picture has on either side: antialiasing looks there.  An object
        # that is beside the picture in one row may enter it before the next: its span there is
        # empty, at the rim, but not left out.
        keep = indices(left <= right)
        keep = keep[row[keep].argsort(kind="stable")]
        low, high = -1.0, self.raster.width + 1.0
        left, right = np.clip(left[keep] - pad, low, high), np.clip(right[keep] + pad, low, high)
        return Spans(owner[keep], row[keep], left, right)


def frames_of(raster: Raster, surfaces: Surfaces) -> Frames:
    """Where surfaces are in the picture, roughly."""
    corners = _local_corners(raster, surfaces.min_pt, surfaces.max_pt)
    return _frames(raster, raster.to_camera(surfaces.center), surfaces.radius, corners)


def outlines_of(raster: Raster, surfaces: Surfaces) -> Outlines:
    """Project all surfaces onto the picture."""
    center, radius = raster.to_camera(surfaces.center), surfaces.radius
    min_pt, max_pt = surfaces.min_pt, surfaces.max_pt
    corners = _local_corners(raster, min_pt, max_pt)
    frames = _frames(raster, center, radius, corners)
    of_boxes = frames.take(slice(radius.size, None))
    planes, slack = _silhouettes(of_boxes, corners, min_pt, max_pt)
    return Outlines(
        center=center,
        radius=radius,
        power=power_of(np.sqrt(dot(center, center)), radius),
        planes=planes,
        slack=slack,
        frames=frames,
    )


def _frames(raster: Raster, center: Triple, radius: Floats, corners: Triple) -> Frames:
    """Of spheres, and of boxes with corners three (8, b), all seen from the eye."""
    (u, v, w), (x, y, z) = center, corners
    radius2 = radius * radius
    behind, ahead = z.min(axis=0) <= 0, z.max(axis=0) >= 0
    ends = []
    for along, corner, place in ((v, y, raster.row), (u, x, raster.column)):
        low, high = _tangents(along, w, radius2, along * along + w * w - radius2)
        if corner.size:
            slope = corner / z
            most = np.where(behind, np.where(ahead, np.inf, -np.inf), slope.max(axis=0))
            low = np.append(low, np.where(behind, -np.inf, slope.min(axis=0)))
            high = np.append(high, most)
        ends += [place(low * raster.depth), place(high * raster.depth)]
    return Frames(raster, *ends)


def _tangents(along: Floats, ahead: Floats, chord2: Floats, power: Floats) -> tuple[Floats, Floats]:
    """Slopes (along / ahead) between which rays from the origin meet discs.

    Parameters
    ----------
    along, ahead
        The disc's centre.
    chord2, power
        Its squared radius, and its centre's squared distance less that.
    """
    tilt = along * ahead
    root = np.sqrt(chord2 * power)
    divisor = ahead * ahead - chord2
    # Clear of the plane beside the eye: all of the disc is ahead, or all behind.
    clear = divisor >= 0
    # The slopes s solve divisor s^2 - 2 tilt s + rest = 0.  Where the disc nearly touches the plane
    # beside the eye the divisor is as good as zero: only one of the two may be divided by it.
    # Both forms of `rest` are the same number; each is used where it cancels less.
    rest = np.where(clear, along * along - chord2, power - ahead * ahead)
    stable = tilt + np.copysign(root, tilt)
    a, b = stable / divisor, rest / stable
    least, most = np.minimum(a, b), np.maximum(a, b)
    low = np.where(clear, least, np.where(along > 0, most, -np.inf))
    high = np.where(clear, most, np.where(along > 0, np.inf, least))
    # With the eye on the disc, or nearly, any ray may meet it.
    whole = (power <= _NEARLY_ON * (along * along + ahead * ahead)) & (chord2 >= 0)
    # No rays at all: the plane misses the sphere, or the disc lies behind the eye.
    miss = (chord2 < 0) | (clear & (ahead < 0) & ~whole)
    # What rounding left undecided covers the row: wider is always safe.
    low = np.where(whole | np.isnan(low), -np.inf, low)
    high = np.where(whole | np.isnan(high), np.inf, high)
    return np.where(miss, np.inf, low), np.where(miss, -np.inf, high)


def _silhouette_table() -> tuple[Ints, Ints, Ints]:
    """Corner pairs (27, 6) of the silhouette edges a b, by where the eye is; sides of the box.

    A side is 1 where a x b, seen from the eye, points to the box's side of the edge, else -1.

    The eye is below, between or above the two planes of each axis: 27 regions
    (Schmalstieg and Tobler, Real-time bounding box area computation, 1999).
    Corner i has bit k set where it is high along axis k.  Regions with four
    edges repeat the first two; the middle region has none (corners 0 and 0).
    """
    start = np.zeros((27, 6), dtype=np.intp)
    end = np.zeros((27, 6), dtype=np.intp)
    side = np.ones((27, 6), dtype=np.intp)
    for region, code in enumerate(product((-1, 0, 1), repeat=3)):
        pairs = []
        for k, corner in product(range(3), range(8)):
            i, j = (k + 1) % 3, (k + 2) % 3
            outward_i, outward_j = (1 if corner >> m & 1 else -1 for m in (i, j))
            # Of the two faces at an edge along k, one is seen and one is not.
            seen = code[i] == outward_i
            if not corner >> k & 1 and seen != (code[j] == outward_j):
                pairs.append((corner, corner | 1 << k, outward_i * outward_j * (-1) ** seen))
        if pairs:
            start[region], end[region], side[region] = np.transpose((pairs * 2)[:6])
    return start, end, side


_EDGE_START, _EDGE_END, _EDGE_SIDE = _silhouette_table()


def silhouette_planes(
    corners: Triple, apex: Floats, min_pt: Floats, max_pt: Floats
) -> tuple[Triple, tuple[Floats, Floats]]:
    """Planes through an apex and the silhouette edges of boxes seen from there.

    Parameters
    ----------
    corners : three (8, n)
        The boxes' corners seen from the apex, in any axes that are right-handed.
    apex : (3,), or (n, 3)
    min_pt, max_pt : (n, 3)

    Returns
    -------
    normals : three (6, n)
        In the same axes; directions d towards the box have d . normal >= 0.
        Zero, which says nothing, where there is no silhouette (apex inside) or
        an edge is so short, or so nearly end-on, that rounding has a say.
    rounding : two (6, n)
        How much of d . normal that may be: so much for each unit of d's length, and so much more
        for each unit that d lies beside the line to the edge's nearer end, which the plane holds.
    """
    code = (apex > max_pt).astype(np.intp) - (apex < min_pt)
    region = (code + 1) @ np.array([9, 3, 1])
    every = np.arange(len(min_pt))
    start, end = _EDGE_START[region].T, _EDGE_END[region].T
    a = each(lambda m: m[start, every], corners)
    b = each(lambda m: m[end, every], corners)
    # a x b, from the edge and its nearer end: the two ends of what is far away hardly differ.
    a2, b2 = dot(a, a), dot(b, b)
    near = each(lambda a, b: np.asarray(np.where(a2 < b2, a, b)), a, b)
    edge = each(np.subtract, b, a)
    normal = cross(near, edge)
    doubtful = dot(normal, normal) <= _LEAST_ANGLE**2 * a2 * b2
    # Not by where the box's middle is: seen from near a vast box, that is little but rounding.
    sign = np.where(doubtful, 0, _EDGE_SIDE[region].T)
    # What products lose as their sum cancels; then what the edge's ends lose as one is subtracted.
    products = _CANCELLED * np.sqrt(np.minimum(a2, b2) * dot(edge, edge))
    return each(lambda n: sign * n, normal), (products, _CANCELLED * np.sqrt(a2 * b2))


def boxes_around(point: Floats, min_pt: Floats, max_pt: Floats) -> Bools:
    """Which boxes (n,) hold a point (3,), inside or on a face."""
    around = np.ones(len(min_pt), dtype=np.bool_)
    for k, place in enumerate(point.tolist()):
        around &= (min_pt[:, k] <= place) & (place <= max_pt[:, k])
    return around


def box_corners(min_pt: Floats, max_pt: Floats, apex: Floats) -> Triple:
    """Corners seen from an apex: three (8, n); i is high along axis k where bit k of i is set."""
    ends = (min_pt - apex).T, (max_pt - apex).T
    x, y, z = (np.array([ends[i >> k & 1][k] for i in range(8)]) for k in range(3))
    return x, y, z


def _local_corners(raster: Raster, min_pt: Floats, max_pt: Floats) -> Triple:
    """`box_corners` seen from the eye, in the camera's axes."""
    ends = (np.array([min_pt, max_pt]) - raster.eye).transpose(2, 0, 1)

    def component(axis: list[float]) -> Floats:
        # The four corners in each of the two planes across an axis share one product.
        x, y, z = (end * a for end, a in zip(ends, axis, strict=True))
        return np.asarray(x + y[:, None] + z[:, None, None]).reshape(8, -1)

    u, v, w = map(component, raster.axes.tolist())
    return u, v, w


def _silhouettes(
    frames: Frames, corners: Triple, min_pt: Floats, max_pt: Floats
) -> tuple[Triple, Floats]:
    """Planes (6, n) through the eye and silhouette edges of boxes, given their `_local_corners`.

    A plane is three coefficients: slope, tilt and level of
    slope * s + tilt * g + level >= 0 inside, with the ray (s, g, depth).  By how much rounding may
    change that, for rays that meet the box, comes last.
    """
    raster = frames.raster
    if not len(min_pt):
        nothing = np.zeros((6, 0))
        return (nothing, nothing, nothing), nothing
    planes, (rounding, beside) = silhouette_planes(corners, raster.eye, min_pt, max_pt)
    slope, tilt, level = planes
    # A box is seen from inside on its side of the faces that the eye is on.
    for box in indices(boxes_around(raster.eye, min_pt, max_pt)).tolist():
        faces = [(k, 1.0) for k in range(3) if min_pt[box, k] == raster.eye[k]]
        faces += [(k, -1.0) for k in range(3) if max_pt[box, k] == raster.eye[k]]
        if not faces:
            continue
        for number in range(6):
            k, sign = faces[number % len(faces)]
            for plane, axis in zip((slope, tilt, level), raster.axes, strict=True):
                plane[number, box] = sign * axis[k]
            rounding[number, box] = beside[number, box] = 0
    rounding += _ROUNDING * (np.abs(slope) + np.abs(tilt) + np.abs(level))
    level *= raster.depth
    longest = raster.longest()
    return planes, rounding * longest + beside * np.minimum(frames.extent(), longest)
