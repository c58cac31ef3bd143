"""Antialiasing: one sample on either side of an edge, weighted by its share of the pixel.

Most pixels see one smooth surface: there the sample at the centre, with a
correction for curvature, is worth more than any number of samples.  Where one
edge crosses a pixel, its place is known in closed form, and a sample on either
side is enough.  A pixel that holds more is split into four, and so on; in the
last of its parts samples lie on a lattice that is as good as the grid asked
for.  What a look has found is known of all samples near it.  Pictures that are
full of edges are such lattices everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Bools, each, expand, pick
from tracer.boundaries import Surface, footprint_of
from tracer.cells import InCells
from tracer.edges import BEND, Kind, Lines, Pencil, joined
from tracer.lighting import Gloss, Lighting, incoming, narrow, radiance_at, shade
from tracer.outlines import Outlines, Spans
from tracer.sampling import CENTRES, Lattice, Samples
from tracer.scene import Floats, Ints
from tracer.surroundings import InSurroundings, Look
from tracer.visibility import View, visible

__all__ = ["antialiased", "dense"]

# Samples in cells that are split at a time.
_CHUNK = 1 << 16

# Pixels that are looked at, at a time.
_STRIP = 3 << 15

# A correction for curvature may be off by a part of itself; where that could show, split.  Grids
# err less with the power 3/2 of the samples along each side.
_CURVATURE = 1e-2

# Cells that stand for so many samples along each side are not split any more: looks would cost
# more than the samples they save.
_AT_ONCE = 3

# Light on a sphere changes like the root of the distance from its limb.  The mean of roots from 0
# to 1 is that of 4/9: so much nearer than the middle is the sample that stands for all.
_ROOT = 1 / 9

# Where two outlines cross a larger share of the pixels, samples everywhere do for less than looks;
# each time that pixels are split, four times as large.
_DENSE = 0.022

# Rows of samples in each row of cells, beside edges: the more in a row the better.
_ROWS = 16


def dense(outlines: Outlines, per_side: int) -> bool:
    """Whether a picture is so full of outlines that samples everywhere cost less than looks.

    Either way it is to be as accurate as per_side x per_side samples in every pixel.
    """
    return outlines.crossed_twice() > _DENSE * 4.0 ** _splittings(per_side)


def _splittings(per_side: int) -> int:
    """How often pixels are split to be looked at again, where they need it."""
    return 0 if per_side <= _AT_ONCE else 1 + _splittings((per_side + 1) // 2)


def antialiased(
    view: View,
    lighting: Lighting,
    top: int,
    bottom: int,
    left: int,
    right: int,
    per_side: int,
    out: Floats,
) -> None:
    """Radiance, averaged over each pixel of a rectangle, into zeros (rows, columns, 3).

    At least as accurate as per_side x per_side samples in every pixel.
    """
    # A pixel more on every side: the curvature is that between neighbours.
    top, height = top - 1, bottom + 2 - top
    spans = _spans(view.outlines, top, height, per_side)
    if not spans.owner.size:
        return
    # Nothing is seen to the left and to the right of all objects.
    start = max(left, int(spans.left.min()) - 1)
    right = min(right, int(spans.right.max()) + 2)
    if start >= right:
        return
    out = out[:, start - left : right - left]
    left, width = start - 1, right + 2 - start
    # The finer the grid that is asked for, the less a sample may be off.
    tolerance = _CURVATURE / per_side**1.5
    seen = _Seen.of(height * width)
    # As much at a time as the processor's cache holds.
    step = max(1, _STRIP // width)
    for begin in range(0, height, step):
        end = min(begin + step, height)
        strip = CENTRES.samples(top + begin, top + end, left, left + width)
        places = np.arange(begin * width, begin * width + strip.size)
        _look(view, lighting, strip, 1.0, tolerance, seen, places)
    curvature, rough = _curvature(seen.radiance, seen.key, width)
    mean = np.add(seen.radiance, curvature, out=curvature)
    row, column, owner = _crossed(spans, left, height, width, per_side)
    inner = np.flatnonzero((row > 0) & (row < height - 1) & (column > 0) & (column < width - 1))
    pixels = _Cells(
        1.0,
        tolerance,
        *CENTRES.samples(top, top + height, left, left + width).positions(),
        rough,
        (row * width + column)[inner],
        owner[inner],
    )
    inside = np.zeros((height, width), dtype=np.bool_)
    inside[1:-1, 1:-1] = True
    _refine(view, lighting, pixels, seen, mean, per_side, inside.ravel())
    out[:] = np.moveaxis(mean.reshape(3, height, width)[:, 1:-1, 1:-1], 0, 2)


_Lights: TypeAlias = Callable[[Ints], Lighting]
"""The lights as they are known of samples, given the cell of each."""


class _Cells(NamedTuple):
    """Squares of the picture.

    Attributes
    ----------
    size : float
        In pixels.
    tolerance : float
        What a sample may be off, in radiance.
    x, y : (n,)
        Their centres.
    rough : (n,)
        How far the sample at the centre may be off.
    cell, owner : (m,)
        Pairs of a cell and an object whose outline may cross it.
    """

    size: float
    tolerance: float
    x: Floats
    y: Floats
    rough: Floats
    cell: Ints
    owner: Ints

    def places(self, index: Ints, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Points of some cells, one cell's after the other's; x and y from -1/2 to 1/2."""
        return (
            np.add.outer(self.x[index], self.size * x).ravel(),
            np.add.outer(self.y[index], self.size * y).ravel(),
        )

    def split(self, index: Ints) -> _Cells:
        """Quarters of some cells."""
        quarter = np.array([-0.25, 0.25])
        x, y = self.places(index, np.tile(quarter, 2), np.repeat(quarter, 2))
        place = np.full(self.x.size, -1)
        place[index] = np.arange(index.size)
        cell = place[self.cell]
        kept = np.flatnonzero(cell >= 0)
        quarters = (4 * cell[kept, None] + np.arange(4)).ravel()
        rough = np.repeat(self.rough[index] / 4, 4)
        return _Cells(
            self.size / 2, self.tolerance, x, y, rough, quarters, np.repeat(self.owner[kept], 4)
        )


