"""Scenes that can be rendered, but hardly as their authors meant them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracer.scene.model import Phong, Scene, Shader, VectorLike
from tracer.scene.schema import number
from tracer.view.first_hits import first_hits

__all__ = ["SceneWarning", "suspicions"]

# A colour of whole numbers, with one of at least this size, is taken to be from 0 to 255.
_LEAST_CODE = 10

# Where a black picture is searched for objects: at most so many positions along each side.
_SIDE = 256


class SceneWarning(UserWarning):
    """A scene that renders, but hardly as meant: an empty view, no light, colours up to 255."""


def suspicions(scene: Scene, *, black: bool) -> Iterator[str]:
    """Say in words what looks wrong in a scene.

    Parameters
    ----------
    scene : Scene
    black : bool
        Whether its picture is all black.
    """
    yield from _codes(scene)
    if not black:
        return
    x, y = (
        (np.arange(n) + 0.5) * (size / n)
        for size, n in ((m, min(m, _SIDE)) for m in (scene.width, scene.height))
    )
    seen = first_hits(scene, np.tile(x, y.size), y.repeat(x.size)).surface
    if not (seen >= 0).any():
        yield "no object is in view: the picture is black; see viewPoint, viewDir and the window"
        return
    surfaces = scene.surfaces
    in_file = surfaces.shader_index[np.argsort(surfaces.file_index)]
    shaders = {surfaces.shaders[k] for k in in_file[np.unique(seen[seen >= 0])].tolist()}
    if any(max(color) > 0 for shader in shaders for _, color in _colors(shader)):
        yield "no light reaches anything in view: the picture is black; see the lights' positions"


def _colors(shader: Shader) -> Iterator[tuple[str, VectorLike]]:
    """Colours of a shader, by their tags."""
    for name in ("diffuse", "specular") if isinstance(shader, Phong) else ("diffuse",):
        yield f"{name}Color", getattr(shader, name)


def _codes(scene: Scene) -> Iterator[str]:
    """Say which is the first colour that looks like 8-bit codes, if there is one."""
    colors: list[tuple[int | None, str, VectorLike, str]] = [
        (light.line, "intensity", light.intensity, f"light {k}")
        for k, light in enumerate(scene.lights)
    ]
    surfaces = scene.surfaces
    for k, shader in enumerate(surfaces.shaders):
        for name, color in _colors(shader):
            if max(color) > 1:
                used = np.flatnonzero(surfaces.shader_index == k)
                if used.size:
                    at = used[surfaces.file_index[used].argmin()]
                    line, index = surfaces.line[at].item(), surfaces.file_index[at].item()
                    colors.append((line or None, name, color, f"surface {index}"))
    for line, name, color, of in colors:
        whole = all(value == int(value) <= 255 for value in color)
        if whole and max(color) >= _LEAST_CODE:
            where = of if line is None else f"{of} (line {line})"
            given = " ".join(map(number, color))
            right = " ".join(f"{value / 255:.3g}" for value in color)
            yield f"{name} {given} of {where} looks like 0 to 255; for 0 to 1, write {right}"
            return
