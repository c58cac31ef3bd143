"""Cells of the picture: the faces that may be seen in each, what may shade them, and all edges.

Warnock's subdivision (A hidden surface algorithm for computer generated halftone pictures, 1969):
cells inherit the lists of the cell that they are parts of, and drop what is settled.  Where the
picture may change, an *edge function* is zero: a form that is positive to one side of a silhouette,
an intersection of surfaces, a terminator, or an edge of a shadow.  If it has one sign in all of a
cell, it settles a question there; else it is one of the cell's edges.

On a sphere edge functions are u + v s, with u and v at most quadratic, and the root s of `faces`.
They are zero only where u^2 - v^2 s^2 is, which holds no root.

Rounding: linear functions are sums of three products, hence off by 4 e of the sum of these, with
e = 2^-53; the quadratics of cones by 20 e of (r^2 + |c|^2) |q|^2.  They are widened by at least
900 e of that: also for what has been rounded before, centres seen from the eye and planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple, TypeAlias

import numpy as np

from reference.judges.arrays import Bools, Floats, Index, Ints, add_runs, least_sums, segments
from reference.judges.faces import Faces
from reference.judges.forms import ROUNDING, XX, C, Form, R, X, Y, Z, difference

LARGEST = 8
"""Pixels across cells for which what may shade them is listed; no larger ones are filled."""

# In cells that see more faces, their intersections are not looked for.
_MOST_SEEN = 6

# Edge functions are loose if what is not known of them is more than this part of their slope.
_LOOSE = 0.02


class Cells(NamedTuple):
    """Cells (c,) of one size; pairs (p,) of one and a face; rows (q,) of what may shade a pair.

    Attributes
    ----------
    size, x, y : float and (c,)
        In pixels; the cells' middles.
    cell, face, covers : (p,)
        Whether the face covers all of the cell.
    done : (p, lights)
        Lights that reach nothing of the face in the cell, or all: then their radiance is `known`.
    known : Form (8, 3, p)
    light, pair, occluder : (q,)
    """

    size: float
    x: Floats
    y: Floats
    cell: Ints
    face: Ints
    covers: Bools
    done: Bools
    known: Form
    light: Ints
    pair: Ints
    occluder: Ints

    def rows(self, keep: Index) -> Cells:
        """Keep some rows."""
        light, pair, occluder = self.light[keep], self.pair[keep], self.occluder[keep]
        return self._replace(light=light, pair=pair, occluder=occluder)

    def pairs(self, keep: Bools) -> tuple[Cells, Ints]:
        """Keep some pairs and their rows; also the new number of each pair, or -1."""
        number = np.where(keep, keep.cumsum() - 1, -1)
        cell, face, covers = self.cell[keep], self.face[keep], self.covers[keep]
        done, known, pair = self.done[keep], self.known[keep], number[self.pair]
        new = Cells(*self[:3], cell, face, covers, done, known, self.light, pair, self.occluder)
        return new.rows(pair >= 0), number

    def take(self, keep: Bools) -> Cells:
        """Keep some cells and their pairs."""
        cell = np.where(keep, keep.cumsum() - 1, -1)[self.cell]
        return self._replace(x=self.x[keep], y=self.y[keep], cell=cell).pairs(cell >= 0)[0]

    def parts(self) -> Cells:
        """The quarters of every cell."""
        part, off = np.arange(4), self.size / 4
        x = np.add.outer(self.x, (2 * (part & 1) - 1) * off).ravel()
        y = np.add.outer(self.y, (part & 2) * off - off).ravel()
        cell, pair = ((4 * m[:, None] + part).ravel() for m in (self.cell, self.pair))
        face, light, occluder = (m.repeat(4) for m in (self.face, self.light, self.occluder))
        covers, done = self.covers.repeat(4), self.done.repeat(4, axis=0)
        rows = light, pair, occluder
        return Cells(self.size / 2, x, y, cell, face, covers, done, self.known.quarters(), *rows)


def first_cells(faces: Faces, width: int, height: int) -> Cells:
    """Cells as wide or as high as the picture, with all faces and no rows yet."""
    size, none = float(LARGEST), np.zeros(0, dtype=np.intp)
    while size < min(width, height):
        size *= 2
    shape = int(np.ceil(height / size)), int(np.ceil(width / size))
    y, x = (np.indices(shape).reshape(2, -1) + 0.5) * size
    seen = np.flatnonzero(~faces.prepared.repeated[faces.owner])
    cell, face = np.arange(x.size).repeat(seen.size), np.tile(seen, x.size)
    known, done = Form(np.zeros((8, 3, face.size))), faces.dead[:, face].T
    return Cells(size, x, y, cell, face, cell < 0, done, known, none, none, none)


class Shades(NamedTuple):
    """Radiance that lights (n,) add to pairs, where they reach these; sorted by pair and light."""

    pair: Ints
    light: Ints
    radiance: Form

    def take(self, keep: Bools) -> Shades:
        """Some of them."""
        return Shades(self.pair[keep], self.light[keep], self.radiance[keep])


_Edges: TypeAlias = tuple[Ints, Ints, Form]

# Functions u + v s of some of n questions (m,): their forms, u and v, and whether they have edges.
_Function: TypeAlias = tuple[Ints, Form, Form, Form | Floats, Bools | bool]


def _squared(q: Floats) -> Floats:
    """Squares of linear vectors (3 components, 3 coefficients, n): quadratics (6, n)."""
    a, b, c = q.swapaxes(0, 1)
    pairs = ((a, a), (a, b), (a, c), (b, b), (b, c), (c, c))
    return np.array([(p * q).sum(axis=0) * (1 if p is q else 2) for p, q in pairs])


def _cross(c: Floats, q: Floats) -> Floats:
    """c x q of vectors c (3, n) and linear vectors q (3, m, n)."""
    return np.array([c[i - 2] * q[i - 1] - c[i - 1] * q[i - 2] for i in range(3)])


def _cone(
    c: Floats, r: Floats, q: Floats, size: Floats, w: Floats, w_size: Floats
) -> tuple[Form, Floats]:
    """r^2 q^2 - |c x w|^2, and c x w.

    q, w: linear vectors, made of terms no larger than `size` and `w_size`.
    """
    across, m = _cross(c, w), np.zeros((8, c.shape[1]))
    m[:Z] = r * r * _squared(q) - _squared(across)
    c2 = (c * c).sum(axis=0)
    m[R] = r * r * size * np.abs(q).sum(axis=(0, 1)) + c2 * w_size * np.abs(w).sum(axis=(0, 1))
    m[R] *= 8 * ROUNDING
    return Form(m), across


class CellForms:
    """Forms of the rays through cells, and of what they see.

    Attributes
    ----------
    cells : Cells
        Without what is settled.
    edges : list of pairs, lights and forms
        Edge functions (n,) that are zero somewhere in cells; lights: -1 if it is of none.
    square, inverse : Form
        d^2 in each cell, and 1 / t of each pair.
    s2, root : Form
        s^2 and s of each pair, zero of planes.  The Z of s is that of 1 / t.
    """

    def __init__(self, faces: Faces, cells: Cells) -> None:
        self.faces, self.cells, frame = faces, cells, faces.frame
        self._s, self._g = frame.across(cells.x), frame.down(cells.y)
        self._hx, self._hy = 0.5 * cells.size * frame.step_u, 0.5 * cells.size * frame.step_v
        m = np.zeros((8, cells.x.size))
        m[:Z] = _squared(self._rays(np.arange(cells.x.size)))
        m[R] = ROUNDING * m[C]
        self.square, self.edges = Form(m), list[_Edges]()
        self._find_surfaces()
        self._find_terminators()
        self._find_shadows()

    def _rays(self, cell: Ints) -> Floats:
        """d as linear vectors (3, 3, n)."""
        q = np.zeros((3, 3, cell.size))
        q[0, 0], q[1, 0], q[2, 0] = self._s[cell], self._g[cell], self.faces.frame.depth
        q[0, 1], q[1, 2] = self._hx, self._hy
        return q

    def _linear(self, k: Floats, cell: Ints) -> Form:
        """k.d of vectors (3, n), in cells (n,)."""
        m, (u, v, w) = np.zeros((8, cell.size)), k
        m[C] = u * self._s[cell] + v * self._g[cell] + w * self.faces.frame.depth
        m[X], m[Y] = u * self._hx, v * self._hy
        m[R] = ROUNDING * self.faces.frame.longest * np.abs(k).sum(axis=0)
        return Form(m)

    def _function(
        self, at: Ints, pair: Ints, u: Form, v: Form | Floats, edge: Bools | bool
    ) -> _Function:
        """u + v s of pairs."""
        some = np.flatnonzero(~self.faces.flat[self.cells.face[pair]])
        form = Form(u.m.copy())
        form.m[:, some] += (self.root[pair[some]] * v[some]).m
        return at, form, u, v, edge

    def _plane(
        self, at: Ints, pair: Ints, normal: Floats, b: Floats, size: Floats, edge: Bools | bool
    ) -> _Function:
        """normal.d + b / t of pairs, where b is a sum of terms of a `size`."""
        u = self._linear(normal, self.cells.cell[pair]) + self._rootless[pair] * b
        u.m[R] += ROUNDING * size * self._inverse_size[pair]
        return self._function(at, pair, u, b, edge)

    def _settle(
        self, pair: Ints, light: Ints | int, nowhere: Bools, functions: Iterable[_Function]
    ) -> Bools:
        """Whether all functions of a question are positive everywhere in its cell (n,).

        `pair`, `light` (n,): of each question; `nowhere` (n,) is set, function by function, where
        one is positive nowhere.  Where one changes its sign, and none is so, its edge is added.
        """
        everywhere, light = np.ones(pair.size, np.bool_), np.broadcast_to(light, pair.shape)
        found = []
        for at, form, u, v, edge in functions:
            low, high = form.bounds()
            nowhere[at[high <= 0]] = True
            everywhere[at[~(low > 0)]] = False
            some = np.flatnonzero(~(low >= 0) & ~(high <= 0) & edge)
            found.append((at[some], form[some], u[some], v[some]))
        for at, form, u, v in found:
            some = np.flatnonzero(~nowhere[at])
            at, form = at[some], form[some]
            self._drop_root(pair[at], form, u[some], v[some])
            self.edges.append((pair[at], light[at], form))
        return everywhere & ~nowhere

    def _drop_root(self, pair: Ints, form: Form, u: Form, v: Form | Floats) -> None:
        """Turn edge functions u + v s into u^2 - v^2 s^2, where s is not known well."""
        a = np.abs(form.m)
        at = a[Z] + a[R] > _LOOSE * np.maximum(a[X], a[Y])
        at = np.flatnonzero(at & ~self.faces.flat[self.cells.face[pair]])
        u, v = u[at], v[at]
        other = u * u - self.s2[pair[at]] * v * v

        def width(form: Form) -> Floats:
            a = np.abs(form.m)
            return np.asarray(a[XX:].sum(axis=0) / np.maximum(a[X], a[Y]))

        better = width(other) < width(form[at])
        form.m[:, at[better]] = other.m[:, better]

    def _find_surfaces(self) -> None:
        """Find 1 / t = k.d + s of faces; drop those that are not seen, or behind others."""
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        face, cell, flat = cells.face, cells.cell, faces.flat[cells.face]
        ball, chord, root = np.flatnonzero(~flat), *np.zeros((2, 8, face.size))
        q, size = self._rays(cell[ball]), np.full(ball.size, frame.longest)
        cone, _ = _cone(faces.center[:, face[ball]], faces.radius[face[ball]], q, size, q, size)
        chord[:, ball] = cone.m
        self.s2, self.root = Form(chord * faces.w[face] ** 2), Form(root)

        def silhouettes() -> Iterator[_Function]:
            at = np.flatnonzero(~cells.covers & flat)
            for rim in faces.rim:
                form = self._linear(rim[:, face[at]], cell[at])
                yield at, form, form, np.zeros(at.size), True
            at = ball[~cells.covers[ball] & (faces.power[face[ball]] > 0)]
            # That is positive in the opposite direction as well.
            form = self._linear(faces.center[:, face[at]], cell[at])
            yield at, form, form, np.zeros(at.size), False
            form = Form(chord[:, at])
            yield at, form, form, np.zeros(at.size), True

        out = np.zeros(face.size, np.bool_)
        covers = self._settle(np.arange(face.size), -1, out, silhouettes())
        self._rootless = self._linear(faces.k[:, face], cell)
        self.inverse, at = Form(self._rootless.m.copy()), ball[~out[ball]]
        m, rounding = self.s2[at].power(0.5).m, self.inverse.m[R, at]
        # All that is not known of 1 / t is its Z, and that of s is the same but for rounding.
        m[Z], m[R] = m[R] + rounding, rounding
        root[:, at] = m
        self.inverse.m[:, at] += m
        self.inverse.m[R, at] = 0
        out |= self._hidden(covers)
        self.cells, number = cells._replace(covers=covers).pairs(~out)
        seen = [(np.flatnonzero(~out[edges[0]]), edges) for edges in self.edges]
        self.edges = [(number[pair[k]], light[k], form[k]) for k, (pair, light, form) in seen]
        self.inverse, self.s2, self.root = self.inverse[~out], self.s2[~out], self.root[~out]
        self._rootless, self._inverse_size = self._rootless[~out], self.inverse.size

    def _hidden(self, covers: Bools) -> Bools:
        """Pairs that are behind the nearest of those that cover a cell."""
        faces, (_, x, _, cell, face, *_), inverse = self.faces, self.cells, self.inverse
        order, at = faces.order[face], np.flatnonzero(covers)
        at = at[np.lexsort((-order[at], inverse[at].bounds()[0], cell[at]))]
        nearest = np.full(x.size, -1)
        nearest[cell[at]] = at  # of several in a cell, the last
        some = np.flatnonzero((nearest[cell] >= 0) & (nearest[cell] != np.arange(cell.size)))
        other = nearest[cell[some]]
        same = faces.plane[face[some]] == faces.plane[face[other]]
        behind = difference(inverse[some], inverse[other]).bounds()[1] < 0
        hidden = np.zeros(cell.size, np.bool_)
        hidden[some] = np.where(same, order[some] > order[other], behind)
        return hidden

    def _heights(self, pair: Ints, light: Ints) -> _Function:
        """Heights, over t, of lights or the eye (-1) over what pairs see."""
        faces, face = self.faces, self.cells.face[pair]
        a, b, size = faces.a[:, light, face], faces.b[light, face], faces.b_size[light, face]
        return self._plane(np.arange(pair.size), pair, a, b, size, ~faces.flat[face])

    def _find_terminators(self) -> None:
        done = self.cells.done.copy()
        pair, light = np.nonzero(~done)
        up, dark = self._heights(pair, light), np.zeros(pair.size, np.bool_)
        self._settle(pair, light, dark, [up])
        done[pair[dark], light[dark]] = True
        self._up, self.cells = (pair, light, up[1]), self.cells._replace(done=done)

    def _patches(self) -> tuple[Floats, Floats]:
        """Boxes around what pairs see, in the scene's axes: middles and half sizes (3, n)."""
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        least, most = self.inverse.bounds()
        near, far = 1 / most, np.where(least > 0, 1 / least, np.inf)
        low, high = faces.low[:, cells.face], faces.high[:, cells.face]
        for axis, eye in enumerate(frame.eye):
            a, b = self._linear(
                np.tile(frame.axes[:, axis : axis + 1], cells.cell.size), cells.cell
            ).bounds()
            low[axis] = np.fmax(low[axis], eye + np.fmin(a * near, a * far))
            high[axis] = np.fmin(high[axis], eye + np.fmax(b * near, b * far))
        half = np.maximum(0.5 * (high - low), 0) + faces.error[cells.face]
        return 0.5 * (low + high), half

    def listed(self) -> Cells:
        """The cells, with rows of all that may keep lights from what pairs see."""
        cells, found = self.cells, [np.zeros(0, dtype=np.intp)]
        shape = (*cells.done.shape, self.faces.count)
        for rows in self.faces.candidates(*self._patches(), cells.face, ~cells.done.T):
            light, pair, occluder = rows
            found.append(np.ravel_multi_index((pair, light, occluder), shape))
        pair, light, occluder = np.unravel_index(np.unique(np.concatenate(found)), shape)
        return cells._replace(light=light, pair=pair, occluder=occluder)

    def _find_shadows(self) -> None:
        cells = self.cells.rows(~self.cells.done[self.cells.pair, self.cells.light])
        self.cells, lit = cells, np.zeros(cells.pair.size, dtype=np.bool_)
        ball = cells.occluder < self.faces.spheres
        functions = chain(
            self._cones(np.flatnonzero(ball)), self._boxes(np.flatnonzero(~ball), lit)
        )
        shaded = self._settle(cells.pair, cells.light, lit, functions)
        cells.done[cells.pair[shaded], cells.light[shaded]] = True
        self.cells = cells.rows(~lit & ~cells.done[cells.pair, cells.light])

    def _cones(self, row: Ints) -> Iterator[_Function]:
        """Functions that are positive in spheres' shadows.

        A sphere at C from the eye, at c from the light L, shades what is in its cone,
        |c x (p - L)| <= r |p - L|, and behind the plane where that touches it,
        c.(p - L) >= |c|^2 - r^2.  Of that plane, the part in the cone is in the sphere, so it is no
        edge.  Over t, p - L is q - L s with q = d - L k.d; and c x (p - L) is c x (p - C), where
        nothing cancels however far the light: over t, p - C is w - C s with w = d - C k.d.  So the
        first is u + v s, with

            u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
            v = 2 ((c x C).(c x w) - r^2 L.q),

        and the second is c.d - (c.C - r^2) / t.
        """
        faces, cells, pair = self.faces, self.cells, self.cells.pair[row]
        light, ball, k = cells.light[row], cells.occluder[row], faces.k[:, cells.face[pair]]
        c, r2, at = faces.to_center[:, light, ball], faces.radius[ball] ** 2, faces.lights[light].T
        center, rays = faces.center[:, ball], self._rays(cells.cell[pair])
        root = self._rootless.m[:XX, pair]
        q, w = (rays - end[:, None] * root for end in (at, center))
        at2, center2, c2 = ((end * end).sum(axis=0) for end in (at, center, c))
        k1 = np.abs(k).sum(axis=0)
        q_size, w_size = (faces.frame.longest * (1 + np.sqrt(m) * k1 * 2) for m in (at2, center2))
        u, across = _cone(c, faces.radius[ball], q, q_size, w, w_size)
        e, v, s2 = _cross(c, center[:, None]), np.zeros((8, row.size)), self.s2.m[:, pair]
        v[:XX] = 2 * ((e * across).sum(axis=0) - r2 * (at[:, None] * q).sum(axis=0))
        v[R] = 16 * ROUNDING * (c2 * np.sqrt(center2) * w_size + r2 * np.sqrt(at2) * q_size)
        u += Form(s2) * (r2 * at2 - (e * e).sum(axis=(0, 1)))
        u.m[R] += 16 * ROUNDING * (c2 * center2 + r2 * at2) * np.abs(s2).sum(axis=0)
        yield self._function(row, pair, u, Form(v), True)
        terms = c * center
        size = r2 + np.abs(terms).sum(axis=0)
        yield self._plane(row, pair, c, r2 - terms.sum(axis=0), size, False)

    def _boxes(self, row: Ints, lit: Bools) -> Iterator[_Function]:
        """The same of boxes, plane by plane; `lit`: where some has been negative."""
        faces, cells = self.faces, self.cells
        light, box = cells.light, cells.occluder - faces.spheres
        lit[row] = faces.edge_on[light[row], box[row]]
        planes = zip(faces.normal, faces.offset, faces.offset_size, faces.edge, strict=True)
        for normals, offsets, sizes, edge in planes:
            at = row[~lit[row]]
            at = at[normals[:, light[at], box[at]].any(axis=0)]
            of = light[at], box[at]
            normal = normals[:, of[0], of[1]]
            yield self._plane(at, cells.pair[at], normal, offsets[of], sizes[of], edge[of])

    def find_intersections(self) -> Bools:
        """Add edges where surfaces of two pairs may meet; tell cells (c,) that have too many.

        Where p is on one surface, it is on a plane if k.d - 1 / t = 0, and on a second sphere if
        2 (c - c').d + (p' - p) / t = 0, the difference of both equations.
        """
        faces, cells = self.faces, self.cells
        count = np.bincount(cells.cell, minlength=cells.x.size)
        by, start = np.argsort(cells.cell, kind="stable"), np.cumsum(count) - count
        cell, many = cells.cell[by], count > _MOST_SEEN
        before = np.where(many[cell], 0, np.arange(by.size) - start[cell])
        a, b = (by[m] for m in segments(before, start[cell]))
        a, b = np.where(faces.flat[cells.face[a]], (b, a), (a, b))  # planes last
        f, g = cells.face[a], cells.face[b]
        some = np.flatnonzero(
            (faces.owner[f] != faces.owner[g]) & (faces.plane[f] != faces.plane[g])
        )
        a, f, g = a[some], f[some], g[some]
        normal, offset, size = faces.k[:, g], np.full(a.size, -1.0), np.ones(a.size)
        at = np.flatnonzero(~faces.flat[g])
        f, g = f[at], g[at]
        normal[:, at] = 2 * (faces.center[:, f] - faces.center[:, g])
        offset[at], size[at] = (
            faces.power[g] - faces.power[f],
            np.abs(faces.power[[f, g]]).sum(axis=0),
        )
        meeting = self._plane(np.arange(a.size), a, normal, offset, size, True)
        self._settle(a, -1, np.zeros(a.size, np.bool_), [meeting])
        return many

    def settle(self, wanted: Bools, error: float) -> Shades:
        """Shade `wanted` (p,) pairs; add to what is known of them the lights that reach all.

        Left are lights that may not, or the radiance of which is not known within an error.
        """
        shades, cells, edged = self._shade(wanted), self.cells, np.zeros_like(self.cells.done)
        edged[cells.pair, cells.light] = True
        for pair, light, _ in self.edges:
            edged[pair[light >= 0], light[light >= 0]] = True
        off = np.fmin(shades.radiance.radius.max(axis=0), 2 * error)
        off[edged[shades.pair, shades.light]] = 2 * error
        sure = least_sums(shades.pair, off) <= error - cells.known.radius.max(axis=0)[shades.pair]
        pair, light, radiance = shades.take(sure)
        add_runs(cells.known.m, pair, radiance.m)
        cells.done[pair, light] = True
        return shades.take(~sure)

    def _shade(self, wanted: Bools) -> Shades:
        """What lights add to pairs.

        For a light at q, |p - q|^2 / t^2 is d^2 - 2 q.d / t + q^2 / t^2, and (q - p).(-p) / t^2 is
        d^2 - q.d / t; with unit vectors n.h = (n.l + n.v) / |l + v| and |l + v|^2 = 2 + 2 l.v.
        """
        faces, cells, (pair, light, up) = self.faces, self.cells, self._up
        at = np.flatnonzero(~cells.done[pair, light] & wanted[pair])
        pair, light, up = pair[at], light[at], up[at]
        cell, face, q = cells.cell[pair], cells.face[pair], faces.lights[light].T
        square, along = self.square[cell], self.inverse[pair] * self._linear(q, cell)
        inverse2 = (self.inverse * self.inverse)[pair]
        away = (square - along * 2.0 + inverse2 * (q * q).sum(axis=0)).power(-0.5, 1e-300)
        matt, power = (up * away).unit(), faces.prepared.intensities[light].T
        radiance = matt.m[:, None] * (power * faces.diffuse[:, face])
        at = np.flatnonzero(faces.glossy[face])
        seen, which = np.unique(pair[at], return_inverse=True)
        near = self.square.power(-0.5)
        n_dot_v = self._heights(seen, np.full(seen.size, -1))[1] * near[cells.cell[seen]]
        sum2 = (square[at] - along[at]) * (away[at] * near[cell[at]]) * 2.0 + 2.0
        n_dot_h = ((matt[at] + n_dot_v[which]) * sum2.power(-0.5, 1e-300)).unit()
        shiny, specular = n_dot_h.power(faces.exponent[face[at]], 0.0, 1.0).unit(), faces.specular
        radiance[..., at] += shiny.m[:, None] * (power[:, at] * specular[:, face[at]])
        return Shades(pair, light, Form(radiance))
