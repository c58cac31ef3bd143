"""Warnings for valid scenes that look like mistakes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from tracer.arrays import Bools
from tracer.scene.model import Phong, Scene, Shader, Surfaces, VectorLike
from tracer.scene.schema import number
from tracer.trace.first_hits import first_hits

# A colour of whole numbers, with one of at least this size, is taken to be from 0 to 255.
_LEAST_CODE = 10

# Pixels that are so many times as wide as high, or as high as wide, are taken for a slip.
_STRETCHED = 1.05

# A black picture is searched for objects at this many positions along each side, at most.
_PROBE_SIDE = 256


class SceneWarning(UserWarning):
    """A valid scene that looks like a mistake: stretched, without light, colours up to 255."""


def scene_warnings(scene: Scene, *, black: bool) -> Iterator[str]:
    """Yield a warning for each suspicious property; `black`: whether the picture is all black."""
    surfaces = scene.surfaces
    yield from islice(_codes(scene), 1)
    yield from _ineffective_shaders(scene.surfaces)
    yield from _stretched(scene)
    if not black:
        return
    if not scene.lights:
        yield "the scene has no light: the picture is black; add <light>"
        return
    x, y = (
        np.arange(0.5, min(size, _PROBE_SIDE)) * max(1, size / _PROBE_SIDE)
        for size in (scene.width, scene.height)
    )
    hit = first_hits(scene, np.tile(x, y.size), y.repeat(x.size)).surface
    hit = surfaces.file_order[np.unique(hit[hit >= 0])]
    shaders = {surfaces.shaders[k] for k in surfaces.shader_index[hit].tolist()}
    if not hit.size:
        yield "no object is in view: the picture is black; see viewPoint, viewDir and the window"
    elif any(max(color) > 0 for shader in shaders for _, color in _colors(shader)):
        remedy = "see the lights' positions"
        around = hit[_contain_eye(scene)[hit]]
        if around.size:
            first = surfaces.file_index[around].min().item()
            name = _named("surface", first, surfaces[first].line)
            remedy = f"viewPoint is inside {name}: move it out, or a light in"
        yield f"no light reaches anything in view: the picture is black; {remedy}"


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
    if not 1 / _STRETCHED <= across * height / (down * width) <= _STRETCHED:
        window = f"{width} x {height} pixels show a window of {number(across)} x {number(down)}"
        columns = max(1, round(height * across / down))
        remedy = f"viewWidth {down * width / height:.6g}, or {columns} columns,"
        yield f"{window}, stretched; {remedy} would make them square"


def _contain_eye(scene: Scene) -> Bools:
    """Find surfaces (S + B,), in the order of the arrays, that the eye is inside of."""
    surfaces, eye = scene.surfaces, np.asarray(scene.camera.view_point)
    spheres = np.linalg.norm(surfaces.center - eye, axis=1) < surfaces.radius
    boxes = ((surfaces.min_pt < eye) & (eye < surfaces.max_pt)).all(axis=1)
    return np.concatenate([spheres, boxes])


def _named(what: str, index: int, line: int | None) -> str:
    """Name a light or surface by its index in the file, and its line there."""
    return f"{what} {index}" if line is None else f"{what} {index} (line {line})"


def _colors(shader: Shader) -> Iterator[tuple[str, VectorLike]]:
    """Yield the colours of a shader, and their tags."""
    yield "diffuseColor", shader.diffuse
    if isinstance(shader, Phong):
        yield "specularColor", shader.specular


def _codes(scene: Scene) -> Iterator[str]:
    """Yield a warning for each colour that looks like 8-bit codes."""
    surfaces = scene.surfaces
    colors = [
        ("intensity", light.intensity, _named("light", k, light.line))
        for k, light in enumerate(scene.lights)
    ]
    shaders, users = np.unique(surfaces.shader_index[surfaces.file_order], return_index=True)
    for k, user in zip(shaders.tolist(), users.tolist(), strict=True):
        for name, color in _colors(surfaces.shaders[k]):
            if max(color) >= _LEAST_CODE:
                colors.append((name, color, _named("surface", user, surfaces[user].line)))
    for name, color, where in colors:
        if max(color) >= _LEAST_CODE and all(value == int(value) <= 255 for value in color):
            given = " ".join(map(number, color))
            right = " ".join(f"{value / 255:.3g}" for value in color)
            yield f"{name} {given} of {where} looks like 0 to 255; for 0 to 1, write {right}"
