"""Pictures that are hard to antialias, each for a reason of its own.

Even so, many samples a pixel are no worse than a uniform grid, or nearly as good as a fine one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from probe import Surface, scene_of
from random_scenes import random_scene
from uniform_grid import no_worse_than_the_uniform_grid, uniform

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, render
from tracer.antialias import refine as antialias
from tracer.antialias.curvature import curvature
from tracer.arrays import Floats, Ints, Vector

RED = Lambertian(diffuse=(1, 0, 0))
ROOM = Box(min_pt=(-30, -30, -30), max_pt=(30, 30, 30))


class Hard(NamedTuple):
    """A picture, and what is asked of it."""

    scene: Scene
    times: float = 1
    """How many times the grid's largest error its own may be."""
    numbers: tuple[int, ...] = (4, 16, 64, 256)
    """Of samples a pixel."""
    split: bool = False
    """Pixels are split even if it is full of outlines."""


def seen(
    *surfaces: Surface,
    light: Vector,
    size: tuple[int, int] = (36, 24),
    wide: float = 1,
    high: float | None = None,
    **camera: Any,
) -> Scene:
    """Surfaces in a window so wide; unless told how high that is, in square pixels."""
    high = wide * size[1] / size[0] if high is None else high
    view = Camera(view_width=wide, view_height=high, **camera)
    return scene_of(*surfaces, camera=view, size=size, lights=light)


def floor(half: float, **shader: Any) -> Box:
    """So large, and one unit thick, under the origin."""
    return Box(min_pt=(-half, -1, -half), max_pt=(half, 0, half), **shader)


def wall(half: float, z: float, **shader: Any) -> Box:
    """So large, and one unit thick, behind that z."""
    return Box(min_pt=(-half, -half, z - 1), max_pt=(half, half, z), **shader)


def ball(center: Vector, radius: float, **shader: Any) -> Sphere:
    """A red one, unless told otherwise."""
    return Sphere(center=center, radius=radius, **{"shader": RED, **shader})


def red_box(low: Vector, high: Vector) -> Box:
    return Box(min_pt=low, max_pt=high, shader=RED)


def gloss(diffuse: float, exponent: float) -> Phong:
    """White highlights on gray."""
    return Phong(diffuse=(diffuse,) * 3, specular=(1, 1, 1), exponent=exponent)


def shadow_far_away(slope: float, pixel: float) -> Scene:
    ahead = (0.72 * pixel, -slope - 0.4 * pixel, -1)
    return seen(
        Box(min_pt=(-1e3, -5, -1e3), max_pt=(1e3, 0, 1e3)),
        red_box((-300, 150, -103), (300, 160, -100)),
        light=(3, 2000, -101), size=(24, 16), wide=24 * pixel,
        view_point=(0, 100 * slope, 0), view_dir=ahead,
    )  # fmt: skip


def long_lens(distance: float) -> Scene:
    x, y, z = (np.array([-2.0, 3.0, -6.0]) / 7 * distance).tolist()
    cube = Box(min_pt=(-0.5, -0.5, -0.5), max_pt=(0.5, 0.5, 0.5))
    lens = {"view_point": (x, y, z), "view_dir": (2, -3, 6), "proj_distance": distance}
    return seen(cube, light=(-0.14, 3.7, -3.4), wide=3, **lens)


def wall_through_floor(slope: float, part: float) -> Scene:
    """Its foot is so much of a pixel below the top of a row; behind it the floor is far away."""
    step = slope * 10 / 18
    up = -slope + part * step
    return seen(
        floor(50), red_box((-3, -1, -11), (3, 2, -10)), light=(5, 20, 5), size=(18, 12),
        wide=18 * step, view_point=(0, 10 * slope, 0), view_dir=(0, up, -1),
        proj_normal=(0, 0, 1), proj_distance=math.hypot(1, up),
    )  # fmt: skip


