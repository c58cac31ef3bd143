"""Many samples a pixel: no worse than a uniform grid, on the project's scenes and on hard ones.

Each hard picture is so for a reason of its own.  What lies between the centres of pixels is found,
and edges, silhouettes and shadows whose place is known in closed form have their share of a pixel.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
from probe import Surface, noted, scene_of
from random_scenes import random_scene
from scene_files import NAMES, names

from reference.command import SCENES
from reference.judges.true_picture import rmse, supersampled, true_picture
from reference.measured.workloads import crowd
from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    Sphere,
    explain,
    load_scene,
    render,
)
from tracer.antialias import refine as antialias
from tracer.antialias.lattice import CENTRES, Lattice
from tracer.arrays import Floats
from tracer.geometry.camera import camera_frame
from tracer.trace import visibility
from tracer.trace.radiance import radiance_and_ids
from tracer.world.prepared_scene import PreparedScene

TRUE = 1 / 1024
"""The certified error of pictures that others are held against."""


@cache
def uniform(scene: Scene, per_side: int) -> Floats:
    """The mean of a grid of samples in every pixel; nothing that antialiasing does changes it."""
    return supersampled(scene, per_side)


def true_means(scene: Scene) -> Floats:
    """The means of pixels as certified; where that cannot be, of a fine grid."""
    try:
        known = true_picture(scene, TRUE)
    except ValueError:  # as with the eye on a surface
        return uniform(scene, 41)
    # Through a lens too long for certificates all stays unknown.
    return known.image if known.error.max() < 0.05 else uniform(scene, 41)


def no_worse_than_the_uniform_grid(
    scene: Scene, times: float = 1, numbers: tuple[int, ...] = (4, 16, 64, 256)
) -> None:
    """RMSE no larger, and the largest error no more than so many times as large."""
    truth = true_means(scene)
    for samples in numbers:
        image, grid = render(scene, samples), uniform(scene, math.isqrt(samples))
        assert rmse(image, truth) <= rmse(grid, truth) + 1e-12, samples
        assert np.abs(image - truth).max() <= times * np.abs(grid - truth).max() + 1e-12, samples


RED = Lambertian(diffuse=(1, 0, 0))
ROOM = Box(min_pt=(-30, -30, -30), max_pt=(30, 30, 30))


def seen(light, *surfaces, eye=(0, 0, 0), ahead=(0, 0, -1), size=(36, 24), wide=1, high=0, **lens):
    """Surfaces in a window so wide; unless told how high that is, in square pixels."""
    high = high or wide * size[1] / size[0]
    view = Camera(view_point=eye, view_dir=ahead, view_width=wide, view_height=high, **lens)
    return scene_of(*surfaces, camera=view, size=size, lights=light)


def floor(half, **shader) -> Box:
    """So large, and one unit thick, under the origin."""
    return Box(min_pt=(-half, -1, -half), max_pt=(half, 0, half), **shader)


def wall(half, z, **shader) -> Box:
    """So large, and one unit thick, behind that z."""
    return Box(min_pt=(-half, -half, z - 1), max_pt=(half, half, z), **shader)


def ball(center, radius, **shader) -> Sphere:
    return Sphere(center=center, radius=radius, **shader)


def box(low, high, **shader) -> Box:
    return Box(min_pt=low, max_pt=high, **shader)


def red(shape: Surface) -> Surface:
    return replace(shape, shader=RED)


def gloss(diffuse: float, exponent: float) -> Phong:
    """White highlights on gray."""
    return Phong(diffuse=(diffuse,) * 3, specular=(1, 1, 1), exponent=exponent)


BALL = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))


def from_afar(*surfaces: Surface, light=(0, 0, 10), pixels: int = 16, **lens: Any) -> Scene:
    """So many pixels a side, all together of size 4 on the plane z = 0, seen from far away."""
    lens |= {"eye": (0, 0, 100), "proj_distance": 100, "wide": 4}
    return seen(light, *surfaces, size=(pixels, pixels), **lens)


def small(name: str) -> Scene:
    """A scene of the project, 64 pixels wide."""
    scene = load_scene(SCENES / f"{name}.xml")
    return replace(scene, width=64, height=round(64 * scene.height / scene.width))


@pytest.mark.parametrize("name", names("room", "highlights", "four-spheres", "one-box", "touching"))
def test_no_worse_than_the_uniform_grid(name):
    no_worse_than_the_uniform_grid(small(name))


@pytest.mark.slow
@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("name", NAMES)
def test_split_pixels_are_no_worse_than_the_uniform_grid(name):
    # So small, some of them are so full of outlines that they would be made of lattices; and other
    # squares than powers of four.
    no_worse_than_the_uniform_grid(small(name))
    if name in ("many-objects", "room", "two-boxes"):
        no_worse_than_the_uniform_grid(small(name), numbers=(9, 25, 36, 49, 100))


def test_pictures_full_of_outlines_are_lattices():
    scene = crowd(3000, width=96, height=54)
    points = Lattice.of(4).points()
    image = render(scene, samples=16)
    # Every other row of pixels has the mirror image.
    for first, sign in ((0, 1), (1, -1)):
        offsets = zip(sign * points.real, points.imag, strict=True)
        mean = np.mean([render(scene, offset=offset) for offset in offsets], axis=0)
        assert np.abs(image - mean)[first::2].max() <= 1e-12


@pytest.mark.parametrize("supersample", [-1.0, math.inf])
def test_an_offset_of_whole_pixels_moves_the_picture(supersample, monkeypatch):
    monkeypatch.setattr(antialias, "_MAX_SILHOUETTE_PAIRS", supersample)
    scene = crowd(30, width=48, height=27)
    image, moved = (render(scene, 16, offset=offset) for offset in ((0, 0), (3, 2)))
    assert image.std() > 0.05
    # The rays are the same but for rounding, which decides next to nothing.
    assert np.mean(np.abs(moved[:-2, :-3] - image[2:, 3:]) > 1e-9) < 0.01


@pytest.mark.parametrize("slope", [0, 1 / 2, 2 / 3, 3 / 4, 1 / 3, 3 / 2])
def test_lattices_of_edges_in_their_own_directions(slope, monkeypatch):
    monkeypatch.setattr(antialias, "_MAX_SILHOUETTE_PAIRS", -1.0)
    rng = np.random.default_rng(0)
    middles, halves = rng.uniform((-1.2, -1, -4.5), (1.2, 1, -3.5), (60, 3)), (0.02, 0.15)
    boxes = [
        box(at - half, at + half, shader=Lambertian(diffuse=rng.uniform(0.2, 1, 3)))
        for at, half in zip(middles, rng.uniform(*halves, (60, 3)), strict=True)
    ]
    scene = seen((0, 3, 2), *boxes, view_up=(slope, 1, 0), size=(24, 16), wide=0.6)
    # With 49 samples or more, and a slope of 1 / 2, the grid may be closer by some 2 %.
    no_worse_than_the_uniform_grid(scene, times=1.5, numbers=(4, 9, 16, 25, 36))


def test_numbers_of_samples():
    # One is the centre: of three by three pixels in the place of each, the middle one has the same.
    fine = render(from_afar(BALL, pixels=48), samples=1)[1::3, 1::3]
    np.testing.assert_allclose(render(from_afar(BALL), samples=1), fine, atol=1e-12)
    # Others are rounded up to squares.
    assert np.array_equal(render(from_afar(BALL), samples=5), render(from_afar(BALL), samples=9))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("closed", [box((-0.5, 0, -0.5), (0.5, 1, 0.5)), ball((0, 0.4, 0), 0.5)])
def test_a_light_that_is_shut_in_lights_nothing_outside(closed):
    # Points on the floor as near to it as a pixel is wide are inside what is that much larger.
    lens = {"eye": (3, 2.5, 4), "ahead": (-3, -2.2, -4), "proj_distance": 1.2, "size": (120, 90)}
    scene = seen((0, 0.5, 0), floor(9), closed, **lens)
    assert not render(scene, 16).any()


@pytest.mark.parametrize(("name", "better"), [("one-sphere", 9), ("four-spheres", 14)])
def test_silhouettes_and_terminators_are_nearly_exact(name, better):
    # Both are known in closed form, with how light falls off towards them.
    scene = small(name)
    truth = true_picture(scene, TRUE).image
    ours, grid = (rmse(image, truth) for image in (render(scene, 16), uniform(scene, 4)))
    assert ours <= grid / better


def test_pixels_full_of_dim_shadows_are_sampled(monkeypatch):
    # The edges of forty lights everywhere: to split pixels would take many times the samples.
    at = np.random.default_rng(0).uniform((-9, -9, 9), (9, 9, 12), (40, 3))
    lights = [PointLight(position=position, intensity=(0.03,) * 3) for position in at]
    scene = from_afar(wall(9, -1), BALL, light=lights, pixels=24)
    counts = noted(monkeypatch, visibility, "_candidates", lambda _, samples: samples.size)
    render(scene, 16)
    assert sum(counts) < 4 * 16 * 24 * 24
    no_worse_than_the_uniform_grid(scene, times=1.5, numbers=(4, 16))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("seed", [1, 16, 18])
def test_no_radiance_is_negative(seed):
    # What stands for a sliver of a pixel may weigh less than nothing.
    assert render(random_scene("crowd", seed, 24, 16), 4).min() >= 0


def test_crowded_pixels_are_divided_as_well(monkeypatch):
    real = antialias.classify

    def crowded(*cells):
        found = real(*cells)
        return found._replace(crowded=np.ones_like(found.crowded))

    monkeypatch.setattr(antialias, "classify", crowded)
    # Of the tenth column the wall covers 0.33.
    image = render(from_afar(box((-9, -9, -9), (0.25 + 0.33 * 0.25, 9, 0))), 16)[..., 0]
    np.testing.assert_allclose(image[:, 9] / image[:, 8], 0.33, atol=1e-3)


def test_unresolved_pixels_that_look_alike_are_sampled(monkeypatch):
    real, back, bead = antialias.classify, wall(9, -1), red(ball((0.125, 0.06, -1), 0.03))

    def unresolved(*cells):
        found = real(*cells)
        lines, everywhere = found.lines.take(slice(0)), np.ones_like(found.unresolved)
        return found._replace(lines=lines, unresolved=everywhere)

    # The second holds a bead that five samples in its pixel miss: it is split after all.
    scenes = from_afar(back), from_afar(back, bead)
    means = [true_means(scene) for scene in scenes]
    monkeypatch.setattr(antialias, "classify", unresolved)
    counts = noted(monkeypatch, visibility, "_candidates", lambda _, samples: samples.size)
    for scene, mean in zip(scenes, means, strict=True):
        counts.clear()
        np.testing.assert_allclose(render(scene, 64), mean, atol=2e-3)
        # To split all of them would take three times the samples.
        assert sum(counts) < 1.2 * 16 * 16 * 65
    assert np.ptp(means[1]) > 0.02


def test_ids_are_equal_where_object_face_and_lights_are():
    """What antialiasing takes for one smooth surface."""
    boxes = box((-3, -2, -3), (3, -1, 3)), box((-1, -1, -1), (1, 1, 1))
    lights = [PointLight(position=p) for p in ((2, 9, 1), (9, 5, 2), (3, 4, 9))]
    lens = {"eye": (5, 4, 3), "ahead": (-5, -4, -3), "size": (16, 12)}
    scene = seen(lights, ball((1, 0, 2), 0.7), *boxes, **lens)
    frame = camera_frame(scene.camera, scene.width, scene.height)
    samples = CENTRES.samples(slice(0, scene.height), slice(0, scene.width))
    with np.errstate(all="ignore"):  # as where pictures are rendered
        _, ids = radiance_and_ids(PreparedScene(scene, frame), samples)
    keys = {}
    for (y, x), found in np.ndenumerate(ids.reshape(scene.height, scene.width)):
        pixel = explain(scene, x, y)
        flat = pixel.surface is not None and pixel.surface.kind == "Box"
        lit = tuple(not light.occluders for light in pixel.lights)
        key = pixel.surface and (pixel.surface, flat and pixel.normal, lit)
        assert keys.setdefault(key, found) == found
    assert len(set(keys.values())) == len(keys) > 9
    assert keys[None] == -1


FEW = (16, 64)


class Hard(NamedTuple):
    """A picture, and how many times the grid's largest error its own may be, of so many samples."""

    name: str
    scene: Scene
    times: float = 1
    numbers: tuple[int, ...] = (4, 16, 64, 256)


