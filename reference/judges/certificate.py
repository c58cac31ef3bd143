"""Antialiased pictures with a proof: bounds on the mean radiance of every pixel.

Objects are convex and lights are points, so edges in the picture are zeros of smooth functions, and
radiance is smooth between them.  Cells of the picture (`cells`) are divided until every pixel is
known as well as asked:

- The zero of each edge function lies in a *strip* between two parallel lines (`regions`).
- The middle lines of strips divide a cell into *regions*.  In a region nothing changes outside of
  the strips: a sample in its centroid tells which face is seen, and which lights reach it.
- There, radiance is a *form* (`forms`) with a known mean.  X^2 counts as its mean, not as the
  middle of its bounds: so the estimate is much better than the bounds.
- In a strip, radiance is off by no more than may change across its edge: all that the cell may
  show, what one light adds, or, where the light only just rises, by how much it may have risen.
- A region of which the sample lies in a strip may be off by the strip's change as a whole; a strip
  that is too wide counts as all of its cell.

The error of a pixel is at most the sum of these over its cells, weighted by their areas.  Cells
that add the least are done; the others are divided.

Single samples of the tracer are trusted as to what they see, not as to radiance.  A sample that
contradicts its cell proves an error in one of them, and raises one.

Rounding: samples and the coordinates of cells are off by less than the forms' radii, which hold
1e-13 of the coordinates involved.  Areas and means of regions are some hundred roundings off, and
sums over at most 4^10 cells of a pixel, each at most the radiance R there, another 4^10 e R for
e = 2^-53, if all roundings go the same way: the bounds are widened by 1e-9 R.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints, segments, sums
from reference.judges.cells import ROOT, CellForms, Cells, root_cells
from reference.judges.faces import Faces
from reference.judges.forms import Form, R, Z
from reference.judges.regions import NO_AREA, Regions, Strips, divide, strips
from tracer import Scene, to_codes

# So many pairs, rows, and lights of pairs are worked on at a time: their arrays stay in cache.  So
# many lines at most divide a cell.
_AT_ONCE, _MOST_LINES = 64000, 5

# Cells larger than a pixel are done if their form errs by no more than this part of the error.
_SMOOTH = 0.25

# The part of what is left of a pixel's error that is spent at each size of its cells.
_SPENT = 0.2

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
    radiance : list of three Form (n,)
    doubt : (n,)
        By how much more radiance may be off, as the region's sample lies in a strip.
    loose : (c,)
        The same in all of a cell, for its strips that are too wide.
    unknown : (c,)
        Cells of which only `most` is known.
    most : (3, c)
        No point shows more.
    mean, error : (3, c) and (c,)
        Mean radiance, and by how much it may be off in any channel.
    """

    lines: Strips
    regions: Regions
    radiance: list[Form]
    doubt: Floats
    loose: Floats
    unknown: Bools
    most: Floats
    mean: Floats
    error: Floats