def wire_on_centres(thickness: float, turn: float) -> Scene:
    half, up = thickness / 6, (math.sin(turn), math.cos(turn), 0)
    wire = red_box((-0.8, -half, -6), (0.8, half, -5))
    return seen(wall(30, -11), wire, light=(1, 2, 6), size=(15, 15), view_up=up)


def wire_between_samples(up: float, roll: float) -> Scene:
    wire = red_box((-0.2, up - 0.0012, -1), (0.9, up + 0.0012, -0.994))
    back = wall(9, -1.02, shader=Lambertian(diffuse=(0.3,) * 3))
    return seen(wire, back, light=(0, 1.5, 1), size=(32, 32), view_up=(roll, 1, 0))


def many_dim_lights() -> Scene:
    lights = [PointLight(position=(9, 5, -1.5), intensity=(1 / 300,) * 3)] * 300
    eye = {"view_point": (0, 0, 10), "proj_distance": 10}
    scene = seen(ball((0.1, 0.1, 0), 1), light=(0, 0, 0), size=(18, 12), wide=6.3, **eye)
    return replace(scene, lights=lights)


def alike(name: str, pictures: Iterable[Hard]) -> dict[str, Hard]:
    """Pictures of one kind, numbered."""
    return {f"{name}, {number}": picture for number, picture in enumerate(pictures, 1)}


FEW = (16, 64)
HOLLOW = Sphere(radius=6)

