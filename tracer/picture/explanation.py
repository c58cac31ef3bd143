"""Pixels explained: the numbers that go into one, found by the code that renders pictures."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tracer.antialias.lattice import CENTRES
from tracer.arrays import Ints, Vector, take3
from tracer.geometry.camera import camera_frame
from tracer.picture.png import to_codes
from tracer.scene.model import Lambertian, Scene, unit
from tracer.trace.first_hits import FirstHits, first_hits
from tracer.trace.hits import Hits
from tracer.trace.lighting import light_geometry
from tracer.trace.radiance import radiance_at
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

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
    intensity : (3,)
        The light's color.
    n_dot_l, n_dot_h : float
        Cosines between the normal and the direction to the light, and the half vector.
    occluders : tuple of SurfaceRef
        What keeps the light from the point: other surfaces, or its own where that faces away, or
        is seen from inside and holds no light.
    diffuse, specular : (3,)
        Radiance that it adds: intensity kd n.l, and intensity ks (n.h)^exponent.
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
    kd, ks : (3,)
        The surface's colours, ks of zeros where it is Lambertian, all zeros for nothing.
    exponent : float
        The surface's exponent, 1 where it has none.
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
    kd: Vector
    ks: Vector
    exponent: float
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
            yield f"shader    kd {_text(self.kd)}, ks {_text(self.ks)}, exponent {self.exponent:g}"
        for number, light in enumerate(self.lights):
            names = [str(ref) for ref in light.occluders if ref != self.surface]
            names = names or ["the surface itself"] * len(light.occluders)
            how = f"blocked by {', '.join(names)}" if names else "reaches the point"
            nl, nh = f"{light.n_dot_l:.9g}", f"{light.n_dot_h:.9g}"
            yield f"light {number}{_line(light.line)}: n.l = {nl}, n.h = {nh}, {how}"
            if not names:
                products = (light.diffuse, self.kd, nl), (light.specular, self.ks, nh)
                for name, (term, color, cosine) in zip(
                    ("diffuse", "specular"), products, strict=True
                ):
                    power = f"^{self.exponent:g}" if name == "specular" else ""
                    factors = f"{_text(light.intensity)} * {_text(color)} * {cosine}{power}"
                    yield f"  {name:8}  {_text(term)} = {factors}"
        yield f"radiance  {_text(self.radiance)}"
        yield f"codes     {' '.join(map(str, self.codes))}"


def _line(line: int | None) -> str:
    return "" if line is None else f" (line {line})"


def _vector(values: ArrayLike) -> Vector:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


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
        If `x` or `y` is not an integer.
    ValueError
        If the pixel is outside the picture.
    """
    x, y = operator.index(x), operator.index(y)
    width, height = scene.width, scene.height
    if not (0 <= x < width and 0 <= y < height):
        raise ValueError(f"pixel {x},{y} is outside the picture of {width} x {height} pixels")
    frame = camera_frame(scene.camera, width, height)
    prepared = PreparedScene(scene, frame)
    samples = CENTRES.samples(slice(y, y + 1), slice(x, x + 1))
    radiance, hit = radiance_at(prepared, samples)[:, 0], first_hits(scene, [x + 0.5], [y + 0.5])
    across, down = frame.across(np.array(x + 0.5)), frame.down(np.array(y + 0.5))
    direction = np.array(frame.vector_to_scene((across, down, np.array(frame.depth))))
    index = hit.surface.item()
    shader = scene.surfaces[index].shader if index >= 0 else Lambertian(diffuse=(0, 0, 0))
    return Explanation(
        x=x,
        y=y,
        eye=tuple(frame.eye.tolist()),
        direction=tuple(unit(direction).tolist()),
        surface=SurfaceRef.of(scene, index) if index >= 0 else None,
        distance=hit.distance.item(),
        point=tuple(hit.point[0].tolist()),
        normal=tuple(hit.normal[0].tolist()),
        kd=_vector(shader.diffuse),
        ks=_vector(getattr(shader, "specular", (0.0, 0.0, 0.0))),
        exponent=getattr(shader, "exponent", 1.0),
        lights=tuple(_parts(scene, prepared, nearest_hits(prepared, samples), hit)),
        radiance=tuple(radiance.tolist()),
        codes=tuple(to_codes(radiance[None, None])[0, 0].tolist()),
    )


def _parts(
    scene: Scene, prepared: PreparedScene, hits: Hits, hit: FirstHits
) -> Iterator[LightPart]:
    """Each light's part at the one point that is hit, if any is."""
    own = hits.hit_object
    for number, light in enumerate(scene.lights if hits.groups else ()):
        lights = prepared.lights(slice(number, number + 1))
        geometry = light_geometry(hits, lights)
        cosine = geometry.n_dot_l[0] / np.sqrt(geometry.length2[0])
        occluders = _occluders(hits, lights) if cosine > 0 else own
        diffuse, specular = np.zeros((2, 3, 1))
        if not occluders.size:
            strength = lights.intensity.T
            diffuse = strength * prepared.diffuse[:, own] * cosine
            power = geometry.highlight(0, hits.groups[0], np.zeros(1, dtype=np.intp))
            specular = strength * prepared.specular[:, own] * power
        towards = unit(np.subtract(light.position, hit.point[0]))
        half = unit(towards + unit(prepared.frame.eye - hit.point[0]))
        refs = scene.surfaces.file_index[occluders].tolist()
        yield LightPart(
            line=light.line,
            intensity=_vector(light.intensity),
            n_dot_l=float(hit.normal[0] @ towards),
            n_dot_h=float(hit.normal[0] @ half),
            occluders=tuple(SurfaceRef.of(scene, index) for index in refs),
            diffuse=tuple(diffuse[:, 0].tolist()),
            specular=tuple(specular[:, 0].tolist()),
        )


def _occluders(hits: Hits, lights: Lights) -> Ints:
    """All objects, spheres first, that keep the one light from the one point that is hit."""
    found = []
    for shape in hits.prepared.shapes:
        others = np.setdiff1d(np.arange(shape.first, shape.first + shape.count), hits.hit_object)
        point = hits.points(np.zeros_like(others))
        end = take3(lights.position.T, np.zeros_like(others))
        side = lights.side[0, others]
        blocks = shape.occludes(hits.prepared.frame.eye, others, point, end, side)
        found.append(others[blocks])
    return np.concatenate(found)
