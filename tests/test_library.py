"""What programs that make scenes themselves rely on: checks, copies, comparisons."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
    render,
)
from tracer.scene.schema import MAX_PIXELS

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


def a_scene(width: int = 40, height: int = 30) -> Scene:
    """A ball that is lit."""
    ball = Sphere(center=(0, 0, -3))
    return Scene(
        width=width, height=height, lights=(PointLight(position=(3, 4, 5)),), surfaces=(ball,)
    )


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.uint64, np.int64, np.array])
def test_sizes_may_be_integers_of_any_kind(kind: Callable[[int], int]) -> None:
    scene = a_scene(kind(100), kind(90))
    assert (type(scene.width), type(scene.height)) == (int, int)
    assert np.array_equal(render(scene, 4), render(a_scene(100, 90), 4))
    assert np.array_equal(render(scene, kind(4), processes=kind(1)), render(scene, 4))


def test_a_size_may_be_true() -> None:
    scene = a_scene(True, 2)
    assert type(scene.width) is int
    assert render(scene).shape == (2, 1, 3)


@pytest.mark.parametrize(
    ("width", "fault"),
    [
        (4.0, "must be an int, is 4.0"),
        (np.float64(2.5), f"must be an int, is {np.float64(2.5)!r}"),
        (np.nan, "must be an int, is nan"),
        (np.inf, "must be an int, is inf"),
        ("4", "must be an int, is '4'"),
        (None, "must be an int, is None"),
        (np.int8(-4), "must be a whole number of at least 1, is -4"),
        pytest.param(-(10**5000), "must be a whole number of at least 1", id="many digits below"),
        pytest.param(10**5000, f"must be at most {MAX_PIXELS}", id="many digits"),
    ],
)
def test_sizes_that_are_none(width: Any, fault: str) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width=width, height=0)
    told = [f"width: {fault}", "height: must be a whole number of at least 1, is 0"]
    assert str(bad.value).splitlines() == told


def test_numbers_that_are_none() -> None:
    """NumPy would read texts, make others NaN, or drop their imaginary parts."""
    for value in (None, "2", b"2", np.complex128(1 + 2j), np.datetime64("2000-01-01")):
        with pytest.raises(SceneError, match=r"^radius: must be given in numbers, is "):
            Sphere(radius=value)
    with pytest.raises(SceneError, match=r"^center: must be given in numbers, is "):
        Sphere(center=np.array([1j, 2, 3]))


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


@pytest.mark.parametrize("name", ["samples", "processes"])
@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (4.0, TypeError, "must be an int, is 4.0"),
        (2.5, TypeError, "must be an int, is 2.5"),
        ("4", TypeError, "must be an int, is '4'"),
        (-1, ValueError, "must be at least 1, is -1"),
        (np.int8(-1), ValueError, "must be at least 1, is -1"),
        (10**9, ValueError, "must be at most 999999999"),
    ],
)
def test_numbers_of_samples_and_processes_that_are_none(
    name: str, value: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=f"^{name} {message}$"):
        render(a_scene(), **{name: value})


def test_no_samples_at_all() -> None:
    with pytest.raises(ValueError, match="samples must be at least 1, is 0"):
        render(a_scene(), samples=0)


# Two spheres around a box, in this order.
MATTE, SHINY = Lambertian(diffuse=(0.5, 0.5, 0.5)), Phong(specular=(1, 1, 1), exponent=9)
ARRAYS: dict[str, Any] = {
    "center": [(0, 0, 0), (1, 2, 3)],
    "radius": [1, 2],
    "sphere_shader": [0, 1],
    "sphere_index": [0, 2],
    "min_pt": [(-1, -1, -1)],
    "max_pt": [(0, 0, 0)],
    "box_shader": [0],
    "box_index": [1],
    "shaders": (MATTE, SHINY),
}


def test_surfaces_of_arrays() -> None:
    assert list(Surfaces(**ARRAYS)) == [
        Sphere(center=(0, 0, 0), radius=1, shader=MATTE),
        Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 0), shader=MATTE),
        Sphere(center=(1, 2, 3), radius=2, shader=SHINY),
    ]


@pytest.mark.parametrize(
    ("center", "told"),
    [
        ((1, 2), "needs 3 numbers, has 2"),
        (3, "needs 3 numbers, has 1"),
        ([[1, 2, 3]], "needs 3 numbers, has shape (1, 3)"),
        ("abc", "must be given in numbers, is 'abc'"),
        ((1, (2, 3)), "must be given in numbers, is (1, (2, 3))"),
        ((1, 2, "3"), "must be given in numbers, is (1, 2, '3')"),
        ((0, 10**400, 0), "must be finite"),
    ],
)
def test_what_is_no_vector(center: Any, told: str) -> None:
    with pytest.raises(SceneError) as caught:
        Sphere(center=center)
    assert str(caught.value) == f"center: {told}"


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("a", "must be given in numbers, is 'a'"),
        ((1, 2), "must be a single number, has 2"),
        (10**400, "must be finite"),
    ],
)
def test_what_is_no_number(value: Any, told: str) -> None:
    for name, make in (("radius", Sphere), ("exponent", Phong), ("proj_distance", Camera)):
        with pytest.raises(SceneError) as caught:
            make(**{name: value})
        assert str(caught.value) == f"{name}: {told}"


NO_PERMUTATION = "sphere_index, box_index: must together be a permutation of 0 ... 2"


@pytest.mark.parametrize(
    ("arrays", "faults"),
    [
        ({"radius": [1]}, ["radius: needs 2, as many as center; has 1"]),
        ({"radius": [1, -1, 2]}, ["radius: needs 2, as many as center; has 3"]),
        ({"center": range(4)}, ["center: needs 3 numbers in each row, has shape (4,)"]),
        ({"max_pt": np.zeros((3, 2))}, ["max_pt: needs 3 numbers in each row, has shape (3, 2)"]),
        ({"max_pt": [["a", 1, 2]]}, ["max_pt: must be given in numbers, is [['a', 1, 2]]"]),
        ({"center": [(1, 2), 3]}, ["center: must be given in numbers, is [(1, 2), 3]"]),
        ({"radius": [1, 10**400]}, ["radius: must be finite"]),
        ({"box_shader": [None]}, ["box_shader: must be whole numbers"]),
        ({"box_shader": ["red"]}, ["box_shader: must be given in numbers, is ['red']"]),
        ({"max_pt": ()}, ["max_pt: needs 1, as many as min_pt; has 0"]),
        ({"sphere_shader": [0]}, ["sphere_shader: needs 2, as many as center; has 1"]),
        ({"sphere_shader": [7, 0]}, ["sphere_shader: must be places among 2 shaders, has 7"]),
        ({"box_shader": [-1]}, ["box_shader: must be places among 2 shaders, has -1"]),
        ({"box_shader": [0.5]}, ["box_shader: must be whole numbers"]),
        ({"box_shader": [np.nan]}, ["box_shader: must be whole numbers"]),
        ({"box_index": [1, 3]}, ["box_index: needs 1, as many as min_pt; has 2"]),
        ({"box_index": [2]}, [NO_PERMUTATION]),
        ({"box_index": [3]}, [NO_PERMUTATION]),
        ({"sphere_index": [-1, 0]}, [NO_PERMUTATION]),
        ({"box_index": None, "sphere_index": [1, 2]}, [NO_PERMUTATION]),
        (
            {"shaders": (MATTE, "red")},
            ["shaders: must be of type Lambertian or Phong, is of type str"],
        ),
        (
            {"radius": [1], "shaders": (), "box_index": [2]},
            [
                "radius: needs 2, as many as center; has 1",
                "sphere_shader: must be places among 0 shaders, has 0",
                "box_shader: must be places among 0 shaders, has 0",
            ],
        ),
        (
            {"radius": [1, -1], "max_pt": [(-2, 0, 0)]},
            [
                "surface 1: min_pt: must not exceed max_pt, but x has -1 > -2; swap these",
                "surface 2: radius: must be positive and finite, is -1",
            ],
        ),
    ],
)
def test_arrays_that_do_not_fit(arrays: dict[str, Any], faults: list[str]) -> None:
    with pytest.raises(SceneError) as bad:
        Surfaces(**ARRAYS | arrays)
    assert str(bad.value).splitlines() == faults


def test_three_numbers_of_another_shape() -> None:
    with pytest.raises(SceneError, match=r"^center: needs 3 numbers, has shape \(1, 3\)$"):
        Sphere(center=[[0, 0, 0]])  # type: ignore[arg-type]


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
    assert same.surfaces.box_index.dtype is np.dtype(np.intp)


def test_surfaces_are_equal_as_sequences_are() -> None:
    surfaces = Surfaces(**ARRAYS)
    white = Lambertian()
    for same in (
        Surfaces.of(surfaces),
        Surfaces(**ARRAYS | {"shaders": (white, SHINY, MATTE), "box_shader": [2],
                             "sphere_shader": [2, 1]}),
        Surfaces(**ARRAYS | {"center": ARRAYS["center"][::-1], "radius": [2, 1],
                             "sphere_shader": [1, 0], "sphere_index": [2, 0]}),
    ):  # fmt: skip
        assert same == surfaces
        assert hash(same) == hash(surfaces)
    for name, value in {
        "center": [(0, 0, 0), (1, 2, 4)],
        "radius": [1, 3],
        "sphere_shader": [0, 0],
        "sphere_index": [1, 2],
        "shaders": (MATTE, white),
    }.items():
        other = {name: value} | ({"box_index": [0]} if name == "sphere_index" else {})
        assert Surfaces(**ARRAYS | other) != surfaces
    assert Surfaces.of(list(surfaces)[:2]) != surfaces
    assert surfaces != list(surfaces)
    assert Surfaces() == Surfaces()


@pytest.mark.parametrize(
    "view_dir", [(0, 1e-200, -1), (1e-200, 0, -1), (0, 1e-300, -1e300), (0, 3e-320, -1e-320)]
)
def test_underflow_is_no_error_to_anyone(view_dir: tuple[float, float, float]) -> None:
    scene = replace(a_scene(), camera=Camera(view_dir=view_dir))
    image = render(scene)
    with np.errstate(all="raise"):
        same = replace(a_scene(), camera=Camera(view_dir=view_dir))
        assert same == scene
        assert np.array_equal(render(same), image)


@pytest.mark.parametrize(
    "offset", [(np.nan, 0), (0, np.inf), (0,), (0, 0, 0), 0.5, None, [[0, 0]], np.zeros(3)]
)
def test_offsets_that_are_none(offset: Any) -> None:
    with pytest.raises(ValueError, match=r"^offset must be two finite numbers, is "):
        render(a_scene(), offset=offset)


def test_an_offset_may_be_any_two_numbers() -> None:
    image = render(a_scene(), offset=(0.5, 1))
    for offset in ([0.5, 1], np.array([0.5, 1]), (np.float32(0.5), np.int8(1))):
        assert np.array_equal(render(a_scene(), offset=offset), image)  # type: ignore[arg-type]
