"""Warnings for valid scenes that look like mistakes.

Most warnings follow from the scene alone.  Only if a picture is black, rays are traced to find out
which objects are visible, and why no light reaches them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from math import gcd
from typing import NamedTuple

import numpy as np

from tracer.arrays import BATCH_SIZE, Floats, Ints, batches, indices
from tracer.geometry.rounding import LIGHT_TOLERANCE
from tracer.scene.model import Phong, Scene, Shader, Surfaces, VectorLike
from tracer.scene.schema import number_text
from tracer.trace.samples import pixel_centers
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# A colour of whole numbers counts as one from 0 to 255 if at least one of them is this large.
_MIN_CODE = 10

# Pixels count as stretched by mistake if they are more than this many times as wide as high, or as
# high as wide.
_MAX_ASPECT = 1.05

# Maximum number of pairs of a light and a surface for which a picture that is not black is searched
# for lights inside surfaces.
_MAX_PAIRS = BATCH_SIZE

# Maximum number of pixels of one rectangle of the picture that are examined for clipping.
_MAX_EXAMINED = 1 << 12


class SceneWarning(UserWarning):
    """A valid scene that looks like a mistake: stretched, without light, colours up to 255."""


class Exposure(NamedTuple):
    """Numbers of black, lit and clipped pixels in a picture, or in a part of it.

    Attributes
    ----------
    is_black : bool
        Whether all pixels are black.
    lit, clipped : int
        Number of pixels that are not black, and number of pixels with a component larger than 1,
        which a PNG file cannot represent.  For more than `_MAX_EXAMINED` pixels, these are
        estimates.
    """

    is_black: bool = True
    lit: int = 0
    clipped: int = 0

    @classmethod
    def of_pixels(cls, radiance: Floats) -> Exposure:
        """Examine pixels, given by their linear RGB radiance (rows, columns, 3)."""
        height, width, _ = radiance.shape
        step = max(1, -(-height * width // _MAX_EXAMINED))
        while gcd(step, width) > 1:  # else only some of the columns would be examined
            step += 1
        red, green, blue = radiance.reshape(-1, 3)[::step].T
        maximum = np.maximum(np.maximum(red, green), blue)
        lit, clipped = (step * int(np.count_nonzero(maximum > limit)) for limit in (0, 1))
        # Row by row, because this search ends at the first row that is not black.
        return cls(not any(row.any() for row in radiance), lit, clipped)

    def including(self, other: Exposure) -> Exposure:
        """Return the exposure of these pixels together with others."""
        is_black = self.is_black and other.is_black
        return Exposure(is_black, self.lit + other.lit, self.clipped + other.clipped)


def scene_warnings(scene: Scene, prepared: PreparedScene, exposure: Exposure) -> Iterator[str]:
    """Yield a warning for each property of a scene, or of its picture, that looks like a mistake.

    Parameters
    ----------
    scene : Scene
        The scene.
    prepared : PreparedScene
        The same scene, prepared for its camera.
    exposure : Exposure
        Numbers of black, lit and clipped pixels in its picture.
    """
    code_warnings = [*islice(_code_warnings(scene), 1)]
    yield from code_warnings
    yield from _ineffective_shaders(scene.surfaces)
    yield from _stretched(scene)
    if exposure.is_black:
        reason, remedy = _reason_for_black(scene, prepared)
        yield f"{reason}: the picture is black; {remedy}"
        return
    yield from _ineffective_lights(scene, prepared)
    if not code_warnings and 2 * exposure.clipped > exposure.lit:
        brightest = max(range(len(scene.lights)), key=lambda k: max(scene.lights[k].intensity))
        share = f"{100 * exposure.clipped / exposure.lit:.0f} % of the pixels that are not black"
        remedy = f"lower the intensities, first that of {_light_name(scene, brightest)}"
        yield f"{share} are brighter than 1, and clipped at 1 in a PNG file; {remedy}"


def _ineffective_lights(scene: Scene, prepared: PreparedScene) -> Iterator[str]:
    """Yield a warning for the first light of intensity 0, and for the first inside a surface."""
    lights = [index for index, light in enumerate(scene.lights) if not any(light.intensity)]
    for light in lights[:1]:
        yield f"{_light_name(scene, light)} has intensity 0 0 0: it has no effect; remove it"
    if len(scene.lights) * len(scene.surfaces) <= _MAX_PAIRS:
        for light, enclosing in islice(_enclosed_lights(scene, prepared), 1):
            where = f"{_light_name(scene, light)} is inside {_surface_name(scene, enclosing)}"
            yield f"{where}: it has no effect; move it out"


def _enclosed_lights(scene: Scene, prepared: PreparedScene) -> Iterator[tuple[int, Ints]]:
    """Find lights that reach nothing in view because they are inside objects without the eye.

    Yields
    ------
    light : int
        Index of a light whose intensity is not 0.
    enclosing : (k,) int array
        Indices of the objects that contain the light, but not the eye; at least one.
    """
    if not prepared.shapes:
        return
    for batch in batches(np.full(len(scene.lights), prepared.is_eye_inside.size)):
        position = np.array([light.position for light in scene.lights[batch]])
        x, y, z = position.T[:, :, None]
        # A light at a depth of less than the tolerance counts as on the surface.
        is_inside = [
            shape.signed_distance(shape.objects.indices(), (x, y, z))
            < -LIGHT_TOLERANCE * shape.coordinate_size
            for shape in prepared.shapes
        ]
        encloses = np.concatenate(is_inside, axis=1) & ~prepared.is_eye_inside
        for index in np.flatnonzero(encloses.any(axis=1)).tolist():
            if any(scene.lights[batch.start + index].intensity):
                yield batch.start + index, indices(encloses[index])


@np.errstate(all="ignore")
def _reason_for_black(scene: Scene, prepared: PreparedScene) -> tuple[str, str]:
    """Find out why a picture is black; return the reason and a suggested fix."""
    if not scene.lights:
        return "the scene has no light", "add <light>"
    visible = _visible_objects(prepared)
    if not visible.size:
        return _reason_for_empty(scene, prepared)
    shader = f"see the shader of {_surface_name(scene, visible)}"
    colors = (prepared.diffuse[:, visible] > 0) | (prepared.specular[:, visible] > 0)
    if not colors.any():
        return "all surfaces in view are black", shader
    is_bright = np.array([light.intensity for light in scene.lights]) > 0
    if not is_bright.any():
        return "all lights have intensity 0 0 0", f"increase that of {_light_name(scene, 0)}"
    if not colors[is_bright.any(axis=0)].any():
        return "the surfaces in view reflect no colour of the lights", shader
    unlit = "no light reaches anything in view"
    around = visible[prepared.is_eye_inside[visible]]
    if around.size:
        name = _surface_name(scene, around)
        return unlit, f"viewPoint is inside {name}: move it out, or a light in"
    enclosed = [*_enclosed_lights(scene, prepared)]
    if len(enclosed) < np.count_nonzero(is_bright.any(axis=1)):
        return unlit, "see the lights' positions"
    light, enclosing = enclosed[0]
    name = _light_name(scene, light)
    return unlit, f"{name} is inside {_surface_name(scene, enclosing)}: move it out"


def _reason_for_empty(scene: Scene, prepared: PreparedScene) -> tuple[str, str]:
    """Find out why no pixel's centre sees an object; return the reason and a suggested fix."""
    (top, bottom, left, right), frame = prepared.bounds, prepared.frame
    is_near = (top < frame.height) & (bottom > 0) & (left < frame.width) & (right > 0)
    is_near &= (top <= bottom) & (left <= right)
    if not is_near.any():
        return "no object is in view", "see viewPoint, viewDir and the window"
    narrow = indices(is_near & (np.minimum(bottom - top, right - left) < 1))
    if not narrow.size:
        remedy = "see viewPoint, viewDir and the window, or try --samples 16"
        return "no pixel's centre sees an object", remedy
    name = _surface_name(scene, narrow)
    return "no pixel's centre sees an object", f"{name} is narrower than a pixel: try --samples 16"


