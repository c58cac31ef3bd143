"""Warn of valid scenes that look like mistakes.

Most warnings follow from the scene alone.  If a picture is black, rays are traced to find out which
objects are visible, and why no light reaches them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from tracer.arrays import BATCH_SIZE, Floats, Ints, indices
from tracer.geometry.rounding import INSIDE, LIGHT_TOLERANCE
from tracer.scene.model import Phong, Scene, Shader, Surfaces, VectorLike
from tracer.scene.schema import format_number
from tracer.trace.samples import pixel_centers
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# A colour of whole numbers looks like one from 0 to 255 if its largest number is at least this.
_MIN_CODE = 10

# Pixels look stretched by mistake if their width and height differ by more than this factor.
_MAX_ASPECT = 1.05

# Maximum number of pairs of a light and a surface for which a picture that is not black is searched
# for lights inside surfaces.
_MAX_PAIRS = BATCH_SIZE

# In rectangles of more than this many pixels, one in `_EXAMINATION_STEP` pixels is examined for
# clipping.  To examine all took 8 % of the time of a picture of one sphere.
_MIN_ESTIMATED_PIXELS, _EXAMINATION_STEP = 4096, 7


class SceneWarning(UserWarning):
    """The warning that a valid scene looks like a mistake.

    For example, its picture is black or stretched, or its colours go up to 255 instead of 1.
    """


class Exposure(NamedTuple):
    """Counts of lit and clipped pixels in a picture, or in a part of it.

    Attributes
    ----------
    lit_count : int
        Number of pixels that are not black.  It is 0 only if all pixels are black.
    clipped_count : int
        Number of pixels with a component larger than 1, which a PNG file cannot represent.

    Notes
    -----
    In rectangles of more than `_MIN_ESTIMATED_PIXELS` pixels, the counts are estimates from one in
    `_EXAMINATION_STEP` pixels.
    """

    lit_count: int = 0
    clipped_count: int = 0

    @classmethod
    def from_radiance(cls, radiance: Floats) -> Exposure:
        """Count the lit and the clipped pixels in a rectangle of a picture.

        Parameters
        ----------
        radiance : (rows, columns, 3) float array
            Linear RGB radiance of the pixels.

        Returns
        -------
        exposure : Exposure
            The counts.
        """
        pixels = radiance.reshape(-1, 3)
        step = _EXAMINATION_STEP if len(pixels) > _MIN_ESTIMATED_PIXELS else 1
        red, green, blue = pixels[::step].T
        maximum = np.maximum(np.maximum(red, green), blue)
        # Row by row, because this search ends at the first row that is not black.
        lit_count = step * int(np.count_nonzero(maximum)) or int(any(row.any() for row in radiance))
        return cls(lit_count, step * int(np.count_nonzero(maximum > 1)))

    def merged(self, other: Exposure) -> Exposure:
        """Return the exposure of this and another part of a picture together.

        Parameters
        ----------
        other : Exposure
            The exposure of the other part.

        Returns
        -------
        exposure : Exposure
            The sums of the counts of both parts.
        """
        lit_count = self.lit_count + other.lit_count
        return Exposure(lit_count, self.clipped_count + other.clipped_count)


def scene_warnings(scene: Scene, prepared: PreparedScene, exposure: Exposure) -> Iterator[str]:
    """Yield a warning for each property of a scene or of its picture that looks like a mistake.

    Parameters
    ----------
    scene : Scene
        The scene.
    prepared : PreparedScene
        The same scene, prepared for its camera.
    exposure : Exposure
        Counts of lit and clipped pixels in the whole picture.

    Yields
    ------
    warning : str
        One line: what looks wrong, where, and a suggested fix.
    """
    code_warnings = [*islice(_code_warnings(scene), 1)]
    yield from code_warnings
    yield from _shader_warnings(scene.surfaces)
    yield from _aspect_warnings(scene)
    if not exposure.lit_count:
        reason, remedy = _explain_black(scene, prepared)
        yield f"{reason}: the picture is black; {remedy}"
        return
    yield from _light_warnings(scene, prepared)
    if not code_warnings and 2 * exposure.clipped_count > exposure.lit_count:
        intensities = [max(light.intensity) for light in scene.lights]
        brightest = intensities.index(max(intensities))
        percentage = f"{100 * exposure.clipped_count / exposure.lit_count:.0f} %"
        remedy = f"lower the intensities, first that of {_light_name(scene, brightest)}"
        yield (
            f"{percentage} of the pixels that are not black are brighter than 1, and clipped at 1 "
            f"in a PNG file; {remedy}"
        )


def _light_warnings(scene: Scene, prepared: PreparedScene) -> Iterator[str]:
    """Yield a warning for the first light of intensity 0, and for the first inside a surface.

    Lights inside surfaces are searched for only if the scene has at most `_MAX_PAIRS` pairs of a
    light and a surface.

    Parameters
    ----------
    scene : Scene
        The scene.
    prepared : PreparedScene
        The same scene, prepared for its camera.

    Yields
    ------
    warning : str
        One line: what looks wrong, where, and a suggested fix.
    """
    dark_lights = [index for index, light in enumerate(scene.lights) if not any(light.intensity)]
    for light_index in dark_lights[:1]:
        yield f"{_light_name(scene, light_index)} has intensity 0 0 0: it has no effect; remove it"
    if len(scene.lights) * len(scene.surfaces) <= _MAX_PAIRS:
        for light_index, enclosing in islice(_enclosed_lights(prepared), 1):
            light, surface = _light_name(scene, light_index), _surface_name(scene, enclosing)
            yield f"{light} is inside {surface}: it has no effect; move it out"


def _enclosed_lights(prepared: PreparedScene) -> Iterator[tuple[int, Ints]]:
    """Find the lights that are inside an object while the eye is outside that object.

    Such a light illuminates nothing that is visible.  Lights of intensity 0 are skipped.

    Parameters
    ----------
    prepared : PreparedScene
        The scene, prepared for its camera.

    Yields
    ------
    light_index : int
        Index of the light in the scene.
    enclosing : (k,) int array
        Indices of the objects that contain the light, but not the eye; k is at least 1.
    """
    start = 0
    for lights in prepared.light_batches:
        encloses = (lights.side == INSIDE) & ~prepared.is_eye_inside
        for row in np.flatnonzero(encloses.any(axis=1) & lights.intensity.any(axis=1)).tolist():
            # A light that is inside by less than the tolerance is treated as on the surface.
            is_deep = [
                shape.signed_distance(shape.objects.indices(), (*lights.position[row],))
                < -LIGHT_TOLERANCE * shape.coordinate_size
                for shape in prepared.shapes
            ]
            enclosing = indices(encloses[row] & np.concatenate(is_deep))
            if enclosing.size:
                yield start + row, enclosing
        start += len(lights.position)


@np.errstate(all="ignore")
def _explain_black(scene: Scene, prepared: PreparedScene) -> tuple[str, str]:
    """Find out why the picture of a scene is black.

    Parameters
    ----------
    scene : Scene
        The scene.
    prepared : PreparedScene
        The same scene, prepared for its camera.

    Returns
    -------
    reason : str
        Why the picture is black.
    remedy : str
        A suggested fix.
    """
    if not scene.lights:
        return "the scene has no light", "add <light>"
    visible = _visible_objects(prepared)
    if not visible.size:
        return _explain_empty(scene, prepared)
    see_shader = f"see the shader of {_surface_name(scene, visible)}"
    is_reflected = (prepared.diffuse[:, visible] > 0) | (prepared.specular[:, visible] > 0)
    if not is_reflected.any():
        return "all surfaces in view are black", see_shader
    is_emitted = np.array([light.intensity for light in scene.lights]) > 0
    if not is_emitted.any():
        return "all lights have intensity 0 0 0", f"increase that of {_light_name(scene, 0)}"
    if not is_reflected[is_emitted.any(axis=0)].any():
        return "the surfaces in view reflect no colour of the lights", see_shader
    unlit = "no light reaches anything in view"
    around_eye = visible[prepared.is_eye_inside[visible]]
    if around_eye.size:
        name = _surface_name(scene, around_eye)
        return unlit, f"viewPoint is inside {name}: move it out, or a light in"
    enclosed = [*_enclosed_lights(prepared)]
    if len(enclosed) < np.count_nonzero(is_emitted.any(axis=1)):
        return unlit, "see the lights' positions"
    light_index, enclosing = enclosed[0]
    name = _light_name(scene, light_index)
    return unlit, f"{name} is inside {_surface_name(scene, enclosing)}: move it out"


def _explain_empty(scene: Scene, prepared: PreparedScene) -> tuple[str, str]:
    """Find out why no object is visible at the centre of any pixel.

    Parameters
    ----------
    scene : Scene
        The scene.
    prepared : PreparedScene
        The same scene, prepared for its camera.

    Returns
    -------
    reason : str
        Why no object is visible.
    remedy : str
        A suggested fix.
    """
    (top, bottom, left, right), frame = prepared.bounds, prepared.frame
    is_in_view = (top < frame.height) & (bottom > 0) & (left < frame.width) & (right > 0)
    is_in_view &= (top <= bottom) & (left <= right)
    if not is_in_view.any():
        return "no object is in view", "see viewPoint, viewDir and the window"
    narrow = indices(is_in_view & (np.minimum(bottom - top, right - left) < 1))
    if not narrow.size:
        remedy = "see viewPoint, viewDir and the window, or try --samples 16"
        return "no pixel's centre sees an object", remedy
    name = _surface_name(scene, narrow)
    return "no pixel's centre sees an object", f"{name} is narrower than a pixel: try --samples 16"


def _visible_objects(prepared: PreparedScene) -> Ints:
    """Find the objects that are visible at the centre of at least one pixel.

    Parameters
    ----------
    prepared : PreparedScene
        A scene, prepared for its camera.

    Returns
    -------
    visible : (k,) int array
        Indices of the objects in the prepared scene, in ascending order.
    """
    (rows, columns), visible_parts = prepared.window, [np.zeros(0, dtype=np.intp)]
    if columns.start < columns.stop:
        row_count = max(1, prepared.batch_size(BATCH_SIZE) // (columns.stop - columns.start))
        for top in range(rows.start, rows.stop, row_count):
            samples = pixel_centers(slice(top, min(top + row_count, rows.stop)), columns)
            visible_parts.append(np.unique(nearest_hits(prepared, samples).run_object))
    return np.unique(np.concatenate(visible_parts))


def _shader_warnings(surfaces: Surfaces) -> Iterator[str]:
    """Yield a warning for shaders that no surface uses, and one for exponents without effect.

    An exponent has no effect if the specular colour is 0.  Only shaders from a file are reported,
    because others have no line number by which the warning could name them.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces of the scene, with its shaders.

    Yields
    ------
    warning : str
        One line: what looks wrong, in which lines of the file, and a suggested fix.
    """
    is_used = np.zeros(len(surfaces.shaders), dtype=np.bool_)
    is_used[surfaces.shader_index] = True
    unused_lines: list[int] = []
    matte_lines: list[int] = []
    for shader, used in zip(surfaces.shaders, is_used.tolist(), strict=True):
        if shader.line is None:
            continue
        if not used:
            unused_lines.append(shader.line)
        elif isinstance(shader, Phong) and shader.exponent != 1 and not any(shader.specular):
            matte_lines.append(shader.line)
    if unused_lines:
        names, remedy = _shader_names(unused_lines), 'write <shader ref="..."/> with the name in a'
        yield f"no surface refers to the {names}; {remedy} surface, or remove the definition"
    if matte_lines:
        names, reason = _shader_names(matte_lines), "because specularColor is 0 0 0"
        yield f"exponent has no effect in the {names}, {reason}; add <specularColor>"


def _shader_names(lines: list[int]) -> str:
    """Name one or more shaders by the lines of the file that define them.

    At most nine lines are listed: "shader of line 3", or "shaders of lines 3, 7".
    """
    numbers = ", ".join(map(str, lines[:9])) + ", ..." * (len(lines) > 9)
    return f"shader of line {numbers}" if len(lines) == 1 else f"shaders of lines {numbers}"


def _aspect_warnings(scene: Scene) -> Iterator[str]:
    """Yield a warning if the width and height of pixels differ by more than a tolerance.

    The tolerance is the factor `_MAX_ASPECT`.  The warning suggests another `viewWidth`, or another
    number of columns.
    """
    width, height, camera = scene.width, scene.height, scene.camera
    view_width, view_height = camera.view_width, camera.view_height
    if not 1 / _MAX_ASPECT <= view_width * height / (view_height * width) <= _MAX_ASPECT:
        window = f"{format_number(view_width)} x {format_number(view_height)}"
        picture = f"{width} x {height} pixels show a window of {window}, stretched"
        columns = max(1, round(height * view_width / view_height))
        remedy = f"viewWidth {view_height * width / height:.6g}, or {columns} columns,"
        yield f"{picture}; {remedy} would make them square"


def _indexed_name(kind: str, index: int, line: int | None) -> str:
    """Name a light or a surface by its index in the scene, and by its line if it is from a file.

    For example, the name of a light is "light 0", or "light 0 (line 12)".
    """
    return f"{kind} {index}" if line is None else f"{kind} {index} (line {line})"


def _light_name(scene: Scene, index: int) -> str:
    """Name the light `scene.lights[index]` by its index, and by its line if it is from a file."""
    return _indexed_name("light", index, scene.lights[index].line)


def _surface_name(scene: Scene, object_index: Ints) -> str:
    """Name one of several surfaces: the one that comes first in the file.

    Parameters
    ----------
    scene : Scene
        The scene with the surfaces.
    object_index : (n,) int array
        Indices of the surfaces in the order in which the scene stores objects, which is not that of
        the file; n is at least 1.
    """
    index = scene.surfaces.file_index[object_index].min().item()
    return _indexed_name("surface", index, scene.surfaces[index].line)


def _tagged_colors(shader: Shader) -> Iterator[tuple[str, VectorLike]]:
    """Yield each colour of a shader as a pair: its XML tag, and its value."""
    yield "diffuseColor", shader.diffuse
    if isinstance(shader, Phong):
        yield "specularColor", shader.specular


def _code_warnings(scene: Scene) -> Iterator[str]:
    """Yield a warning for each colour that seems to be given as 0 to 255 instead of 0 to 1.

    This is so if its components are whole numbers up to 255, and the largest is at least
    `_MIN_CODE`.  Each warning names the light, or the first surface with the colour, and suggests
    the colour in the range from 0 to 1.
    """
    surfaces = scene.surfaces
    colors = [
        ("intensity", light.intensity, _light_name(scene, index))
        for index, light in enumerate(scene.lights)
    ]
    # Each shader is named by the first surface in the file that uses it.
    shaders, users = np.unique(surfaces.shader_index[surfaces.file_order], return_index=True)
    for shader, user in zip(shaders.tolist(), users.tolist(), strict=True):
        for tag, color in _tagged_colors(surfaces.shaders[shader]):
            if max(color) >= _MIN_CODE:
                colors.append((tag, color, _indexed_name("surface", user, surfaces[user].line)))
    for tag, color, owner in colors:
        if max(color) >= _MIN_CODE and all(value == int(value) <= 255 for value in color):
            codes = " ".join(map(format_number, color))
            fractions = " ".join(f"{value / 255:.3g}" for value in color)
            yield f"{tag} {codes} of {owner} looks like 0 to 255; for 0 to 1, write {fractions}"
