"""Write a scene file that describes a `Scene` exactly: reading it gives an equal scene."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from tracer.files import open_atomically
from tracer.scene.elements import FileOrPath
from tracer.scene.model import Scene, Shader
from tracer.scene.schema import NumberValidator, format_number


def save_scene(scene: Scene, target: FileOrPath) -> None:
    """Write a scene to a file that `load_scene` can read.

    Parameters
    ----------
    scene : Scene
        The scene to write.
    target : str, bytes, path-like or binary file object
        Path of the file, or a file that is open for writing.  An existing scene file at this path
        is replaced when the new file is complete.

    Raises
    ------
    OSError
        If the file cannot be written, or a file that is not a scene exists at the path.
    """
    lines = (line.encode() for line in _format_scene(scene))
    if not isinstance(target, (str, bytes, os.PathLike)):
        target.writelines(lines)
        return
    path = os.fsdecode(target)
    if os.path.isfile(path) and os.path.getsize(path) and not _is_scene_file(path):
        raise FileExistsError(errno.EEXIST, "a file of another kind is there", path)
    with open_atomically(path, b"") as file:
        file.writelines(lines)


def _is_scene_file(path: str) -> bool:
    """Test whether a file is XML with the root <scene>, but not a scene of Mitsuba.

    In files of Mitsuba, the root has an attribute `version`.
    """
    # Imported only when needed, because importing takes time.
    from xml.etree import ElementTree as ET

    with open(path, "rb") as file:
        try:
            _, root = next(iter(ET.iterparse(file, ["start"])))
        except (ET.ParseError, LookupError, ValueError):
            return False
    return root.tag == "scene" and "version" not in root.attrib


def _format_scene(scene: Scene) -> Iterator[str]:
    """Yield the text of a scene file, piece by piece.

    Each shader that a surface uses is written once.  The surfaces follow, and refer to it by name.
    """
    surfaces = scene.surfaces
    yield f"<scene>\n  <camera>{_format_numbers(scene.camera)} </camera>\n"
    yield f"  <image>{scene.width} {scene.height}</image>\n"
    for light in scene.lights:
        yield f"  <light>{_format_numbers(light)} </light>\n"
    # The number in the name of each shader: the index of the first one that is equal to it.
    written_index: dict[Shader, int] = {}
    for index in np.unique(surfaces.shader_index).tolist():
        shader = surfaces.shaders[index]
        if written_index.setdefault(shader, index) == index:
            start_tag = f'<shader name="shader{index}" type="{type(shader).__name__}">'
            yield f"  {start_tag}{_format_numbers(shader)} </shader>\n"
    for surface in surfaces:
        yield f'  <surface type="{type(surface).__name__}">\n'
        yield f'    <shader ref="shader{written_index[surface.shader]}"/>\n'
        yield f"   {_format_numbers(surface)}\n  </surface>\n"
    yield "</scene>\n"


def _format_numbers(scene_object: Any) -> str:
    """Format all numbers of a camera, light, shader or surface as XML elements.

    A sphere gives " <center>0 0 0</center> <radius>1</radius>".  Fields that are None are skipped.
    """
    text = ""
    for field in fields(scene_object):
        value = getattr(scene_object, field.name)
        if value is not None and isinstance(field.metadata.get("validator"), NumberValidator):
            tag = field.metadata["tags"][0]
            numbers = " ".join(map(format_number, np.ravel(value).tolist()))
            text += f" <{tag}>{numbers}</{tag}>"
    return text
