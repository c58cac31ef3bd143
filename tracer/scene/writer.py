"""Write a scene file."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from typing import IO, Any

import numpy as np

from tracer.files import atomic_file
from tracer.scene.elements import Element, FatalError, Parser
from tracer.scene.model import Scene
from tracer.scene.schema import Numbers, number_text


def save_scene(
    scene: Scene,
    target: str | bytes | os.PathLike[str] | os.PathLike[bytes] | IO[bytes],
) -> None:
    """Write a scene to a file from which `load_scene` reads an equal scene.

    Parameters
    ----------
    scene : Scene
        The scene to write.
    target : str, bytes, path-like or binary file object
        Path of the file, or a file open for writing.  If a scene file exists at the path, it is
        replaced when the new file is complete.

    Raises
    ------
    OSError
        If the file cannot be written, or a file that is not a scene exists at the path.
    """
    lines = (line.encode() for line in _lines(scene))
    if not isinstance(target, (str, bytes, os.PathLike)):
        target.writelines(lines)
        return
    path = os.fsdecode(target)
    if os.path.isfile(path) and os.path.getsize(path) and not _is_scene(path):
        raise FileExistsError(errno.EEXIST, "a file of another kind is there", path)
    with atomic_file(path, b"") as file:
        file.writelines(lines)


def _is_scene(path: str) -> bool:
    """Test whether a file is a scene file, by its first XML element alone.

    That must be <scene> without a version: the scene files of Mitsuba have a version.

    Parameters
    ----------
    path : str
        Path of the file.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    roots: list[Element] = []

    def stop_at_root(root: Element) -> None:
        roots.append(root)
        raise FatalError(root.line, "the rest is not parsed")

    with suppress(FatalError), open(path, "rb") as file:
        Parser(stop_at_root, lambda *_: None).parse(file)
    return any(root.tag == "scene" and "version" not in root.attrib for root in roots)


def _lines(scene: Scene) -> Iterator[str]:
    """Yield the text of a scene file in parts of one or more lines, with line breaks.

    Shaders that several surfaces share are written once, with names; all others are written inside
    their surfaces.
    """
    surfaces = scene.surfaces
    yield f"<scene>\n  <camera>{_elements(scene.camera)} </camera>\n"
    yield f"  <image>{scene.width} {scene.height}</image>\n"
    for light in scene.lights:
        yield f"  <light>{_elements(light)} </light>\n"
    use_count = np.bincount(surfaces.shader_index, minlength=len(surfaces.shaders)).tolist()
    shader_elements = []  # for each shader, what its surfaces contain: the shader or a reference
    for index, shader in enumerate(surfaces.shaders):
        is_shared = use_count[index] > 1
        name = f' name="shader{index}"' if is_shared else ""
        element = f'<shader{name} type="{type(shader).__name__}">{_elements(shader)} </shader>'
        if is_shared:
            yield f"  {element}\n"
        shader_elements.append(f'<shader ref="shader{index}"/>' if is_shared else element)
    shader_index = surfaces.shader_index[surfaces.file_order]
    for index, surface in zip(shader_index, surfaces, strict=True):
        yield f'  <surface type="{type(surface).__name__}">\n    {shader_elements[index]}\n'
        yield f"   {_elements(surface)}\n  </surface>\n"
    yield "</scene>\n"


def _elements(instance: Any) -> str:
    """Write the numbers of a camera, light, shader or surface as XML elements.

    Parameters
    ----------
    instance : Camera, PointLight, Lambertian, Phong, Sphere or Box
        Fields that are None, and fields that do not consist of numbers, are skipped.

    Returns
    -------
    text : str
        One element for each field, all on one line, such as " <center>0 0 0</center>".
    """
    texts = {
        field.metadata["tags"][0]: " ".join(map(number_text, np.ravel(value).tolist()))
        for field in fields(instance)
        if isinstance(field.metadata.get("validator"), Numbers)
        and (value := getattr(instance, field.name)) is not None
    }
    return "".join(f" <{tag}>{text}</{tag}>" for tag, text in texts.items())
