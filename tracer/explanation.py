"""Pixels explained: the numbers that go into one, found by the code that renders pictures."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tracer.antialias.lattice import CENTRES
from tracer.arrays import Ints, Vector, pick
from tracer.light.lighting import Lighting, incoming_at, lighting_of, radiance_at
from tracer.picture.png import to_codes
from tracer.scene.model import Scene, unit
from tracer.view.camera import raster_of
from tracer.view.first_hits import Hits, first_hits
from tracer.view.view import Visible, view_of
from tracer.view.visibility import visible

__all__ = ["Explanation", "LightPart", "SurfaceRef", "explain"]


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
    def of(cls, scene: Scene, index: int) -> SurfaceRef:
        """A surface by its index."""
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
    diffuse: Vector
    specular: Vector


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
    eye: Vector
    direction: Vector
    surface: SurfaceRef | None
    distance: float
    point: Vector
    normal: Vector
    lights: tuple[LightPart, ...]
    radiance: Vector
    codes: tuple[int, int, int]

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"pixel     {self.x},{self.y}"
        yield f"ray       from {_text(self.eye)} towards {_text(self.direction)}"
        yield f"surface   {self.surface or 'none: the ray meets nothing'}"
        if self.surface:
            yield f"distance  {self.distance:.9g}"
            yield f"point     {_text(self.point)}"
            yield f"normal    {_text(self.normal)}"
        for number, light in enumerate(self.lights):
            names = [str(ref) for ref in light.kept_out_by if ref != self.surface]
            names = names or ["the surface itself"] * len(light.kept_out_by)
            how = f"kept out by {', '.join(names)}" if names else "reaches the point"
            yield f"light {number}{_line(light.line)}: n.l = {light.n_dot_l:.9g}, {how}"
            if not names:
                yield f"  diffuse   {_text(light.diffuse)}"
                yield f"  specular  {_text(light.specular)}"
        yield f"radiance  {_text(self.radiance)}"
        yield f"codes     {' '.join(map(str, self.codes))}"


def _line(line: int | None) -> str:
    return "" if line is None else f" (line {line})"


def _text(vector: Vector) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in vector)


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
    radiance, hit = radiance_at(lighting, samples)[:, 0], first_hits(scene, [x + 0.5], [y + 0.5])
    across, down = raster.across(np.array(x + 0.5)), raster.down(np.array(y + 0.5))
    direction = np.array(raster.vector_to_scene((across, down, np.array(raster.depth))))
    index = hit.surface.item()
    return Explanation(
        x=x,
        y=y,
        eye=tuple(raster.eye.tolist()),
        direction=tuple(unit(direction).tolist()),
        surface=SurfaceRef.of(scene, index) if index >= 0 else None,
        distance=hit.distance.item(),
        point=tuple(hit.point[0].tolist()),
        normal=tuple(hit.normal[0].tolist()),
        lights=tuple(_parts(scene, lighting, visible(lighting.view, samples), hit)),
        radiance=tuple(radiance.tolist()),
        codes=tuple(to_codes(radiance[None, None])[0, 0].tolist()),
    )


def _parts(scene: Scene, lighting: Lighting, hits: Visible, hit: Hits) -> Iterator[LightPart]:
    """Each light's part at the one point that is hit, if any is."""
    incoming, own = incoming_at(lighting, hits), hits.own
    for number, light in enumerate(scene.lights if hits.groups else ()):
        cosine = incoming.n_dot_l[number] / np.sqrt(incoming.length2[number])
        occluders = _occluders(lighting, hits, number) if cosine > 0 else own
        diffuse, specular = np.zeros((2, 3, 1))
        if not occluders.size:
            strength = lighting.intensities[number][:, None]
            diffuse = strength * lighting.diffuse[:, own] * cosine
            power = incoming.highlight(number, hits.groups[0], np.zeros(1, dtype=np.intp))
            specular = strength * lighting.specular[:, own] * power
        towards = unit(np.subtract(light.position, hit.point[0]))
        refs = scene.surfaces.file_index[occluders].tolist()
        yield LightPart(
            line=light.line,
            n_dot_l=float(hit.normal[0] @ towards),
            kept_out_by=tuple(SurfaceRef.of(scene, index) for index in refs),
            diffuse=tuple(diffuse[:, 0].tolist()),
            specular=tuple(specular[:, 0].tolist()),
        )


def _occluders(lighting: Lighting, hits: Visible, light: int) -> Ints:
    """All objects, spheres first, that keep a light from the one point that is hit."""
    view, found = lighting.view, []
    for shape in view.shapes:
        others = np.setdiff1d(np.arange(shape.first, shape.first + shape.count), hits.own)
        point = hits.points(np.zeros_like(others))
        end = pick(lighting.positions.T, np.full_like(others, light))
        blocks = shape.occludes(view.raster.eye, others, point, end, np.ones_like(others) > 0)
        found.append(others[blocks])
    return np.concatenate(found)
