"""Scenes that programs make: checks, copies, comparisons, types, files."""

from __future__ import annotations

import copy
import io
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tracer
from reference.command import own_scenes
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

# Every way to copy an object.
COPIES: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{
        f"pickle {protocol}": lambda o, p=protocol: pickle.loads(pickle.dumps(o, p))
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1)
    },
}

copied = pytest.mark.parametrize("copy_of", COPIES.values(), ids=COPIES)


@copied
def test_errors_are_copied(copy_of: Callable[[Any], Any]) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width=0, height=-1)
    same = copy_of(bad.value)
    assert type(same) is SceneError
    assert same.faults == bad.value.faults
    assert len(same.faults) == 2
    assert str(same) == str(bad.value)

    with pytest.raises(SceneFileError) as missing:
        load_scene("missing.xml")
    missing.value.note = "kept"  # type: ignore[attr-defined]
    same = copy_of(missing.value)
    assert type(same) is SceneFileError
    assert (same.lines, str(same)) == (missing.value.lines, str(missing.value))
    assert same.note == "kept"


@pytest.mark.parametrize(
    ("width", "fault"),
    [
        (4.0, "must be an int, is 4.0"),
        (np.float64(2.5), f"must be an int, is {np.float64(2.5)!r}"),
        (np.nan, "must be an int, is nan"),
        (np.inf, "must be an int, is inf"),
        ("4", "must be an int, is '4'"),
        (None, "must be an int, is None"),
        (np.int8(-4), "must be a whole number from 1 to 268435456, is -4"),
        pytest.param(
            -(10**5000), "must be a whole number from 1 to 268435456", id="many digits below"
        ),
        pytest.param(10**5000, "must be a whole number from 1 to 268435456", id="many digits"),
    ],
)
def test_sizes_that_are_none(width: Any, fault: str) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width=width, height=0)
    told = [f"width: {fault}", "height: must be a whole number from 1 to 268435456, is 0"]
    assert str(bad.value).splitlines() == told


@pytest.mark.parametrize(
    ("value", "told"),
    [
        # NumPy would read texts, make others NaN, or drop their imaginary parts.
        *(
            (value, "must be given in numbers, is ")
            for value in (None, "2", b"2", np.complex128(1 + 2j), np.datetime64("2000-01-01"))
        ),
        (np.array([1j, 2, 3]), "must be given in numbers, is "),
        ((1, (2, 3)), "must be given in numbers, is (1, (2, 3))"),
        ((1, 2, "3"), "must be given in numbers, is (1, 2, '3')"),
        ((0, 10**400, 0), "must be finite"),
    ],
)
def test_what_is_no_number(value: Any, told: str) -> None:
    for name, make in (
        *(("center", Sphere), ("radius", Sphere), ("exponent", Phong)),
        *(("proj_distance", Camera), ("view_dir", Camera)),
    ):
        with pytest.raises(SceneError) as caught:
            make(**{name: value})
        assert str(caught.value).startswith(f"{name}: {told}")


@pytest.mark.parametrize(
    ("made", "told"),
    [
        ({"center": (1, 2)}, "center: needs 3 numbers, has 2"),
        ({"center": 3}, "center: needs 3 numbers, has 1"),
        ({"center": [[1, 2, 3]]}, "center: needs 3 numbers, has shape (1, 3)"),
        ({"radius": (1, 2)}, "radius: needs 1 number, has 2"),
        ({"radius": 10**400}, "radius: must be finite"),
    ],
)
def test_too_many_numbers_or_too_few(made: dict[str, Any], told: str) -> None:
    with pytest.raises(SceneError) as caught:
        Sphere(**made)
    assert str(caught.value) == told


@pytest.mark.parametrize("one", [Sphere(), None, 5])
def test_one_in_place_of_a_list(one: Any) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width="a", height=8, camera=3, lights=one, surfaces=one)  # type: ignore[arg-type]
    kind = type(one).__name__
    assert str(bad.value).splitlines() == [
        "camera: must be of type Camera, is of type int",
        f"lights: must be a list, is of type {kind}",
        f"surfaces: must be a list, is of type {kind}",
        "width: must be an int, is 'a'",
    ]
    with pytest.raises(SceneError, match=r"^shaders: must be a list, is of type "):
        Surfaces(shaders=one)


def test_too_many_pixels_are_counted_without_overflow() -> None:
    with pytest.raises(SceneError, match=r"^width, height: 65536 x 65536 pixels are too many"):
        Scene(width=np.int32(65536), height=np.int32(65536))


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


def test_surfaces_of_arrays() -> None:
    assert list(Surfaces(**ARRAYS)) == [
        Sphere(center=(0, 0, 0), radius=1, shader=MATTE),
        Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 0), shader=MATTE),
        Sphere(center=(1, 2, 3), radius=2, shader=SHINY),
    ]