PICTURES = {
    # All samples beside edges are far left, and the wall in their rows reaches far right.
    "a small object beside the rim before a wide one": Hard(
        seen(wall(60, -5), ball((-1.7, -0.3, -3.9), 0.1), light=(0, 3, 4), size=(96, 72), high=1), 2
    ),
    # Its edges are straight, but not on a ball of a few pixels.
    "the shadow of a box on a small ball": Hard(
        seen(
            Sphere(radius=0.55), red_box((0.933, 1.304, 0.797), (1.35, 1.746, 1.072)),
            Box(min_pt=(-9, -1.55, -9), max_pt=(9, -0.55, 9)), light=(3.04, 4.625, 2.95),
            wide=3, view_point=(0, 1.4, 8), view_dir=(0, -0.1, -1), proj_distance=4,
        ), numbers=(64,), split=True,
    ),
    # For as many samples it bends too much.
    "the shadow of a box that hardly bends within a pixel": Hard(
        seen(
            Sphere(), Box(min_pt=(0.9, 1.2, 1.5), max_pt=(1.5, 1.8, 2.1)), light=(3, 4, 5),
            size=(24, 24), wide=3, view_point=(0, 0, 10), proj_distance=10,
        ), numbers=(64, 256),
    ),
    # The plane that touches the ball in a pixel's middle is far from it in the corners.
    "the shadow of a box on a ball in tall pixels": Hard(
        seen(
            Box(min_pt=(-1.401, -1.014, -1.69), max_pt=(-0.496, 0.099, -1.105)),
            Sphere(center=(0.7515, -0.7091, -1.1605), radius=0.4899),
            light=(-4.0502, 1.5368, -2.4968), size=(16, 24), wide=0.0296, high=0.6667,
            view_point=(1.934, -0.955, -4.511), view_dir=(-0.3868, 0.191, 0.9022),
            view_up=(0.3754, -0.5468, 0.7484),
        ), numbers=(64, 256), split=True,
    ),
    "surfaces that cross within pixels": Hard(
        random_scene("touching", 111, 36, 24), numbers=(64,), split=True
    ),
    # Light and shaded points are both so near to the plate that one a pixel larger holds both.
    "a lamp behind a plate": Hard(
        seen(
            floor(9), Box(min_pt=(-1, 0, -4.02), max_pt=(1, 0.5, -4)), light=(0, 0.2, -4.1),
            size=(41, 41), view_point=(0, 0.3, 0),
        ), 2,
    ),
    # Points on one of the two are outside of the other as soon as that is a little smaller.
    "shadows on a hollow ball that is there twice": Hard(
        seen(
            HOLLOW, HOLLOW, red_box((-0.7, -0.5, -2.5), (0.4, 0.8, -2.4)), light=(2, 1.5, 1),
            size=(36, 36), view_point=(0, 0, 4),
        ), 2,
    ),
    # Within a pixel beside the horizon the floor comes nearer to the light, and leaves it again.
    "a floor to the horizon": Hard(
        seen(
            floor(1e3), light=(1, 1, -6), wide=0.7, view_point=(0, 0.5, 3),
            view_dir=(0, -0.03, -1),
        ), 2,
    ),
    # Seen so nearly edge-on that a pixel sees as much of the floor as is before it.
    **alike(
        "a shadow far away on a floor",
        (Hard(shadow_far_away(*m)) for m in ((5e-4, 1e-4), (1e-4, 1e-5), (1e-5, 1e-6))),
    ),
    # It is wider than they are: what is nearest to a pixel's centre does not cross the pixel.
    **alike(
        "a shadow less deep than its pixels",
        (
            Hard(seen(floor(1e3), ball(*m), light=light, wide=0.7, view_point=(0, 0.5, 0)), 2)
            for *m, light in (
                ((0.0605, 0.9, -5.6067), 0.456, (6.7206, 9, -4.3108)),
                ((0.0275, 0.9, -3.9131), 0.332, (5.8868, 9, 2.4878)),
            )
        ),
    ),
    # Pixels see long, narrow parts of the floor, across which a ball's shadow bends back: at its
    # near side, and at its tip.
    **alike(
        "a shadow that leaves a pixel beside where it enters",
        (
            Hard(
                seen(
                    floor(1e3), ball(*m), light=light, size=(37, 25), wide=wide,
                    view_point=(0, up, 0), view_dir=ahead,
                ), 2, FEW,
            )
            for up, ahead, wide, *m, light in (
                (0.4908, (0.2594, -0.063, -0.998), 0.222,
                 (2.2266, 1.1065, -8.1563), 0.7377, (13.456, 10.215, -9.003)),
                (1, (0.047, -1.047, -11.276), 0.3056,
                 (3.2015, 4.3799, -10.1688), 0.7602, (14.979, 20.492, -6.096)),
            )
        ),
    ),
    # Rays to its horizon are at right angles to the way to its centre, or nearly.
    **alike(
        "the horizon of a planet",
        (
            Hard(
                seen(
                    Sphere(center=(0, -r, 0), radius=r), light=(0, 1e3, -50), size=(18, 13),
                    high=1, view_point=(0, 2, 0), view_dir=(0, up, -1),
                ), 2, FEW,
            )
            for r in (1e4, 6.4e6, 1e8)
            for up in (0, 0.02, -0.02)
        ),
    ),
    # On a face, an edge, a ball, or beside a ball: it sees the inside, on one side of the plane
    # that touches it there, and past it elsewhere.
    **alike(
        "the eye on a surface",
        (
            Hard(
                seen(
                    surface, ROOM, light=(0, 5, 3), size=(24, 16), high=1,
                    view_dir=(0.3, 0.01, -1), view_up=(0.1, 1, 0),
                )
            )
            for surface in (
                floor(9, shader=RED),
                red_box((0, -1, -9), (9, 0, 9)),
                ball((0, -1, 0), 1),
                ball((-1, 0, 0), 1),
            )
        ),
    ),
    # It looks along a face of a box, from so near to its edge that no outline is known there.
    **alike(
        "the eye beside an edge but for rounding",
        (
            Hard(
                seen(
                    red_box((0, -1, -4), (4, 1, -aside)), ROOM, light=(-2, 5, -4), size=(24, 20),
                    wide=0.37, high=0.37, view_dir=(0, -1, 0), view_up=(-0.013, 0.49, 0.87),
                ), numbers=FEW,
            )
            for aside in (0.0, 1e-16, 3e-12)
        ),
    ),
    # On the near side of the horizon's line light falls from nearly all to nothing.  Or the line
    # passes so near to pixels' centres that the floor's lower edges there may count for it.
    **alike(
        "light that falls off towards a horizon",
        (
            Hard(
                seen(
                    floor(3e4), light=(-100, 210, -160), size=(18, 13), wide=0.4,
                    view_point=(0, 1.4, 0), view_dir=(0, up, -1), proj_normal=(0, 0, 1),
                ), 2, FEW,
            )
            for up in (0.009, 0, -2e-5)
        ),
    ),
    "a shadow on the far part of what a pixel sees": Hard(
        seen(
            floor(6e4), Box(min_pt=(-3.3, 2.7, -45.5), max_pt=(9.4, 6.6, -30.3)), size=(24, 16),
            light=(-360, 295, 131), wide=0.65, view_point=(0, 0.31, 0), view_dir=(0, -0.034, -1),
        ), 2, (64, 256),
    ),
    **alike("a box through a long lens", (Hard(long_lens(d), 1, FEW) for d in (1e4, 1e6, 1e8))),
    # Its tangent plane there divides what it lights from what the ball shades: on the wall.
    "a light on a ball": Hard(
        seen(
            wall(9, -3), Sphere(shader=RED), light=(0, 1, 0), size=(24, 16), wide=0.6,
            view_point=(6, 1.02, 5), view_dir=(-3, 0, -8),
        ), numbers=FEW,
    ),
    # All centres see it; of a grid of four or sixteen samples none does.
    **alike(
        "a wire on a row of centres",
        (Hard(wire_on_centres(m, turn)) for m in (0.05, 0.1, 0.3) for turn in (0.0, 0.02)),
    ),
    # Where its shadow divides a pixel, a sample for one side may fall onto the wire.
    **alike(
        "a wire between rows of samples",
        (
            Hard(wire_between_samples(up, roll), 1, (9, 16, 64))
            for up, roll in ((-0.081, 0.0133), (-0.012, 0.0164), (0.09, 0.0))
        ),
    ),
    **alike(
        "a wall through a floor seen at a low angle",
        (
            Hard(wall_through_floor(slope, part), 1, (16, 64, 256))
            for slope in (1e-2, 2e-3)
            for part in (0.1, 0.3, 0.7)
        ),
    ),
    # None of them alone shows.
    "a terminator of many dim lights": Hard(many_dim_lights(), numbers=FEW),
    # No edge at all: the light alone changes, in a highlight, within a pixel.
    "a smooth surface in large pixels": Hard(
        seen(Sphere(shader=gloss(0.4, 50)), light=(1, 2, 5), wide=0.54, view_point=(0, 0, 3)), 2
    ),
    # No neighbour sees the ball, and its pixel's quarters do not all see it under the light.
    "light on a ball as wide as a pixel": Hard(
        seen(
            ball((-0.35, -0.29, 0), 0.65), light=(1.4, 1.5, 5.5), size=(9, 6), wide=9,
            view_point=(0, 0, 10), proj_distance=10,
        ), numbers=(64, 256),
    ),
    # By a hundredth of a pixel, all along it: two lines, however near each other.
    "a shadow right behind an outline": Hard(
        seen(
            Box(min_pt=(-0.3, -0.3, -2), max_pt=(0.3, 0.3, -1.9)), wall(9, -2.5),
            light=(0.004, 0.004, 0), size=(24, 24), view_up=(0.3, 1, 0),
        ), numbers=(16, 64, 256),
    ),
    # A highlight bends from row to row, and no row beside it says how.
    "a surface one pixel high": Hard(
        seen(
            Box(min_pt=(-9, -7 / 82, -1), max_pt=(9, 7 / 82, 0), shader=gloss(0.1, 34)),
            light=(0, 0, 1), size=(24, 13), wide=0.2, high=2, view_point=(0, 0, 1),
        )
    ),
    # It divides nothing of the wall before it, whose light rises along it.
    "the outline of a hidden ball": Hard(
        seen(
            wall(9, 0, shader=gloss(0.1, 200)), Sphere(center=(-78.54, -49.34, -99.11), radius=95),
            light=(0.5, -0.4, 3), size=(24, 16), wide=0.4, view_point=(0, 0, 3),
        ), numbers=(4, 16),
    ),
    # One or two pixels below the horizon light does not depend on the distance from it alone.
    "glitter below the horizon of a planet": Hard(
        seen(
            Sphere(center=(0, -1115, 0), radius=1115, shader=gloss(0.5, 5)), size=(24, 16),
            light=(-4, 0.298, -57.6), wide=1.375, view_point=(0, 0.293, 0),
            view_dir=(0, -0.0724, -1),
        )
    ),
    # Both sides of the shadow lie in a pixel, far from where its middle is.
    "the shadow of a ball smaller than its pixel": Hard(
        seen(
            floor(1e4), ball((3.9, 2.7, 11), 0.37), light=(-34, 12.4, -7.9), size=(24, 16),
            wide=0.7, high=0.47, view_point=(0, 37, 62), view_dir=(0, -0.51, -0.86),
        )
    ),
}  # fmt: skip


