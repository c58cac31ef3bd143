"""Scenes of this project, scenes that are hard to render (`tests/scenes`), and scenes from tests.

Each file in `tests/scenes` begins with a comment: first the reason why the scene is hard; then,
after an empty line, fields, one "name: value" in each line.  `FIELDS` lists all names.  The fields
decide which tests read the file: `hard_scenes("error factor")` returns all files with that field.
To add a scene to these tests, add a file.  A scene that fails opens with

    python -m tracer tests/scenes/NAME.xml
"""

from pathlib import Path
from typing import NamedTuple

import pytest

from reference.command import SCENES, list_scene_files
from reference.measured.workloads import copy_with_picture_size
from tracer import Scene, load_scene

HARD_SCENES = Path(__file__).with_name("scenes")

FIELDS = {
    "error factor": "the largest error is at most this many times that of a uniform grid",
    "largest error": "the largest error of a pixel, in linear radiance, is at most this",
    "certificate": "agrees: the certified picture is nearly that of many samples per pixel",
    "samples": "the numbers of samples per pixel for which one of the above holds",
    "brightest value": "Mitsuba's picture agrees, and the tracer's largest value is above this",
    "culling": "exact: the picture is that of every ray against every object, to the last bit",
    "read by": "the file of the test that reads the scene by its name",
    "slow": "yes, if similar scenes show the same, and this one is for the slow tests only",
}
"""Names of the fields of a hard scene, and what they mean."""

NAMES = [path.stem for path in list_scene_files()]


def scene_parameters(*quick: str) -> list:
    """Return the names of the project's scenes as test parameters, slow but for some quick ones."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in quick)) for name in NAMES]


class HardScene(NamedTuple):
    """A file in `tests/scenes`, and the fields of its comment."""

    path: Path
    fields: dict[str, str]  # values by name

    @property
    def scene(self) -> Scene:
        """The scene that the file describes; it is read each time."""
        return load_scene(self.path)

    @property
    def samples(self) -> list[int]:
        """Numbers of samples per pixel to test with, from the field "samples"."""
        return [int(count) for count in self.fields["samples"].split()]


def hard_scenes(field: str) -> list:
    """Return all files of `tests/scenes` that have a certain field, as test parameters.

    Each is a `HardScene`; a file with "slow: yes" is marked slow.  A comment that does not say why
    its scene is hard, or has a field that is not in `FIELDS`, fails.
    """
    parameters = []
    for path in sorted(HARD_SCENES.glob("*.xml")):
        comment = path.read_text(encoding="utf-8").partition("<!--")[2].partition("-->")[0]
        reason, _, lines = comment.strip().rpartition("\n\n")
        fields = dict(line.strip().split(": ") for line in lines.splitlines())
        assert reason, f"{path}: the comment does not say why the scene is hard to render"
        assert fields.keys() <= FIELDS.keys(), f"{path}: {fields.keys() - FIELDS.keys()}"
        if field in fields:
            marks = [pytest.mark.slow] * (fields.get("slow") == "yes")
            parameters.append(pytest.param(HardScene(path, fields), marks=marks, id=path.stem))
    return parameters


def small_scene(name: str, width: int = 48, height: int = 27) -> Scene:
    """Read a scene of this project by its name, and make its picture small.

    Its window has the height in the file, and a width that makes pixels square.
    """
    return copy_with_picture_size(load_scene(SCENES / f"{name}.xml"), width, height)
