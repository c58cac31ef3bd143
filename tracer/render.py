"""From a scene to radiance, band by band.

A band is a few rows of the picture: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to
weigh nothing.  Bands depend on nothing but the scene, so they can be rendered
in any order, in threads, and written out as they come.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster, raster_of
from tracer.intersection import Bools, Triple, box_hit, dot, sphere_hit
from tracer.pencil import Outlines, Spans, expand, outlines
from tracer.scene import Floats, Ints, Scene, Surfaces
from tracer.shading import Materials, highlight
from tracer.shadow import LightPencil, Occluders, light_pencil, occluders_of

__all__ = ["render", "render_bands"]

_BAND_PIXELS = 1 << 16

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A scene with everything that all bands share."""

    raster: Raster
    surfaces: Surfaces
    outlines: Outlines
    sphere_spans: Spans
    box_spans: Spans
    occluders: Occluders
    materials: Materials
    shader: Ints
    order: Ints
    lights: tuple[tuple[LightPencil, Floats], ...]


@dataclass(frozen=True, slots=True)
class _Hits:
    """What is seen, one entry a pixel: object, distance, point and normal."""

    pixel: Ints
    owner: Ints
    t: Floats
    direction: Triple
    p: Triple
    n: Triple


def render(
    scene: Scene,
    samples: int = 1,
    *,
    threads: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
    samples : int
        The picture is at least as accurate as with so many samples spread
        evenly over every pixel; 1 samples the pixels' centres.
    threads : int, optional
        How many threads to work in; chosen by the size of the picture if absent.
    offset : (float, float)
        Moves every sample by so many pixels to the right and down.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance; row 0 is the top.
    """
    image = np.zeros((scene.height, scene.width, 3))
    row = 0
    for band in render_bands(scene, samples, threads=threads, offset=offset):
        image[row : row + len(band)] = band
        row += len(band)
    return image


def render_bands(
    scene: Scene,
    samples: int = 1,
    *,
    threads: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    band_pixels: int = _BAND_PIXELS,
) -> Iterator[Floats]:
    """Render a scene from the top, band by band.

    Parameters are those of `render`; `band_pixels` is the size of a band,
    which changes no pixel.

    Yields
    ------
    band : (rows, width, 3) float64
        The next rows of the picture.
    """
    prepared = _prepare(scene, offset)
    step = max(1, band_pixels // scene.width)
    for top in range(0, scene.height, step):
        yield _band(prepared, top, min(top + step, scene.height))


def _prepare(scene: Scene, offset: tuple[float, float]) -> _Prepared:
    raster = raster_of(scene.camera, scene.width, scene.height, offset)
    surfaces = scene.surfaces
    lines = outlines(raster, surfaces)
    rows = np.arange(scene.height) + 0.5
    sphere_spans, box_spans = lines.sphere_spans(rows, _PAD), lines.box_spans(rows, _PAD)
    inside_box = ((surfaces.min_pt <= raster.eye) & (raster.eye <= surfaces.max_pt)).all(axis=1)
    spheres = len(surfaces.radius)
    seen = np.zeros(len(surfaces), dtype=np.bool_)
    seen[sphere_spans.owner] = True
    seen[spheres + box_spans.owner] = True
    occluders = occluders_of(surfaces, np.concatenate([lines.power <= 0, inside_box]), seen)
    return _Prepared(
        raster=raster,
        surfaces=surfaces,
        outlines=lines,
        sphere_spans=sphere_spans,
        box_spans=box_spans,
        occluders=occluders,
        materials=Materials(surfaces.shaders),
        shader=np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        order=np.concatenate([surfaces.sphere_index, surfaces.box_index]),
        lights=tuple(
            (light_pencil(light.position, occluders), np.array(light.intensity))
            for light in scene.lights
        ),
    )


def _band(prepared: _Prepared, top: int, bottom: int) -> Floats:
    width = prepared.raster.width
    radiance = np.zeros(((bottom - top) * width, 3))
    hits = _visible(prepared, top, bottom)
    if hits.pixel.size:
        radiance[hits.pixel] = _shade(prepared, hits)
    return radiance.reshape(bottom - top, width, 3)


def _fragments(spans: Spans, top: int, bottom: int, width: int) -> tuple[Ints, Ints, Ints]:
    """Pixels whose centres lie within spans of the rows: span, column and pixel."""
    first, last = np.searchsorted(spans.row, (top, bottom)).tolist()
    left = np.ceil(spans.left[first:last] - 0.5).astype(np.intp)
    right = np.minimum(np.floor(spans.right[first:last] - 0.5).astype(np.intp), width - 1)
    owner, place = expand(np.maximum(right - left + 1, 0))
    column = left[owner] + place
    return owner + first, column, (spans.row[first:last][owner] - top) * width + column


def _visible(prepared: _Prepared, top: int, bottom: int) -> _Hits:
    """The nearest surface at the pixels of some rows."""
    raster, surfaces, lines = prepared.raster, prepared.surfaces, prepared.outlines
    width = raster.width
    eye = raster.eye

    spans = prepared.sphere_spans
    span, column, pixel = _fragments(spans, top, bottom, width)
    ball = spans.owner[span]
    s = raster.across(column + 0.5)
    g = raster.down(spans.row[span] + 0.5)
    hypot = np.sqrt(g * g + raster.depth * raster.depth)
    u, v, w = (m[ball] for m in lines.center)
    radius = lines.radius[ball]
    aside = (v * raster.depth - w * g) / hypot
    ahead = (v * g + w * raster.depth) / hypot
    chord2 = (radius - aside) * (radius + aside)
    t = sphere_hit(s, hypot, u, ahead, chord2, lines.power[ball])

    spans = prepared.box_spans
    box_span, box_column, box_pixel = _fragments(spans, top, bottom, width)
    box = spans.owner[box_span]
    box_d = _directions(raster, box_column, spans.row[box_span])
    low = tuple(surfaces.min_pt[box, k] - eye[k] for k in range(3))
    high = tuple(surfaces.max_pt[box, k] - eye[k] for k in range(3))
    box_t, axis = box_hit(box_d, low, high)  # type: ignore[arg-type]

    spheres = len(surfaces.radius)
    nearest = np.full((bottom - top) * width, np.inf)
    np.minimum.at(nearest, pixel, t)
    np.minimum.at(nearest, box_pixel, box_t)
    won = np.flatnonzero((t == nearest[pixel]) & (t < np.inf))
    box_won = np.flatnonzero((box_t == nearest[box_pixel]) & (box_t < np.inf))
    won_pixel = np.concatenate([pixel[won], box_pixel[box_won]])
    won_owner = np.concatenate([ball[won], box[box_won] + spheres])
    if won_pixel.size > np.count_nonzero(nearest < np.inf):
        # Exactly equal distances: the first in the file is seen.
        ranked = np.lexsort((prepared.order[won_owner], won_pixel))
        again = np.diff(won_pixel[ranked], prepend=-1) == 0
        keep = np.ones(won_pixel.size, dtype=np.bool_)
        keep[ranked[again]] = False
        won, box_won = won[keep[: won.size]], box_won[keep[won.size :]]

    ball, t = ball[won], t[won]
    d = _directions(raster, column[won], prepared.sphere_spans.row[span[won]])
    center = tuple(surfaces.center[ball, k] for k in range(3))
    radius = surfaces.radius[ball]
    n = tuple((t * d[k] - (center[k] - eye[k])) / radius for k in range(3))
    p = tuple(center[k] + radius * n[k] for k in range(3))
    flip = np.where(prepared.occluders.eye_inside[ball], -1.0, 1.0)
    n = tuple(flip * m for m in n)

    box, box_t, axis = box[box_won], box_t[box_won], axis[box_won]
    e = tuple(m[box_won] for m in box_d)
    inside = prepared.occluders.eye_inside[box + spheres]
    q, normal = [], []
    for k in range(3):
        on = axis == k
        backward = e[k] < 0
        face = np.where(
            backward != inside, surfaces.max_pt[box, k], surfaces.min_pt[box, k]
        )
        q.append(np.where(on, face, eye[k] + box_t * e[k]))
        normal.append(np.where(on, np.where(backward, 1.0, -1.0), 0.0))
    return _Hits(
        np.concatenate([pixel[won], box_pixel[box_won]]),
        np.concatenate([ball, box + spheres]),
        np.concatenate([t, box_t]),
        tuple(np.concatenate([d[k], e[k]]) for k in range(3)),  # type: ignore[arg-type]
        tuple(np.concatenate([p[k], q[k]]) for k in range(3)),  # type: ignore[arg-type]
        tuple(np.concatenate([n[k], normal[k]]) for k in range(3)),  # type: ignore[arg-type]
    )


def _directions(raster: Raster, column: Ints, row: Ints) -> Triple:
    """Ray directions (not normalised) in the scene's axes."""
    s, g = raster.across(column + 0.5), raster.down(row + 0.5)
    u, v, w = raster.axes
    x, y, z = (s * u[k] + (g * v[k] + raster.depth * w[k]) for k in range(3))
    return x, y, z


def _shade(prepared: _Prepared, hits: _Hits) -> Floats:
    """Radiance (n, 3) towards the eye."""
    occluders, materials = prepared.occluders, prepared.materials
    shader = prepared.shader[hits.owner]
    total = np.zeros((3, hits.pixel.size))
    length = np.sqrt(dot(hits.direction, hits.direction))
    view: Triple = tuple(-m / length for m in hits.direction)  # type: ignore[assignment]
    reach = np.abs(hits.p[0]) + np.abs(hits.p[1]) + np.abs(hits.p[2]) + hits.t * length
    for light, intensity in prepared.lights:
        to_light: Triple = tuple(  # type: ignore[assignment]
            x - m for x, m in zip(light.position, hits.p, strict=True)
        )
        projected = dot(hits.n, to_light)
        # Seen from inside, an object keeps out all light that is not inside as well.
        kept_out = occluders.eye_inside & (light.side >= 0)
        lit = np.flatnonzero((projected > 0) & ~kept_out[hits.owner])
        to_light = tuple(m[lit] for m in to_light)  # type: ignore[assignment]
        blocked = light.blocked(
            occluders,
            tuple(m[lit] for m in hits.p),  # type: ignore[arg-type]
            to_light,
            hits.owner[lit],
            reach[lit],
        )
        free = np.flatnonzero(~blocked)
        lit = lit[free]
        distance = np.sqrt(dot(*[tuple(m[free] for m in to_light)] * 2))  # type: ignore[arg-type]
        cosine = projected[lit] / distance
        material = shader[lit]
        for k in range(3):
            total[k, lit] += intensity[k] * materials.diffuse[k][material] * cosine
        shiny = np.flatnonzero(materials.glossy[material])
        if shiny.size:
            at, material = lit[shiny], material[shiny]
            power = highlight(
                tuple(m[at] for m in hits.n),  # type: ignore[arg-type]
                tuple(m[free[shiny]] / distance[shiny] for m in to_light),  # type: ignore[arg-type]
                tuple(m[at] for m in view),  # type: ignore[arg-type]
                materials.exponent[material],
            )
            for k in range(3):
                total[k, at] += intensity[k] * materials.specular[k][material] * power
    return total.T
