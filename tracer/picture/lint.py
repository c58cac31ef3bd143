"""Warn about valid scenes that look like mistakes.

Most warnings follow from the scene alone.  Others follow from the *exposure* of its picture: how
many pixels are black, and how many are too bright.  If all are black, rays are traced to find out
which objects are visible, and why no light reaches them.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.lattice import PIXEL_CENTERS
from tracer.arrays import BATCH_SIZE, Floats, Ints
from tracer.geometry.rounding import LIGHT_TOLERANCE
from tracer.messages import name_element
from tracer.scene.model import Phong, Scene, Surfaces, VectorLike
from tracer.scene.schema import format_number
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import PreparedScene

# A colour of integers looks like 0 to 255 if its peak (largest component) is at least this.
_MIN_PEAK = 10

# Pixels look stretched by mistake if their width and height differ by more than this factor.
_MAX_ASPECT = 1.05

# If the number of lights times the number of surfaces is larger than this, no light is checked for
# being inside a surface.
_MAX_PAIRS = BATCH_SIZE

# In a tile with more pixels than this, only some rows are examined for black and clipped pixels.
# Examining all rows took 8 % of the time of a picture of one sphere.
_MAX_EXAMINED_PIXELS = 4096
# In such a tile, one in this many rows is examined.
_ROW_STEP = 16

# Maximum number of lines that a warning lists.
_MAX_LISTED_LINES = 9


class SceneWarning(UserWarning):
    """The warning that a valid scene looks like a mistake.

    For example, its picture is black or stretched, or its colours go up to 255 instead of 1.
    """


def warn_user(message: str, category: type[Warning], *, in_notebook: bool = False) -> None:
    """Give a warning that names the innermost line of the user's code.

    That is the innermost line outside of the tracer.  While a notebook shows a scene, functions of
    the notebook call the tracer, so the innermost line of `__main__` is named instead.
    """

    def is_user_code(module_name: str) -> bool:
        if in_notebook:
            return module_name == "__main__"
        return module_name.partition(".")[0] != "tracer"

    level = 1  # `warnings.warn` counts this function as level 1
    frame = sys._getframe()
    while frame.f_back is not None and not is_user_code(frame.f_globals.get("__name__", "")):
        frame = frame.f_back
        level += 1
    warnings.warn(message, category, stacklevel=level)


class Exposure(NamedTuple):
    """Counts of lit and clipped pixels in a picture, or in a tile of it."""

    pixel_count: int = 0
    lit_count: int = 0  # number of pixels that are not black; 0 only if all are black
    # Number of pixels with a component larger than 1, which a PNG file cannot represent.
    clipped_count: int = 0

    @classmethod
    def from_radiance(cls, radiance: Shaped[Floats, "rows columns 3"]) -> Exposure:
        """Count the pixels of a tile.

        In a tile of more than `_MAX_EXAMINED_PIXELS`, the counts of lit and clipped pixels are
        estimated from one in `_ROW_STEP` rows.
        """
        pixel_count = radiance[..., 0].size
        row_step = _ROW_STEP if pixel_count > _MAX_EXAMINED_PIXELS else 1
        red, green, blue = np.moveaxis(radiance[::row_step], 2, 0)
        max_component = np.maximum(np.maximum(red, green), blue)
        weight = pixel_count / max_component.size  # pixels that each examined pixel represents
        lit_count = round(weight * np.count_nonzero(max_component))
        return cls(
            pixel_count=pixel_count,
            # Before a tile counts as black, all of its rows are examined.
            lit_count=lit_count or int(radiance.any()),
            clipped_count=round(weight * np.count_nonzero(max_component > 1)),
        )

    def add(self, other: Exposure) -> Exposure:
        """Return the counts in two parts of a picture together."""
        return Exposure(
            pixel_count=self.pixel_count + other.pixel_count,
            lit_count=self.lit_count + other.lit_count,
            clipped_count=self.clipped_count + other.clipped_count,
        )


def lint_scene(
    scene: Scene, prepared_scene: PreparedScene, exposure: Exposure | None
) -> Iterator[str]:
    """Yield a warning for each property of a scene or its picture that looks like a mistake.

    A warning is one line.  It says what looks wrong and where, and suggests a fix.  If several
    lights or colours have the same mistake, only the first is reported.

    Parameters
    ----------
    prepared_scene
        The prepared form of `scene`.
    exposure
        Counts in the whole picture; None if only a part of it was rendered.  That part may be black
        or too bright although the whole picture is not, so nothing is said about it.
    """
    range_warning = _check_color_ranges(scene)
    if range_warning:
        yield range_warning
    yield from _check_shaders(scene.surfaces)
    yield from _check_aspect(scene)
    yield from _check_dark_lights(scene)
    yield from _check_enclosed_lights(scene, prepared_scene)
    if exposure is None:
        return
    if not exposure.lit_count:
        reason, remedy = _explain_black_picture(scene, prepared_scene)
        yield f"{reason}: the picture is black; {remedy}"
    elif not range_warning:  # colours up to 255 would explain a bright picture
        yield from _check_clipping(scene, exposure)


def _check_color_ranges(scene: Scene) -> str | None:
    """Return a warning if a colour seems to be given as 0 to 255 instead of 0 to 1, or None.

    The warning names the light, or the first surface with the colour, and suggests a new colour.
    """
    for light_index, light in enumerate(scene.lights):
        if _is_up_to_255(light.intensity):
            light_name = _format_light_name(scene, light_index)
            return _format_range_warning("intensity", light.intensity, light_name)
    surfaces = scene.surfaces
    shader_index_of_surface = surfaces.shader_index[surfaces.array_index]
    # For each shader that a surface uses, the first of these surfaces.
    _, first_indices = np.unique(shader_index_of_surface, return_index=True)
    for surface_index in first_indices.tolist():
        shader = surfaces.shaders[shader_index_of_surface[surface_index]]
        colors = {"diffuseColor": shader.diffuse}
        if isinstance(shader, Phong):
            colors["specularColor"] = shader.specular
        for tag, color in colors.items():
            if _is_up_to_255(color):
                name = name_element("surface", surface_index, surfaces[surface_index].line)
                return _format_range_warning(tag, color, name)
    return None


def _is_up_to_255(color: VectorLike) -> bool:
    """Test whether all components are integers up to 255, and one is at least `_MIN_PEAK`."""
    return max(color) >= _MIN_PEAK and all(value == int(value) <= 255 for value in color)


def _format_range_warning(tag: str, color: VectorLike, owner_name: str) -> str:
    """Return a warning that a colour seems to be given as 0 to 255, with the colour for 0 to 1.

    `tag` names the colour, and `owner_name` the light or the surface that has it.
    """
    old_color = " ".join(map(format_number, color))
    new_color = " ".join(f"{value / 255:.3g}" for value in color)
    problem = f"{tag} {old_color} of {owner_name} looks like 0 to 255"
    return f"{problem}; for 0 to 1, write {new_color}"


def _check_shaders(surfaces: Surfaces) -> Iterator[str]:
    """Yield one warning about shaders that no surface uses, and one about exponents without effect.

    An exponent has no effect if the specular colour is 0.  Shaders that do not come from a file
    have no line that a message could name, so they are skipped.
    """
    used_shader_indices = set(surfaces.shader_index.tolist())
    unused_lines: list[int] = []
    matte_lines: list[int] = []  # lines of shaders with an exponent, but without highlights
    for index, shader in enumerate(surfaces.shaders):
        if shader.line is None:
            continue
        if index not in used_shader_indices:
            unused_lines.append(shader.line)
        elif isinstance(shader, Phong) and shader.exponent != 1 and not any(shader.specular):
            matte_lines.append(shader.line)
    if unused_lines:
        names = _format_shader_names(unused_lines)
        remedy = 'write <shader ref="..."/> with the name in a surface, or remove the definition'
        yield f"no surface refers to the {names}; {remedy}"
    if matte_lines:
        names = _format_shader_names(matte_lines)
        reason = "because specularColor is 0 0 0"
        yield f"exponent has no effect in the {names}, {reason}; add <specularColor>"


def _format_shader_names(lines: list[int]) -> str:
    """Return a phrase such as "shader on line 3" or "shaders on lines 3, 7"."""
    if len(lines) == 1:
        return f"shader on line {lines[0]}"
    listed_lines = [str(line) for line in lines[:_MAX_LISTED_LINES]]
    ellipsis = ["..."] * (len(lines) > _MAX_LISTED_LINES)
    return f"shaders on lines {', '.join(listed_lines + ellipsis)}"


def _check_aspect(scene: Scene) -> Iterator[str]:
    """Yield a warning if pixels are stretched by a factor of more than `_MAX_ASPECT`.

    The warning suggests a `viewWidth`, or else a number of columns, that makes the pixels square.
    """
    width, height = scene.width, scene.height
    view_width, view_height = scene.camera.view_width, scene.camera.view_height
    pixel_aspect = view_width * height / (view_height * width)
    if not 1 / _MAX_ASPECT <= pixel_aspect <= _MAX_ASPECT:
        window_size = f"{format_number(view_width)} x {format_number(view_height)}"
        problem = f"a window of {window_size} is stretched over {width} x {height} pixels"
        column_count = max(1, round(height * view_width / view_height))
        remedy = f"viewWidth {view_height * width / height:.6g}, or {column_count} columns,"
        yield f"{problem}; {remedy} would make them square"


def _check_dark_lights(scene: Scene) -> Iterator[str]:
    """Yield a warning about the first light of intensity 0."""
    for light_index, light in enumerate(scene.lights):
        if not any(light.intensity):
            name = _format_light_name(scene, light_index)
            reason = "has intensity 0 0 0: it has no effect"
            yield f"{name} {reason}; increase the intensity, or remove it"
            return


def _check_enclosed_lights(scene: Scene, prepared_scene: PreparedScene) -> Iterator[str]:
    """Yield a warning about the first light that is inside a surface while the eye is outside it.

    A light counts as inside if it is deeper below the surface than rounding can explain.
    """
    if not 0 < len(scene.lights) * len(scene.surfaces) <= _MAX_PAIRS:
        return
    x, y, z = np.array([light.position for light in scene.lights]).T[:, :, None]
    # For each shape, whether each light (row) is inside each object (column).
    is_inside_shape = []
    for shape in prepared_scene.shapes:
        distances = shape.measure_distance(shape.objects.list_indices(), (x, y, z))
        is_inside_shape.append(distances < -LIGHT_TOLERANCE * shape.coordinate_bound)
    has_no_effect = np.concatenate(is_inside_shape, axis=1) & ~prepared_scene.is_eye_inside
    enclosed_lights = np.flatnonzero(has_no_effect.any(axis=1)).tolist()
    if enclosed_lights:
        light_index = enclosed_lights[0]
        light_name = _format_light_name(scene, light_index)
        surface_name = _format_surface_name(scene, np.flatnonzero(has_no_effect[light_index]))
        yield f"{light_name} is inside {surface_name}: it has no effect; move it out"


def _check_clipping(scene: Scene, exposure: Exposure) -> Iterator[str]:
    """Yield a warning if more than half of the lit pixels are too bright for a PNG file."""
    if 2 * exposure.clipped_count > exposure.lit_count:
        intensities = [max(light.intensity) for light in scene.lights]
        brightest_light = _format_light_name(scene, intensities.index(max(intensities)))
        percentage = f"{100 * exposure.clipped_count / exposure.lit_count:.0f} %"
        yield (
            f"{percentage} of the pixels that are not black are brighter than 1, and clipped at 1 "
            f"in a PNG file; lower the intensities of the lights, {brightest_light} first"
        )


@np.errstate(all="ignore")
def _explain_black_picture(scene: Scene, prepared_scene: PreparedScene) -> tuple[str, str]:
    """Return the reason why the picture of a scene is black, and a suggested fix."""
    if not scene.lights:
        return "the scene has no light", "add <light>"
    visible_index = _find_visible_objects(prepared_scene)
    camera_remedy = "see viewPoint, viewDir and the window"
    if not visible_index.size:
        if prepared_scene.bounds.is_in_picture(prepared_scene.frame).any():
            return "no object is at a pixel's centre", f"try --samples 16, or {camera_remedy}"
        return "no object is in view", camera_remedy
    shader_remedy = f"see the shader of {_format_surface_name(scene, visible_index)}"
    # Which channels (red, green, blue) does each visible object reflect, and each light emit?
    has_reflectance = (prepared_scene.diffuse > 0) | (prepared_scene.specular > 0)
    reflects_channel = has_reflectance[:, visible_index]
    emits_channel = np.array([light.intensity for light in scene.lights]) > 0
    if not reflects_channel.any():
        return "all surfaces in view are black", shader_remedy
    if emits_channel.any() and not reflects_channel[emits_channel.any(axis=0)].any():
        return "the surfaces in view reflect no colour of the lights", shader_remedy
    remedy = "see the lights' positions and intensities"
    enclosing_index = visible_index[prepared_scene.is_eye_inside[visible_index]]
    if enclosing_index.size:
        surface_name = _format_surface_name(scene, enclosing_index)
        remedy = f"viewPoint is inside {surface_name}: move it out, or a light in"
    return "no light reaches anything in view", remedy


def _find_visible_objects(prepared_scene: PreparedScene) -> Shaped[Ints, "n"]:
    """Find the objects that are visible at the centre of at least one pixel.

    Return their object indices in ascending order.
    """
    rows, columns = prepared_scene.visible_pixels
    index_batches = [np.zeros(0, dtype=np.intp)]
    column_count = columns.stop - columns.start
    if column_count > 0:
        rows_per_batch = max(1, prepared_scene.choose_batch_size(BATCH_SIZE) // column_count)
        for top in range(rows.start, rows.stop, rows_per_batch):
            batch_rows = slice(top, min(top + rows_per_batch, rows.stop))
            samples = PIXEL_CENTERS.place_in_pixels(batch_rows, columns)
            index_batches.append(np.unique(find_nearest_hits(prepared_scene, samples).run_object))
    return np.unique(np.concatenate(index_batches))


def _format_light_name(scene: Scene, index: int) -> str:
    return name_element("light", index, scene.lights[index].line)


def _format_surface_name(scene: Scene, object_indices: Shaped[Ints, "n"]) -> str:
    """Return the name of the first of these objects in the scene file."""
    surface_index = scene.surfaces.file_index[object_indices].min().item()
    return name_element("surface", surface_index, scene.surfaces[surface_index].line)
