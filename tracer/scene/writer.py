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
    """Write a scene to a file, from which `load_scene` reads an equal scene.

    Parameters
    ----------
    scene : Scene
    target : str, bytes, path-like or binary file object
        If a scene file exists at this path, it is replaced when the new file is complete.

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
    """Return whether a file is XML with the root <scene>, and not a scene of Mitsuba."""
    roots: list[Element] = []

    def stop(root: Element) -> None:
        roots.append(root)
        raise FatalError(root.line, "the rest is not parsed")

    with suppress(FatalError), open(path, "rb") as file:
        Parser(stop, lambda *_: None).parse(file)
    # Mitsuba's scenes have a version.
    return any(root.tag == "scene" and "version" not in root.attrib for root in roots)


def _lines(scene: Scene) -> Iterator[str]:
    """Yield the text of a scene file, in pieces of one or more lines."""
    surfaces = scene.surfaces
    yield f"<scene>\n  <camera>{_elements(scene.camera)} </camera>\n"
    yield f"  <image>{scene.width} {scene.height}</image>\n"
    for light in scene.lights:
        yield f"  <light>{_elements(light)} </light>\n"
    # Shaders that several surfaces share are written once, with names.
    use_count = np.bincount(surfaces.shader_index, minlength=len(surfaces.shaders)).tolist()
    shaders = []
    for k, shader in enumerate(surfaces.shaders):
        is_named = use_count[k] > 1
        name = f' name="shader{k}"' if is_named else ""
        text = f'<shader{name} type="{type(shader).__name__}">{_elements(shader)} </shader>'
        if is_named:
            yield f"  {text}\n"
        shaders.append(f'<shader ref="shader{k}"/>' if is_named else text)
    for k, surface in zip(surfaces.shader_index[surfaces.file_order], surfaces, strict=True):
        yield f'  <surface type="{type(surface).__name__}">\n    {shaders[k]}\n'
        yield f"   {_elements(surface)}\n  </surface>\n"
    yield "</scene>\n"


def _elements(instance: Any) -> str:
    """Return the elements with the numbers of a dataclass instance, all on one line."""
    numbers = {
        field.metadata["tags"][0]: np.ravel(value).tolist()
        for field in fields(instance)
        if isinstance(field.metadata.get("validator"), Numbers)
        and (value := getattr(instance, field.name)) is not None
    }
    return "".join(f" <{tag}>{' '.join(map(number_text, n))}</{tag}>" for tag, n in numbers.items())