def outlines() -> Iterator[Hard]:
    """What is seen past what."""
    # All samples beside edges are far left, and the wall in their rows reaches far right.
    bead = red(ball((-1.7, -0.3, -3.9), 0.1))
    yield Hard("bead", seen((0, 3, 4), wall(60, -5), bead, size=(96, 72), high=1), 2)
    crossing = random_scene("touching", 111, 36, 24)
    yield Hard("surfaces that cross within pixels", crossing, numbers=(64,))
    # One box comes out of the other by another face than the middle of the pixel has behind it.
    view = {"ahead": (0.26, 0, -1), "view_up": (0.12, 1, 0), "size": (32, 24), "wide": 1.6}
    rooms = box((-9, -9, -5), (9, 9, 9)), red(box((-9, -9, -5.2), (1.3, 9, 9)))
    yield Hard("room that comes out of a room", seen((0.5, 0, -2), *rooms, **view))
    view = {"ahead": (-2.1, 2.934, 1.521), "view_up": (0.73, 0.588, 0.35), "size": (16, 12)}
    dome = red(ball((-0.1337, 0.5724, -0.0658), 3.7835))
    room = box((-2.1046, -1.4706, -2.5026), (2.8879, 4.0979, 1.1028))
    scene = seen((-0.215, 0.708, -1.184), room, dome, **view, proj_distance=0.0251, wide=0.0368)
    yield Hard("room that comes out of a dome", scene, numbers=(16, 64))
    # Rays to its horizon are at right angles to the way to its centre, or nearly.
    for r, up in product((1e4, 6.4e6, 1e8), (0, 0.02, -0.02)):
        planet, view = ball((0, -r, 0), r), {"eye": (0, 2, 0), "ahead": (0, up, -1)}
        scene = seen((0, 1e3, -50), planet, **view, size=(18, 13), high=1)
        yield Hard("horizon of a planet", scene, 2, FEW)
    # On a face, an edge, a ball, or beside a ball: it sees the inside, on one side of the plane
    # that touches it there, and past it elsewhere.
    for surface in (
        floor(9),
        box((0, -1, -9), (9, 0, 9)),
        ball((0, -1, 0), 1),
        ball((-1, 0, 0), 1),
    ):
        view = {"ahead": (0.3, 0.01, -1), "view_up": (0.1, 1, 0)}
        scene = seen((0, 5, 3), red(surface), ROOM, **view, size=(24, 16), high=1)
        yield Hard("eye on a surface", scene)
    # It looks along a face of a box, from so near to its edge that no outline is known there.
    for aside in (0.0, 1e-16, 3e-12):
        view = {"ahead": (0, -1, 0), "view_up": (-0.013, 0.49, 0.87), "size": (24, 20)}
        beside = red(box((0, -1, -4), (4, 1, -aside)))
        scene = seen((-2, 5, -4), beside, ROOM, **view, wide=0.37, high=0.37)
        yield Hard("eye beside an edge but for rounding", scene, numbers=FEW)
    for d in (1e4, 1e6, 1e8):
        x, y, z = (np.array([-2.0, 3.0, -6.0]) / 7 * d).tolist()
        lens = {"eye": (x, y, z), "ahead": (2, -3, 6), "proj_distance": d}
        scene = seen((-0.14, 3.7, -3.4), box((-0.5,) * 3, (0.5,) * 3), **lens, wide=3)
        yield Hard("box through a long lens", scene, 1, FEW)
    # All centres see it; of a grid of four or sixteen samples none does.
    for thick, turn in product((0.05, 0.1, 0.3), (0.0, 0.02)):
        wire = red(box((-0.8, -thick / 6, -6), (0.8, thick / 6, -5)))
        up = (math.sin(turn), math.cos(turn), 0)
        scene = seen((1, 2, 6), wall(30, -11), wire, size=(15, 15), view_up=up)
        yield Hard("wire on a row of centres", scene)
    # Its foot is so much of a pixel below the top of a row; behind it the floor is far away.
    for slope, part in product((1e-2, 2e-3), (0.1, 0.3, 0.7)):
        step = slope * 10 / 18
        up = -slope + part * step
        view = {"eye": (0, 10 * slope, 0), "ahead": (0, up, -1), "proj_normal": (0, 0, 1),
                "proj_distance": math.hypot(1, up)}  # fmt: skip
        through = red(box((-3, -1, -11), (3, 2, -10)))
        scene = seen((5, 20, 5), floor(50), through, **view, size=(18, 12), wide=18 * step)
        yield Hard("wall through a floor seen at a low angle", scene, 1, (16, 64, 256))
    # It divides nothing of the wall before it, whose light rises along it.
    hidden, before = ball((-78.54, -49.34, -99.11), 95), wall(9, 0, shader=gloss(0.1, 200))
    scene = seen((0.5, -0.4, 3), before, hidden, eye=(0, 0, 3), size=(24, 16), wide=0.4)
    yield Hard("outline of a hidden ball", scene, numbers=(4, 16))


