"""Antialiased pictures with a proof: bounds on the mean radiance of every pixel.

Objects are convex and lights are points, so edges in the picture are zeros of smooth functions, and
radiance is smooth between them.  Cells of the picture are divided (`cells`) until every pixel is
known as well as asked:

- A light that reaches all that a cell shows of a face adds a *form* (`forms`) with a known mean.
  X^2 counts as its mean, not as the middle of its bounds: so the estimate is much better than the
  bounds.  What such lights add to a face is kept, and its parts inherit it.
- A cell that shows nothing else is done: so are all pixels of a large one.
- Else, the zero of each edge function lies in a *strip* between two parallel lines (`regions`).
- The middle lines of strips divide a cell into *regions*.  In a region nothing changes outside of
  the strips: a sample in its centroid tells which face is seen, and which other lights reach it.
- In a strip, radiance is off by no more than may change across its edge: what one light adds, or
  all that the cell may show.
- A region of which the sample lies in a strip may be off by the strip's change as a whole.
- Other edges divide nothing, if there are many.  Whatever side of such an edge a centroid is on,
  beyond the edge is no more than 5/9 of a convex region (Winternitz's theorem): radiance is off by
  the edge's change in so much of the cell, and in the strip.

The error of a pixel is at most the sum of these over its cells, weighted by their areas.  Cells
that err no more than what is left of the pixel may on average are done; the others are divided.

Single samples of the tracer are trusted as to what they see, not as to radiance.  A sample that
sees what its cell rules out proves an error in one of them, and raises one.

Rounding: samples and the coordinates of cells are off by less than the forms' radii, which hold
1e-13 of the coordinates involved.  Areas and means of regions are some hundred roundings off, and
sums over at most 4^10 cells of a pixel, each at most the radiance R there, another 4^10 e R for
e = 2^-53, if all roundings go the same way, and those over n lights n e R: the bounds are widened
by 1e-9 R.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints, add_runs, places, segments, sums
from reference.judges.cells import LARGEST, CellForms, Cells, Shades, first_cells
from reference.judges.faces import Faces
from reference.judges.forms import Form, Z, constant
from reference.judges.regions import NO_AREA, Regions, Strips, divide, strips
from tracer import Scene, to_codes

# So many pairs, rows, and lights of pairs are worked on at a time: their arrays stay in cache.  So
# many lines at most divide a cell.
_AT_ONCE, _MOST_LINES = 12000, 5

# Lights that reach all of a face are kept if each errs by no more than an even share of this part
# of the error.
_SMOOTH = 0.25

# Cells are no smaller than this part of a pixel across.
_SMALLEST = 2.0**-10

# A pixel that is left with so many cells of one size is given up: all of it stays unknown, as
# through a lens so long that rounding hides every edge, and parts would stay so as well.
_MOST_CELLS = 1 << 11

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Certificate:
    """Every pixel's mean radiance, between two bounds.

    Attributes
    ----------
    low, high : (height, width, 3)
        Linear RGB; the mean of a pixel lies between these.
    image : (height, width, 3)
        The best estimate, which does as well.
    cells : int
        Number of cells that were measured.
    """

    low: Floats
    high: Floats
    image: Floats
    cells: int

    @property
    def error(self) -> Floats:
        """By how much (height, width) the mean may differ from the image in any channel."""
        return np.asarray((self.high - self.image).max(axis=2))

    @property
    def codes(self) -> NDArray[np.uint8]:
        """The image in 8 bits (height, width, 3)."""
        return to_codes(self.image)

    @property
    def certain(self) -> Bools:
        """Whether the codes of a pixel (height, width) are the only ones possible."""
        return np.asarray((to_codes(self.low) == to_codes(self.high)).all(axis=2))


class Enclosure(NamedTuple):
    """Radiance in cells (c,), by regions (n,).

    Attributes
    ----------
    lines : Strips
    regions : Regions
    radiance : Form (8, 3, n)
    doubt : (n,)
        By how much more radiance may be off, as the region's sample lies in a strip.
    loose : (c,)
        The same anywhere in a cell, for edges that do not divide it.
    most : (3, c)
        No point shows more.
    mean, error : (3, c) and (c,)
        Mean radiance, and by how much it may be off in any channel.
    """

    lines: Strips
    regions: Regions
    radiance: Form
    doubt: Floats
    loose: Floats
    most: Floats
    mean: Floats
    error: Floats


def enclose(forms: CellForms, shades: Shades, unknown: Bools, error: float) -> Enclosure:
    """Enclose radiance in cells; those of no use for an `error` of their pixel stay `unknown`.

    `shades`: of all lights that are not done; `unknown` (c,): cells that are not asked for.
    """
    cells, count, unknown = forms.cells, forms.cells.x.size, unknown.copy()
    each, most = shades.radiance.size, np.zeros((3, count))
    tops = cells.known.bounds()[1]
    add_runs(tops, shades.pair, each)
    for channel, top in zip(most, tops, strict=True):
        np.maximum.at(channel, cells.cell, top)
    # The strips of edges, except in black cells.
    lights = cells.done.shape[1]
    keys = shades.pair * lights + shades.light
    pair, light, form = forms.edge_functions()
    shade, cell = places(keys, pair * lights + light), cells.cell[pair]
    jump = np.where(light < 0, most.max(axis=0)[cell], np.append(each.max(axis=0), 0)[shade])
    at = np.flatnonzero((jump > 0) & ~unknown[cell])
    lines = strips(cell[at], form[at], jump[at])
    # Too wide, or too many: then those with the least changes.
    wide = lines.share > 0.999
    by = np.lexsort((-lines.jump, wide, lines.cell))
    wide[by] |= np.arange(by.size) - lines.cell.searchsorted(lines.cell) >= _MOST_LINES
    loose = sums(lines.cell[wide], lines.jump[wide], count)
    beyond = np.minimum(lines.share[wide] + 5 / 9, 1) * lines.jump[wide]
    beyond = sums(lines.cell[wide], beyond, count)
    unknown |= (beyond * cells.size**2 > error) | (most.max(axis=0) == 0)
    lines, inside = lines.take(~wide & ~unknown[lines.cell]), np.flatnonzero(~unknown)
    place = np.cumsum(~unknown) - 1
    regions = divide(lines._replace(cell=place[lines.cell]), inside.size)
    regions = regions._replace(cell=inside[regions.cell])
    _, x, y, *_ = regions.mean
    first = lines.cell.searchsorted(np.arange(count + 1))
    which, line = segments(np.diff(first)[regions.cell], first[regions.cell])
    z = lines.a[line] * x[which] + lines.b[line] * y[which] + lines.c[line]
    doubt = sums(which, (np.abs(z) <= lines.half[line]) * lines.jump[line], x.size)
    doubt[regions.area < NO_AREA] = np.inf
    pairs, lit = _sampled(forms, regions.cell, x, y)
    radiance = cells.known[pairs].m
    radiance[..., pairs < 0] = 0
    region, light = np.nonzero(lit.T)
    of = places(keys, pairs[region] * lights + light)
    add_runs(radiance, region, shades.radiance[of].m)
    value = (radiance[:Z] * regions.mean[:, None]).sum(axis=0)
    worst = np.maximum(value, most[:, regions.cell] - value)
    off = np.minimum(Form(radiance).radius + doubt, worst)
    mean = np.array([sums(regions.cell, regions.area * m, count) for m in value])
    mean[:, unknown] = most[:, unknown] / 2
    bound = sums(regions.cell, regions.area * off.max(axis=0), count)
    bound += sums(lines.cell, lines.share * lines.jump, count) + beyond
    bound[unknown] = np.inf
    bound = np.fmin(bound, np.maximum(mean, most - mean).max(axis=0))
    return Enclosure(lines, regions, Form(radiance), doubt, loose, most, mean, bound)


def _sampled(forms: CellForms, cell: Ints, x: Floats, y: Floats) -> tuple[Ints, Bools]:
    """Pairs (n,) that samples at X and Y in cells see, or -1; which lights reach them (lights, n).

    Only lights count of which it is not known yet.

    Raises
    ------
    RuntimeError
        If what is seen contradicts a cell: the certificate or the tracer is wrong.
    """
    cells, faces, half = forms.cells, forms.faces, forms.cells.size / 2
    hits, at, face = faces.see(cells.x[cell] + half * x, cells.y[cell] + half * y)
    keys = cells.cell * faces.owner.size + cells.face
    by, pairs = keys.argsort(), np.full(cell.size, -1)
    found = places(keys[by], cell[at] * faces.owner.size + face)
    if (found < 0).any():
        wrong = "a sample contradicts its cell: the certificate or the tracer is wrong"
        raise RuntimeError(wrong)
    pairs[at] = found = by[found]
    lit = np.zeros((cells.done.shape[1], cell.size), dtype=np.bool_)
    lit[:, at] = faces.lit(hits, ~cells.done[found].T)
    return pairs, lit


class _Picture:
    """A picture of which some is known: means of pixels, and how far off these are."""

    def __init__(self, scene: Scene, error: float, codes: bool) -> None:
        self.faces, self.error, self.by_codes, self.cells = Faces(scene), error, codes, 0
        self.width, self.height = scene.width, scene.height
        size = scene.height + LARGEST, scene.width + LARGEST  # cells may reach beyond the picture
        self.image, self.bound = np.zeros((3, *size)), np.zeros(size)

    def halves(self, cells: Cells) -> list[Cells]:
        """Cells in two parts, if they are many, with all cells of a pixel in one of these."""
        if cells.cell.size + cells.rows.shape[1] + np.count_nonzero(~cells.done) <= _AT_ONCE:
            return [cells]
        pixel = self.pixels(cells)
        first = pixel < np.partition(pixel, pixel.size // 2)[pixel.size // 2]
        return [cells.take(first), cells.take(~first)] if first.any() else [cells]

    def pixels(self, cells: Cells) -> Ints:
        """The pixel (c,) of each cell; of cells larger than that, the first."""
        half = cells.size / 2 if cells.size > 1 else 0
        row, column = (np.floor(m - half).astype(np.intp) for m in (cells.y, cells.x))
        return np.asarray(row * self.bound.shape[1] + column)

    def add(self, cells: Cells, which: Ints, radiance: Form) -> None:
        """Add the radiance (8, 3, n) of some cells (n,) to their pixels."""
        n, share = max(int(cells.size), 1), min(cells.size, 1) ** 2
        row, column = np.divmod(self.pixels(cells)[which][:, None, None], self.bound.shape[1])
        down, across = np.indices((n, n))
        pixel, third = (row + down, column + across), 1 / (3 * n * n)
        x, y = ((2 * m + 1) / n - 1 for m in (across, down))
        mean = np.array([x * 0 + 1, x, y, x * x + third, x * y, y * y + third])
        for channel, m in zip(self.image, radiance.m.swapaxes(0, 1), strict=True):
            np.add.at(channel, pixel, share * np.tensordot(m[:Z], mean, ((0,), (0,))))
        np.add.at(self.bound, pixel, share * radiance.radius.max(axis=0)[:, None, None])

    def refine(self, cells: Cells) -> Cells:
        """Add what is known of cells; return the others."""
        self.cells += cells.x.size
        forms = CellForms(self.faces, cells)
        cells = forms.cells
        number = np.bincount(cells.cell, minlength=cells.x.size)
        alone, remain = cells.covers & (number[cells.cell] == 1), number > 0
        alone &= cells.size <= LARGEST
        shades = forms.settle(alone | (cells.size <= 1), _SMOOTH * self.error)
        smooth = np.flatnonzero(alone & cells.done.all(axis=1))
        remain[cells.cell[smooth]] = False
        self.add(cells, cells.cell[smooth], cells.known[smooth])
        if cells.size <= 1:
            enclosed = enclose(forms, shades, ~remain, self.error)
            done = np.flatnonzero(remain & self.accepted(cells, enclosed, remain))
            self.add(cells, done, constant(enclosed.mean[:, done], enclosed.error[done]))
            remain[done] = False
        return cells.take(remain)

    def accepted(self, cells: Cells, enclosed: Enclosure, remain: Bools) -> Bools:
        """Of the cells of a pixel that remain, those that err no more than it may on average."""
        share, bound = remain * np.float64(cells.size**2), self.bound.reshape(-1)
        at, place = np.unique(self.pixels(cells), return_inverse=True)
        area, left = sums(place, share, at.size), self.error - bound[at]
        total = sums(place, share * enclosed.error, at.size)
        if self.by_codes:
            mean = np.array([sums(place, channel * share, at.size) for channel in enclosed.mean])
            mean = (mean + self.image.reshape(3, -1)[:, at]).T[None]
            off = (bound[at] + total)[None, :, None]
            left[(to_codes(mean - off) == to_codes(mean + off)).all(axis=(0, 2))] = np.inf
        most = np.where(total <= left, np.inf, left / area)
        most[np.bincount(place) >= _MOST_CELLS] = np.inf
        return np.asarray((enclosed.error <= most[place]) | (cells.size <= _SMALLEST))


@np.errstate(all="ignore")
def certify(
    scene: Scene,
    error: float,
    *,
    codes: bool = False,
    progress: Callable[[float], object] = lambda part: None,
) -> Certificate:
    """Enclose the mean radiance of every pixel.

    Parameters
    ----------
    scene : Scene
    error : float
        Pixels are divided until their mean is known as well as that.  Where edges graze each other,
        some may stay wider: `Certificate.error` tells.
    codes : bool
        Whether pixels are done, too, as soon as their 8-bit codes are certain.
    progress : callable
        Is called, now and then, with the part of the picture that is done since.

    Raises
    ------
    ValueError
        If `error` is not positive, the eye is on a surface, or a light is more than 1e14 times as
        far away as an object is large.
    """
    if not error > 0:
        raise ValueError(f"the error must be more than 0, not {error}")
    picture = _Picture(scene, 0.999 * error, codes)  # the rest is for rounding
    todo = [first_cells(picture.faces, scene.width, scene.height)]
    everything = todo[0].area
    while todo:
        cells = todo.pop()
        halves = picture.halves(cells)
        if len(halves) > 1:
            todo += halves
            continue
        remain = picture.refine(cells.parts(scene.width, scene.height))
        progress((cells.area - remain.area) / everything)
        if remain.x.size:
            todo.append(remain)
    image, bound = (m[..., : scene.height, : scene.width] for m in (picture.image, picture.bound))
    image = image.transpose(1, 2, 0).copy()
    bound = bound[:, :, None] + _ROUNDING * image.max(initial=0)
    return Certificate(np.maximum(image - bound, 0), image + bound, image, picture.cells)
