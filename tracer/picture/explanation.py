"""Explain a pixel: list the numbers from which its colour is computed.

The numbers come from the functions that render pictures.  A single ray is traced, and its hit is
shaded twice: by all lights together, as in a picture, and by each light alone.

In the text of an explanation, n is the normal of the hit, l the direction to a light, and h the
half vector; kd and ks are the diffuse and specular colours of the surface.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tracer.antialias.lattice import PIXEL_CENTERS
from tracer.arrays import Ints, Vector, take
from tracer.picture.lint import name_element
from tracer.picture.png import to_codes
from tracer.scene.model import Lambertian, Scene, normalize
from tracer.trace.first_hits import FirstHits
from tracer.trace.hits import Hits
from tracer.trace.lighting import compute_light_geometry
from tracer.trace.radiance import shade
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

__all__ = ["Explanation", "LightPart", "SurfaceRef", "explain"]


@dataclass(frozen=True)
class SurfaceRef:
    """A reference to a surface of a scene, which shows where the file defines the surface.

    ``str(ref)`` is, for example, "Sphere 0 (line 12)".

    Attributes
    ----------
    index : int
        Index of the surface in ``scene.surfaces``, which has the order of the file.
    kind : str
        "Sphere" or "Box".
    line : int or None
        Line of the file where the surface begins; None if the surface does not come from a file.
    """

    index: int
    kind: str
    line: int | None

    @classmethod
    def from_index(cls, scene: Scene, index: int) -> SurfaceRef:
        """Create a reference to the surface ``scene.surfaces[index]``."""
        surface = scene.surfaces[index]
        return cls(index, type(surface).__name__, surface.line)

    def __str__(self) -> str:
        return name_element(self.kind, self.index, self.line)


@dataclass(frozen=True)
class LightPart:
    """The contribution of one light to the colour of a pixel.

    Attributes
    ----------
    line : int or None
        Line of the file where the light begins; None if the light does not come from a file.
    intensity : (float, float, float)
        Linear RGB intensity of the light.
    n_dot_l, n_dot_h : float
        Cosines of the angle between the normal n and the direction l to the light, and of the angle
        between n and the half vector h.  The half vector is the unit vector halfway between l and
        the direction to the eye.
    occluders : tuple of SurfaceRef
        The surfaces that block the light, for example the surface itself if it faces away; empty if
        the hit is lit.
    diffuse, specular : (float, float, float)
        Linear RGB radiance that the light adds: intensity kd n.l, and intensity ks (n.h)^exponent.
        Both are 0 if the light is blocked.
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
    """The numbers from which the colour of a pixel is computed, from the ray to the codes.

    ``str(explanation)`` shows all of them as text, one step of the computation in each line.

    Attributes
    ----------
    x, y : int
        Column and row of the pixel; the top left pixel is 0, 0.
    eye, direction : (float, float, float)
        Start and unit direction of the ray through the centre of the pixel, in the axes of the
        scene.
    surface : SurfaceRef or None
        The surface that the ray meets first; None if the ray meets no surface.
    distance : float
        Distance of the hit from the eye; infinite if the ray meets no surface.
    point, normal : (float, float, float)
        Position of the hit, and unit normal of the surface there, on the side of the eye.  Both are
        NaN if the ray meets no surface.
    kd, ks : (float, float, float)
        Diffuse and specular colour of the surface, linear RGB.  `ks` is 0 if the surface is
        Lambertian, and both are 0 if the ray meets no surface.
    exponent : float
        Exponent of the surface's highlights; 1 if it has none.
    lights : tuple of LightPart
        The contribution of each light, in the order of ``scene.lights``; empty if the ray meets no
        surface.
    radiance : (float, float, float)
        Linear RGB radiance of the pixel in a picture with one sample per pixel.
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
        return "\n".join(self._format_lines())

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Show the explanation as text in IPython and notebooks, which call this method."""
        printer.text(str(self))

    def _format_lines(self) -> Iterator[str]:
        yield f"pixel     {self.x},{self.y}"
        yield f"ray       from {_format_vector(self.eye)} towards {_format_vector(self.direction)}"
        yield f"surface   {self.surface or 'none: the ray meets nothing'}"
        if self.surface:
            yield f"distance  {self.distance:.9g}"
            yield f"point     {_format_vector(self.point)}"
            yield f"normal    {_format_vector(self.normal)}"
            kd, ks = _format_vector(self.kd), _format_vector(self.ks)
            yield f"shader    kd {kd}, ks {ks}, exponent {self.exponent:g}"
        for index, light in enumerate(self.lights):
            yield from self._format_light_lines(index, light)
        yield f"radiance  {_format_vector(self.radiance)}"
        yield f"codes     {' '.join(map(str, self.codes))}"

    def _format_light_lines(self, light_index: int, light: LightPart) -> Iterator[str]:
        """Yield the cosines and occluders of a light; then, unless it is blocked, its two terms."""
        other_names = [str(ref) for ref in light.occluders if ref != self.surface]
        blockers = other_names or ["the surface itself"] * len(light.occluders)
        outcome = f"blocked by {', '.join(blockers)}" if blockers else "reaches the point"
        n_dot_l = f"{light.n_dot_l:.9g}"
        n_dot_h = f"{light.n_dot_h:.9g}"
        light_name = name_element("light", light_index, light.line)
        yield f"{light_name}: n.l = {n_dot_l}, n.h = {n_dot_h}, {outcome}"
        if not light.occluders:
            intensity, kd, ks = map(_format_vector, (light.intensity, self.kd, self.ks))
            highlight = f"{n_dot_h}^{self.exponent:g}"
            yield f"  diffuse   {_format_vector(light.diffuse)} = {intensity} * {kd} * {n_dot_l}"
            yield f"  specular  {_format_vector(light.specular)} = {intensity} * {ks} * {highlight}"


