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
    """A picture that was handed in, or one that is missing, with the right picture.

    Attributes
    ----------
    student, scene : str
        The student who handed the picture in, and the name of the scene.  The student is empty for
        a scene of which nobody has handed in a picture; the scene is empty if it is unknown.
    picture : Path or None
        The file that was handed in; None if it is missing.
    right : Path or None
        The right picture or scene file; None if it is unknown.
    error : str
        Why the picture cannot be compared, as a predicate: "is an archive; unpack it first".  Empty
        if it can be compared.
    output : Path or None
        File to which a picture that shows both is written; None if no such file is requested.
    """

    student: str
    scene: str
    picture: Path | None
    right: Path | None
    error: str = ""
    output: Path | None = None


def list_hand_ins(folder: Path) -> list[Path]:
    """Return the paths of all pictures and archives in a folder and its subfolders, sorted.

    Hidden files, files that operating systems leave in folders, and comparisons that an earlier run
    wrote (`NAME.compare.png`) are skipped.
    """
    paths = _visible_paths(folder)
    return sorted(path for path in paths if _is_hand_in(path, _PICTURES + _ARCHIVES))


def _visible_paths(folder: Path) -> Iterator[Path]:
    """Yield all files and folders below a folder.

    Hidden ones, whose names begin with a dot, and the folders `__MACOSX`, which macOS adds to
    archives, are skipped with all that they contain.
    """
    for path in folder.rglob("*"):
        names = path.relative_to(folder).parts
        if not any(name.startswith(".") or name == "__MACOSX" for name in names):
            yield path


def _is_hand_in(path: Path, suffixes: tuple[str, ...]) -> bool:
    """Test whether a path is a file with one of some suffixes, in upper or lower case.

    The result is false for comparisons that an earlier run wrote (`NAME.compare.png`).
    """
    name = path.name.lower()
    return name.endswith(suffixes) and not name.endswith(".compare.png") and path.is_file()


def match_hand_ins(pictures: Iterable[Path], folder: Path, rights: Path) -> list[HandIn]:
    """Find the right picture or scene of each hand-in, and the pictures that are missing.

    A hand-in of the scene NAME has NAME in its file name as a whole word, in upper or lower case:
    `NAME.png`, `NAME.xml.png`, `ada_NAME.png`, `NAME-ada.png`, `NAME (1).png`.  In a folder
    `rights` that contains the scene `NAME.xml`, files such as `NAME.png` and `NAME.check.png` are
    treated as pictures that were computed from the scene, and are ignored.

    Parameters
    ----------
    pictures : iterable of Path
        The result of `list_hand_ins(folder)`, or one picture.
    folder : Path
        The folder of the class, with a subfolder for each student.
    rights : Path
        A scene file or a picture, or a folder of these.

    Returns
    -------
    list of HandIn
        First, one for each of `pictures`.  The following are added only if `rights` is a folder.
        Second, one for each scene that a student has not handed in although another student has.  A
        student who has handed in nothing is recognised only by an empty folder.  Last, one for each
        scene that nobody has handed in.
    """
    right_of = _find_rights(rights)
    matched = [_match(picture, folder, rights, right_of) for picture in pictures]
    if not rights.is_dir():
        return matched
    present = {(hand_in.student, hand_in.scene) for hand_in in matched}
    handed_in = {hand_in.scene: hand_in.right for hand_in in matched if hand_in.right}
    students = {hand_in.student for hand_in in matched} | set(_empty_folders(folder))
    missing = [HandIn(student, scene, None, right, "no picture of this scene")
               for student in sorted(students) for scene, right in sorted(handed_in.items())
               if (student, scene) not in present]  # fmt: skip
    without_hand_in = [HandIn("", scene, None, right, "nobody has handed in a picture of it")
                       for scene, right in right_of.items() if scene not in handed_in]  # fmt: skip
    return matched + missing + without_hand_in


def _find_rights(rights: Path) -> dict[str, Path]:
    """Return the scenes that hand-ins are compared with, and pictures that have no scene file.

    Parameters
    ----------
    rights : Path
        A scene file or a picture, or a folder of these.

    Returns
    -------
    dict of str to Path
        The files by their names, in lower case and without suffixes.  Pictures that were computed
        from a scene of the folder are excluded: their names begin with its name and a dot.
    """
    if not rights.is_dir():
        return {_base_name(rights): rights}
    scenes = sorted(rights.glob("*.xml"))
    paths = [path for path in sorted(rights.iterdir()) if _is_hand_in(path, _PICTURES)] + scenes
    generated = {path for path in paths for scene in scenes
                 if path != scene and path.name.startswith(f"{scene.stem}.")}  # fmt: skip
    return {_base_name(path): path for path in paths if path not in generated}


def _empty_folders(folder: Path) -> list[str]:
    """Return the names of the visible subfolders of a folder that contain no hand-ins.

    A path that is not a folder has none.
    """
    if not folder.is_dir():
        return []
    filled = {parent for picture in list_hand_ins(folder) for parent in picture.parents}
    empty = [path for path in folder.iterdir() if path.is_dir() and path not in filled]
    visible = set(_visible_paths(folder))
    return [path.name for path in empty if path in visible]


def _match(picture: Path, folder: Path, rights: Path, right_of: dict[str, Path]) -> HandIn:
    """Determine the student and the scene of one hand-in from its path.

    The student is the subfolder of the class's folder; without one, the rest of the file name.

    Parameters
    ----------
    picture : Path
        The file that was handed in.
    folder : Path
        The folder of the class.
    rights : Path
        The scene or picture, or the folder of these, that the user has given.  A single one belongs
        to every hand-in, regardless of the name.
    right_of : dict of str to Path
        The result of `_find_rights(rights)`.

    Returns
    -------
    HandIn
        With an error if it is an archive, or if no scene has its name.
    """
    subfolder = picture.parent.relative_to(folder) if picture.is_relative_to(folder) else Path()
    student = str(subfolder) if subfolder.parts else ""
    if _is_hand_in(picture, _ARCHIVES):
        return HandIn(student or picture.stem, "", picture, None, "is an archive; unpack it first")
    name = _COPY.sub("", _base_name(picture))
    scenes = [scene for scene in right_of
              if re.search(rf"(?<![^\W_]){re.escape(scene)}(?![^\W_])", name)]  # fmt: skip
    if scenes or not rights.is_dir():
        scene = max(scenes, key=len) if scenes else next(iter(right_of))
        rest_of_name = name.replace(scene, " ", 1).strip(" _-.")
        return HandIn(student or rest_of_name or folder.name, scene, picture, right_of[scene])
    error = f"no scene or picture in {rights} has this name"
    words = (name, name.rpartition("_")[2])
    similar = [scene for word in words for scene in difflib.get_close_matches(word, right_of, 1)]
    error += f"; did you mean {right_of[similar[0]].name}?" if similar else ""
    return HandIn(student or folder.name, "", picture, None, error)


def _base_name(path: Path) -> str:
    """Return the name of a file in lower case, without its suffix and without ".xml" before it.

    `Room.xml.png`, `room.png` and `room.xml` all have the base name "room".
    """
    return path.stem.lower().removesuffix(".xml")