def shadows() -> Iterator[Hard]:
    """Where light ends."""
    # Their edges are straight, but not on a ball of a few pixels, or on one that hardly bends; and
    # the plane that touches a ball in a pixel's middle is far from it in the corners.
    lens = {"eye": (0, 1.4, 8), "ahead": (0, -0.1, -1), "proj_distance": 4, "wide": 3}
    above = red(box((0.933, 1.304, 0.797), (1.35, 1.746, 1.072)))
    below = box((-9, -1.55, -9), (9, -0.55, 9))
    scene = seen((3.04, 4.625, 2.95), Sphere(radius=0.55), above, below, **lens)
    yield Hard("box over a small ball", scene, numbers=(64,))
    lens = {"eye": (0, 0, 10), "proj_distance": 10, "wide": 3, "size": (24, 24)}
    scene = seen((3, 4, 5), Sphere(), box((0.9, 1.2, 1.5), (1.5, 1.8, 2.1)), **lens)
    yield Hard("box over a ball", scene, numbers=(64, 256))
    tall = {"eye": (1.934, -0.955, -4.511), "ahead": (-0.3868, 0.191, 0.9022), "size": (16, 24),
            "view_up": (0.3754, -0.5468, 0.7484), "wide": 0.0296, "high": 0.6667}  # fmt: skip
    plate = box((-1.401, -1.014, -1.69), (-0.496, 0.099, -1.105))
    under = ball((0.7515, -0.7091, -1.1605), 0.4899)
    scene = seen((-4.0502, 1.5368, -2.4968), plate, under, **tall)
    yield Hard("box over a ball in tall pixels", scene, numbers=(64, 256))
    # Light and shaded points are both so near to the plate that one a pixel larger holds both.
    plate = box((-1, 0, -4.02), (1, 0.5, -4))
    scene = seen((0, 0.2, -4.1), floor(9), plate, eye=(0, 0.3, 0), size=(41, 41))
    yield Hard("lamp behind a plate", scene, 2)
    # Points on one of the two are outside of the other as soon as that is a little smaller.
    plate = red(box((-0.7, -0.5, -2.5), (0.4, 0.8, -2.4)))
    scene = seen((2, 1.5, 1), *[Sphere(radius=6)] * 2, plate, eye=(0, 0, 4), size=(36, 36))
    yield Hard("hollow ball that is there twice", scene, 2)
    # Seen so nearly edge-on that a pixel sees as much of the floor as is before it.
    for slope, pixel in ((5e-4, 1e-4), (1e-4, 1e-5), (1e-5, 1e-6)):
        view = {"eye": (0, 100 * slope, 0), "ahead": (0.72 * pixel, -slope - 0.4 * pixel, -1)}
        ground, bar = (
            box((-1e3, -5, -1e3), (1e3, 0, 1e3)),
            red(box((-300, 150, -103), (300, 160, -100))),
        )
        scene = seen((3, 2000, -101), ground, bar, **view, size=(24, 16), wide=24 * pixel)
        yield Hard("shadow far away on a floor", scene)
    # It is wider than they are: what is nearest to a pixel's centre does not cross the pixel.
    for *at, light in (
        ((0.0605, 0.9, -5.6067), 0.456, (6.7206, 9, -4.3108)),
        ((0.0275, 0.9, -3.9131), 0.332, (5.8868, 9, 2.4878)),
    ):
        scene = seen(light, floor(1e3), red(ball(*at)), eye=(0, 0.5, 0), wide=0.7)
        yield Hard("shadow less deep than its pixels", scene, 2)
    # Pixels see long, narrow parts of the floor, across which a ball's shadow bends back: at its
    # near side, and at its tip.
    for up, ahead, wide, *at, light in (
        (0.4908, (0.2594, -0.063, -0.998), 0.222,
         (2.2266, 1.1065, -8.1563), 0.7377, (13.456, 10.215, -9.003)),
        (1, (0.047, -1.047, -11.276), 0.3056,
         (3.2015, 4.3799, -10.1688), 0.7602, (14.979, 20.492, -6.096)),
    ):  # fmt: skip
        view = {"eye": (0, up, 0), "ahead": ahead, "size": (37, 25), "wide": wide}
        scene = seen(light, floor(1e3), red(ball(*at)), **view)
        yield Hard("shadow that leaves a pixel beside where it enters", scene, 2, FEW)
    view = {"eye": (0, 0.31, 0), "ahead": (0, -0.034, -1), "size": (24, 16), "wide": 0.65}
    bar = box((-3.3, 2.7, -45.5), (9.4, 6.6, -30.3))
    scene = seen((-360, 295, 131), floor(6e4), bar, **view)
    yield Hard("shadow on the far part of what a pixel sees", scene, 2, (64, 256))
    # Its tangent plane there divides what it lights from what the ball shades: on the wall.
    view = {"eye": (6, 1.02, 5), "ahead": (-3, 0, -8), "size": (24, 16), "wide": 0.6}
    scene = seen((0, 1, 0), wall(9, -3), Sphere(shader=RED), **view)
    yield Hard("light on a ball", scene, numbers=FEW)
    # Where its shadow divides a pixel, a sample for one side may fall onto the wire.
    for up, roll in ((-0.081, 0.0133), (-0.012, 0.0164), (0.09, 0.0)):
        wire = red(box((-0.2, up - 0.0012, -1), (0.9, up + 0.0012, -0.994)))
        back = wall(9, -1.02, shader=Lambertian(diffuse=(0.3,) * 3))
        scene = seen((0, 1.5, 1), wire, back, size=(32, 32), view_up=(roll, 1, 0))
        yield Hard("wire between rows of samples", scene, 1, (9, 16, 64))
    # So far away that a ray to it and the scene's own lengths share no digits.
    plate = box((-0.6, 0.5, -0.5), (0.5, 1.1, 0.7))
    view = {"eye": (1, 3, 6), "ahead": (-0.2, -0.5, -1), "view_up": (0.1, 1, 0)}
    scene = seen((4.2e19, 7.1e19, 5.7e19), floor(20), plate, **view, size=(32, 24), wide=0.8)
    yield Hard("shadow of a distant sun", scene)
    # By a hundredth of a pixel, all along it: two lines, however near each other.
    plate, up = box((-0.3, -0.3, -2), (0.3, 0.3, -1.9)), {"view_up": (0.3, 1, 0)}
    scene = seen((0.004, 0.004, 0), plate, wall(9, -2.5), **up, size=(24, 24))
    yield Hard("shadow right behind an outline", scene, numbers=(16, 64, 256))
    # Both sides of the shadow lie in a pixel, far from where its middle is.
    view = {"eye": (0, 37, 62), "ahead": (0, -0.51, -0.86), "size": (24, 16)}
    small = red(ball((3.9, 2.7, 11), 0.37))
    scene = seen((-34, 12.4, -7.9), floor(1e4), small, **view, wide=0.7, high=0.47)
    yield Hard("shadow of a ball smaller than its pixel", scene)