def enclose(forms: CellForms, error: float) -> Enclosure:
    """Enclose radiance in cells; those of no use for an `error` of their pixel stay unknown."""
    unknown, shades, faces = forms.find_intersections(), forms.shade(), forms.faces
    cells, count = forms.cells, forms.cells.x.size
    face, power = cells.face[shades.pair], faces.prepared.intensities[shades.light].T
    diffuse, specular = power * faces.diffuse[:, face], power * faces.specular[:, face]
    shine = specular * shades.shiny.size
    each, most = diffuse * shades.matt.size + shine, np.zeros((3, count))
    for channel, values in zip(most, each, strict=True):
        np.maximum.at(channel, cells.cell, sums(shades.pair, values, cells.cell.size))
    number = np.full(cells.dark.shape, -1)
    number[shades.light, shades.pair] = np.arange(shades.pair.size)
    change = (m.max(axis=0) for m in (most, each, diffuse * shades.near, shine))
    lines = _lines(forms, number, *change)
    # Too wide, or too many: then those with the least changes.
    wide = lines.share > 0.999
    by = np.lexsort((-lines.full, wide, lines.cell))
    wide[by] |= np.arange(by.size) - lines.cell.searchsorted(lines.cell) >= _MOST_LINES
    loose = sums(lines.cell[wide], lines.full[wide], count)
    unknown |= (loose * min(cells.size, 1) ** 2 > error) | (most.max(axis=0) == 0)
    lines, known = lines.take(~wide & ~unknown[lines.cell]), np.flatnonzero(~unknown)
    place = np.cumsum(~unknown) - 1
    regions = divide(lines._replace(cell=place[lines.cell]), known.size)
    regions = regions._replace(cell=known[regions.cell])
    _, x, y, *_ = regions.mean
    first = lines.cell.searchsorted(np.arange(count + 1))
    which, line = segments(np.diff(first)[regions.cell], first[regions.cell])
    z = lines.a[line] * x[which] + lines.b[line] * y[which] + lines.c[line]
    doubt = sums(which, (np.abs(z) <= lines.half[line]) * lines.full[line], x.size)
    doubt = np.where(regions.area > NO_AREA, doubt, np.inf)
    pairs, lit = _sampled(forms, regions.cell, x, y)
    region, light = np.nonzero(lit.T)
    of, radiance = number[light, pairs[region]], [np.zeros((8, x.size)) for _ in range(3)]
    glossy = np.flatnonzero(faces.glossy[face[of]])
    for form, color, some in (
        (shades.matt, diffuse, slice(None)),
        (shades.shiny, specular, glossy),
    ):
        at, which, m = region[some], of[some], form.m[:, of[some]]
        first = np.flatnonzero(np.diff(at, prepend=-1))
        for channel, weight in zip(radiance, color[:, which], strict=True):
            channel[:, at[first]] += np.add.reduceat(weight * m, first, axis=1)
    value = np.array([(m[:Z] * regions.mean).sum(axis=0) for m in radiance])
    off = np.array([np.abs(m[Z]) + m[R] for m in radiance]) + doubt
    unsure = np.flatnonzero(doubt)  # still no less than nothing, and no more than all
    worst = np.maximum(value[:, unsure], most[:, regions.cell[unsure]] - value[:, unsure])
    off[:, unsure] = np.minimum(off[:, unsure], worst)
    mean = np.array([sums(regions.cell, regions.area * m, count) for m in value])
    mean[:, unknown] = most[:, unknown] / 2
    bound = sums(regions.cell, regions.area * off.max(axis=0), count)
    bound += sums(lines.cell, lines.share * lines.jump, count) + loose
    bound = np.fmin(np.where(unknown, np.inf, bound), np.maximum(mean, most - mean).max(axis=0))
    channels = list(map(Form, radiance))
    return Enclosure(lines, regions, channels, doubt, loose, unknown, most, mean, bound)


def _lines(
    forms: CellForms, number: Ints, most: Floats, each: Floats, slope: Floats, shine: Floats
) -> Strips:
    """The strips of all edges, except in black cells.

    `number` (lights, pairs): of shades, or -1; `most` (c,): radiance of cells; `each`, `slope` and
    `shine` (n,): of shades, all that a light adds, for each unit of its height, and highlights.
    """
    form = Form(np.concatenate([edges.form.m for edges in forms.edges], axis=1))
    pair, light, terminator = (
        np.concatenate([edges[i] for edges in forms.edges]) for i in (0, 1, 2)
    )
    cell, shade = forms.cells.cell[pair], number[light, pair]
    at = np.flatnonzero((most[cell] > 0) & ((light < 0) | (shade >= 0)))
    cell, shade = cell[at], shade[at]
    full = np.where(light[at] < 0, most[cell], each[shade])
    rise = np.where(terminator[at], slope[shade], np.inf)
    return strips(cell, form[at], full, rise, shine[shade])


def _sampled(forms: CellForms, cell: Ints, x: Floats, y: Floats) -> tuple[Ints, Bools]:
    """Pairs (n,) that samples at X and Y in cells see, or -1; which lights reach them (lights, n).

    Raises
    ------
    RuntimeError
        If that contradicts a cell: the certificate or the tracer is wrong.
    """
    cells, count, half = forms.cells, forms.faces.owner.size, forms.cells.size / 2
    face, lit = forms.faces.trace(cells.x[cell] + half * x, cells.y[cell] + half * y)
    keys, seen, pair = (
        cells.cell * count + cells.face,
        np.flatnonzero(face >= 0),
        np.full(face.size, -1),
    )
    by, wanted = keys.argsort(), cell[seen] * count + face[seen]
    found = np.append(by, -1)[keys[by].searchsorted(wanted)]
    if (np.append(keys, -1)[found] != wanted).any() or (lit[:, seen] & cells.dark[:, found]).any():
        raise RuntimeError("a sample contradicts its cell: the certificate or the tracer is wrong")
    pair[seen] = found
    return pair, lit


