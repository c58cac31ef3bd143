"""What programs that render scenes rely on: numbers of any kind, and faults in what is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tracer import Camera, PointLight, Scene, Sphere, render


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
    assert type(a_scene(True, 2).width) is int


@pytest.mark.parametrize("name", ["samples", "processes"])
@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (4.0, TypeError, "must be an int, is 4.0"),
        (2.5, TypeError, "must be an int, is 2.5"),
        ("4", TypeError, "must be an int, is '4'"),
        (0, ValueError, "must be at least 1, is 0"),
        (np.int8(-1), ValueError, "must be at least 1, is -1"),
        (10**9, ValueError, "must be at most 999999999"),
    ],
)
def test_numbers_of_samples_and_processes_that_are_none(
    name: str, value: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=f"^{name} {message}$"):
        render(a_scene(), **{name: value})


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
