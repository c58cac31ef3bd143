"""Explanations of pixels: all numbers that lead to the colour of a pixel.

The numbers come from the functions that render pictures.  A pixel is traced once, and its hit is
then shaded twice: by all lights together, as in a picture, and by each light alone.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import Ints, Vector, take3
from tracer.picture.png import to_codes
from tracer.scene.model import Lambertian, PointLight, Scene, unit
from tracer.trace.first_hits import FirstHits
from tracer.trace.hits import Hits
from tracer.trace.lighting import light_geometry
from tracer.trace.radiance import shade
from tracer.trace.samples import pixel_centers
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

__all__ = ["Explanation", "LightPart", "SurfaceRef", "explain"]


@dataclass(frozen=True)
class SurfaceRef:
    """A surface of the scene, given by its place in the file.

    Attributes
    ----------
    index : int
        Index of the surface among the surfaces of the scene, in the order of the file.
    kind : str
        "Sphere" or "Box".
    line : int or None
        Line of the surface in its file; None if it does not come from a file.
    """

    index: int
    kind: str
    line: int | None

    @classmethod
    def from_index(cls, scene: Scene, index: int) -> SurfaceRef:
        """Return the reference to a surface of a scene, given by its index."""
        surface = scene.surfaces[index]
        return cls(index, type(surface).__name__, surface.line)

    def __str__(self) -> str:
        return f"{self.kind} {self.index}{_line(self.line)}"


@dataclass(frozen=True)
class LightPart:
    """The contribution of one light to a pixel.

    Attributes
    ----------
    line : int or None
        Line of the light in its file; None if it does not come from a file.
    intensity : (float, float, float)
        Linear RGB intensity of the light.
    n_dot_l, n_dot_h : float
        Cosines of the angles between the normal and the direction to the light, and between the
        normal and the half vector.
    occluders : tuple of SurfaceRef
        The surfaces that block the light: other surfaces, or the surface itself if it faces away
        from the light, or if the eye is inside it and the light is not.
    diffuse, specular : (float, float, float)
        Linear RGB radiance that the light adds: intensity kd n.l, and intensity ks (n.h)^exponent.
        0 if the light is blocked.
    """

    line: int | None
    intensity: Vector
    n_dot_l: float
    n_dot_h: float
    occluders: tuple[SurfaceRef, ...]
    diffuse: Vector
    specular: Vector


@dataclass(frozen=True)
class Explanation:
    """All numbers that lead to the colour of a pixel; as text, one line for each number.

    Attributes
    ----------
    x, y : int
        Column and row of the pixel; the top left pixel is 0, 0.
    eye, direction : (float, float, float)
        Start and unit direction of the ray through the centre of the pixel, in the axes of the
        scene.
    surface : SurfaceRef or None
        The surface that the ray meets first; None if it meets no surface.
    distance : float
        Distance of the hit from the eye; infinite if the ray meets no surface.
    point, normal : (float, float, float)
        Position of the hit, and the unit normal on the side of the eye; NaN if the ray meets no
        surface.
    kd, ks : (float, float, float)
        Diffuse and specular colour of the surface, linear RGB.  `ks` is 0 if the surface is
        Lambertian, and both are 0 if the ray meets no surface.
    exponent : float
        Exponent of the surface's highlights; 1 if it has none.
    lights : tuple of LightPart
        The contribution of each light of the scene; empty if the ray meets no surface.
    radiance : (float, float, float)
        Linear RGB radiance of the pixel, in a picture with one sample per pixel.
    codes : (int, int, int)
        The colour of the pixel in a PNG file, from 0 to 255.
    """

    x: int
    y: int
    eye: Vector
    direction: Vector
    surface: SurfaceRef | None
    distance: float
    point: Vector
    normal: Vector
    kd: Vector
    ks: Vector
    exponent: float
    lights: tuple[LightPart, ...]
    radiance: Vector
    codes: tuple[int, int, int]

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Show the text in IPython and in notebooks."""
        printer.text(str(self))

    def _lines(self) -> Iterator[str]:
        """Yield the lines of the text."""
        yield f"pixel     {self.x},{self.y}"
        yield f"ray       from {_text(self.eye)} towards {_text(self.direction)}"
        yield f"surface   {self.surface or 'none: the ray meets nothing'}"
        if self.surface:
            yield f"distance  {self.distance:.9g}"
            yield f"point     {_text(self.point)}"
            yield f"normal    {_text(self.normal)}"
            yield f"shader    kd {_text(self.kd)}, ks {_text(self.ks)}, exponent {self.exponent:g}"
        for number, light in enumerate(self.lights):
            yield from self._light_lines(number, light)
        yield f"radiance  {_text(self.radiance)}"
        yield f"codes     {' '.join(map(str, self.codes))}"

    def _light_lines(self, number: int, light: LightPart) -> Iterator[str]:
        """Yield the lines about one light, given by its index and its contribution."""
        names = [str(ref) for ref in light.occluders if ref != self.surface]
        names = names or ["the surface itself"] * len(light.occluders)
        how = f"blocked by {', '.join(names)}" if names else "reaches the point"
        n_dot_l, n_dot_h = f"{light.n_dot_l:.9g}", f"{light.n_dot_h:.9g}"
        yield f"light {number}{_line(light.line)}: n.l = {n_dot_l}, n.h = {n_dot_h}, {how}"
        if not names:
            intensity, kd, ks = map(_text, (light.intensity, self.kd, self.ks))
            power = f"{n_dot_h}^{self.exponent:g}"
            yield f"  diffuse   {_text(light.diffuse)} = {intensity} * {kd} * {n_dot_l}"
            yield f"  specular  {_text(light.specular)} = {intensity} * {ks} * {power}"


