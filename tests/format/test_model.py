"""Scenes that programs make: checks, copies, comparisons, types, files."""

import copy
import io
import pickle
from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    SceneError,
    SceneFileError,
    Sphere,
    Surfaces,
    load_scene,
    save_scene,
)

# Two spheres around a box, in this order.
MATTE, SHINY = Lambertian(diffuse=(0.5, 0.5, 0.5)), Phong(specular=(1, 1, 1), exponent=9)

ARRAYS: dict[str, Any] = {
    "center": [(0, 0, 0), (1, 2, 3)],
    "radius": [1, 2],
    "min_pt": [(-1, -1, -1)],
    "max_pt": [(0, 0, 0)],
    "shader_index": [0, 1, 0],
    "file_index": [0, 2, 1],
    "shaders": (MATTE, SHINY),
}


def faults_of(make: Callable[[], object]) -> ValueError:
    """The error that is raised."""
    with pytest.raises((SceneError, SceneFileError)) as caught:
        make()
    return caught.value


SIZE = {"width": 1, "height": 1}
IN_PIXELS = "must be a whole number from 1 to 268435456"

# What is made, with which values, and the lines of the error, in full or how each line begins.
FAULTS: list[tuple[type, dict[str, Any], list[str]]] = [
    *(
        (Scene, {"width": width, "height": 0}, [f"width: {wrong}", f"height: {IN_PIXELS}, is 0"])
        for width, wrong in (
            (4.0, "must be an int, is 4.0"),
            ("4", "must be an int, is '4'"),
            (np.int8(-4), f"{IN_PIXELS}, is -4"),
            (10**5000, IN_PIXELS),
        )
    ),
    # Counted without overflow.
    (Scene, dict.fromkeys(("width", "height"), np.int32(65536)), ["width, height: 65536 x 65536"]),
    # NumPy would read texts, make others NaN, or drop their imaginary parts.
    *(
        (made, {name: value}, [f"{name}: must be {wrong}"])
        for value, wrong in (
            *((odd, "given in numbers, is ") for odd in (None, "2", b"2", np.array([1j, 2, 3]))),
            (np.datetime64("2000-01-01"), "given in numbers, is "),
            ((1, (2, 3)), "given in numbers, is (1, (2, 3))"),
            ((1, 2, "3"), "given in numbers, is (1, 2, '3')"),
            ((0, 10**400, 0), "finite"),
        )
        for made, name in ((Sphere, "center"), (Camera, "proj_distance"))
    ),
    (Sphere, {"center": (1, 2)}, ["center: needs 3 numbers, has 2"]),
    (Sphere, {"center": 3}, ["center: needs 3 numbers, has 1"]),
    (Sphere, {"center": [[1, 2, 3]]}, ["center: needs 3 numbers, has shape (1, 3)"]),
    (Sphere, {"radius": (1, 2)}, ["radius: needs 1 number, has 2"]),
    # Parts of another type.
    (
        Scene,
        {"width": "a", "height": 8, "camera": 3, "lights": None, "surfaces": Sphere()},
        [
            "camera: must be of type Camera, is of type int",
            "lights: must be a list, is of type NoneType",
            "surfaces: must be a list, is of type Sphere",
            "width: must be an int, is 'a'",
        ],
    ),
    (Sphere, {"shader": "red"}, ["shader: must be of type Lambertian or Phong, is of type str"]),
    (Scene, SIZE | {"surfaces": ["ball"]}, ["surfaces: must be of type Sphere or Box, is of type"]),
    # Arrays that do not fit.
    *(
        (Surfaces, ARRAYS | {name: value}, [f"{name}: {wrong}"])
        for name, value, wrong in (
            ("shaders", (MATTE, "red"), "must be of type Lambertian or Phong, is of type str"),
            ("max_pt", np.zeros((2, 3)), "needs 1, as many as min_pt; has 2"),
            ("center", range(4), "needs 3 numbers in each row, has shape (4,)"),
            ("max_pt", np.zeros((3, 2)), "needs 3 numbers in each row, has shape (3, 2)"),
            ("center", [(1, 2), 3], "must be given in numbers, is [(1, 2), 3]"),
            ("radius", [1, 10**400], "must be finite"),
            ("shader_index", [0, 7, -1], "must be indices of 2 shaders, has 7"),
            ("shader_index", [-1, 0, 0], "must be indices of 2 shaders, has -1"),
            ("shader_index", [0, 0, 0.5], "must be whole numbers"),
            ("line", [1, 2], "needs 3, one for each surface; has 2"),
            ("file_index", [0, 2, 2], "must be a permutation of 0 ... 2"),
            ("file_index", [-1, 0, 1], "must be a permutation of 0 ... 2"),
        )
    ),
    (
        Surfaces,
        ARRAYS | {"radius": [1, -1, 2], "shaders": ()},
        [
            "radius: needs 2, as many as center; has 3",
            "shader_index: needs 4, one for each surface; has 3",
            "file_index: needs 4, one for each surface; has 3",
            "shader_index: must be indices of 0 shaders, has 0",
        ],
    ),
    (
        Surfaces,
        ARRAYS | {"radius": [1, -1], "max_pt": [(-2, 0, 0)]},
        [
            "surface 1: min_pt: must not exceed max_pt, but x has -1 > -2; swap these",
            "surface 2: radius: must be positive, is -1",
        ],
    ),
]


