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

from typing import NamedTuple, TypeAlias

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints, segments
from reference.judges.faces import Faces
from reference.judges.forms import ROUNDING, XX, C, Form, Index, R, X, Y, Z, difference

ROOT = 16
"""Pixels across the largest cells."""

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
    dark : (lights, p)
        Whether a light reaches nothing of the face in the cell.
    light, pair, occluder : (q,)
    """

    size: float
    x: Floats
    y: Floats
    cell: Ints
    face: Ints
    covers: Bools
    dark: Bools
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
        dark, pair = self.dark[:, keep], number[self.pair]
        new = self._replace(cell=cell, face=face, covers=covers, dark=dark, pair=pair)
        return new.rows(new.pair >= 0), number

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
        covers, dark = self.covers.repeat(4), self.dark.repeat(4, axis=1)
        return Cells(self.size / 2, x, y, cell, face, covers, dark, light, pair, occluder)


def root_cells(faces: Faces, width: int, height: int) -> Cells:
    """The largest cells, with all faces that may be seen in them and no rows yet."""
    across, down = -(-width // ROOT), -(-height // ROOT)
    y, x = (m.ravel() * ROOT + ROOT / 2 for m in np.mgrid[:down, :across])
    face, bounds = np.flatnonzero(~faces.prepared.repeated[faces.owner]), faces.prepared.bounds
    ends = np.array(bounds)[:, faces.owner[face]] + [[-1], [1], [-1], [1]]
    most = [[down], [down], [across], [across]]
    top, bottom, left, right = np.floor(np.clip(ends / ROOT, -1, most)).astype(np.intp)
    top, left = np.maximum(top, 0), np.maximum(left, 0)
    tall, wide = np.minimum(bottom, down - 1) - top + 1, np.minimum(right, across - 1) - left + 1
    which, row = segments(np.maximum(tall, 0), top)
    strip, column = segments(np.maximum(wide, 0)[which], left[which])
    cell, face, none = row[strip] * across + column, face[which[strip]], np.zeros(0, dtype=np.intp)
    covers, dark = np.zeros(cell.size, np.bool_), faces.dead[:, None].repeat(cell.size, axis=1)
    return Cells(ROOT, x, y, cell, face, covers, dark, none, none, none)


class Edges(NamedTuple):
    """Edge functions (n,) that are zero somewhere in their cells.

    Attributes
    ----------
    pair, light : (n,)
        The pair that each is of, and the light, or -1.
    terminator : (n,)
        Whether it is the height of the light, over t.
    form : Form
    """

    pair: Ints
    light: Ints
    terminator: Bools
    form: Form


class Shades(NamedTuple):
    """Lights that may reach pairs (n,).

    Attributes
    ----------
    light, pair : (n,)
    matt, shiny : Form
        n.l, and (n.h)^exponent where the face is glossy.
    near : (n,)
        The most that t / |p - light| is.
    """

    light: Ints
    pair: Ints
    matt: Form
    shiny: Form
    near: Floats


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
) -> tuple[Floats, Floats]:
    """r^2 q^2 - |c x w|^2 (8, n), and c x w.

    q, w: linear vectors, made of terms no larger than `size` and `w_size`.
    """
    across, m = _cross(c, w), np.zeros((8, c.shape[1]))
    m[:Z] = r * r * _squared(q) - _squared(across)
    c2 = (c * c).sum(axis=0)
    m[R] = r * r * size * np.abs(q).sum(axis=(0, 1)) + c2 * w_size * np.abs(w).sum(axis=(0, 1))
    m[R] *= 8 * ROUNDING
    return m, across


class CellForms:
    """Forms of the rays through cells, and of what they see.

    Attributes
    ----------
    cells : Cells
        Without what is settled.
    edges : list of Edges
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
        self.square, self.edges = Form(m), list[Edges]()
        self._find_silhouettes()
        self._drop_hidden()
        self._find_terminators()
        self._find_shadows()

    def _rays(self, cell: Ints) -> Floats:
        """d as linear vectors (3, 3, n)."""
        q = np.zeros((3, 3, cell.size))
        q[0, 0], q[1, 0], q[2, 0] = self._s[cell], self._g[cell], self.faces.frame.depth
        q[0, 1], q[1, 2] = self._hx, self._hy
        return q

    def _dot(self, k: Floats, cell: Ints) -> Floats:
        """k.d of vectors (3, n) as linear functions (8, n), without their rounding."""
        m, (u, v, w) = np.zeros((8, cell.size)), k
        m[C] = u * self._s[cell] + v * self._g[cell] + w * self.faces.frame.depth
        m[X], m[Y] = u * self._hx, v * self._hy
        return m

    def _linear(self, k: Floats, cell: Ints) -> Form:
        """k.d of vectors (3, n), in cells (n,)."""
        m = self._dot(k, cell)
        m[R] = ROUNDING * self.faces.frame.longest * np.abs(k).sum(axis=0)
        return Form(m)

    def _on_surface(self, pair: Ints, u: Floats, v: Floats) -> Form:
        """u + v s of pairs; v: numbers (n,) or linear functions (8, n)."""
        m = u.copy()
        at = np.flatnonzero(~self.faces.flat[self.cells.face[pair]])
        s, v = self.root[pair[at]], v[..., at]
        m[:, at] += (s * v if v.ndim == 1 else s.times(v)).m
        return Form(m)

    def _plane(self, pair: Ints, normal: Floats, b: Floats, size: Floats) -> tuple[Form, Floats]:
        """normal.d + b / t of pairs, and its u, for v is b: a sum of terms of a `size`."""
        k, m = self.faces.k[:, self.cells.face[pair]], self._dot(normal, self.cells.cell[pair])
        m[:XX] += b * self._without_root[:, pair]
        m[R] = self.faces.frame.longest * (
            np.abs(normal).sum(axis=0) + size * np.abs(k).sum(axis=0)
        )
        m[R] = ROUNDING * (m[R] + size * self._inverse_size[pair])
        return self._on_surface(pair, m, b), m

    def _add(
        self, pair: Ints, form: Form, light: Ints | None = None, terminator: bool = False
    ) -> None:
        light = np.full(pair.size, -1) if light is None else light
        self.edges.append(Edges(pair, light, np.full(pair.size, terminator), form))

    def _add_rootless(
        self, pair: Ints, form: Form, u: Floats, v: Floats, light: Ints | None = None
    ) -> None:
        """Add edge functions u + v s, or u^2 - v^2 s^2 where s is not known well."""
        a = np.abs(form.m)
        at = a[Z] + a[R] > _LOOSE * np.maximum(a[X], a[Y])
        at = np.flatnonzero(at & ~self.faces.flat[self.cells.face[pair]])
        one, two = Form(u[:, at]), np.zeros((8, at.size))
        two[: 1 if v.ndim == 1 else 8] = v[..., at]
        other = one * one - Form(two) * Form(two) * self.s2[pair[at]]

        def width(form: Form) -> Floats:
            a = np.abs(form.m)
            return np.asarray(a[XX:].sum(axis=0) / np.maximum(a[X], a[Y]))

        better = width(other) < width(form[at])
        form.m[:, at[better]] = other.m[:, better]
        self._add(pair, form, light)

    def _keep(self, keep: Bools) -> None:
        """Drop pairs."""
        self.cells, number = self.cells.pairs(keep)
        found, self.edges = self.edges, []
        for edges in found:
            kept = keep[edges.pair]
            self._add(number[edges.pair[kept]], edges.form[kept])

    def _find_silhouettes(self) -> None:
        """Drop faces that are not seen, and find 1 / t = k.d + s of the others."""
        faces, cells = self.faces, self.cells
        out, covers = np.zeros(cells.cell.size, dtype=np.bool_), np.ones(cells.cell.size, np.bool_)
        flat, chord = faces.flat[cells.face], np.zeros((8, cells.cell.size))
        at = np.flatnonzero(~cells.covers & flat)
        face, cell = cells.face[at], cells.cell[at]
        functions = [(at, self._linear(rim[:, face], cell)) for rim in faces.rim]
        at = np.flatnonzero(~flat)
        face, q = cells.face[at], self._rays(cells.cell[at])
        c, size = faces.center[:, face], np.full(at.size, faces.frame.longest)
        chord[:, at], _ = _cone(c, faces.radius[face], q, size, q, size)
        at = at[~cells.covers[at] & (faces.power[face] > 0)]
        functions.append((at, Form(chord[:, at])))
        # That is positive in the opposite direction as well.
        ahead = self._linear(faces.center[:, cells.face[at]], cells.cell[at])
        out[at[ahead.bounds()[1] < 0]] = True
        for at, form in functions:
            low, high = form.bounds()
            out[at[high < 0]] = True
            covers[at[low < 0]] = False
            some = np.flatnonzero((low < 0) & (high >= 0))
            self._add(at[some], form[some])
        self.cells = cells._replace(covers=covers)
        self._keep(~out)
        cells, flat = self.cells, flat[~out]
        self.s2 = Form(chord[:, ~out] * faces.w[cells.face] ** 2)
        self.inverse = self._linear(faces.k[:, cells.face], cells.cell)
        self._without_root = self.inverse.m[:XX].copy()
        self.root = Form(np.zeros((8, flat.size)))
        at = np.flatnonzero(~flat)
        root, rounding = self.s2[at].power(0.5).m, self.inverse.m[R, at]
        # All that is not known of 1 / t is its Z, and that of s is the same but for rounding.
        root[Z], root[R] = root[R] + rounding, rounding
        self.inverse.m[:, at] += root
        self.inverse.m[R, at] = 0
        self.root.m[:, at] = root

    def _drop_hidden(self) -> None:
        """Drop what is behind the nearest of the faces that cover a cell."""
        faces, (_, x, _, cell, face, covers, *_), inverse = self.faces, self.cells, self.inverse
        order, at = faces.order[face], np.flatnonzero(covers)
        at = at[np.lexsort((-order[at], inverse[at].bounds()[0], cell[at]))]
        nearest = np.full(x.size, -1)
        nearest[cell[at]] = at  # of several in a cell, the last
        some = np.flatnonzero((nearest[cell] >= 0) & (nearest[cell] != np.arange(cell.size)))
        other = nearest[cell[some]]
        same = faces.plane[face[some]] == faces.plane[face[other]]
        behind = difference(inverse[some], inverse[other]).bounds()[1] < 0
        keep = np.ones(cell.size, dtype=np.bool_)
        keep[some] = ~np.where(same, order[some] > order[other], behind)
        self._keep(keep)
        self.inverse, self.s2, self.root = inverse[keep], self.s2[keep], self.root[keep]
        self._without_root, self._inverse_size = self._without_root[:, keep], self.inverse.size

    def _heights(self, light: Ints, pair: Ints) -> Form:
        """Heights, over t, of lights or the eye (-1) over what pairs see."""
        faces, face = self.faces, self.cells.face[pair]
        form = self.inverse[pair] * faces.b[light, face]
        form.m[R] += ROUNDING * faces.b_size[light, face] * self._inverse_size[pair]
        at = np.flatnonzero(~faces.flat[face])
        form.m[:, at] += self._linear(faces.a[:, light[at], face[at]], self.cells.cell[pair[at]]).m
        return form

    def _find_terminators(self) -> None:
        dark = self.cells.dark.copy()
        light, pair = np.nonzero(~dark)
        form = self._heights(light, pair)
        low, high = form.bounds()
        dark[light, pair] = high <= 0
        at = np.flatnonzero((low < 0) & (high > 0) & ~self.faces.flat[self.cells.face[pair]])
        self._add(pair[at], form[at], light[at], terminator=True)
        at = np.flatnonzero(~(high <= 0))
        self._up, self.cells = (light[at], pair[at], form[at]), self.cells._replace(dark=dark)

    def _patches(self) -> tuple[Floats, Floats]:
        """Boxes around what pairs see, in the scene's axes: middles and half sizes (3, n)."""
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        least, most = self.inverse.bounds()
        near, far = 1 / most, np.where(least > 0, 1 / least, np.inf)
        low, high = faces.low[:, cells.face], faces.high[:, cells.face]
        for axis, (u, v, w) in enumerate(frame.axes.T):
            d = (u * self._s + v * self._g + w * frame.depth)[cells.cell]
            off, eye = abs(u) * self._hx + abs(v) * self._hy, frame.eye[axis]
            a, b = d - off, d + off
            low[axis] = np.fmax(low[axis], eye + np.where(a > 0, near, far) * a)
            high[axis] = np.fmin(high[axis], eye + np.where(b > 0, far, near) * b)
        half = np.maximum(0.5 * (high - low), 0) + faces.error[cells.face]
        return 0.5 * (low + high), half

    def listed(self) -> Cells:
        """The cells, with rows of all that may keep lights from what pairs see."""
        cells, patches, found = self.cells, self._patches(), [np.zeros(0, dtype=np.intp)]
        shape = (*cells.dark.shape, self.faces.count)
        for rows in self.faces.candidates(*patches, cells.face, ~cells.dark):
            meets, cuts = self.faces.capsules(*patches, rows)
            cells.dark[rows[0, cuts], rows[1, cuts]] = True
            found.append(np.ravel_multi_index(tuple(rows[:, meets & ~cuts]), shape))
        light, pair, occluder = np.unravel_index(np.unique(np.concatenate(found)), shape)
        cells = cells._replace(light=light, pair=pair, occluder=occluder)
        return cells.rows(~cells.dark[light, pair])

    def _find_shadows(self) -> None:
        cells = self.cells.rows(~self.cells.dark[self.cells.light, self.cells.pair])
        self.cells, (lit, shaded) = cells, np.zeros((2, cells.pair.size), dtype=np.bool_)
        ball = cells.occluder < self.faces.spheres
        edges = self._cones(np.flatnonzero(ball), lit, shaded)
        edges += self._boxes(np.flatnonzero(~ball), lit, shaded)
        cells.dark[cells.light[shaded], cells.pair[shaded]] = True
        keep = ~lit & ~cells.dark[cells.light, cells.pair]
        for row, form, u, v in edges:
            some = np.flatnonzero(keep[row])
            at, v = row[some], v[..., some]
            self._add_rootless(cells.pair[at], form[some], u[:, some], v, cells.light[at])
        self.cells = cells.rows(keep)

    def _cones(self, row: Ints, lit: Bools, shaded: Bools) -> list[_Shadow]:
        """Edges of spheres' shadows; tells rows where all is `lit`, and where all is `shaded`.

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
        center, rays, root = faces.center[:, ball], self._rays(cells.cell[pair]), self._without_root
        q, w = (rays - end[:, None] * root[:, pair] for end in (at, center))
        at2, center2, c2 = ((end * end).sum(axis=0) for end in (at, center, c))
        k1 = np.abs(k).sum(axis=0)
        q_size, w_size = (faces.frame.longest * (1 + np.sqrt(m) * k1 * 2) for m in (at2, center2))
        u, across = _cone(c, faces.radius[ball], q, q_size, w, w_size)
        e, v, s2 = _cross(c, center[:, None]), np.zeros((8, row.size)), self.s2.m[:, pair]
        v[:XX] = 2 * ((e * across).sum(axis=0) - r2 * (at[:, None] * q).sum(axis=0))
        v[R] = 16 * ROUNDING * (c2 * np.sqrt(center2) * w_size + r2 * np.sqrt(at2) * q_size)
        times = r2 * at2 - (e * e).sum(axis=(0, 1))
        u[:Z] += times * s2[:Z]
        u[R] += 16 * ROUNDING * (c2 * center2 + r2 * at2) * np.abs(s2).sum(axis=0)
        u[R] += np.abs(times) * s2[R]
        form = self._on_surface(pair, u, v)
        low, high = form.bounds()
        terms = c * center
        behind, _ = self._plane(pair, c, r2 - terms.sum(axis=0), r2 + np.abs(terms).sum(axis=0))
        least, most = behind.bounds()
        lit[row], shaded[row] = (high < 0) | (most < 0), (low > 0) & (least > 0)
        m = np.flatnonzero(~(low >= 0) & ~lit[row])
        return [(row[m], form[m], u[:, m], v[:, m])]

    def _boxes(self, row: Ints, lit: Bools, shaded: Bools) -> list[_Shadow]:
        """The same of boxes, plane by plane."""
        faces, cells, pair = self.faces, self.cells, self.cells.pair[row]
        light, box, edges = cells.light[row], cells.occluder[row] - faces.spheres, list[_Shadow]()
        lit[row], shaded[row] = faces.edge_on[light, box], True
        planes = zip(faces.normal, faces.offset, faces.offset_size, faces.edge, strict=True)
        for normals, offsets, sizes, is_edge in planes:
            normal, b, size = (m[..., light, box] for m in (normals, offsets, sizes))
            at = np.flatnonzero(normal.any(axis=0) & ~lit[row])
            form, u = self._plane(pair[at], normal[:, at], b[at], size[at])
            low, high = form.bounds()
            lit[row[at[high < 0]]] = True
            shaded[row[at[~(low > 0)]]] = False
            m = np.flatnonzero(~(low >= 0) & ~(high < 0) & is_edge[light[at], box[at]])
            edges.append((row[at[m]], form[m], u[:, m], b[at[m]]))
        shaded[row] &= ~lit[row]
        return edges

    def find_intersections(self) -> Bools:
        """Add edges where surfaces of two pairs may meet; tell cells (c,) that have too many."""
        faces, cells, inverse = self.faces, self.cells, self.inverse
        count = np.bincount(cells.cell, minlength=cells.x.size)
        by, start = np.argsort(cells.cell, kind="stable"), np.cumsum(count) - count
        cell, many = cells.cell[by], count > _MOST_SEEN
        before = np.where(many[cell], 0, np.arange(by.size) - start[cell])
        a, b = (by[m] for m in segments(before, start[cell]))
        a, b = np.where(faces.flat[cells.face[b]], (b, a), (a, b))  # planes first
        some = np.flatnonzero(~faces.apart(cells.face[a], cells.face[b]))
        a, b = a[some], b[some]
        f, g, cell = cells.face[a], cells.face[b], cells.cell[a]
        form, u, v = difference(inverse[a], inverse[b]), np.zeros((8, a.size)), np.zeros(a.size)
        # Of a plane, the points within the sphere: d^2 - 2 c.d / t + p / t^2, over t^2.
        m = np.flatnonzero(faces.flat[f] & ~faces.flat[g])
        c, power, one = faces.center[:, g[m]], faces.power[g[m]], inverse[a[m]]
        within = self.square[cell[m]] - self._linear(2 * c, cell[m]) * one + one * one * power
        form.m[:, m] = within.m
        # Of a sphere, those beyond the circle that both share: the difference of the same for both.
        m = np.flatnonzero(~faces.flat[f])
        f, g = f[m], g[m]
        v[m], size = faces.power[g] - faces.power[f], np.abs(faces.power[[f, g]]).sum(axis=0)
        between = 2 * (faces.center[:, f] - faces.center[:, g])
        beyond, u[:, m] = self._plane(a[m], between, v[m], size)
        form.m[:, m] = beyond.m
        low, high = form.bounds()
        m = np.flatnonzero((low < 0) & (high >= 0))
        self._add_rootless(a[m], form[m], u[:, m], v[m])
        return many

    def shade(self) -> Shades:
        """What lights add to each pair: forms of n.l and of the highlight.

        For a light at q, |p - q|^2 / t^2 is d^2 - 2 q.d / t + q^2 / t^2, and (q - p).(-p) / t^2 is
        d^2 - q.d / t; with unit vectors n.h = (n.l + n.v) / |l + v| and |l + v|^2 = 2 + 2 l.v.
        """
        faces, cells, (light, pair, up) = self.faces, self.cells, self._up
        at = np.flatnonzero(~cells.dark[light, pair])
        light, pair, up = light[at], pair[at], up[at]
        cell, q = cells.cell[pair], faces.lights[light].T
        square, along = self.square[cell], self.inverse[pair].times(self._linear(q, cell).m)
        inverse2 = (self.inverse * self.inverse)[pair]
        away = (square - along * 2.0 + inverse2 * (q * q).sum(axis=0)).power(-0.5, 1e-300)
        matt, shiny = (up * away).unit(), Form(np.zeros((8, pair.size)))
        at = np.flatnonzero(faces.glossy[cells.face[pair]])
        seen, which = np.unique(pair[at], return_inverse=True)
        near = self.square.power(-0.5)
        n_dot_v = self._heights(np.full(seen.size, -1), seen) * near[cells.cell[seen]]
        sum2 = (square[at] - along[at]) * (away[at] * near[cell[at]]) * 2.0 + 2.0
        n_dot_h = ((matt[at] + n_dot_v[which]) * sum2.power(-0.5, 1e-300)).unit()
        exponent = faces.exponent[cells.face[pair[at]]]
        shiny.m[:, at] = n_dot_h.power(exponent, 0.0, 1.0).unit().m
        return Shades(light, pair, matt, shiny, away.bounds()[1])


# Rows, their edge functions u + v s, and u and v.
_Shadow: TypeAlias = tuple[Ints, Form, Floats, Floats]
