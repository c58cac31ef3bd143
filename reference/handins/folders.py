"""Find hand-ins in folders, and the right picture for each."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")


class HandIn(NamedTuple):
    """A picture that was handed in, the right one or a scene file, or what is wrong.

    `output` is where a picture of both is written.
    """

    picture: Path
    right: Path | None
    error: str | None = None
    output: Path | None = None


def hand_ins(folder: Path) -> list[Path]:
    """All pictures in a folder and its folders, but comparisons and what a system leaves there."""
    return sorted(path for path in _visible(folder) if _is_picture(path))


def empty_folders(folder: Path) -> list[Path]:
    """Folders in it without any picture, in them or in their folders; the outermost of these."""
    full = {above for picture in hand_ins(folder) for above in picture.parents}
    empty = (path for path in _visible(folder) if path.is_dir() and path not in full)
    return sorted(path for path in empty if path.parent in full or path.parent == folder)


def _visible(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        parts = path.relative_to(folder).parts
        if not any(part.startswith(".") or part == "__MACOSX" for part in parts):
            yield path


def _is_picture(path: Path) -> bool:
    name = path.name.lower()
    return name.endswith(_SUFFIXES) and not name.endswith(".compare.png") and path.is_file()


def match(pictures: Iterable[Path], rights: Path) -> tuple[list[HandIn], list[Path]]:
    """Find the right picture or scene of each; and those that nobody has handed in.

    In a folder `rights`, `NAME.png`, `NAME.check.png` and the like were made of the scene
    `NAME.xml`, and are passed over.  `NAME.png`, `NAME.xml.png` and `ID_NAME.png` are hand-ins of
    NAME, in upper or lower case.
    """
    if not rights.is_dir():
        return [HandIn(picture, rights) for picture in pictures], []
    scenes = sorted(rights.glob("*.xml"))
    found = sorted(filter(_is_picture, rights.iterdir())) + scenes
    known = {_name(path): path for path in found if not any(_made_of(path, one) for one in scenes)}
    used, matched = set[str](), []
    for picture in pictures:
        name, error = _name(picture), None
        fitting = [one for one in known if name == one or name.endswith(f"_{one}")]
        right = known[max(fitting, key=len)] if fitting else None
        if right is None:
            error = f"no scene or picture in {rights} has this name"
            near = difflib.get_close_matches(name, known, 1) or difflib.get_close_matches(
                name.rpartition("_")[2], known, 1
            )
            error += f"; did you mean {known[near[0]].name}?" if near else ""
        else:
            used.add(_name(right))
        matched.append(HandIn(picture, right, error))
    return matched, [path for name, path in known.items() if name not in used]


def _made_of(path: Path, scene: Path) -> bool:
    return path.name.startswith(f"{scene.stem}.") and path != scene


def _name(path: Path) -> str:
    """What a picture and the right one have in common: the name, without `.png` and `.xml`."""
    return path.stem.lower().removesuffix(".xml")
