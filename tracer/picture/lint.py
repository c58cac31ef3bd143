"""Scenes that can be rendered, but hardly as their authors meant them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from tracer.arrays import Ints
from tracer.scene.model import Phong, Scene, Shader, VectorLike
from tracer.scene.schema import number
from tracer.trace.first_hits import first_hits

# A colour of whole numbers, with one of at least this size, is taken to be from 0 to 255.
_LEAST_CODE = 10

# Where a black picture is searched for objects: at most so many positions along each side.
_PROBE_SIDE = 256


class SceneWarning(UserWarning):
    """A scene that renders, but hardly as meant: an empty view, no light, colours up to 255."""


def scene_warnings(scene: Scene, *, black: bool) -> Iterator[str]:
    """Say in words what looks wrong in a scene; `black`: its picture is all black."""
    surfaces = scene.surfaces
    shader_index = surfaces.shader_index[np.argsort(surfaces.file_index)]
    yield from islice(_codes(scene, shader_index), 1)
    if not black:
        return
    x, y = (
        np.arange(0.5, min(size, _PROBE_SIDE)) * max(1, size / _PROBE_SIDE)
        for size in (scene.width, scene.height)
    )
    seen = first_hits(scene, np.tile(x, y.size), y.repeat(x.size)).surface
    seen = np.unique(seen[seen >= 0])
    shaders = {surfaces.shaders[k] for k in shader_index[seen].tolist()}
    if not seen.size:
        yield "no object is in view: the picture is black; see viewPoint, viewDir and the window"
    elif any(max(color) > 0 for shader in shaders for _, color in _colors(shader)):
        yield "no light reaches anything in view: the picture is black; see the lights' positions"


def _colors(shader: Shader) -> Iterator[tuple[str, VectorLike]]:
    """Colours of a shader, by their tags."""
    yield "diffuseColor", shader.diffuse
    if isinstance(shader, Phong):
        yield "specularColor", shader.specular


def _codes(scene: Scene, shader_index: Ints) -> Iterator[str]:
    """Colours that look like 8-bit codes; `shader_index`: of the surfaces in the file's order."""
    surfaces = scene.surfaces
    colors = [
        ("intensity", light.intensity, f"light {k}", light.line)
        for k, light in enumerate(scene.lights)
    ]
    shaders, users = np.unique(shader_index, return_index=True)
    for k, user in zip(shaders.tolist(), users.tolist(), strict=True):
        for name, color in _colors(surfaces.shaders[k]):
            if max(color) >= _LEAST_CODE:
                colors.append((name, color, f"surface {user}", surfaces[user].line))
    for name, color, of, line in colors:
        if max(color) >= _LEAST_CODE and all(value == int(value) <= 255 for value in color):
            where = of if line is None else f"{of} (line {line})"
            given = " ".join(map(number, color))
            right = " ".join(f"{value / 255:.3g}" for value in color)
            yield f"{name} {given} of {where} looks like 0 to 255; for 0 to 1, write {right}"
