"""Explain a pixel: list the numbers from which its colour is computed.

The numbers come from the functions that render pictures.  A single ray is traced, and its hit (the
point where it first meets a surface) is shaded twice: by all lights together, as in a picture, and
by each light alone.

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
from tracer.messages import name_element
from tracer.picture.png import to_codes
from tracer.scene.model import Lambertian, Phong, Scene, normalize
from tracer.trace.first_hits import FirstHits
from tracer.trace.hits import Hits
from tracer.trace.light_geometry import compute_light_geometry
from tracer.trace.radiance import shade
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

__all__ = ["Explanation", "LightPart", "SurfaceRef", "explain"]


@dataclass(frozen=True)
class SurfaceRef:
    """A surface of a scene, given by its index, and the line of the file that defines it.

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
        """Yield a line about the light; then, if it reaches the point, one for each of its terms.

        The first line states the cosines n.l and n.h, and what blocks the light.
        """
        occluder_names = [
            "the surface itself" if surface == self.surface else str(surface)
            for surface in light.occluders
        ]
        blocked_by = f"blocked by {', '.join(occluder_names)}"
        outcome = blocked_by if occluder_names else "reaches the point"
        n_dot_l = f"{light.n_dot_l:.9g}"
        n_dot_h = f"{light.n_dot_h:.9g}"
        light_name = name_element("light", light_index, light.line)
        yield f"{light_name}: n.l = {n_dot_l}, n.h = {n_dot_h}, {outcome}"
        if not light.occluders:
            intensity, kd, ks = map(_format_vector, (light.intensity, self.kd, self.ks))
            highlight = f"{n_dot_h}^{self.exponent:g}"
            yield f"  diffuse   {_format_vector(light.diffuse)} = {intensity} * {kd} * {n_dot_l}"
            yield f"  specular  {_format_vector(light.specular)} = {intensity} * {ks} * {highlight}"


# Infinities and NaN are valid results: for example, the distance if the ray meets no surface.
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
    shown_hit = FirstHits.from_hits(hits)
    surface_index = shown_hit.surface.item()
    # The components of the ray in camera axes, each an array of one number.
    ray = samples.compute_ray_x(frame), frame.to_ray_y(samples.y), np.array([frame.depth])
    has_hit = surface_index >= 0
    shader = scene.surfaces[surface_index].shader if has_hit else Lambertian(diffuse=(0, 0, 0))
    # A Lambertian surface looks like one with black highlights.
    phong = shader if isinstance(shader, Phong) else Phong(diffuse=shader.diffuse)
    return Explanation(
        x=x,
        y=y,
        eye=_to_vector(frame.eye),
        direction=_to_vector(normalize(np.ravel(frame.rotate_to_scene(ray)))),
        surface=SurfaceRef.from_index(scene, surface_index) if has_hit else None,
        distance=shown_hit.distance.item(),
        point=_to_vector(shown_hit.point[0]),
        normal=_to_vector(shown_hit.normal[0]),
        kd=_to_vector(phong.diffuse),
        ks=_to_vector(phong.specular),
        exponent=phong.exponent,
        lights=tuple(
            _explain_light(scene, hits, shown_hit, light_index)
            for light_index in range(len(scene.lights) if has_hit else 0)
        ),
        radiance=_to_vector(radiance),
        codes=tuple(to_codes(radiance[None, None])[0, 0].tolist()),
    )


def _explain_light(scene: Scene, hits: Hits, shown_hit: FirstHits, light_index: int) -> LightPart:
    """Compute the contribution of one light to the colour of a pixel that shows a surface.

    `hits` contains one hit, and `shown_hit` is the same hit in scene axes, as the explanation shows
    it.  The radiance and the occluders are computed from `hits`, as in a picture.  The cosines are
    computed from `shown_hit`, so that readers can check them with the numbers that they see.
    """
    light = scene.lights[light_index]
    prepared_light = hits.scene.prepare_lights(slice(light_index, light_index + 1))
    occluder_index = _find_occluders(hits, prepared_light)
    surface_indices = scene.surfaces.file_index[occluder_index].tolist()
    diffuse = np.zeros(3)
    specular = np.zeros(3)
    for radiance in shade(hits, [prepared_light]).compute_channels():
        diffuse[radiance.channel] = radiance.diffuse.item()
        specular[radiance.channel] = radiance.specular.item()
    point = shown_hit.point[0]
    normal = shown_hit.normal[0]
    to_light = normalize(np.subtract(light.position, point))
    to_eye = normalize(hits.scene.frame.eye - point)
    return LightPart(
        line=light.line,
        intensity=_to_vector(light.intensity),
        n_dot_l=float(normal @ to_light),
        n_dot_h=float(normal @ normalize(to_light + to_eye)),
        occluders=tuple(SurfaceRef.from_index(scene, index) for index in surface_indices),
        diffuse=_to_vector(diffuse),
        specular=_to_vector(specular),
    )


def _find_occluders(hits: Hits, lights: Lights) -> Shaped[Ints, "n"]:
    """Find the object indices of all objects that block one light from one hit.

    `hits` contains only this hit, and `lights` only this light.  If the surface at the hit faces
    away from the light, the result is the object of the hit alone.
    """
    is_facing_light = compute_light_geometry(hits, lights).n_dot_l.item() > 0
    if not is_facing_light:
        return hits.hit_object
    occluder_indices = []
    for shape in hits.scene.shapes:
        object_index = np.setdiff1d(shape.objects.list_indices(), hits.hit_object)
        # Repeat the hit and the light for each object.
        hit_position = hits.get_points(np.zeros_like(object_index))
        light_position = take(lights.position.T, np.zeros_like(object_index))
        light_side = lights.side[0, object_index]  # outside, on or inside the object
        is_blocking = shape.occludes(object_index, hit_position, light_position, light_side)
        occluder_indices.append(object_index[is_blocking])
    return np.concatenate(occluder_indices)


def _to_vector(values: ArrayLike) -> Vector:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def _format_vector(vector: Vector) -> str:
    """Format a vector with up to nine digits for each component, and negative zero as 0."""
    return " ".join(f"{component + 0.0:.9g}" for component in vector)
