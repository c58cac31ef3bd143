"""Looks: what the sample in a cell's middle tells of all of the cell.

A cell is a square of the picture: a pixel, or a part of one.  A *look* takes the sample in its
middle.  Besides what that sees, it finds the straight lines that divide the surface within the
cell, and which objects may keep lights from any part of it.  A cell that may hold more than such
lines is *unresolved*.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.antialias.edges import Views, footprints_of
from tracer.antialias.lines import Lines
from tracer.antialias.margins import Margins, fitted, joined, sheets
from tracer.arrays import Bools, Floats, Ints, indices
from tracer.light.lighting import (
    Highlights,
    Lighting,
    incoming_at,
    key_of,
    narrow_highlights,
    radiance_at,
    shade,
)
from tracer.shadow.occluders import ShadowEdges
from tracer.view.samples import Samples, Scattered
from tracer.view.visibility import visible_and_behind

__all__ = ["Cells", "LightingIn", "Seen", "look", "look_at", "radiance_in"]

# Cells with a larger footprint than this, as a part of the distance to a light, are split.
_WIDE = 0.1

LightingIn: TypeAlias = Callable[[Ints], Lighting]
"""Given the cell of each sample: the lighting, with what is known of shadows in those cells."""


class Cells(NamedTuple):
    """Squares of the picture: pixels, or parts of them.

    Attributes
    ----------
    size : float
        Width of a cell, in pixels.
    tolerance : float
        By how much a sample may differ from the mean of its cell, in radiance.
    x, y : (n,)
        Their centres, in pixels.
    error : (n,)
        By how much the sample at the centre, corrected by `curvature`, may differ from the mean;
        NaN if only a closer look can tell.
    cell, owner : (m,)
        Pairs of a cell and an object whose outline may cross it.
    """

    size: float
    tolerance: float
    x: Floats
    y: Floats
    error: Floats
    cell: Ints
    owner: Ints

    def at(self, cell: Ints, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """One point, x and y from -1/2 to 1/2, in each of some cells."""
        return self.x[cell] + self.size * x, self.y[cell] + self.size * y

    def split(self, index: Ints) -> Cells:
        """Quarters of some cells, four after four."""
        count, quarter = index.size, np.array([-0.25, 0.25])
        x, y = np.tile(quarter, 2 * count), np.tile(quarter.repeat(2), count)
        x, y = self.at(index.repeat(4), x, y)
        place = np.full(self.x.size, -1)
        place[index] = np.arange(count)
        cell = place[self.cell]
        kept = indices(cell >= 0)
        quarters = (4 * cell[kept, None] + np.arange(4)).ravel()
        error = np.repeat(self.error[index] / 4, 4)
        return Cells(
            self.size / 2, self.tolerance, x, y, error, quarters, self.owner[kept].repeat(4)
        )


class Seen(NamedTuple):
    """What a look has found, n being the number of cells.

    Attributes
    ----------
    radiance : (3, n)
        Of the sample in each cell's middle.
    key : (n,)
        See `key_of`; -1 where nothing is seen.
    lines : Lines
        What divides the surfaces: where they meet, ridges, shadows and terminators.
    cell : (n,)
        The cell of each sample that was taken.
    shadow_edges : ShadowEdges
        What may shade around the samples.
    unresolved : (n,)
        Whether a cell may hold more than straight lines.
    """

    radiance: Floats
    key: Ints
    lines: Lines
    cell: Ints
    shadow_edges: ShadowEdges
    unresolved: Bools

    def lighting_in(self, lighting: Lighting) -> LightingIn:
        """The lighting for samples in cells, with what the look has found of shadows there."""
        if not lighting.shadows.caches:
            return lambda _: lighting
        seen = self.cell[self.shadow_edges.hits.sample]
        place = np.full(self.key.size, -1)
        place[seen] = np.arange(seen.size)
        cached = lighting.shadows.cached(self.shadow_edges)
        return lambda cell: lighting._replace(shadows=cached(place[cell]))


def radiance_in(lighting_in: LightingIn, x: Floats, y: Floats, cell: Ints) -> tuple[Floats, Ints]:
    """Radiance (3, n) and keys (n,), as in `Seen`, at positions in any order.

    `cell` (n,): the cell that each lies in.
    """
    radiance, key, found = np.empty((3, x.size)), *np.full((2, x.size), -1)
    if x.size:
        samples, order = Scattered.of(x, y)
        radiance[:, order] = radiance_at(lighting_in(cell[order]), samples, key=found)
        key[order] = found
    return radiance, key


def look_at(
    lighting_in: LightingIn,
    x: Floats,
    y: Floats,
    cell: Ints,
    size: float,
    tolerance: float,
    share: float = 1.0,
    outlines: tuple[Margins, ...] | list[Margins] = (),
) -> Seen:
    """Look at cells of a size around positions in any order.

    `cell` (n,): the cell, of those that `lighting_in` knows, in which each position lies.
    `share`: see `look`.
    """
    samples, order = Scattered.of(x, y)
    return look(lighting_in(cell[order]), samples, order, size, tolerance, share, outlines)


def look(
    lighting: Lighting,
    samples: Samples,
    cell: Ints,
    size: float,
    tolerance: float,
    share: float = 1.0,
    outlines: tuple[Margins, ...] | list[Margins] = (),
) -> Seen:
    """Look at cells of a size around samples.

    `cell` (n,): the cell around each, a number less than n.  `share`: the part of its cell's width
    that a sample stands for.
    """
    radiance, key = np.zeros((3, cell.size)), np.full(cell.size, -1)
    unresolved = np.zeros(cell.size, dtype=np.bool_)
    view = lighting.view
    hits, behind = visible_and_behind(view, samples, size)
    incoming = incoming_at(lighting, hits)
    facing = incoming.n_dot_l > 0
    footprint = footprints_of(hits, view.surfaces.radius, size)
    # Cells that see so much of a surface are split anyway: the edges of shadows are not sought.
    wide = np.any(incoming.length2 < (share * footprint / _WIDE) ** 2, axis=0)
    unresolved[cell[hits.sample[wide]]] = True
    reach = np.where(wide, 0, footprint)
    blocked, found = lighting.shadows.edges(hits, facing, reach)
    lit = facing & ~blocked
    views = Views(lighting, hits, sheets(hits), cell[hits.sample], footprint, size)
    margins = [*outlines, *views.intersections(behind), *views.shadows(found)]
    for group in hits.groups:
        inside, part = cell[group.sample], group.part
        here, reached = incoming.part(part), lit[:, part]
        highlights = Highlights.of(lighting, hits, group)
        shaded = shade(highlights, here, reached)
        for channel, values in zip(radiance, shaded, strict=True):
            channel[inside] = values
        key[inside] = key_of(group, reached)
        for places in narrow_highlights(highlights, here, facing[:, part], share * footprint[part]):
            unresolved[inside[places]] = True
        margins += views.creases(group) if group.flat else views.terminators(group, incoming)
    lines, curved = fitted(joined(margins), tolerance)
    unresolved[curved] = True
    return Seen(radiance, key, lines, cell, found, unresolved)