def light() -> Iterator[Hard]:
    """How light varies over a surface."""
    # Within a pixel beside the horizon the floor comes nearer to the light, and leaves it again.
    view = {"eye": (0, 0.5, 3), "ahead": (0, -0.03, -1), "wide": 0.7}
    yield Hard("floor to the horizon", seen((1, 1, -6), floor(1e3), **view), 2)
    # On the near side of the horizon's line light falls from nearly all to nothing.  Or the line
    # passes so near to pixels' centres that the floor's lower edges there may count for it.
    for up in (0.009, 0, -2e-5):
        view = {"eye": (0, 1.4, 0), "ahead": (0, up, -1), "proj_normal": (0, 0, 1), "wide": 0.4}
        scene = seen((-100, 210, -160), floor(3e4), **view, size=(18, 13))
        yield Hard("light that falls off towards a horizon", scene, 2, FEW)
    # A terminator of many dim lights: none of them alone shows.
    lens = {"eye": (0, 0, 10), "proj_distance": 10, "size": (18, 12), "wide": 6.3}
    dim = [PointLight(position=(9, 5, -1.5), intensity=(1 / 300,) * 3)] * 300
    yield Hard("dim lights", seen(dim, red(ball((0.1, 0.1, 0), 1)), **lens), numbers=FEW)
    # No neighbour sees the ball, and its pixel's quarters do not all see it under the light.
    lens = {**lens, "size": (9, 6), "wide": 9}
    scene = seen((1.4, 1.5, 5.5), red(ball((-0.35, -0.29, 0), 0.65)), **lens)
    yield Hard("light on a ball as wide as a pixel", scene, numbers=(64, 256))
    # No edge at all: the light alone changes, in a highlight, within a pixel.
    glossy = Sphere(shader=gloss(0.4, 50))
    scene = seen((1, 2, 5), glossy, eye=(0, 0, 3), wide=0.54)
    yield Hard("smooth surface in large pixels", scene, 2)
    # A highlight bends from row to row, and no row beside it says how.
    strip = box((-9, -7 / 82, -1), (9, 7 / 82, 0), shader=gloss(0.1, 34))
    scene = seen((0, 0, 1), strip, eye=(0, 0, 1), size=(24, 13), wide=0.2, high=2)
    yield Hard("surface one pixel high", scene)
    # One or two pixels below the horizon light does not depend on the distance from it alone.
    view = {"eye": (0, 0.293, 0), "ahead": (0, -0.0724, -1), "size": (24, 16), "wide": 1.375}
    planet = ball((0, -1115, 0), 1115, shader=gloss(0.5, 5))
    yield Hard("glitter below the horizon", seen((-4, 0.298, -57.6), planet, **view))