class _Picture:
    """A picture of which some is known: means of pixels, and how far off these are."""

    def __init__(self, scene: Scene, error: float, codes: bool) -> None:
        self.faces, self.error, self.by_codes, self.cells = Faces(scene), error, codes, 0
        self.width, self.height = scene.width, scene.height
        size = scene.height + ROOT, scene.width + ROOT  # cells may reach beyond the picture
        self.image, self.bound = np.zeros((3, *size)), np.zeros(size)

    def pixels(self, cells: Cells) -> Ints:
        """The pixel (c,) of each cell; of cells larger than that, the first."""
        half = cells.size / 2 if cells.size > 1 else 0
        row, column = (np.floor(m - half).astype(np.intp) for m in (cells.y, cells.x))
        return np.asarray(row * self.bound.shape[1] + column)

    def halves(self, cells: Cells) -> list[Cells]:
        """Cells in two parts, if they are many, with all cells of a pixel in one of these."""
        if cells.cell.size + cells.pair.size + np.count_nonzero(~cells.dark) <= _AT_ONCE:
            return [cells]
        pixel = self.pixels(cells)
        first = pixel < np.partition(pixel, pixel.size // 2)[pixel.size // 2]
        return [cells.take(first), cells.take(~first)] if first.any() else [cells]

    def refine(self, cells: Cells) -> Cells:
        """Add what is known of cells; return the parts of the others."""
        half = cells.size / 2
        cells = cells.take((cells.x - half < self.width) & (cells.y - half < self.height))
        self.cells += cells.x.size
        forms = CellForms(self.faces, cells)
        if cells.size == ROOT:
            forms = CellForms(self.faces, forms.listed())
        rest = self.fill(forms) if cells.size > 1 else self.split(forms)
        return forms.cells.take(rest).parts()

    def fill(self, forms: CellForms) -> Bools:
        """Fill cells that show a single smooth form; tell which remain."""
        cells = forms.cells
        count = np.bincount(cells.cell, minlength=cells.x.size)
        clean, remain, n = count == 1, count > 0, int(cells.size)
        for edges in forms.edges:
            clean[cells.cell[edges.pair]] = False
        smooth = CellForms(self.faces, cells.take(clean))
        enclosed = enclose(smooth, self.error)
        off = np.max([form.radius for form in enclosed.radiance], axis=0)
        regions, alone = enclosed.regions, enclosed.regions.area == 1
        good = np.flatnonzero(alone & (off + enclosed.doubt <= _SMOOTH * self.error))
        index = np.flatnonzero(clean)
        cell = index[regions.cell[good]]
        middle, third = (np.arange(n) + 0.5) / n * 2 - 1, 1 / (3 * n * n)
        x, y = np.meshgrid(middle, middle)
        mean = np.array([x * 0 + 1, x, y, x * x + third, x * y, y * y + third])
        row, column = (
            (m[cell] - cells.size / 2).astype(np.intp)[:, None] + np.arange(n)
            for m in (cells.y, cells.x)
        )
        where = row[:, :, None], column[:, None]
        for channel, form in zip(self.image, enclosed.radiance, strict=True):
            channel[where] = np.tensordot(form.m[:Z, good], mean, ((0,), (0,)))
        self.bound[where] = off[good, None, None]
        remain[cell] = remain[index[enclosed.most.max(axis=0) == 0]] = False
        return remain

    def split(self, forms: CellForms) -> Bools:
        """Add the cells of a pixel that add little to its error, or all; tell which remain."""
        enclosed, share = enclose(forms, self.error), forms.cells.size**2
        image, bound = self.image.reshape(3, -1), self.bound.reshape(-1)
        at, place = np.unique(self.pixels(forms.cells), return_inverse=True)
        part = enclosed.error * share
        total, left = sums(place, part, at.size), self.error - bound[at]
        means = np.array([sums(place, mean * share, at.size) for mean in enclosed.mean])
        if self.by_codes:
            mean, off = (image[:, at] + means).T[None], (bound[at] + total)[None, :, None]
            left[(to_codes(mean - off) == to_codes(mean + off)).all(axis=(0, 2))] = np.inf
        budget = np.where(total <= left, np.inf, left * np.minimum(_SPENT, 0.5 * left / total))
        by = np.lexsort((part, place))
        spent, first = part[by].cumsum(), np.searchsorted(place[by], np.arange(at.size))
        spent -= (spent[first] - part[by[first]])[place[by]]
        done = (np.bincount(place) >= _MOST_CELLS)[place] | (forms.cells.size <= _SMALLEST)
        done[by] |= (spent <= budget[place[by]]) | (part[by] == 0)
        for channel, mean in zip(image, enclosed.mean, strict=True):
            channel[at] += sums(place, mean * share * done, at.size)
        bound[at] += sums(place, part * done, at.size)
        return ~done


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
    todo = [root_cells(picture.faces, scene.width, scene.height)]
    roots = todo[0].x.size
    while todo:
        cells = todo.pop()
        parts = picture.halves(cells)
        if len(parts) > 1:
            todo += parts
            continue
        area, cells = cells.x.size * cells.size**2, picture.refine(cells)
        progress((area - cells.x.size * cells.size**2) / (roots * ROOT**2))
        if cells.x.size:
            todo.append(cells)
    image, bound = (m[..., : scene.height, : scene.width] for m in (picture.image, picture.bound))
    image = image.transpose(1, 2, 0).copy()
    bound = bound[:, :, None] + _ROUNDING * image.max(initial=0)
    return Certificate(np.maximum(image - bound, 0), image + bound, image, picture.cells)
