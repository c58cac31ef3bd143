"""Find the pictures that students handed in, and match each with its reference picture.

A *hand-in* is a picture that a student handed in; its *reference picture* is the picture, or the
scene to render, with which it is compared.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_PICTURE_SUFFIXES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".bmp",
    ".gif",
    ".ppm",
    ".tga",
    ".tif",
    ".tiff",
    ".webp",
)
_ARCHIVE_SUFFIXES = (".zip", ".rar", ".7z", ".tar", ".tgz", ".gz")
# What operating systems append to the name of a copy.
_COPY_SUFFIX = re.compile(r"[ _-]*(\(\d+\)|copy|kopie)$")


class HandIn(NamedTuple):
    """A picture that a student handed in, or should have, with its reference picture."""

    student: str  # empty if nobody has handed in a picture of the scene
    scene: str  # empty if it is unknown
    picture: Path | None  # None if it is missing
    reference: Path | None  # picture or scene file; None if it is unknown
    # Why the picture cannot be compared, as in "is an archive; unpack it first"; or empty.
    error: str = ""


def list_hand_ins(folder: Path) -> list[Path]:
    """List all pictures and archives in a folder and its subfolders, sorted by path.

    Hidden files and folders, `__MACOSX` folders (which macOS adds to archives) and comparisons
    written by an earlier run (`NAME.compare.png`) are skipped.
    """
    return sorted(
        path
        for path in folder.rglob("*")
        if _is_input(path, _PICTURE_SUFFIXES + _ARCHIVE_SUFFIXES)
        and not any(map(_is_hidden, path.relative_to(folder).parts))
    )


def _is_hidden(name: str) -> bool:
    """Test whether a name belongs to a hidden file or folder, or to a `__MACOSX` folder."""
    return name.startswith(".") or name == "__MACOSX"


def _is_input(path: Path, suffixes: tuple[str, ...]) -> bool:
    """Test whether a path leads to a file with one of the suffixes, which are in lower case.

    Comparison pictures that an earlier run wrote (`NAME.compare.png`) do not count.
    """
    name = path.name.lower()
    return name.endswith(suffixes) and not name.endswith(".compare.png") and path.is_file()


def match_hand_ins(
    files: Sequence[Path], class_path: Path, reference_path: Path, names: Sequence[str] = ()
) -> list[HandIn]:
    """Match students' pictures with their reference pictures, and list missing pictures.

    A picture belongs to the scene NAME if its file name contains NAME as a whole word: `NAME.png`,
    `NAME.xml.png`, `ada_NAME.png`, `NAME-ada.png`, `NAME (1).png`.  Case, spaces, `-` and `_` do
    not count: `Two Boxes.png` belongs to `two-boxes.xml`.

    Parameters
    ----------
    files
        The result of `list_hand_ins(class_path)`, or one picture.
    class_path
        The folder of the class, with a subfolder for each student; or the one picture.
    reference_path
        A scene file, a reference picture, or a folder of these.
    names
        The students of a class list.  The folder `03_chen` belongs to the student `chen`.

    Returns
    -------
    list of HandIn
        One hand-in for each of `files`.  If both paths are folders, hand-ins without a picture
        follow: first for scenes that other students have handed in, then for scenes that nobody has
        handed in.  Each empty subfolder and each name on the class list also counts as a student.
    """
    path_by_scene = list_references(reference_path)
    hand_ins = [_match_hand_in(path, class_path, reference_path, path_by_scene) for path in files]
    hand_ins = [
        hand_in._replace(student=_find_in_class_list(hand_in.student, names))
        for hand_in in hand_ins
    ]
    if not (class_path.is_dir() and reference_path.is_dir()):
        return hand_ins
    students_and_scenes = {(hand_in.student, hand_in.scene) for hand_in in hand_ins}
    used_scenes = {scene for _, scene in students_and_scenes if scene}
    filled_folders = {parent for file in files for parent in file.parents}
    empty_folders = {
        _find_in_class_list(path.name, names)
        for path in class_path.iterdir()
        if path.is_dir() and path not in filled_folders and not _is_hidden(path.name)
    }
    students = {student for student, _ in students_and_scenes} | empty_folders | {*names}
    hand_ins += [
        HandIn(student, scene, None, path_by_scene[scene], "no picture of this scene")
        for student in sorted(students)
        for scene in sorted(used_scenes)
        if (student, scene) not in students_and_scenes
    ]
    hand_ins += [
        HandIn("", scene, None, path, "nobody has handed in a picture of it")
        for scene, path in path_by_scene.items()
        if scene not in used_scenes
    ]
    return hand_ins


def _find_in_class_list(student: str, names: Sequence[str]) -> str:
    """Return the longest name of a class list that a folder's name contains; or the folder's."""
    return max((name for name in names if _find_words(name, student)), key=len, default=student)


def _find_words(words: str, text: str) -> re.Match[str] | None:
    """Find words in a text as whole words, whatever the case, spaces, `-` and `_` in both."""
    letters = re.sub(r"[\s_-]", "", words)
    pattern = r"[\s_-]*".join(map(re.escape, letters))
    return re.search(rf"(?<![^\W_]){pattern}(?![^\W_])", text, re.IGNORECASE)


def list_references(reference_path: Path) -> dict[str, Path]:
    """List the scenes and reference pictures by name in lower case, without suffixes.

    In a folder with the scene `NAME.xml`, files such as `NAME.png` and `NAME.check.png` are
    ignored, because they were computed from the scene.
    """
    if not reference_path.is_dir():
        return {_get_base_name(reference_path): reference_path}
    scenes = sorted(reference_path.glob("*.xml"))
    pictures = [
        path for path in sorted(reference_path.iterdir()) if _is_input(path, _PICTURE_SUFFIXES)
    ]
    computed_files = {path for path in pictures + scenes for scene in scenes
                      if path != scene and path.name.startswith(f"{scene.stem}.")}  # fmt: skip
    return {_get_base_name(path): path for path in pictures + scenes if path not in computed_files}


def _match_hand_in(
    picture: Path, class_path: Path, reference_path: Path, path_by_scene: dict[str, Path]
) -> HandIn:
    """Work out from a picture's path which student and which scene it belongs to.

    The student is the first subfolder: `03_chen` for `03_chen/out/room.png`.  Without a subfolder,
    the student's name is the file name without the scene's name.  If `reference_path` is a single
    file, it is used for all pictures.
    """
    folders = picture.relative_to(class_path).parts[:-1]
    student = folders[0] if folders else ""
    if _is_input(picture, _ARCHIVE_SUFFIXES):
        return HandIn(student or picture.stem, "", picture, None, "is an archive; unpack it first")
    name = _COPY_SUFFIX.sub("", _get_base_name(picture))
    # What stands for each scene in the name, as "Two Boxes" for "two-boxes".
    found_names = {
        scene: match[0] for scene in path_by_scene if (match := _find_words(scene, name))
    }
    if found_names or not reference_path.is_dir():
        scene = max(found_names, key=len) if found_names else next(iter(path_by_scene))
        other_words = name.replace(found_names.get(scene, scene), " ", 1).strip(" _-.")
        student = student or other_words or picture.parent.name
        return HandIn(student, scene, picture, path_by_scene[scene])
    error = f"no scene or picture in {reference_path.resolve().name} has this name"
    words = (name, name.rpartition("_")[2])
    guesses = [key for word in words for key in difflib.get_close_matches(word, path_by_scene, 1)]
    error += f"; did you mean {path_by_scene[guesses[0]].name}?" if guesses else ""
    return HandIn(student or picture.parent.name, "", picture, None, error)


def _get_base_name(path: Path) -> str:
    """Return a file name in lower case, without suffixes: "room" for `Room.xml.png`."""
    return path.stem.lower().removesuffix(".xml")