def marks(name: str) -> list[pytest.MarkDecorator]:
    """Of pictures that are alike, one is quick."""
    return [pytest.mark.slow] * (name[-1].isdigit() and name[-1] != "1")


@pytest.mark.parametrize("name", [pytest.param(m, marks=marks(m)) for m in PICTURES])
def test_no_worse_than_the_uniform_grid(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = PICTURES[name]
    if picture.split:
        monkeypatch.setattr(antialias, "_DENSE", math.inf)
    no_worse_than_the_uniform_grid(picture.scene, picture.times, picture.numbers)


@pytest.mark.parametrize("aside", [-0.01, 0.01, 0.02])
def test_a_narrow_highlight_beside_a_shadow(aside: float) -> None:
    # The pixel's middle lies in the shadow of the plate, its highlight beside it.
    at = -2.5 + 2.5 * 3 / 11
    plate = Box(min_pt=(-3, -3, 4), max_pt=((at + aside) / 2, 3, 4.01))
    eye = {"view_point": (-2.5, 0, 3), "view_dir": (at + 2.5, 0, -3)}
    glossy = wall(9, 0, shader=gloss(0.2, 1e5))
    scene = seen(glossy, plate, light=(0, 0, 8), size=(12, 8), wide=1 / 3, **eye)
    assert np.abs(render(scene, samples=64) - uniform(scene, 129)).max() <= 0.002


def test_a_ball_under_a_lamp_at_the_eye() -> None:
    # Light falls off towards the limb, also in parts of pixels whose middles see past the ball.
    eye, alone = (2, 1, 4), Sphere(center=(-0.5, 1, 0.5), radius=0.5)
    scene = seen(alone, light=eye, size=(24, 16), wide=0.5, view_point=eye, view_dir=(-2, 0, -4))
    error = render(scene, samples=256) - uniform(scene, 129)
    assert np.sqrt((error**2).mean()) <= 4e-5


def test_more_lights_than_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    # A key says what a pixel sees, and which lights reach it: the first of them counts, too.
    keys: set[int] = set()

    def noted(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
        keys.update(key.tolist())
        return curvature(radiance, key, width)

    monkeypatch.setattr(antialias, "curvature", noted)
    first, *others = [PointLight(position=(3, 5, 4), intensity=(1 / 80,) * 3)] * 80
    lights = [first, *(replace(light, position=(0, 0, 0)) for light in others)]
    scene = seen(wall(60, -5), ball((0, 0, -4), 1.2), light=(0, 0, 0), size=(24, 24))
    no_worse_than_the_uniform_grid(replace(scene, lights=lights), 2, numbers=(16, 64))
    # The wall and the ball, each in its light and out of it.
    assert len(keys) == 4