@pytest.mark.parametrize(("made", "values", "expected"), FAULTS, ids=range(len(FAULTS)))
def test_all_faults_are_reported(made, values, expected):
    lines = str(faults_of(lambda: made(**values))).splitlines()
    assert [line[: len(key)] for line, key in zip(lines, expected, strict=True)] == expected


def test_a_scene_does_not_change_with_the_arrays_it_was_made_from():
    arrays = {name: np.array(value) for name, value in ARRAYS.items() if name != "shaders"}
    surfaces = Surfaces(**arrays, shaders=ARRAYS["shaders"])
    for array in arrays.values():
        array[:] = -1
    assert surfaces == Surfaces(**ARRAYS)
    for name in arrays:
        for same in (surfaces, copy.copy(surfaces), pickle.loads(pickle.dumps(surfaces))):
            with pytest.raises(ValueError, match="read-only"):
                getattr(same, name)[:] = -1


PICKLED = [lambda made, p=p: pickle.loads(pickle.dumps(made, p)) for p in range(6)]


@pytest.mark.parametrize("copy_of", [copy.copy, copy.deepcopy, *PICKLED])
def test_copies_are_equal(copy_of):
    lights = [PointLight(position=(1, 2, 3))]
    scene = Scene(width=4, height=3, lights=lights, surfaces=Surfaces(**ARRAYS))
    same = copy_of(scene)
    assert same == scene
    assert hash(same) == hash(scene)
    # NumPy's own data types, not equal ones: see Surfaces.__setstate__.
    assert same.surfaces.center.dtype is np.dtype(np.float64)
    assert same.surfaces.file_index.dtype is np.dtype(np.intp)
    for error in faults_of(lambda: Scene(width=0, height=-1)), faults_of(lambda: load_scene("a")):
        same = copy_of(error)
        assert (type(same), vars(same), str(same)) == (type(error), vars(error), str(error))


def test_surfaces_are_equal_as_sequences_are():
    surfaces = Surfaces(**ARRAYS)
    assert list(surfaces) == [
        Sphere(center=(0, 0, 0), radius=1, shader=MATTE),
        Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 0), shader=MATTE),
        Sphere(center=(1, 2, 3), radius=2, shader=SHINY),
    ]
    white = Lambertian()
    for same in (
        Surfaces.of(list(surfaces)),
        Surfaces(**ARRAYS | {"shaders": (white, SHINY, MATTE), "shader_index": [2, 1, 2]}),
        Surfaces(**ARRAYS | {"center": ARRAYS["center"][::-1], "radius": [2, 1],
                             "shader_index": [1, 0, 0], "file_index": [2, 0, 1]}),
    ):  # fmt: skip
        assert same == surfaces
        assert hash(same) == hash(surfaces)
    for name, value in {
        "center": [(0, 0, 0), (1, 2, 4)],
        "radius": [1, 3],
        "shader_index": [0, 0, 0],
        "file_index": [1, 2, 0],
        "shaders": (MATTE, white),
    }.items():
        assert Surfaces(**ARRAYS | {name: value}) != surfaces
    assert Surfaces.of(list(surfaces)[:2]) != surfaces
    assert surfaces != list(surfaces)
    assert Surfaces() == Surfaces()


