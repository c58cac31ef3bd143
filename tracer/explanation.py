"""Pixels explained: the numbers that go into one, found by the code that renders pictures."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tracer.antialias.lattice import CENTRES
from tracer.arrays import Floats
from tracer.arrays import Triple as Vectors
from tracer.light.lighting import Lighting, incoming_at, lighting_of, radiance_at
from tracer.picture.png import to_codes
from tracer.scene.model import Scene, unit
from tracer.view.camera import raster_of
from tracer.view.first_hits import Hits, first_hits
from tracer.view.view import Visible, view_of
from tracer.view.visibility import visible

__all__ = ["Explanation", "LightPart", "SurfaceRef", "explain"]

Triple: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceRef:
    """A surface of the scene.

    Attributes
    ----------
    index : int
        Its place among the scene's surfaces, in the file's order.
    kind : str
        Sphere or Box.
    line : int or None
        Where it stands in its file, if it is from one.
    """

    index: int
    kind: str
    line: int | None

    @classmethod
    def of(cls, scene: Scene, owner: int) -> SurfaceRef:
        """A surface by its number among all, spheres first."""
        index = scene.surfaces.file_index[owner].item()
        surface = scene.surfaces[index]
        return cls(index, type(surface).__name__, surface.line)

    def __str__(self) -> str:
        return f"{self.kind} {self.index}{_line(self.line)}"


@dataclass(frozen=True)
class LightPart:
    """One light's part in a pixel.

    Attributes
    ----------
    line : int or None
        Where the light stands in its file, if it is from one.
    n_dot_l : float
        Cosine between the normal and the direction to the light.
    kept_out_by : tuple of SurfaceRef
        What keeps the light from the point: other surfaces, or its own where that faces away, or
        is seen from inside and holds no light.
    diffuse, specular : (3,)
        Radiance that it adds: intensity kd n.l, and intensity ks (n.h)^exponent.
    """

    line: int | None
    n_dot_l: float
    kept_out_by: tuple[SurfaceRef, ...]
    diffuse: Triple
    specular: Triple


@dataclass(frozen=True)
class Explanation:
    """What goes into a pixel; as text, a line for each number.

    Attributes
    ----------
    x, y : int
        Column and row of the pixel; 0, 0 is the top left.
    eye, direction : (3,)
        The ray through the pixel's centre, its direction of unit length.
    surface : SurfaceRef or None
        What it meets first; None for nothing.
    distance : float
        From the eye; infinite where it meets nothing.
    point, normal : (3,)
        Where it meets the surface, and the unit normal there, towards the eye; NaN for nothing.
    lights : tuple of LightPart
        A part for each light of the scene; none where it meets nothing.
    radiance : (3,)
        Of the pixel in a picture of one sample a pixel, linear RGB.
    codes : (3,)
        The same in 8 bits.
    """

    x: int
    y: int
    eye: Triple
    direction: Triple
    surface: SurfaceRef | None
    distance: float
    point: Triple
    normal: Triple
    lights: tuple[LightPart, ...]
    radiance: Triple
    codes: tuple[int, int, int]

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"pixel     {self.x},{self.y}"
        yield f"ray       from {_text(self.eye)} towards {_text(self.direction)}"
        yield f"surface   {self.surface or 'none: the ray meets nothing'}"
        if self.surface is not None:
            yield f"distance  {self.distance:.9g}"
            yield f"point     {_text(self.point)}"
            yield f"normal    {_text(self.normal)}"
        for number, light in enumerate(self.lights):
            others = [ref for ref in light.kept_out_by if ref != self.surface]
            how = "reaches the point"
            if others:
                how = f"kept out by {', '.join(map(str, others))}"
            elif light.kept_out_by:
                how = "kept out by the surface itself"
            yield f"light {number}{_line(light.line)}: n.l = {light.n_dot_l:.9g}, {how}"
            if not light.kept_out_by:
                yield f"  diffuse   {_text(light.diffuse)}"
                yield f"  specular  {_text(light.specular)}"
        yield f"radiance  {_text(self.radiance)}"
        yield f"codes     {' '.join(map(str, self.codes))}"


def _line(line: int | None) -> str:
    return "" if line is None else f" (line {line})"


def _text(vector: Triple) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in vector)


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


@np.errstate(all="ignore")
def explain(scene: Scene, x: int, y: int) -> Explanation:
    """Explain a pixel of a picture of one sample a pixel.

    Parameters
    ----------
    scene : Scene
    x, y : int
        Column and row; 0, 0 is the top left.

    Raises
    ------
    TypeError
        If `x` or `y` is no integer.
    ValueError
        If the pixel is outside the picture.
    """
    x, y = operator.index(x), operator.index(y)
    width, height = scene.width, scene.height
    if not (0 <= x < width and 0 <= y < height):
        raise ValueError(f"pixel {x},{y} is outside the picture of {width} x {height} pixels")
    raster = raster_of(scene.camera, width, height)
    lighting = lighting_of(scene, view_of(raster, scene.surfaces))
    samples = CENTRES.samples(slice(y, y + 1), slice(x, x + 1))
    radiance = radiance_at(lighting, samples)
    hit, hits = first_hits(scene, [x + 0.5], [y + 0.5]), visible(lighting.view, samples)
    across, down = np.array(x + 0.5), np.array(y + 0.5)
    ray = raster.across(across), raster.down(down), np.array(raster.depth)
    red, green, blue = to_codes(radiance.T[None])[0, 0].tolist()
    return Explanation(
        x=x,
        y=y,
        eye=_triple(raster.eye),
        direction=_triple(unit(np.array(raster.vector_to_scene(ray)))),
        surface=SurfaceRef.of(scene, int(hits.own[0])) if hits.groups else None,
        distance=hit.distance.item(),
        point=_triple(hit.point[0]),
        normal=_triple(hit.normal[0]),
        lights=tuple(_parts(scene, lighting, hits, hit)) if hits.groups else (),
        radiance=_triple(radiance[:, 0]),
        codes=(red, green, blue),
    )


def _parts(scene: Scene, lighting: Lighting, hits: Visible, hit: Hits) -> Iterator[LightPart]:
    """Each light's part at the one point that is hit."""
    owner, materials = int(hits.own[0]), lighting.materials
    shader = lighting.shader[owner]
    incoming = incoming_at(lighting, hits)
    for number, light in enumerate(scene.lights):
        towards = unit(np.subtract(light.position, hit.point[0]))
        occluders = [owner]
        if incoming.n_dot_l[number, 0] > 0:
            occluders = [*_occluders(lighting, owner, hits.points(slice(None)), number)]
        diffuse, specular = np.zeros((2, 3))
        if not occluders:
            cosine = incoming.n_dot_l[number] / np.sqrt(incoming.length2[number])
            diffuse = lighting.intensities[number] * materials.diffuse[:, shader] * cosine
            if materials.glossy[shader]:
                power = incoming.highlight(number, hits.groups[0], np.zeros(1, dtype=np.intp))
                specular = lighting.intensities[number] * materials.specular[:, shader] * power
        yield LightPart(
            line=light.line,
            n_dot_l=float(hit.normal[0] @ towards),
            kept_out_by=tuple(SurfaceRef.of(scene, each) for each in occluders),
            diffuse=_triple(diffuse),
            specular=_triple(specular),
        )


def _occluders(lighting: Lighting, owner: int, p: Vectors, light: int) -> Iterator[int]:
    """All objects, spheres first, that keep a light from a point `p` of an object."""
    view, position = lighting.view, lighting.positions[light]
    for shape in view.shapes:
        others = np.arange(shape.first, shape.first + shape.count)
        others = others[others != owner]
        n = others.size
        start = np.repeat(p[0], n), np.repeat(p[1], n), np.repeat(p[2], n)
        end = np.full(n, position[0]), np.full(n, position[1]), np.full(n, position[2])
        closely = np.ones(n, dtype=np.bool_)
        yield from others[shape.occludes(view.raster.eye, others, start, end, closely)].tolist()
