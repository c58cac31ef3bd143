"""Find hand-ins in folders, and the right picture for each."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")
_ARCHIVES = (".zip", ".rar", ".7z", ".tar", ".tgz", ".gz")
# The words that systems append to the name of a copy.
_COPY = re.compile(r"[ _-]*(\(\d+\)|copy|kopie)$")


class HandIn(NamedTuple):
    """A picture that was handed in, or a missing one.

    Attributes
    ----------
    student, scene : str
        Who handed it in, and the name of the scene.
    picture, right : Path or None
        The picture, and the right picture or scene file.
    error : str
        What is wrong, if there is no right picture.
    output : Path or None
        Where a picture of both is written.
    """

    student: str
    scene: str
    picture: Path | None
    right: Path | None
    error: str = ""
    output: Path | None = None


def hand_ins(folder: Path) -> list[Path]:
    """Return all pictures and archives in a folder and its subfolders, without comparisons."""
    return sorted(path for path in _visible(folder) if _has_suffix(path, _PICTURES + _ARCHIVES))


def _visible(folder: Path) -> Iterator[Path]:
    """Yield all files and folders in a folder, without those that systems leave there."""
    for path in folder.rglob("*"):
        names = path.relative_to(folder).parts
        if not any(name.startswith(".") or name == "__MACOSX" for name in names):
            yield path


def _has_suffix(path: Path, suffixes: tuple[str, ...]) -> bool:
    name = path.name.lower()
    return name.endswith(suffixes) and not name.endswith(".compare.png") and path.is_file()


def match(pictures: Iterable[Path], folder: Path, rights: Path) -> list[HandIn]:
    """Find the right picture or scene of each picture, and pictures that are missing.

    In a folder `rights`, files such as `NAME.png` and `NAME.check.png` were computed from the scene
    `NAME.xml`, and are ignored.  A hand-in of NAME has NAME in its name as a whole word, in upper
    or lower case: `NAME.png`, `NAME.xml.png`, `ada_NAME.png`, `NAME-ada.png`, `NAME (1).png`.

    Parameters
    ----------
    pictures : iterable of Path
        The result of `hand_ins(folder)`, or one picture.
    folder : Path
        The folder of the class.
    rights : Path
        A scene file or a picture, or a folder of these.

    Returns
    -------
    list of HandIn
        Those of `pictures`; then, if a student has handed in some pictures or has an empty folder,
        one for each scene that others have handed in and this student has not; and one, without a
        student, for each scene that nobody has handed in.
    """
    known = _known(rights)
    matched = [_match(picture, folder, rights, known) for picture in pictures]
    if not rights.is_dir():
        return matched
    present = {(one.student, one.scene) for one in matched}
    handed_in = {one.scene: one.right for one in matched if one.right}
    students = {one.student for one in matched} | set(_empty_folders(folder))
    lacking = [HandIn(student, scene, None, right, "no picture of this scene")
               for student in sorted(students) for scene, right in sorted(handed_in.items())
               if (student, scene) not in present]  # fmt: skip
    nobodys = [HandIn("", name, None, path, "nobody has handed in a picture of it")
               for name, path in known.items() if name not in handed_in]  # fmt: skip
    return matched + lacking + nobodys


def _known(rights: Path) -> dict[str, Path]:
    """Return the scenes, and pictures without a scene, of a folder by their names."""
    if not rights.is_dir():
        return {_name(rights): rights}
    scenes = sorted(rights.glob("*.xml"))
    paths = [path for path in sorted(rights.iterdir()) if _has_suffix(path, _PICTURES)] + scenes
    generated = {path for path in paths for scene in scenes
                 if path != scene and path.name.startswith(f"{scene.stem}.")}  # fmt: skip
    return {_name(path): path for path in paths if path not in generated}


def _empty_folders(folder: Path) -> list[str]:
    """Return the folders in a class's folder that contain no pictures."""
    if not folder.is_dir():
        return []
    full = {above for picture in hand_ins(folder) for above in picture.parents}
    visible = (path for path in folder.iterdir() if path.is_dir() and path not in full)
    return [path.name for path in visible if path in set(_visible(folder))]


def _match(picture: Path, folder: Path, rights: Path, known: dict[str, Path]) -> HandIn:
    """Find the right picture of one hand-in."""
    above = picture.parent.relative_to(folder) if picture.is_relative_to(folder) else Path()
    student = str(above) if above.parts else ""
    if _has_suffix(picture, _ARCHIVES):
        return HandIn(student or picture.stem, "", picture, None, "is an archive; unpack it first")
    name = _COPY.sub("", _name(picture))
    fitting = [one for one in known if re.search(rf"(?<![^\W_]){re.escape(one)}(?![^\W_])", name)]
    if fitting or not rights.is_dir():
        scene = max(fitting, key=len) if fitting else next(iter(known))
        owner = name.replace(scene, " ", 1).strip(" _-.")
        return HandIn(student or owner or folder.name, scene, picture, known[scene])
    error = f"no scene or picture in {rights} has this name"
    words = (name, name.rpartition("_")[2])
    close = [close for word in words for close in difflib.get_close_matches(word, known, 1)]
    error += f"; did you mean {known[close[0]].name}?" if close else ""
    return HandIn(student or folder.name, "", picture, None, error)


def _name(path: Path) -> str:
    """Return what a picture and the right one have in common: the name without suffixes."""
    return path.stem.lower().removesuffix(".xml")