class _Seen(NamedTuple):
    """What samples see.

    Attributes
    ----------
    radiance : (3, n)
    key : (n,)
        -1 where nothing is seen.
    lines : list of Lines
        Ridges and shadows near each sample, c being zero at the sample.
    looks : list of (Look, (m,))
        What keeps lights from what is seen, and the places of each look's samples.
    several : (n,)
        Whether there may be more than straight lines.
    wide : (n,)
        Whether a cell sees so much of a surface that no sample stands for all of it.
    """

    radiance: Floats
    key: Ints
    lines: list[Lines]
    looks: list[tuple[Look, Ints]]
    several: Bools
    wide: Bools

    @classmethod
    def of(cls, count: int) -> _Seen:
        """Nothing so far, of so many samples."""
        none = np.zeros((2, count), dtype=np.bool_)
        return cls(np.zeros((3, count)), np.full(count, -1), [], [], *none)


def _refine(
    view: View,
    lighting: Lighting,
    cells: _Cells,
    seen: _Seen,
    mean: Floats,
    per_side: int,
    wanted: Bools,
) -> None:
    """Put mean radiance (3, n) in the place of that of cells that hold more than a smooth surface.

    `seen` is what their centres see.
    """
    lines = joined([*_outlines(view, cells, seen.several, per_side), *seen.lines])
    # The first line of each cell, and whether it is the only one.
    lines = lines.take(np.argsort(lines.cell, kind="stable"))
    first = np.flatnonzero(np.diff(lines.cell, prepend=-1))
    count = np.diff(first, append=lines.cell.size)
    differ = lines.differ(lines.take(np.repeat(first, count)))
    several = seen.several | (cells.rough > cells.tolerance)
    several[lines.cell[differ]] = True
    # Where an outline crosses, its place is worth more.
    wide = seen.wide
    wide[lines.cell[lines.kind <= Kind.OUTLINE]] = False
    several |= wide
    single = lines.take(first[(wanted & ~several)[lines.cell[first]]])
    sides = _Sides.of(cells, single)
    colors = np.empty((3, sides.x.size))
    # All of a surface has been looked at where only a shadow's edge divides it.
    known = np.tile(single.kind == Kind.SHADOW, 2)
    beyond, beside = np.flatnonzero(~known), np.flatnonzero(known)
    if beyond.size:
        colors[:, beyond], more = _beyond(view, lighting, cells, single, sides, beyond)
        several[more] = True
    rest = np.flatnonzero(several & wanted)
    lights = _known(lighting, seen, np.append(rest, single.cell))
    at_once = per_side <= _AT_ONCE
    lattice = Lattice.of(per_side)
    step = max(1, _CHUNK // (lattice.size if at_once else 4))
    for begin in range(0, rest.size, step):
        part = rest[begin : begin + step]
        if at_once:
            x, y = cells.places(part, *lattice.points())
            # Along with the first of them the sides of shadows' edges.
            x, y = np.append(x, sides.x[beside]), np.append(y, sides.y[beside])
            inside = np.append(np.repeat(part, lattice.size), sides.cell[beside])
            radiance = _radiance(view, lights, x, y, inside)
            radiance, colors[:, beside] = np.split(radiance, [x.size - beside.size], axis=1)
            beside = beside[:0]
        else:
            quarters = cells.split(part)
            inside = np.repeat(part, 4)
            closer = _looked(
                view, lights, quarters.x, quarters.y, inside, quarters.size, cells.tolerance
            )
            bend, rough = _bend(seen.radiance[:, part], seen.key[part], closer)
            quarters = quarters._replace(rough=np.fmax(quarters.rough, rough))
            radiance = np.add(closer.radiance, bend, out=bend)
            every = np.ones(quarters.x.size, dtype=np.bool_)
            _refine(view, lighting, quarters, closer, radiance, (per_side + 1) // 2, every)
        mean[:, part] = radiance.reshape(3, part.size, -1).mean(axis=2)
    if beside.size:
        x, y, inside = sides.x[beside], sides.y[beside], sides.cell[beside]
        colors[:, beside] = _radiance(view, lights, x, y, inside)
    alone = np.flatnonzero(~several[single.cell])
    mean[:, single.cell[alone]] = sides.mean(colors)[:, alone]


def _sorted(x: Floats, y: Floats) -> tuple[Samples, Ints]:
    """Positions as samples, and which is which."""
    order = np.lexsort((x, y))
    y = y[order]
    new = np.diff(y, prepend=-np.inf) != 0
    return Samples(y[new], x[order], np.cumsum(new) - 1), order


def _known(lighting: Lighting, seen: _Seen, some: Ints) -> _Lights:
    """What looks at some cells have found is known of all samples in them."""
    finder = lighting.shadows.finder
    if not isinstance(finder, InCells):
        # Stretches take neighbours together, which would be taken apart.
        return lambda _: lighting
    sample = np.concatenate([order[look.hits.sample] for look, order in seen.looks])
    place = np.full(seen.key.size, -1)
    place[sample] = np.arange(sample.size)
    known = InSurroundings.of(finder, [look for look, _ in seen.looks], place[some])
    near = np.empty(seen.key.size, dtype=np.intp)
    near[some] = np.arange(some.size)

    def lights(cell: Ints) -> Lighting:
        shadows = lighting.shadows._replace(finder=known._replace(near=near[cell]))
        return lighting._replace(shadows=shadows)

    return lights


def _radiance(view: View, lights: _Lights, x: Floats, y: Floats, cell: Ints) -> Floats:
    """Radiance (3, n) at positions in any order, each in a cell."""
    samples, order = _sorted(x, y)
    radiance = np.empty((3, order.size))
    radiance[:, order] = radiance_at(view, lights(cell[order]), samples)
    return radiance


def _looked(
    view: View,
    lights: _Lights,
    x: Floats,
    y: Floats,
    cell: Ints,
    size: float,
    tolerance: float,
) -> _Seen:
    """What positions in any order see, and the lines through cells of a size around them.

    Each is in one of the cells that `lights` knows.
    """
    samples, order = _sorted(x, y)
    seen = _Seen.of(order.size)
    _look(view, lights(cell[order]), samples, size, tolerance, seen, order)
    return seen


def _look(
    view: View,
    lighting: Lighting,
    samples: Samples,
    size: float,
    tolerance: float,
    seen: _Seen,
    order: Ints,
) -> None:
    """Put what samples see, and the lines through cells of a size around them, in their places."""
    close = np.zeros(samples.size, dtype=np.bool_)
    hits = visible(view, samples, close, size)
    seen.several[order[close]] = True
    light = incoming(lighting, hits)
    facing = light.falls > 0
    sights = [hits.sights(group) for group in hits.groups]
    footprint = np.empty(facing.shape[1])
    for group, (_, slope) in zip(hits.groups, sights, strict=True):
        footprint[group.part] = footprint_of(hits, group, slope, size)
    blocked, look = lighting.shadows.edges(hits, facing, footprint)
    lit = facing & ~blocked
    seen.looks.append((look, order))
    for group, sight in zip(hits.groups, sights, strict=True):
        cell, part = order[group.sample], group.part
        surface = Surface(view, lighting, hits, group, cell, footprint[part], size)
        here, reached = light.part(part), lit[:, part]
        gloss = Gloss.of(lighting, hits, group, sight)
        shaded = shade(gloss, here, reached)
        for channel, values in zip(seen.radiance, shaded, strict=True):
            channel[cell] = values
        key = group.spread(group.owner * 4) + group.face
        for bit in reached:
            # Odd numbers lose nothing where there are more lights than bits.
            key = key * 3 + bit
        seen.key[cell] = key
        for places in narrow(gloss, here, reached, footprint[part]):
            seen.several[cell[places]] = True
        for places in surface.wide(here, sight[1]):
            seen.wide[cell[places]] = True
        at = np.flatnonzero((look.point >= part.start) & (look.point < part.stop))
        if at.size:
            places = look.point[at] - part.start
            lines = surface.shadows(look.light[at], places, look.other[at], seen.several)
            seen.lines.append(lines)
        if group.flat:
            seen.lines.extend(surface.ridges())
        else:
            number, at = surface.turning(here)
            seen.several[cell[surface.kinks(number, at, tolerance)]] = True
            seen.lines.extend(surface.terminators(here, number, at, seen.several))


def _outlines(view: View, cells: _Cells, several: Bools, per_side: int) -> Iterator[Lines]:
    """Outlines across cells; marks `several` where they are not straight enough."""
    if not cells.cell.size:
        return
    raster, lines = view.raster, view.outlines
    spheres = len(lines.radius)
    s, g = raster.across(cells.x[cells.cell]), raster.down(cells.y[cells.cell])
    zero, one = np.zeros(s.size), np.ones(s.size)
    pencil = Pencil(
        Kind.LIMB,
        cells.cell,
        (s, g, raster.depth * one),
        (raster.step_u * cells.size * one, zero, zero),
        (zero, raster.step_v * cells.size * one, zero),
    )
    at = np.flatnonzero(cells.owner < spheres)
    ball = cells.owner[at]
    discs, turn, near = pencil.take(at).discs(pick(lines.center, ball), lines.radius[ball])
    # Within a limb light is not even: that is for the smallest cells.
    odd = turn > (BEND if per_side <= _AT_ONCE else 0)
    several[discs.cell[odd & near]] = True
    yield discs.crossing()
    at = np.flatnonzero(cells.owner >= spheres)
    if not at.size:
        return
    box = cells.owner[at] - spheres
    planes = each(lambda m: m.take(box, axis=1), lines.edges)
    pencil = pencil.take(at)._replace(kind=Kind.OUTLINE)
    edges, _ = pencil.boxes((planes[0], planes[1], planes[2] / raster.depth))
    yield edges


def _curvature(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
    """What to add to centres (3, height * width) for the mean of pixels, and how far it may be off.

    It is a 24th of the second differences along the row and the column, where both neighbours
    see the same.  What it says of pixels on the rim has no meaning.
    """
    count = key.size
    total, rough = np.empty(radiance.shape), np.zeros(count)
    lone = np.ones(count, dtype=np.bool_)
    for stride in (1, width):
        middle = slice(stride, count - stride)
        same = key[stride:] == key[:-stride]
        before, after = same[:-stride], same[stride:]
        lone[middle] &= ~(before | after)
        # There are few edges: what is wrong there is put right there.
        other = np.flatnonzero(~same)
        one, none = np.flatnonzero(before != after), np.flatnonzero(~(before & after))
        off = np.zeros(one.size)
        for channel, out in zip(radiance, total, strict=True):
            step = channel[stride:] - channel[:-stride]
            step[other] = 0
            bend = step[stride:] - step[:-stride]
            np.maximum(off, np.abs(bend[one]), out=off)
            bend[none] = 0
            if stride == 1:
                out[0], out[middle], out[-1] = 0, bend, 0
            else:
                out[middle] += bend
        rough[one + stride] = np.maximum(rough[one + stride], off)
    total *= 1 / 24
    rough *= 1 / 24
    for channel in total:
        np.maximum(rough, np.abs(channel), out=rough)
    # Surfaces that coincide may change from one ray to the next.
    rough[lone] = np.inf
    return total, rough


def _bend(radiance: Floats, key: Ints, quarters: _Seen) -> tuple[Floats, Floats]:
    """`_curvature` of quarters of cells, given also what the cells' centres see (3, n) and (n,).

    Where all see the same, the mean lies beyond that of the quarters' centres by a third of the
    way there from the cell's (Richardson's extrapolation).
    """
    fine, keys = quarters.radiance.reshape(3, -1, 4), quarters.key.reshape(-1, 4)
    alike = (keys == key[:, None]).all(axis=1)
    bend = np.where(alike, (fine.mean(axis=2) - radiance) / 3, 0)
    # What that leaves out is of higher order in their size.
    rough = np.abs(bend).max(axis=0) / 2
    return np.repeat(bend, 4, axis=1), np.repeat(rough, 4)


def _spans(lines: Outlines, top: int, height: int, per_side: int) -> Spans:
    """Spans of all objects, spheres first, in rows of samples from one above to one below."""
    y = top + (np.arange(-1, height * per_side + 1) + 0.5) / per_side
    spheres, boxes = lines.sphere_spans(y), lines.box_spans(y)
    boxes = boxes._replace(owner=boxes.owner + len(lines.radius))
    return Spans(*(np.concatenate(pair) for pair in zip(spheres, boxes, strict=True)))


def _crossed(
    spans: Spans, left: int, height: int, width: int, per_side: int
) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: pixels that an outline may cross.

    Seen in rows of samples: between the leftmost and the rightmost place at which
    an object begins (or ends) in a pixel's rows and the next ones its outline
    crosses; one that misses some of them crosses wherever it is.
    """
    owner, line, begin, end = spans.owner, spans.row - 1, spans.left, spans.right
    # The first row of a pixel is that below the pixel above, too.
    above, below = (np.flatnonzero(line % per_side == k) for k in (0, per_side - 1))
    span = np.concatenate([np.arange(line.size), above, below])
    row = line // per_side
    row = np.concatenate([row, row[above] - 1, row[below] + 1])
    keep = np.flatnonzero((row >= 0) & (row < height))
    span, row = span[keep], row[keep]
    order = np.lexsort((row, owner[span]))
    span, row = span[order], row[order]
    first = np.flatnonzero(
        (np.diff(row, prepend=-1) != 0) | (np.diff(owner[span], prepend=-1) != 0)
    )
    if not first.size:
        return first, first, first
    (left_min, left_max), (right_min, right_max) = (
        (np.minimum.reduceat(m[span], first), np.maximum.reduceat(m[span], first))
        for m in (begin, end)
    )
    whole = (np.diff(first, append=row.size) < per_side + 2) | (left_max + 1 >= right_min)
    apart = np.flatnonzero(~whole)
    start = np.concatenate([left_min, right_min[apart]])
    stop = np.concatenate([np.where(whole, right_max, left_max), right_max[apart]])
    row, owner = (np.concatenate([m, m[apart]]) for m in (row[first], owner[span][first]))
    start, stop = (np.floor(m).astype(np.intp) - left for m in (start, stop))
    start = np.maximum(start, 0)
    each_one, column = expand(np.maximum(np.minimum(stop + 1, width) - start, 0), start)
    return row[each_one], column, owner[each_one]


class _Sides(NamedTuple):
    """Samples on either side of lines: first where c + a x + b y > 0 for each, then beyond.

    Attributes
    ----------
    cell : (2 n,)
    share : (n,)
        Of the cell, that of the first side.
    row, column : (2 n,)
        Where they are in their cells, from -1/2 to 1/2.
    x, y : (2 n,)
        Where they are in the picture.
    """

    cell: Ints
    share: Floats
    row: Floats
    column: Floats
    x: Floats
    y: Floats

    @classmethod
    def of(cls, cells: _Cells, lines: Lines) -> _Sides:
        """Where they stand for all of their side: in its middle, but that light falls off."""
        share, moment_x, moment_y = lines.halves()
        shares = np.concatenate([share, 1 - share])
        x = np.concatenate([moment_x, -moment_x]) / np.maximum(shares, 1e-9)
        y = np.concatenate([moment_y, -moment_y]) / np.maximum(shares, 1e-9)
        a, b, c = (np.concatenate([m, -m]) for m in (lines.a, lines.b, lines.c))
        # Within a limb, towards it.
        nearer = np.repeat([0.0, _ROOT], share.size) * np.tile(lines.kind == Kind.LIMB, 2)
        nearer *= (c + a * x + b * y) / (a * a + b * b)
        x, y = x - nearer * a, y - nearer * b
        # To the next row on the same side of the line, along it if it is steep.
        row = (y + 0.5) * _ROWS
        row = np.where(b < 0, np.floor(row), np.ceil(row)) / _ROWS - 0.5
        x = np.where(np.abs(a) > np.abs(b), x - b / a * (row - y), x)
        cell = np.tile(lines.cell, 2)
        at = cells.x[cell] + cells.size * x, cells.y[cell] + cells.size * row
        return cls(cell, share, row, x, *at)

    def mean(self, radiance: Floats) -> Floats:
        """Of the radiance (3, 2 n) on both sides."""
        first, second = np.split(radiance, 2, axis=1)
        mean: Floats = self.share * first + (1 - self.share) * second
        return mean


def _beyond(
    view: View, lighting: Lighting, cells: _Cells, single: Lines, sides: _Sides, which: Ints
) -> tuple[Floats, Ints]:
    """Radiance (3, n) at some samples beside lines; and cells that hold more lines there."""
    count = single.cell.size
    x, y = sides.x[which], sides.y[which]
    unknown = sides.cell[which]
    seen = _looked(view, lambda _: lighting, x, y, unknown, 2 * cells.size, cells.tolerance)
    found = joined(seen.lines)
    side = which[found.cell]
    a, b = found.a / 2, found.b / 2
    c = found.c - a * sides.column[side] - b * sides.row[side]
    found = Lines(side % count, found.kind, a, b, c).crossing()
    differ = found.cell[found.differ(single.take(found.cell))]
    return seen.radiance, single.cell[np.append(which[seen.several] % count, differ)]
