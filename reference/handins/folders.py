"""Find the pictures that students handed in, and match each with its reference picture.

A *reference picture* is what a hand-in is compared with: a picture, or a scene that is rendered.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")
_ARCHIVES = (".zip", ".rar", ".7z", ".tar", ".tgz", ".gz")
# The words that systems append to the name of a copy.
_COPY = re.compile(r"[ _-]*(\(\d+\)|copy|kopie)$")


class HandIn(NamedTuple):
    """A picture that a student handed in, or that is missing, with its reference picture.

    Attributes
    ----------
    student, scene : str
        The names of the student and of the scene.  The student is empty for a scene of which nobody
        has handed in a picture; the scene is empty if it is unknown.
    picture : Path or None
        The file that was handed in; None if it is missing.
    reference : Path or None
        The reference picture or scene file; None if it is unknown.
    error : str
        Why the picture cannot be compared, as a predicate such as "is an archive; unpack it first".
        Empty if it can be compared.
    """

    student: str
    scene: str
    picture: Path | None
    reference: Path | None
    error: str = ""


def list_hand_ins(folder: Path) -> list[Path]:
    """List all pictures and archives in a folder and its subfolders, sorted by path.

    Hidden files and folders, whose names begin with a dot, are skipped, as are the folders
    `__MACOSX`, which macOS adds to archives, and the comparisons `NAME.compare.png` that an earlier
    run wrote.
    """
    return sorted(path for path in folder.rglob("*")
                  if _is_file(path, _PICTURES + _ARCHIVES)
                  and not any(map(_is_hidden, path.relative_to(folder).parts)))  # fmt: skip


def _is_hidden(name: str) -> bool:
    """Test whether a file or folder is hidden (begins with a dot), or is a `__MACOSX` folder."""
    return name.startswith(".") or name == "__MACOSX"


def _is_file(path: Path, suffixes: tuple[str, ...]) -> bool:
    """Test whether a path is a file with one of several suffixes, in upper or lower case.

    Parameters
    ----------
    path : Path
        The path.  Comparisons that an earlier run wrote (`NAME.compare.png`) give False.
    suffixes : tuple of str
        Suffixes in lower case, such as ".png".
    """
    name = path.name.lower()
    return name.endswith(suffixes) and not name.endswith(".compare.png") and path.is_file()


def match_hand_ins(pictures: Sequence[Path], folder: Path, references: Path) -> list[HandIn]:
    """Match hand-ins with reference pictures, and find the pictures that are missing.

    A hand-in of the scene NAME has NAME in its file name as a whole word, in upper or lower case:
    `NAME.png`, `NAME.xml.png`, `ada_NAME.png`, `NAME-ada.png`, `NAME (1).png`.

    Parameters
    ----------
    pictures : sequence of Path
        The result of `list_hand_ins(folder)`, or one picture.
    folder : Path
        The folder of the class, with a subfolder for each student; or the one picture.
    references : Path
        A scene file or a reference picture, or a folder of these.  In a folder with the scene
        `NAME.xml`, files such as `NAME.png` and `NAME.check.png` are ignored, because they were
        computed from the scene.

    Returns
    -------
    list of HandIn
        First, one for each of `pictures`.  The others are added only if `folder` and `references`
        are folders.  Second, one for each scene that a student has not handed in although another
        student has.  A student who has handed in nothing is recognised by an empty folder.  Last,
        one for each scene that nobody has handed in.
    """
    path_of_scene = _find_references(references)
    matched = [_match_hand_in(picture, folder, references, path_of_scene) for picture in pictures]
    if not (folder.is_dir() and references.is_dir()):
        return matched
    present = {(hand_in.student, hand_in.scene) for hand_in in matched}
    handed_in = {scene for _, scene in present if scene}
    filled_folders = {parent for picture in pictures for parent in picture.parents}
    empty_folders = {path.name for path in folder.iterdir() if path.is_dir()
                     and path not in filled_folders and not _is_hidden(path.name)}  # fmt: skip
    students = {student for student, _ in present} | empty_folders
    missing = [HandIn(student, scene, None, path_of_scene[scene], "no picture of this scene")
               for student in sorted(students) for scene in sorted(handed_in)
               if (student, scene) not in present]  # fmt: skip
    unused = [HandIn("", scene, None, path, "nobody has handed in a picture of it")
              for scene, path in path_of_scene.items() if scene not in handed_in]  # fmt: skip
    return matched + missing + unused


def _find_references(references: Path) -> dict[str, Path]:
    """List the scenes and reference pictures with which hand-ins are compared.

    Parameters
    ----------
    references : Path
        A scene file or a reference picture, or a folder of these.

    Returns
    -------
    dict of str to Path
        The files by their names, in lower case and without suffixes.  Files that were computed from
        a scene of the folder are excluded: their names begin with its name and a dot.
    """
    if not references.is_dir():
        return {_base_name(references): references}
    scenes = sorted(references.glob("*.xml"))
    pictures = [path for path in sorted(references.iterdir()) if _is_file(path, _PICTURES)]
    computed = {path for path in pictures + scenes for scene in scenes
                if path != scene and path.name.startswith(f"{scene.stem}.")}  # fmt: skip
    return {_base_name(path): path for path in pictures + scenes if path not in computed}


def _match_hand_in(
    picture: Path, folder: Path, references: Path, path_of_scene: dict[str, Path]
) -> HandIn:
    """Determine the student and the scene of one hand-in from its path.

    The student is the subfolder of the class's folder.  Without a subfolder, the student is what
    the file name contains in addition to the scene.

    Parameters
    ----------
    picture : Path
        The file that was handed in.
    folder : Path
        The folder of the class; or `picture`, if it is the only one.
    references : Path
        The scene or reference picture, or the folder of these, that the user has given.  A single
        one belongs to every hand-in, regardless of the name.
    path_of_scene : dict of str to Path
        The scenes and reference pictures by their names in lower case.

    Returns
    -------
    HandIn
        With an error if the file is an archive, or if no scene has its name.
    """
    subfolder = picture.relative_to(folder).parent
    student = str(subfolder) if subfolder.parts else ""
    if _is_file(picture, _ARCHIVES):
        return HandIn(student or picture.stem, "", picture, None, "is an archive; unpack it first")
    name = _COPY.sub("", _base_name(picture))
    scenes = [scene for scene in path_of_scene
              if re.search(rf"(?<![^\W_]){re.escape(scene)}(?![^\W_])", name)]  # fmt: skip
    if scenes or not references.is_dir():
        scene = max(scenes, key=len) if scenes else next(iter(path_of_scene))
        student = student or name.replace(scene, " ", 1).strip(" _-.") or picture.parent.name
        return HandIn(student, scene, picture, path_of_scene[scene])
    error = f"no scene or picture in {references} has this name"
    words = (name, name.rpartition("_")[2])
    similar = [k for word in words for k in difflib.get_close_matches(word, path_of_scene, 1)]
    error += f"; did you mean {path_of_scene[similar[0]].name}?" if similar else ""
    return HandIn(student or picture.parent.name, "", picture, None, error)


def _base_name(path: Path) -> str:
    """Return the name of a file in lower case, without its suffix and without ".xml" before it.

    `Room.xml.png`, `room.png` and `room.xml` all have the base name "room".
    """
    return path.stem.lower().removesuffix(".xml")