def test_surfaces_are_sorted_once(monkeypatch):
    surfaces, argsort = Surfaces(**ARRAYS), Mock(wraps=np.argsort)
    monkeypatch.setattr("numpy.argsort", argsort)
    assert [surfaces[k] for k in (0, 1, -1)] == list(surfaces)
    assert argsort.call_count == 1


# In a file and back


def test_all_digits_are_saved(tmp_path):
    third = (1 / 3, -0.0, 1e-75)
    scene = Scene(
        camera=Camera(view_point=third, proj_normal=(0, 1e-9, 1), view_height=0.1 + 0.2),
        width=4,
        height=3,
        lights=[PointLight(position=third, intensity=(1e75, 0.1, 0))],
        surfaces=[
            Sphere(center=third, radius=1e75, shader=SHINY),
            Box(min_pt=(-1e75, 0, -1 / 3), max_pt=third),
            Sphere(shader=SHINY),
        ],
    )
    path = tmp_path / "a.xml"
    for target in (bytes(path), str(path), path):
        save_scene(scene, target)
        same = load_scene(target)
        assert same == scene
        assert repr(same) == repr(scene)
        assert list(map(repr, same.surfaces)) == list(map(repr, scene.surfaces))
    # What is shared is written once.
    assert path.read_text().count("Phong") == 1
    assert len(same.surfaces.shaders) <= 3


def test_only_scenes_are_replaced(tmp_path):
    scene, path = Scene(width=1, height=2), tmp_path / "scene.xml"
    for there in (
        b"",
        b"<scene/>",
        b'<?xml version="1.0"?>\n<!-- a\n--><!-- b -->\n<scene >',
        b"\xef\xbb\xbf<scene/>",
        "<scene/>".encode("utf-16"),
        b"<!-- %b --><scene/>" % (b"long " * 100_000),
    ):
        path.write_bytes(there)
        save_scene(scene, path)
        assert load_scene(path) == scene
    for there in ('<scene version="3.0.0">', "<scenes>", "my notes", "<!-- <scene> --> text"):
        path.write_text(there)
        with pytest.raises(FileExistsError):
            save_scene(scene, path)
        assert path.read_text() == there


LINED = """<scene><image>4 3</image><camera/>
<surface type="Box"><minPt>0 0 0</minPt><maxPt>1 1 1</maxPt></surface>
<light><position>1 2 3</position></light>
<surface
  type="Sphere"/> <light><position>1 2 3</position></light>
</scene>"""


def test_objects_know_their_lines():
    scene = load_scene(io.BytesIO(LINED.encode()))
    read = scene.surfaces
    for surfaces in read, pickle.loads(pickle.dumps(read)), Surfaces.of(list(read)):
        assert [surface.line for surface in surfaces] == [2, surfaces[1].line] == [2, 4]
    assert [light.line for light in scene.lights] == [3, 5]
    ball, lights = Sphere(), [PointLight(position=(1, 2, 3))] * 2
    assert ball.line is lights[0].line is Surfaces.of([ball])[0].line is None
    # They are no part of what an object is.
    assert (read[1], scene.lights) == (ball, tuple(lights))
    assert (hash(read[1]), repr(read[1])) == (hash(ball), repr(ball))
    arrays = [a.nbytes for a in vars(read).values() if isinstance(a, np.ndarray)]
    assert 10 * read.line.nbytes < sum(arrays)


@pytest.mark.parametrize(
    ("vectors", "wrong"),
    [
        (lambda x: {"view_up": (x, 0, -1)}, "view_up: must not be parallel to view_dir"),
        (lambda x: {"proj_normal": (0, 1, x), "view_up": (1, 0, 0)},
         "proj_normal: must not be perpendicular to view_dir"),
    ],
)  # fmt: skip
def test_directions_are_refused_where_too_few_digits_are_right(vectors, wrong):
    """Below a sine or cosine of 1e-10."""
    for x in (1.01e-10, -1.01e-10):
        Camera(**vectors(x))
    for x in (0.99e-10, -0.99e-10):
        with pytest.raises(SceneError, match=wrong):
            Camera(**vectors(x))
