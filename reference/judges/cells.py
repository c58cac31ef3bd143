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

from reference.judges.arrays import Bools, Floats, Ints, add_runs, segments
from reference.judges.faces import Faces
from reference.judges.forms import ROUNDING, XX, C, Form, R, X, Y, Z, constant, difference

LARGEST = 8
"""Pixels across cells for which what may shade them is listed; no larger ones are filled."""


class Cells(NamedTuple):
    """Cells (c,) of one size; pairs (p,) of one and a face; rows (q,) of what may shade these.

    Attributes
    ----------
    size, x, y : float and (c,)
        In pixels; the cells' middles.
    cell, face, covers : (p,)
        Whether the face covers all of the cell.
    done : (p, lights)
        Lights that reach nothing of the face in the cell, or all: then their radiance is `known`.
    known : Form (8, 3, p)
    rows : (3, q)
        Pairs, lights and occluders.
    """

    size: float
    x: Floats
    y: Floats
    cell: Ints
    face: Ints
    covers: Bools
    done: Bools
    known: Form
    rows: Ints

    def with_rows(self, keep: Bools) -> Cells:
        """Keep some rows."""
        return self._replace(rows=self.rows.compress(keep, axis=1))

    def pairs(self, keep: Bools) -> tuple[Cells, Ints]:
        """Keep some pairs and their rows; also the new number of each pair, or -1."""
        number = np.where(keep, keep.cumsum() - 1, -1)
        cell, face, covers = self.cell[keep], self.face[keep], self.covers[keep]
        pair, light, occluder = self.rows
        new = Cells(*self[:3], cell, face, covers, self.done[keep], self.known[keep],
                    np.array([number[pair], light, occluder]))  # fmt: skip
        return new.with_rows(new.rows[0] >= 0), number

    def take(self, keep: Bools) -> Cells:
        """Keep some cells and their pairs."""
        cell = np.where(keep, keep.cumsum() - 1, -1)[self.cell]
        return self._replace(x=self.x[keep], y=self.y[keep], cell=cell).pairs(cell >= 0)[0]

    @property
    def area(self) -> float:
        """Of all cells."""
        return self.x.size * self.size**2

    def parts(self, width: int, height: int) -> Cells:
        """The quarters of every cell, but those beyond a picture."""
        part, off = np.arange(4), self.size / 4
        x = np.add.outer(self.x, (2 * (part & 1) - 1) * off).ravel()
        y = np.add.outer(self.y, (part & 2) * off - off).ravel()
        face, covers = self.face.repeat(4), self.covers.repeat(4)
        pair, light, occluder = self.rows.repeat(4, axis=1)
        cell = (4 * self.cell[:, None] + part).ravel()
        rows = np.array([4 * pair + np.tile(part, pair.size // 4), light, occluder])
        done, known = self.done.repeat(4, axis=0), self.known.quarters()
        parts = Cells(self.size / 2, x, y, cell, face, covers, done, known, rows)
        inside = (x - off < width) & (y - off < height)
        return parts if inside.all() else parts.take(inside)


def first_cells(faces: Faces, width: int, height: int) -> Cells:
    """Cells that are wider or higher than the picture, with all faces and no rows yet."""
    size = 2.0 * LARGEST
    while size < min(width, height):
        size *= 2
    shape = int(np.ceil(height / size)), int(np.ceil(width / size))
    y, x = (np.indices(shape).reshape(2, -1) + 0.5) * size
    seen = np.flatnonzero(faces.seen)
    cell, face = np.arange(x.size).repeat(seen.size), np.tile(seen, x.size)
    known, rows = Form(np.zeros((8, 3, face.size))), np.zeros((3, 0), dtype=np.intp)
    return Cells(size, x, y, cell, face, cell < 0, faces.dead[:, face].T, known, rows)


class Shades(NamedTuple):
    """Radiance that lights (n,) add to pairs, where they reach these; sorted by pair and light."""

    pair: Ints
    light: Ints
    radiance: Form

    def take(self, keep: Bools) -> Shades:
        """Some of them."""
        return Shades(self.pair[keep], self.light[keep], self.radiance[keep])


# Functions u + v s of some of n questions (m,), and whether they have edges.
_Function: TypeAlias = tuple[Ints, Form, Form | Floats, Bools | bool]


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
    edges : list of pairs, lights and forms u and v
        Edge functions u + v s (n,) that are zero somewhere in cells; lights: -1 if it is of none.
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
        self.square, self.edges = Form(m), list[tuple[Ints, Ints, Form, Form]]()
        self._find_surfaces()
        self._find_terminators()
        self._find_shadows()
        if cells.size <= 1:
            self._find_intersections()

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

    def _half_space(self, pair: Ints, plane: Floats) -> tuple[Form, Floats]:
        """n.d + b / t of half-spaces (5, n) and pairs (n,), as u and v of u + v s."""
        *normal, b, size = plane
        u = self._linear(np.array(normal), self.cells.cell[pair]) + self._rootless[pair] * b
        u.m[R] += ROUNDING * size * self._inverse_size[pair]
        return u, b

    def function(self, pair: Ints, u: Form, v: Form | Floats) -> Form:
        """u + v s of pairs (n,)."""
        m, some = u.m.copy(), np.flatnonzero(~self.faces.flat[self.cells.face[pair]])
        m[:, some] += (self.root[pair[some]] * v[some]).m
        return Form(m)

    def _settle(
        self, pair: Ints, light: Ints | int, nowhere: Bools, functions: Iterable[_Function]
    ) -> Bools:
        """Whether all functions of a question are positive everywhere in its cell (n,).

        `pair`, `light` (n,): of each question; `nowhere` (n,) is set, function by function, where
        one is positive nowhere.  Where one changes its sign, and none is so, it is an edge.
        """
        everywhere, light = np.ones(pair.size, np.bool_), np.broadcast_to(light, pair.shape)
        found = []
        for at, u, v, edge in functions:
            low, high = self.function(pair[at], u, v).bounds()
            nowhere[at[high <= 0]] = True
            everywhere[at[~(low > 0)]] = False
            some = np.flatnonzero(~(low >= 0) & ~(high <= 0) & edge)
            found.append((at[some], u[some], v[some]))
        for at, u, v in found:
            some = np.flatnonzero(~nowhere[at])
            at, v = at[some], v[some]
            v = v if isinstance(v, Form) else constant(v)
            self.edges.append((pair[at], light[at], u[some], v))
        return everywhere & ~nowhere

    def _find_surfaces(self) -> None:
        """Find 1 / t = k.d + s of faces; drop those that are not seen, or behind others."""
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        face, cell, flat = cells.face, cells.cell, faces.flat[cells.face]
        ball, chord, root = np.flatnonzero(~flat), *np.zeros((2, 8, face.size))
        q, size = self._rays(cell[ball]), np.full(ball.size, frame.longest)
        cone, _ = _cone(faces.center[:, face[ball]], faces.radius[face[ball]], q, size, q, size)
        chord[:, ball] = cone.m
        self.s2, self.root = Form(chord * faces.w[face] ** 2), Form(root)

        self._rootless = self.inverse = self._linear(faces.k[:, face], cell)
        self._inverse_size = self.inverse.size

        def silhouettes() -> Iterator[_Function]:
            at = np.flatnonzero(~cells.covers & flat)
            for half_spaces in faces.rim.swapaxes(0, 1):
                yield at, *self._half_space(at, half_spaces[:, face[at]]), True
            at = ball[~cells.covers[ball] & (faces.power[face[ball]] > 0)]
            # That is positive in the opposite direction as well.
            yield at, self._linear(faces.center[:, face[at]], cell[at]), np.zeros(at.size), False
            yield at, Form(chord[:, at]), np.zeros(at.size), True

        out = np.zeros(face.size, np.bool_)
        covers = self._settle(np.arange(face.size), -1, out, silhouettes())
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
        self.edges = [(number[p[k]], light[k], u[k], v[k]) for k, (p, light, u, v) in seen]
        self.inverse, self.s2, self.root = self.inverse[~out], self.s2[~out], self.root[~out]
        self._rootless, self._inverse_size = self._rootless[~out], self.inverse.size

    def _hidden(self, covers: Bools) -> Bools:
        """Pairs that are behind the nearest of those that cover a cell."""
        faces, (_, x, _, cell, face, *_), inverse = self.faces, self.cells, self.inverse
        order = faces.prepared.surfaces.file_index[faces.owner[face]]
        at = np.flatnonzero(covers)
        at = at[np.lexsort((-order[at], inverse[at].bounds()[0], cell[at]))]
        nearest = np.full(x.size, -1)
        nearest[cell[at]] = at  # of several in a cell, the last
        some = np.flatnonzero((nearest[cell] >= 0) & (nearest[cell] != np.arange(cell.size)))
        other = nearest[cell[some]]
        same = (faces.plane[:, face[some]] == faces.plane[:, face[other]]).all(axis=0)
        behind = difference(inverse[some], inverse[other]).bounds()[1] < 0
        hidden = np.zeros(cell.size, np.bool_)
        hidden[some] = np.where(same, order[some] > order[other], behind)
        return hidden

    def _heights(self, pair: Ints, light: Ints) -> tuple[Form, Floats]:
        """Heights, over t, of lights or the eye (-1) over what pairs see."""
        return self._half_space(pair, self.faces.height[:, light, self.cells.face[pair]])

    def _find_terminators(self) -> None:
        curved = ~self.faces.flat[self.cells.face]  # what is behind a plane is dead
        pair, light = np.nonzero(~self.cells.done & curved[:, None])
        dark = np.zeros(pair.size, np.bool_)
        self._settle(pair, light, dark, [(np.arange(pair.size), *self._heights(pair, light), True)])
        self.cells.done[pair[dark], light[dark]] = True

    def _patches(self) -> tuple[Floats, Floats]:
        """Boxes around what pairs see, in the scene's axes: middles and half sizes (3, n)."""
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        rays, half = self._rays(cells.cell), np.array([self._hx, self._hy])
        middle = frame.axes.T @ rays[:, 0]
        half = (np.abs(frame.axes[:2].T) @ half)[:, None]
        a, b, eye = middle - half, middle + half, frame.eye[:, None]
        least, most = self.inverse.bounds()
        near, far = 1 / most, np.where(least > 0, 1 / least, np.inf)
        low, high = faces.bounds[:, :, cells.face]
        low = np.fmax(low, eye + np.fmin(a * near, a * far))
        high = np.fmin(high, eye + np.fmax(b * near, b * far))
        error = faces.prepared.position_error[faces.owner[cells.face]]
        return 0.5 * (low + high), np.maximum(0.5 * (high - low), 0) + error

    def _find_shadows(self) -> None:
        cells = self.cells
        if cells.size == LARGEST:
            rows = self.faces.blockers(*self._patches(), cells.face, ~cells.done.T)
            self.cells = cells = cells._replace(rows=rows)
        pair, light, occluder = cells.rows
        ball, lit = occluder < self.faces.spheres, np.zeros(pair.size, dtype=np.bool_)
        cones, boxes = self._cones(np.flatnonzero(ball)), self._boxes(np.flatnonzero(~ball), lit)
        shaded = self._settle(pair, light, lit, chain(cones, boxes))
        cells.done[pair[shaded], light[shaded]] = True
        self.cells = cells.with_rows(~lit & ~cells.done[pair, light])

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
        faces, cells, (pair, light, ball) = self.faces, self.cells, self.cells.rows[:, row]
        k = faces.k[:, cells.face[pair]]
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
        yield row, u, Form(v), True
        terms = c * center
        beyond = np.array([*c, r2 - terms.sum(axis=0), r2 + np.abs(terms).sum(axis=0)])
        yield row, *self._half_space(pair, beyond), False

    def _boxes(self, row: Ints, lit: Bools) -> Iterator[_Function]:
        """The same of boxes; `lit`: where some has been negative."""
        pair, light, box = self.cells.rows - [[0], [0], [self.faces.spheres]]
        for half_spaces, edge in zip(
            self.faces.shadow.swapaxes(0, 1), self.faces.edge, strict=True
        ):
            at = row[~lit[row]]
            each = half_spaces[:, light[at], box[at]]
            some = each[:4].any(axis=0)
            at = at[some]
            yield at, *self._half_space(pair[at], each[:, some]), edge[light[at], box[at]]

    def _find_intersections(self) -> None:
        """Add edges where surfaces of two pairs may meet.

        Where p is on one surface, it is on a plane if k.p - 1 = 0, and on a second sphere if it is
        on the plane that is the difference of both equations, p^2 - 2 c.p + power = 0.
        """
        faces, cells = self.faces, self.cells
        by = np.argsort(cells.cell, kind="stable")
        first = cells.cell[by].searchsorted(cells.cell[by])
        a, b = (by[m] for m in segments(np.arange(by.size) - first, first))
        a, b = np.where(faces.flat[cells.face[a]], (b, a), (a, b))  # planes last
        f, g = cells.face[a], cells.face[b]
        apart = (faces.plane[:, f] != faces.plane[:, g]).any(axis=0)
        some = np.flatnonzero((faces.owner[f] != faces.owner[g]) & apart)
        a, f, g = a[some], f[some], g[some]
        other, at = faces.surface[:, g], np.flatnonzero(~faces.flat[g])
        other[:, at] += faces.surface[:, f[at]] * [[-1], [-1], [-1], [-1], [1]]
        meeting = np.arange(a.size), *self._half_space(a, other), True
        self._settle(a, -1, np.zeros(a.size, np.bool_), [meeting])

    def edge_functions(self) -> tuple[Ints, Ints, Form]:
        """Pairs, lights and forms of all edges: u + v s, or u^2 - v^2 s^2 if that is better.

        It is where less is not known of it, in proportion to its slope.
        """
        pair, light = (np.concatenate([edge[i] for edge in self.edges]) for i in (0, 1))
        u = Form(np.concatenate([edge[2].m for edge in self.edges], axis=1))
        v = Form(np.concatenate([edge[3].m for edge in self.edges], axis=1))
        form = self.function(pair, u, v)

        def width(form: Form) -> Floats:
            a = np.abs(form.m)
            return np.asarray(a[XX:].sum(axis=0) / np.maximum(a[X], a[Y]))

        at = np.flatnonzero(form.m[Z])
        u, v = u[at], v[at]
        other = u * u - self.s2[pair[at]] * v * v
        better = width(other) < width(form[at])
        form.m[:, at[better]] = other.m[:, better]
        return pair, light, form

    def settle(self, wanted: Bools, error: float) -> Shades:
        """Shade `wanted` (p,) pairs; add to what is known of them the lights that reach all.

        Left are lights that may not, or the radiance of which errs by more than their part of an
        error.
        """
        shades, cells, edged = self._shade(wanted), self.cells, np.zeros_like(self.cells.done)
        edged[cells.rows[0], cells.rows[1]] = True
        for pair, light, *_ in self.edges:
            edged[pair[light >= 0], light[light >= 0]] = True
        sure = ~edged[shades.pair, shades.light]
        sure &= shades.radiance.radius.max(axis=0) <= error / cells.done.shape[1]
        kept, left = shades.take(sure), shades.take(~sure)
        add_runs(cells.known.m, kept.pair, kept.radiance.m)
        cells.done[kept.pair, kept.light] = True
        return left

    def _shade(self, wanted: Bools) -> Shades:
        """What lights add to pairs.

        For a light at q, |p - q|^2 / t^2 is d^2 - 2 q.d / t + q^2 / t^2, and (q - p).(-p) / t^2 is
        d^2 - q.d / t; with unit vectors n.h = (n.l + n.v) / |l + v| and |l + v|^2 = 2 + 2 l.v.
        """
        faces, cells, prepared = self.faces, self.cells, self.faces.prepared
        pair, light = np.nonzero(~cells.done & wanted[:, None])
        up = self.function(pair, *self._heights(pair, light))
        cell, obj, q = cells.cell[pair], faces.owner[cells.face[pair]], faces.lights[light].T
        square, along = self.square[cell], self.inverse[pair] * self._linear(q, cell)
        inverse2 = (self.inverse * self.inverse)[pair]
        away = (square - along * 2.0 + inverse2 * (q * q).sum(axis=0)).power(-0.5, 1e-300)
        matt, power = (up * away).unit(), faces.given.intensity[light].T
        radiance = matt.m[:, None] * (power * prepared.diffuse[:, obj])
        at = np.flatnonzero(prepared.glossy[obj])
        seen, which = np.unique(pair[at], return_inverse=True)
        near = self.square.power(-0.5)
        n_dot_v = self.function(seen, *self._heights(seen, 0 * seen - 1)) * near[cells.cell[seen]]
        sum2 = (square[at] - along[at]) * (away[at] * near[cell[at]]) * 2.0 + 2.0
        n_dot_h = ((matt[at] + n_dot_v[which]) * sum2.power(-0.5, 1e-300)).unit()
        shiny = n_dot_h.power(prepared.exponent[obj[at]], 0.0, 1.0).unit()
        radiance[..., at] += shiny.m[:, None] * (power[:, at] * prepared.specular[:, obj[at]])
        return Shades(pair, light, Form(radiance))