def pictures() -> Iterator[Any]:
    """All of them; of those alike, one is quick."""
    names: set[str] = set()
    for each in (*outlines(), *shadows(), *light()):
        slow = [pytest.mark.slow] * (each.name in names)
        names.add(each.name)
        yield pytest.param(each, marks=slow, id=each.name)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("picture", [*pictures()])
def test_hard_pictures_are_no_worse_than_the_uniform_grid(picture):
    no_worse_than_the_uniform_grid(picture.scene, picture.times, picture.numbers)


def exact() -> Iterator[Any]:
    """Pictures, numbers of samples, and the largest error that they may leave."""
    # The corner of a wall: both edges divide the pixel that holds it, however few the samples.
    scene = from_afar(box((-9, -9, -1), (0.3, 0.17, 0)), view_up=(0.3, 1, 0))
    yield from ((scene, samples, 3e-4) for samples in (4, 16))
    # A spot of some 0.03 around (0.15, 0.1), in pixels of 1/4.
    yield from_afar(Sphere(shader=gloss(0, 2000)), light=(0.3, 0.2, 100)), 64, 2e-4
    # A wall that leans out of another: no edge of either, but a straight line between them.
    view = {"eye": (6, 0, 8), "ahead": (-6, 0, -8), "view_up": (0.3, 1, 0), "size": (9, 9)}
    back, side = box((-9, -9, -9), (0.3, 9, 0)), red(box((-9, -9, -9), (9, 9, -1)))
    yield seen((40, 0, 30), back, side, **view, wide=0.2), 16, 5e-4
    # The pixel's middle lies in the shadow of the plate, its narrow highlight beside it.
    at = -2.5 + 2.5 * 3 / 11
    view = {"eye": (-2.5, 0, 3), "ahead": (at + 2.5, 0, -3), "size": (12, 8), "wide": 1 / 3}
    for aside in (-0.01, 0.01, 0.02):
        plate = box((-3, -3, 4), ((at + aside) / 2, 3, 4.01))
        yield seen((0, 0, 8), wall(9, 0, shader=gloss(0.2, 1e5)), plate, **view), 64, 2e-3
    # Light falls off towards the silhouette, also in parts of pixels whose middles see past the
    # ball, for the lamp is at the eye.
    view = {"eye": (2, 1, 4), "ahead": (-2, 0, -4), "size": (24, 16), "wide": 0.5}
    yield seen((2, 1, 4), ball((-0.5, 1, 0.5), 0.5), **view), 256, 4e-4
    # A highlight narrower than a pixel, of a light much nearer than the eye: directions to it turn
    # within a pixel.
    view = {"eye": (0, 5, 0), "ahead": (0, -1, 0), "view_up": (0, 0, -1), "proj_distance": 5}
    for right in (0.004, 0.009):
        mirror = floor(9, shader=gloss(0, 1e4))
        yield seen((right, 0.2, 0.007), mirror, **view, size=(12, 12), wide=0.36), 64, 2e-4


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize(("scene", "samples", "errs"), [*exact()])
def test_nearly_exact(scene, samples, errs):
    truth = true_picture(scene, 1 / 16384)
    assert truth.image.max() > 50 * errs
    assert np.abs(render(scene, samples) - truth.image).max() <= errs
    assert truth.error.max() <= errs


def test_more_lights_than_bits(monkeypatch):
    # A key says what a pixel sees, and which lights reach it: the first of them counts, too.
    keys = noted(monkeypatch, antialias, "curvature", lambda _, key, width: key)
    first, *others = [PointLight(position=(3, 5, 4), intensity=(1 / 66,) * 3)] * 66
    lights = [first, *(replace(each, position=(0, 0, 0)) for each in others)]
    scene = seen(lights, wall(60, -5), red(ball((0, 0, -4), 1.2)), size=(9, 9))
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))
    # The wall and the ball, each in its light and out of it.
    assert np.unique(np.concatenate(keys)).size == 4