FOR_ALL = [f"{name}: needs 4, one a surface; has 3" for name in ("shader_index", "file_index")]


@pytest.mark.parametrize(
    ("arrays", "faults"),
    [
        ({"radius": [1, -1, 2]}, ["radius: needs 2, as many as center; has 3", *FOR_ALL]),
        ({"max_pt": np.zeros((2, 3))}, ["max_pt: needs 1, as many as min_pt; has 2"]),
        ({"center": range(4)}, ["center: needs 3 numbers in each row, has shape (4,)"]),
        ({"max_pt": np.zeros((3, 2))}, ["max_pt: needs 3 numbers in each row, has shape (3, 2)"]),
        ({"max_pt": [["a", 1, 2]]}, ["max_pt: must be given in numbers, is [['a', 1, 2]]"]),
        ({"center": [(1, 2), 3]}, ["center: must be given in numbers, is [(1, 2), 3]"]),
        ({"radius": [1, 10**400]}, ["radius: must be finite"]),
        ({"shader_index": [0, 1]}, ["shader_index: needs 3, one a surface; has 2"]),
        ({"shader_index": [0, 7, -1]}, ["shader_index: must be places among 2 shaders, has 7"]),
        ({"shader_index": [-1, 0, 0]}, ["shader_index: must be places among 2 shaders, has -1"]),
        *(
            ({"shader_index": [0, 0, odd]}, ["shader_index: must be whole numbers"])
            for odd in (None, 0.5, np.nan)
        ),
        ({"shader_index": ["red"]}, ["shader_index: must be given in numbers, is ['red']"]),
        ({"line": [1, 2]}, ["line: needs 3, one a surface; has 2"]),
        ({"file_index": [0, 1]}, ["file_index: needs 3, one a surface; has 2"]),
        *(
            ({"file_index": index}, ["file_index: must be a permutation of 0 ... 2"])
            for index in ([0, 2, 2], [0, 2, 3], [-1, 0, 1])
        ),
        (
            {"shaders": (MATTE, "red")},
            ["shaders: must be of type Lambertian or Phong, is of type str"],
        ),
        (
            {"shaders": (), "file_index": [0, 2, 2]},
            [
                "shader_index: must be places among 0 shaders, has 0",
                "file_index: must be a permutation of 0 ... 2",
            ],
        ),
        (
            {"radius": [1, -1], "max_pt": [(-2, 0, 0)]},
            [
                "surface 1: min_pt: must not exceed max_pt, but x has -1 > -2; swap these",
                "surface 2: radius: must be positive, is -1",
            ],
        ),
    ],
)
def test_arrays_that_do_not_fit(arrays: dict[str, Any], faults: list[str]) -> None:
    with pytest.raises(SceneError) as bad:
        Surfaces(**ARRAYS | arrays)
    assert str(bad.value).splitlines() == faults


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: Sphere(shader="red"), "shader: must be of type Lambertian or Phong"),
        (
            lambda: Box(min_pt=(0, 0, 0), max_pt=(1, 1, 1), shader=None),
            "shader: must be of type Lambertian or Phong",
        ),
        (
            lambda: Scene(width=1, height=1, surfaces=["ball"]),
            "surfaces: must be of type Sphere or Box",
        ),
        (lambda: Scene(width=1, height=1, lights=[MATTE]), "lights: must be of type PointLight"),
        (lambda: Scene(width=1, height=1, camera=None), "camera: must be of type Camera"),
    ],
)
def test_parts_of_another_type(make: Callable[[], object], fault: str) -> None:
    with pytest.raises(SceneError, match=f"^{fault}, is of type [a-zA-Z]+$"):
        make()


def test_a_scene_does_not_change_with_the_arrays_it_was_made_from() -> None:
    arrays = {name: np.array(value) for name, value in ARRAYS.items() if name != "shaders"}
    surfaces = Surfaces(**arrays, shaders=ARRAYS["shaders"])
    for array in arrays.values():
        array[:] = -1
    assert surfaces == Surfaces(**ARRAYS)
    for name in arrays:
        for same in (surfaces, copy.copy(surfaces), pickle.loads(pickle.dumps(surfaces))):
            with pytest.raises(ValueError, match="read-only"):
                getattr(same, name)[:] = -1


@copied
def test_copies_are_equal(copy_of: Callable[[Any], Any]) -> None:
    scene = Scene(
        width=4, height=3, lights=[PointLight(position=(1, 2, 3))], surfaces=Surfaces(**ARRAYS)
    )
    same = copy_of(scene)
    assert same == scene
    assert hash(same) == hash(scene)
    # NumPy's own data types, not equal ones: see Surfaces.__setstate__.
    assert same.surfaces.center.dtype is np.dtype(np.float64)
    assert same.surfaces.file_index.dtype is np.dtype(np.intp)


