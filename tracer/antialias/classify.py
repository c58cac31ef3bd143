"""Looks: what the sample in a cell's middle tells of all of the cell.

A cell is a square of the picture: a pixel, or a part of one.  A *look* takes the sample in its
middle.  Besides what that sees, it finds the straight lines that divide the surface within the
cell, and which objects may keep lights from any part of it.  A cell that may hold more than such
lines is *unresolved*.
"""

from __future__ import annotations

from typing import NamedTuple

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
from tracer.shadow.occlusion import NearbyShadows, ShadowEdges, shadow_edges
from tracer.view.samples import Samples, Scattered
from tracer.view.visibility import visible_and_behind

__all__ = ["Cells", "Seen", "look", "look_at", "radiance_in"]

# Cells with a larger footprint than this, as a part of the distance to a light, are split.
_WIDE = 0.1


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

    def nearby(self) -> NearbyShadows:
        """What the look has found of shadows, by cell."""
        point = np.full(self.key.size, -1)
        point[self.cell[self.shadow_edges.sample]] = np.arange(self.shadow_edges.own.size)
        return NearbyShadows(self.shadow_edges, point)


def radiance_in(
    lighting: Lighting, nearby: NearbyShadows | None, x: Floats, y: Floats, cell: Ints
) -> tuple[Floats, Ints]:
    """Radiance (3, n) and keys (n,), as in `Seen`, at positions in any order.

    `cell` (n,): the cell, of those that `nearby` knows, that each lies in.
    """
    radiance, key, found = np.empty((3, x.size)), *np.full((2, x.size), -1)
    if x.size:
        samples, order = Scattered.of(x, y)
        known = nearby and nearby.at(cell[order])
        radiance[:, order] = radiance_at(lighting, samples, key=found, nearby=known)
        key[order] = found
    return radiance, key


def look_at(
    lighting: Lighting,
    nearby: NearbyShadows | None,
    x: Floats,
    y: Floats,
    cell: Ints,
    size: float,
    tolerance: float,
    share: float = 1.0,
    outlines: tuple[Margins, ...] | list[Margins] = (),
) -> Seen:
    """Look at cells of a size around positions in any order.

    `cell` (n,): the cell, of those that `nearby` knows, in which each position lies.
    `share`: see `look`.
    """
    samples, order = Scattered.of(x, y)
    known = nearby and nearby.at(cell[order])
    return look(lighting, samples, order, size, tolerance, share, outlines, known)


def look(
    lighting: Lighting,
    samples: Samples,
    cell: Ints,
    size: float,
    tolerance: float,
    share: float = 1.0,
    outlines: tuple[Margins, ...] | list[Margins] = (),
    nearby: NearbyShadows | None = None,
) -> Seen:
    """Look at cells of a size around samples.

    `cell` (n,): the cell around each, a number less than n.  `share`: the part of its cell's width
    that a sample stands for.  `nearby`: what is known of shadows near the samples.
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
    blocked, found = shadow_edges(lighting.occluders, hits, facing, reach, nearby)
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