def _line(line: int | None) -> str:
    """Return a line of a file as text to append to a name."""
    return "" if line is None else f" (line {line})"


def _vector(values: ArrayLike) -> Vector:
    """Convert three numbers to a tuple of floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def _text(vector: Vector) -> str:
    """Return the components of a vector as text; the sum turns -0 into 0."""
    return " ".join(f"{value + 0.0:.9g}" for value in vector)


@np.errstate(all="ignore")
def explain(scene: Scene, x: int, y: int) -> Explanation:
    """Explain the colour of a pixel, in a picture with one sample per pixel.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : int
        Column and row of the pixel; the top left pixel is 0, 0.

    Raises
    ------
    TypeError
        If `x` or `y` is not an integer.
    ValueError
        If the pixel is outside of the picture.
    """
    x, y = operator.index(x), operator.index(y)
    width, height = scene.width, scene.height
    if not (0 <= x < width and 0 <= y < height):
        raise ValueError(f"pixel {x},{y} is outside the picture of {width} x {height} pixels")
    prepared = PreparedScene(scene)
    frame, samples = prepared.frame, pixel_centers(slice(y, y + 1), slice(x, x + 1))
    hits = nearest_hits(prepared, samples)
    radiance = shade(hits, prepared.light_batches).radiance()[:, 0]
    first_hit = FirstHits.from_hits(hits)
    index = first_hit.surface.item()
    s, g, depth = samples.ray_s(frame), frame.ray_g(samples.y), np.array([frame.depth])
    shader = scene.surfaces[index].shader if index >= 0 else Lambertian(diffuse=(0, 0, 0))
    return Explanation(
        x=x,
        y=y,
        eye=_vector(frame.eye),
        direction=_vector(unit(np.ravel(frame.vector_to_scene((s, g, depth))))),
        surface=SurfaceRef.from_index(scene, index) if index >= 0 else None,
        distance=first_hit.distance.item(),
        point=_vector(first_hit.point[0]),
        normal=_vector(first_hit.normal[0]),
        kd=_vector(shader.diffuse),
        ks=_vector(getattr(shader, "specular", (0.0, 0.0, 0.0))),
        exponent=getattr(shader, "exponent", 1.0),
        lights=tuple(
            _light_part(scene, hits, first_hit, light, prepared.prepare_lights(slice(i, i + 1)))
            for i, light in enumerate(scene.lights if index >= 0 else ())
        ),
        radiance=_vector(radiance),
        codes=tuple(to_codes(radiance[None, None])[0, 0].tolist()),
    )


def _light_part(
    scene: Scene, hits: Hits, first_hit: FirstHits, light: PointLight, lights: Lights
) -> LightPart:
    """Compute the contribution of one light to a pixel.

    Parameters
    ----------
    scene : Scene
        The scene.
    hits : Hits
        The one hit of the pixel.
    first_hit : FirstHits
        The same hit in the axes of the scene: arrays of length 1.
    light : PointLight
        The light.
    lights : Lights
        The batch that contains only this light.
    """
    faces_light = light_geometry(hits, lights).n_dot_l.item() > 0
    occluders = _occluders(hits, lights) if faces_light else hits.hit_object
    diffuse, specular = np.zeros((2, 3))
    for _, channel, diffuse_term, specular_term in shade(hits, [lights]).reflection_terms():
        diffuse[channel] = diffuse_term.item()
        specular[channel] = 0 if specular_term is None else specular_term.item()
    point, normal = first_hit.point[0], first_hit.normal[0]
    to_light = unit(np.subtract(light.position, point))
    half = unit(to_light + unit(hits.prepared.frame.eye - point))
    file_index = scene.surfaces.file_index[occluders].tolist()
    return LightPart(
        line=light.line,
        intensity=_vector(light.intensity),
        n_dot_l=float(normal @ to_light),
        n_dot_h=float(normal @ half),
        occluders=tuple(SurfaceRef.from_index(scene, index) for index in file_index),
        diffuse=_vector(diffuse),
        specular=_vector(specular),
    )


def _occluders(hits: Hits, lights: Lights) -> Ints:
    """Find all objects that block the segment from a hit to a light.

    The object on which the hit lies is not tested.

    Parameters
    ----------
    hits : Hits
        The one hit.
    lights : Lights
        The batch that contains only this light.

    Returns
    -------
    occluders : (k,) int array
        Indices among all objects of the scene.
    """
    occluders = []
    for shape in hits.prepared.shapes:
        others = np.setdiff1d(shape.objects.indices(), hits.hit_object)
        same_hit = hits.points(np.zeros_like(others))
        same_light = take3(lights.position.T, np.zeros_like(others))
        side = lights.side[0, others]
        blocks = shape.occludes(others, same_hit, same_light, side)
        occluders.append(others[blocks])
    return np.concatenate(occluders)