def test_surfaces_are_equal_as_sequences_are() -> None:
    surfaces = Surfaces(**ARRAYS)
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


# In a file and back


def saved(scene: Scene) -> str:
    file = io.BytesIO()
    save_scene(scene, file)
    return file.getvalue().decode()


@pytest.mark.parametrize("path", own_scenes(), ids=lambda path: path.stem)
def test_a_saved_scene_is_equal(path: Path) -> None:
    scene = load_scene(path)
    assert load_scene(io.BytesIO(saved(scene).encode())) == scene


def test_all_digits_are_saved(tmp_path: Path) -> None:
    third = (1 / 3, -0.0, 1e-75)
    scene = Scene(
        camera=Camera(view_point=third, proj_normal=(0, 1e-9, 1), view_height=0.1 + 0.2),
        width=4,
        height=3,
        lights=[PointLight(position=third, intensity=(1e300, 0.1, 0))],
        surfaces=[
            Sphere(center=third, radius=1e75, shader=SHINY),
            Box(min_pt=(-1e75, 0, -1 / 3), max_pt=third),
            Sphere(shader=SHINY),
        ],
    )
    for path in (tmp_path / "a.xml", str(tmp_path / "b.xml"), bytes(tmp_path / "c.xml")):
        save_scene(scene, path)
        same = load_scene(path)
        assert same == scene
        assert repr(same) == repr(scene)
        assert list(map(repr, same.surfaces)) == list(map(repr, scene.surfaces))
    # What is shared is written once.
    assert saved(scene).count("Phong") == 1
    assert len(same.surfaces.shaders) <= 3


def test_what_is_no_xml_is_not_replaced(tmp_path: Path) -> None:
    scene, path = Scene(width=1, height=2), tmp_path / "scene.xml"
    for there in ("", "<scene/>"):
        path.write_text(there)
        save_scene(scene, path)
        assert load_scene(path) == scene
    path.write_text("my notes")
    with pytest.raises(FileExistsError):
        save_scene(scene, path)
    assert path.read_text() == "my notes"


LINED = """<scene><image>4 3</image><camera/>
<surface type="Box"><minPt>0 0 0</minPt><maxPt>1 1 1</maxPt></surface>
<light><position>1 2 3</position></light>
<surface
  type="Sphere"/> <light><position>1 2 3</position></light>
</scene>"""


def test_objects_know_their_lines() -> None:
    scene = load_scene(io.BytesIO(LINED.encode()))
    for surfaces in (
        scene.surfaces,
        pickle.loads(pickle.dumps(scene.surfaces)),
        Surfaces.of(list(scene.surfaces)),
    ):
        assert [surface.line for surface in surfaces] == [2, 4]
        assert surfaces[1].line == 4
    assert [light.line for light in scene.lights] == [3, 5]
    ball, lights = Sphere(), [PointLight(position=(1, 2, 3))] * 2
    assert ball.line is lights[0].line is Surfaces.of([ball])[0].line is None
    # They are no part of what an object is.
    assert (scene.surfaces[1], scene.lights) == (ball, tuple(lights))
    assert hash(scene.surfaces[1]) == hash(ball)
    assert repr(scene.surfaces[1]) == repr(ball)
    surfaces = scene.surfaces
    arrays = [value.nbytes for value in vars(surfaces).values() if isinstance(value, np.ndarray)]
    assert 10 * surfaces.line.nbytes < sum(arrays)


USES = """
from pathlib import Path
import numpy as np
import tracer

shader: tracer.Shader = tracer.Phong(diffuse=[1, 0.5, 0], specular=np.ones(3), exponent=9)
ball = tracer.Sphere(center=np.array([1, 2, 3]), radius=2, shader=shader)
brick = tracer.Box(min_pt=[0, 0, 0], max_pt=(1.0, 1, 1))
lights = [tracer.PointLight(position=[1, 2, 3], intensity=np.ones(3))]
scene = tracer.Scene(width=4, height=3, lights=lights, surfaces=[ball, brick])
scene = tracer.Scene(width=4, height=3, lights=scene.lights, surfaces=scene.surfaces)
x, y, z = scene.lights[0].position
height: float = ball.center[1] + y
line: int | None = scene.surfaces[0].line
count: int = len(scene.surfaces.center) + len(scene.lights)
tracer.save_scene(scene, Path("scene.xml"))
with open("scene.xml", "rb") as file:
    scene = tracer.load_scene(file)
"""


@pytest.mark.slow
def test_types_of_documented_usage(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="mypy is not installed")
    readme = (Path(tracer.__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```python\n(.*?)^```", readme, re.M | re.S)
    for i, text in enumerate([USES, *examples]):
        (tmp_path / f"use{i}.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", *map(str, tmp_path.glob("use*.py"))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("Success"), done.stdout