def _to_vector(values: ArrayLike) -> Vector:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def _format_vector(vector: Vector) -> str:
    """Format a vector with up to nine digits for each component, and negative zero as 0."""
    return " ".join(f"{component + 0.0:.9g}" for component in vector)


@np.errstate(all="ignore")
def explain(scene: Scene, x: int, y: int) -> Explanation:
    """Explain how the colour of a pixel is computed in a picture with one sample per pixel.

    Parameters
    ----------
    scene : Scene
        The scene to render.
    x, y : int
        Column and row of the pixel; the top left pixel is 0, 0.

    Returns
    -------
    explanation : Explanation
        The ray through the centre of the pixel, the point that it hits, the contribution of each
        light, the radiance and the 8-bit colour.  ``print(explanation)`` shows them as text.

    Raises
    ------
    TypeError
        If `x` or `y` is not an integer.
    ValueError
        If the pixel is outside the picture.
    """
    x, y = operator.index(x), operator.index(y)
    width, height = scene.width, scene.height
    if not (0 <= x < width and 0 <= y < height):
        raise ValueError(f"pixel {x},{y} is outside the picture of {width} x {height} pixels")
    prepared_scene = PreparedScene(scene)
    frame = prepared_scene.frame
    samples = PIXEL_CENTERS.place_in_pixels(slice(y, y + 1), slice(x, x + 1))
    hits = find_nearest_hits(prepared_scene, samples)
    radiance = shade(hits, prepared_scene.iterate_light_batches()).compute_radiance()[:, 0]
    first_hit = FirstHits.from_hits(hits)
    surface_index = first_hit.surface.item()
    ray = samples.compute_ray_x(frame), frame.to_ray_y(samples.y), np.array([frame.depth])
    has_hit = surface_index >= 0
    shader = scene.surfaces[surface_index].shader if has_hit else Lambertian(diffuse=(0, 0, 0))
    return Explanation(
        x=x,
        y=y,
        eye=_to_vector(frame.eye),
        direction=_to_vector(normalize(np.ravel(frame.rotate_to_scene(ray)))),
        surface=SurfaceRef.from_index(scene, surface_index) if has_hit else None,
        distance=first_hit.distance.item(),
        point=_to_vector(first_hit.point[0]),
        normal=_to_vector(first_hit.normal[0]),
        kd=_to_vector(shader.diffuse),
        ks=_to_vector(getattr(shader, "specular", (0.0, 0.0, 0.0))),
        exponent=getattr(shader, "exponent", 1.0),
        lights=tuple(
            _explain_light(scene, hits, first_hit, light_index)
            for light_index in range(len(scene.lights) if has_hit else 0)
        ),
        radiance=_to_vector(radiance),
        codes=tuple(to_codes(radiance[None, None])[0, 0].tolist()),
    )


def _explain_light(
    scene: Scene, camera_hits: Hits, first_hit: FirstHits, light_index: int
) -> LightPart:
    """Compute the contribution of one light to a pixel that shows a surface.

    `camera_hits` and `first_hit` contain the same single hit, in camera axes and in scene axes.
    The first is needed to decide what the renderer decides, with the same rounding errors: whether
    the surface faces the light, and what blocks it.  The second gives the cosines that are shown,
    which thus agree with the position and the normal that are shown.
    """
    light = scene.lights[light_index]
    prepared_light = camera_hits.scene.prepare_lights(slice(light_index, light_index + 1))
    is_facing_light = compute_light_geometry(camera_hits, prepared_light).n_dot_l.item() > 0
    # A surface that faces away from the light blocks the light itself.
    if is_facing_light:
        occluder_index = _find_occluders(camera_hits, prepared_light)
    else:
        occluder_index = camera_hits.hit_object
    diffuse, specular = np.zeros((2, 3))
    for channel, *terms in shade(camera_hits, [prepared_light]).compute_channels():
        diffuse[channel], specular[channel] = (term.item() for term in terms)
    point = first_hit.point[0]
    normal = first_hit.normal[0]
    to_light = normalize(np.subtract(light.position, point))
    half_vector = normalize(to_light + normalize(camera_hits.scene.frame.eye - point))
    surface_indices = scene.surfaces.file_index[occluder_index].tolist()
    return LightPart(
        line=light.line,
        intensity=_to_vector(light.intensity),
        n_dot_l=float(normal @ to_light),
        n_dot_h=float(normal @ half_vector),
        occluders=tuple(SurfaceRef.from_index(scene, index) for index in surface_indices),
        diffuse=_to_vector(diffuse),
        specular=_to_vector(specular),
    )


def _find_occluders(hit: Hits, light: Lights) -> Shaped[Ints, "n"]:
    """Find all objects that block the segment from one hit to one light, except that of the hit."""
    occluder_indices = []
    for shape in hit.scene.shapes:
        object_index = np.setdiff1d(shape.objects.list_indices(), hit.hit_object)
        # Repeat the hit and the light for each object.
        hit_position = hit.get_points(np.zeros_like(object_index))
        light_position = take(light.position.T, np.zeros_like(object_index))
        light_side = light.side[0, object_index]  # outside, on or inside the object
        is_blocking = shape.occludes(object_index, hit_position, light_position, light_side)
        occluder_indices.append(object_index[is_blocking])
    return np.concatenate(occluder_indices)
