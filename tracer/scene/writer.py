"""Write a scene file."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from dataclasses import fields
from typing import IO, Any

import numpy as np

from tracer.files import atomic_file
from tracer.scene.model import Scene
from tracer.scene.schema import Numbers, number

# The beginning of a scene file; Mitsuba's have a version.
_SCENE = rb"(?s)(\xef\xbb\xbf)?(\s|<\?[^?]*\?>|<!--((?!-->).)*-->)*(<scene\s*/?>|\Z)"


def save_scene(
    scene: Scene,
    target: str | bytes | os.PathLike[str] | os.PathLike[bytes] | IO[bytes],
) -> None:
    """Write a scene to a file, from which `load_scene` makes an equal one.

    Parameters
    ----------
    scene : Scene
    target : str, bytes, path-like or binary file object
        A scene file that is there already is replaced, once the new one is whole.

    Raises
    ------
    OSError
        If the file cannot be written, or a file that is there is not a scene.
    """
    lines = (line.encode() for line in _lines(scene))
    if not isinstance(target, (str, bytes, os.PathLike)):
        target.writelines(lines)
        return
    path = os.fsdecode(target)
    if os.path.isfile(path):
        with open(path, "rb") as there:
            if not re.match(_SCENE, there.read(1 << 16)):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", path)
    with atomic_file(path, b"") as file:
        file.writelines(lines)


def _lines(scene: Scene) -> Iterator[str]:
    surfaces = scene.surfaces
    yield f"<scene>\n  <camera>{_elements(scene.camera)} </camera>\n"
    yield f"  <image>{scene.width} {scene.height}</image>\n"
    for light in scene.lights:
        yield f"  <light>{_elements(light)} </light>\n"
    # Shaders that several surfaces share have names.
    uses = np.bincount(surfaces.shader_index, minlength=len(surfaces.shaders)).tolist()
    shaders = []
    for k, shader in enumerate(surfaces.shaders):
        named = f' name="shader{k}"' if uses[k] > 1 else ""
        text = f'<shader{named} type="{type(shader).__name__}">{_elements(shader)} </shader>'
        if named:
            yield f"  {text}\n"
        shaders.append(f'<shader ref="shader{k}"/>' if named else text)
    for k, surface in zip(surfaces.shader_index[surfaces.file_order], surfaces, strict=True):
        yield f'  <surface type="{type(surface).__name__}">\n    {shaders[k]}\n'
        yield f"   {_elements(surface)}\n  </surface>\n"
    yield "</scene>\n"


def _elements(made: Any) -> str:
    """Write the numbers of a dataclass as elements."""
    numbers = {
        field.metadata["tags"][0]: np.ravel(value).tolist()
        for field in fields(made)
        if isinstance(field.metadata.get("validator"), Numbers)
        and (value := getattr(made, field.name)) is not None
    }
    return "".join(f" <{tag}>{' '.join(map(number, n))}</{tag}>" for tag, n in numbers.items())