def _visible_objects(prepared: PreparedScene) -> Ints:
    """Return the indices of all objects that are visible at the centre of any pixel."""
    (rows, columns), visible = prepared.window, [np.zeros(0, dtype=np.intp)]
    if columns.start < columns.stop:
        step = max(1, prepared.batch_size(BATCH_SIZE) // (columns.stop - columns.start))
        for top in range(rows.start, rows.stop, step):
            samples = pixel_centers(slice(top, min(top + step, rows.stop)), columns)
            visible.append(np.unique(nearest_hits(prepared, samples).run_object))
    return np.unique(np.concatenate(visible))


def _ineffective_shaders(surfaces: Surfaces) -> Iterator[str]:
    """Yield warnings for shaders that no surface uses, and for exponents without a highlight.

    Only shaders from a file are reported, because only these have line numbers.
    """
    is_used = np.zeros(len(surfaces.shaders), dtype=np.bool_)
    is_used[surfaces.shader_index] = True
    unused: list[int] = []
    matte: list[int] = []
    for shader, used in zip(surfaces.shaders, is_used.tolist(), strict=True):
        if shader.line is None:
            continue
        if not used:
            unused.append(shader.line)
        elif isinstance(shader, Phong) and shader.exponent != 1 and not any(shader.specular):
            matte.append(shader.line)
    if unused:
        remedy = 'write <shader ref="..."/> with the name in a surface'
        yield f"no surface refers to the {_shaders_of(unused)}; {remedy}, or remove the definition"
    if matte:
        reason = "because specularColor is 0 0 0"
        yield f"exponent has no effect in the {_shaders_of(matte)}, {reason}; add <specularColor>"


def _shaders_of(lines: list[int]) -> str:
    """Name shaders by the lines that define them, of which at most nine are listed."""
    numbers = ", ".join(map(str, lines[:9])) + ", ..." * (len(lines) > 9)
    return f"shader of line {numbers}" if len(lines) == 1 else f"shaders of lines {numbers}"


def _stretched(scene: Scene) -> Iterator[str]:
    """Yield a warning if pixels are far from square."""
    width, height, camera = scene.width, scene.height, scene.camera
    across, down = camera.view_width, camera.view_height
    if not 1 / _MAX_ASPECT <= across * height / (down * width) <= _MAX_ASPECT:
        size = f"{number_text(across)} x {number_text(down)}"
        window = f"{width} x {height} pixels show a window of {size}"
        columns = max(1, round(height * across / down))
        remedy = f"viewWidth {down * width / height:.6g}, or {columns} columns,"
        yield f"{window}, stretched; {remedy} would make them square"


def _name(what: str, index: int, line: int | None) -> str:
    """Name a light or a surface by its index in the file, and by its line if it has one."""
    return f"{what} {index}" if line is None else f"{what} {index} (line {line})"


def _light_name(scene: Scene, index: int) -> str:
    """Name a light, given by its index."""
    return _name("light", index, scene.lights[index].line)


def _surface_name(scene: Scene, object_index: Ints) -> str:
    """Name the surface that is first in the file, of objects given by their indices (n,)."""
    index = scene.surfaces.file_index[object_index].min().item()
    return _name("surface", index, scene.surfaces[index].line)


def _colors(shader: Shader) -> Iterator[tuple[str, VectorLike]]:
    """Yield the tag and the value of each colour of a shader."""
    yield "diffuseColor", shader.diffuse
    if isinstance(shader, Phong):
        yield "specularColor", shader.specular


def _code_warnings(scene: Scene) -> Iterator[str]:
    """Yield a warning for each colour that seems to be given as 0 to 255 instead of 0 to 1."""
    surfaces = scene.surfaces
    colors = [
        ("intensity", light.intensity, _light_name(scene, index))
        for index, light in enumerate(scene.lights)
    ]
    # Each shader is named by the first surface in the file that uses it.
    shaders, users = np.unique(surfaces.shader_index[surfaces.file_order], return_index=True)
    for shader, user in zip(shaders.tolist(), users.tolist(), strict=True):
        for tag, color in _colors(surfaces.shaders[shader]):
            if max(color) >= _MIN_CODE:
                colors.append((tag, color, _name("surface", user, surfaces[user].line)))
    for tag, color, owner in colors:
        if max(color) >= _MIN_CODE and all(value == int(value) <= 255 for value in color):
            codes = " ".join(map(number_text, color))
            fractions = " ".join(f"{value / 255:.3g}" for value in color)
            yield f"{tag} {codes} of {owner} looks like 0 to 255; for 0 to 1, write {fractions}"
