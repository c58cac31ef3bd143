"""Find the pictures that students handed in, and match each with its reference picture.

A *hand-in* is such a picture; a *reference picture* is the picture, or the scene to render, with
which it is compared.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")
_ARCHIVES = (".zip", ".rar", ".7z", ".tar", ".tgz", ".gz")
# What operating systems append to the name of a copy.
_COPY = re.compile(r"[ _-]*(\(\d+\)|copy|kopie)$")


class HandIn(NamedTuple):
    """A picture that a student handed in, or should have, with its reference picture.

    Attributes
    ----------
    student, scene : str
        Names of the student and of the scene.  The student is empty if nobody has handed in a
        picture of the scene; the scene is empty if it is unknown.
    picture : Path or None
        The file that the student handed in; None if it is missing.
    reference : Path or None
        The reference picture or scene file; None if it is unknown.
    error : str
        Why the picture cannot be compared: words such as "is an archive; unpack it first".  Empty
        if it can be compared.
    """

    student: str
    scene: str
    picture: Path | None
    reference: Path | None
    error: str = ""


def list_hand_ins(folder: Path) -> list[Path]:
    """List all pictures and archives in a folder and its subfolders, sorted by path.

    Skip (1) hidden files and folders, whose names begin with a dot; (2) `__MACOSX` folders, which
    macOS adds to archives; and (3) comparisons written by an earlier run (`NAME.compare.png`).
    """
    return sorted(path for path in folder.rglob("*")
                  if _is_file(path, _PICTURES + _ARCHIVES)
                  and not any(map(_is_hidden, path.relative_to(folder).parts)))  # fmt: skip


def _is_hidden(name: str) -> bool:
    """Test whether a name is that of a hidden file or folder, or of a `__MACOSX` folder."""
    return name.startswith(".") or name == "__MACOSX"


def _is_file(path: Path, suffixes: tuple[str, ...]) -> bool:
    """Test whether a path is a file with one of several suffixes, in upper or lower case.

    Parameters
    ----------
    path : Path
        The path.
    suffixes : tuple of str
        Suffixes in lower case, such as ".png".

    Returns
    -------
    bool
        False for comparisons written by an earlier run (`NAME.compare.png`).
    """
    name = path.name.lower()
    return name.endswith(suffixes) and not name.endswith(".compare.png") and path.is_file()


def match_hand_ins(pictures: Sequence[Path], folder: Path, references: Path) -> list[HandIn]:
    """Match the pictures that students handed in with reference pictures, and list missing ones.

    The file name of a picture of the scene NAME must contain NAME as a whole word, in upper or
    lower case: `NAME.png`, `NAME.xml.png`, `ada_NAME.png`, `NAME-ada.png`, `NAME (1).png`.

    Parameters
    ----------
    pictures : sequence of Path
        The result of `list_hand_ins(folder)`, or one picture.
    folder : Path
        The folder of the class, with a subfolder for each student; or the one picture.
    references : Path
        A scene file, a reference picture, or a folder of these.  In a folder with the scene
        `NAME.xml`, files such as `NAME.png` and `NAME.check.png` are ignored, because they were
        computed from the scene.

    Returns
    -------
    list of HandIn
        One for each of `pictures`.  If `folder` and `references` are folders, missing pictures
        follow: for each scene that any student has handed in, one for each student who has not;
        then one for each scene that nobody has handed in.  An empty subfolder stands for a student
        who has handed in nothing.
    """
    path_by_scene = _find_references(references)
    matched = [_match_hand_in(picture, folder, references, path_by_scene) for picture in pictures]
    if not (folder.is_dir() and references.is_dir()):
        return matched
    students_and_scenes = {(hand_in.student, hand_in.scene) for hand_in in matched}
    found_scenes = {scene for _, scene in students_and_scenes if scene}
    filled_folders = {parent for picture in pictures for parent in picture.parents}
    empty_folders = {path.name for path in folder.iterdir() if path.is_dir()
                     and path not in filled_folders and not _is_hidden(path.name)}  # fmt: skip
    students = {student for student, _ in students_and_scenes} | empty_folders
    missing = [HandIn(student, scene, None, path_by_scene[scene], "no picture of this scene")
               for student in sorted(students) for scene in sorted(found_scenes)
               if (student, scene) not in students_and_scenes]  # fmt: skip
    unused = [HandIn("", scene, None, path, "nobody has handed in a picture of it")
              for scene, path in path_by_scene.items() if scene not in found_scenes]  # fmt: skip
    return matched + missing + unused


def _find_references(references: Path) -> dict[str, Path]:
    """List the scenes and reference pictures with which to compare the pictures of students.

    Parameters
    ----------
    references : Path
        A scene file, a reference picture, or a folder of these.

    Returns
    -------
    dict of str to Path
        The files by name, in lower case and without suffixes.  Files computed from a scene in the
        folder are excluded: their names begin with the name of the scene and a dot.
    """
    if not references.is_dir():
        return {_base_name(references): references}
    scenes = sorted(references.glob("*.xml"))
    pictures = [path for path in sorted(references.iterdir()) if _is_file(path, _PICTURES)]
    computed = {path for path in pictures + scenes for scene in scenes
                if path != scene and path.name.startswith(f"{scene.stem}.")}  # fmt: skip
    return {_base_name(path): path for path in pictures + scenes if path not in computed}


def _match_hand_in(
    picture: Path, folder: Path, references: Path, path_by_scene: dict[str, Path]
) -> HandIn:
    """Determine which student handed in a picture, and of which scene, from its path.

    The student's name is that of the subfolder in the folder of the class.  Without a subfolder, it
    is the part of the file name that is not the scene's name.

    Parameters
    ----------
    picture : Path
        The file that the student handed in.
    folder : Path
        The folder of the class; or `picture`, if it is the only one.
    references : Path
        The scene, the reference picture, or the folder of these.  A single scene or reference
        picture is used for every file name.
    path_by_scene : dict of str to Path
        The scenes and reference pictures by name in lower case.

    Returns
    -------
    HandIn
        Its error is set if the file is an archive, or if no scene matches the file name.
    """
    subfolder = picture.relative_to(folder).parent
    student = str(subfolder) if subfolder.parts else ""
    if _is_file(picture, _ARCHIVES):
        return HandIn(student or picture.stem, "", picture, None, "is an archive; unpack it first")
    name = _COPY.sub("", _base_name(picture))
    scenes = [scene for scene in path_by_scene
              if re.search(rf"(?<![^\W_]){re.escape(scene)}(?![^\W_])", name)]  # fmt: skip
    if scenes or not references.is_dir():
        scene = max(scenes, key=len) if scenes else next(iter(path_by_scene))
        student = student or name.replace(scene, " ", 1).strip(" _-.") or picture.parent.name
        return HandIn(student, scene, picture, path_by_scene[scene])
    error = f"no scene or picture in {references} has this name"
    words = (name, name.rpartition("_")[2])
    similar = [near for word in words for near in difflib.get_close_matches(word, path_by_scene, 1)]
    error += f"; did you mean {path_by_scene[similar[0]].name}?" if similar else ""
    return HandIn(student or picture.parent.name, "", picture, None, error)


def _base_name(path: Path) -> str:
    """Return the name of a file in lower case, without its suffix or a preceding ".xml".

    `Room.xml.png`, `room.png` and `room.xml` all have the base name "room".
    """
    return path.stem.lower().removesuffix(".xml")
