"""What programs that make scenes themselves rely on: checks, copies, comparisons."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tracer import PointLight, Scene, SceneError, SceneFileError, Sphere, load_scene, render
from tracer.scene import MAX_PIXELS

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
    assert np.array_equal(render(scene, kind(4), threads=kind(1)), render(scene, 4))


def test_a_size_may_be_true() -> None:
    scene = a_scene(True, 2)
    assert type(scene.width) is int
    assert render(scene).shape == (2, 1, 3)


@pytest.mark.parametrize(
    ("width", "fault"),
    [
        (4.0, "width must be an int, is 4.0"),
        (np.float64(2.5), f"width must be an int, is {np.float64(2.5)!r}"),
        (np.nan, "width must be an int, is nan"),
        (np.inf, "width must be an int, is inf"),
        ("4", "width must be an int, is '4'"),
        (None, "width must be an int, is None"),
        (np.int8(-4), "width must be a whole number of at least 1, is -4"),
        pytest.param(10**5000, f"width must be at most {MAX_PIXELS}", id="many digits"),
    ],
)
def test_sizes_that_are_none(width: Any, fault: str) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width=width, height=0)
    told = [f"image: {fault}", "image: height must be a whole number of at least 1, is 0"]
    assert str(bad.value).splitlines() == told


def test_too_many_pixels_are_counted_without_overflow() -> None:
    with pytest.raises(SceneError, match=r"^image: 65536 x 65536 pixels are too many"):
        Scene(width=np.int32(65536), height=np.int32(65536))


@pytest.mark.parametrize("name", ["samples", "threads"])
@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (4.0, TypeError, "must be an int, is 4.0"),
        (2.5, TypeError, "must be an int, is 2.5"),
        ("4", TypeError, "must be an int, is '4'"),
        (-1, ValueError, "must be at least 1, is -1"),
        (np.int8(-1), ValueError, "must be at least 1, is -1"),
    ],
)
def test_numbers_of_samples_and_threads_that_are_none(
    name: str, value: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=f"^{name} {message}$"):
        render(a_scene(), **{name: value})
