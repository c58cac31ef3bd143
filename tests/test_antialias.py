"""Many samples a pixel: as good as a uniform grid, wherever it would have looked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from random_scenes import KINDS, random_scene

from reference.workloads import crowd
from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    Sphere,
    antialias,
    load_scene,
    render,
    shadow,
)
from tracer.arrays import Bools, Floats
from tracer.intersection import INSIDE
from tracer.occluders import Candidates, Occluders, candidates_by_kind
from tracer.rendering import render_bands
from tracer.sampling import Lattice
from tracer.shadow import Shadows
from tracer.shadow_cache import ShadowCache, ShadowEdges
from tracer.visibility import Hits

SCENES = sorted((Path(__file__).parent.parent / "scenes").glob("*.xml"))


def uniform(scene: Scene, per_side: int) -> Floats:
    """The mean of a grid of samples in every pixel: a picture as many times as large."""
    width, height = per_side * scene.width, per_side * scene.height
    # A few of its rows at a time.
    rows = per_side * max(1, 50_000 // (per_side * width))
    fine = replace(scene, width=width, height=height)
    bands = render_bands(fine, threads=1, band_pixels=rows * width)
    return np.concatenate(
        [b.reshape(-1, per_side, scene.width, per_side, 3).mean(axis=(1, 3)) for b in bands]
    )


def small(path: Path) -> Scene:
    """A scene of the project, some 100 pixels wide."""
    scene = load_scene(path)
    width = 96
    return Scene(
        camera=scene.camera,
        width=width,
        height=round(width * scene.height / scene.width),
        lights=scene.lights,
        surfaces=scene.surfaces,
    )


def no_worse_than_the_uniform_grid(
    scene: Scene, times: float = 1, numbers: tuple[int, ...] = (4, 16, 64, 256)
) -> None:
    """RMSE no larger, and the largest error no more than so many times as large."""
    converged = uniform(scene, 41)
    for samples in numbers:
        image, grid = render(scene, samples=samples), uniform(scene, math.isqrt(samples))
        rmse, grid_rmse = (np.sqrt(((x - converged) ** 2).mean()) for x in (image, grid))
        assert rmse <= grid_rmse + 1e-12, samples
        most, grid_most = (np.abs(x - converged).max() for x in (image, grid))
        assert most <= times * grid_most + 1e-12, samples


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_no_worse_than_the_uniform_grid(path: Path) -> None:
    no_worse_than_the_uniform_grid(small(path))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_splitting_pixels_is_no_worse_than_the_uniform_grid(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So small, some of them are so full of outlines that they would be made of lattices.
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    no_worse_than_the_uniform_grid(small(path))


@pytest.mark.parametrize("name", ["many-objects", "room", "two-boxes"])
def test_other_squares_than_powers_of_four(name: str) -> None:
    scene = small(SCENES[0].parent / f"{name}.xml")
    no_worse_than_the_uniform_grid(scene, numbers=(9, 25, 36, 49, 100))


WALL = Box(min_pt=(-60, -60, -6), max_pt=(60, 60, -5))
RED = Lambertian(diffuse=(1, 0, 0))


def test_a_small_object_beside_the_rim_before_a_wide_one() -> None:
    # All samples beside edges are far left, and the wall in their rows reaches far right.
    ball = Sphere(center=(-1.7, -0.3, -3.9), radius=0.1, shader=RED)
    lights = [PointLight(position=(0, 3, 4))]
    no_worse_than_the_uniform_grid(
        Scene(camera=Camera(), width=96, height=72, lights=lights, surfaces=[WALL, ball]), 2
    )


def test_the_shadow_of_a_box_on_a_small_ball(monkeypatch: pytest.MonkeyPatch) -> None:
    # Its edges are straight, but not on a ball of a few pixels.
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    ball = Sphere(center=(0, 0, 0), radius=0.55)
    box = Box(min_pt=(0.933, 1.304, 0.797), max_pt=(1.35, 1.746, 1.072), shader=RED)
    floor = Box(min_pt=(-9, -1.55, -9), max_pt=(9, -0.55, 9))
    camera = Camera(
        view_point=(0, 1.4, 8),
        view_dir=(0, -0.1, -1),
        proj_distance=4,
        view_width=3,
        view_height=2,
    )
    lights = [PointLight(position=(3.04, 4.625, 2.95))]
    scene = Scene(camera=camera, width=36, height=24, lights=lights, surfaces=[ball, box, floor])
    no_worse_than_the_uniform_grid(scene, numbers=(64,))


def test_surfaces_that_cross_within_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    no_worse_than_the_uniform_grid(random_scene("touching", 111, 36, 24), numbers=(64,))


def test_a_lamp_behind_a_plate() -> None:
    # Light and shaded points are both so near to the plate that one a pixel larger holds both.
    floor = Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9))
    plate = Box(min_pt=(-1, 0, -4.02), max_pt=(1, 0.5, -4))
    no_worse_than_the_uniform_grid(
        Scene(
            camera=Camera(view_point=(0, 0.3, 0)),
            width=41,
            height=41,
            lights=[PointLight(position=(0, 0.2, -4.1))],
            surfaces=[floor, plate],
        ),
        2,
    )


def test_shadows_on_a_hollow_ball_that_is_there_twice() -> None:
    # Points on one of the two are outside of the other as soon as that is a little smaller.
    hollow = Sphere(center=(0, 0, 0), radius=6)
    plate = Box(min_pt=(-0.7, -0.5, -2.5), max_pt=(0.4, 0.8, -2.4), shader=RED)
    no_worse_than_the_uniform_grid(
        Scene(
            camera=Camera(view_point=(0, 0, 4)),
            width=36,
            height=36,
            lights=[PointLight(position=(2, 1.5, 1))],
            surfaces=[hollow, hollow, plate],
        ),
        2,
    )


def low_over(*surfaces: Sphere | Box, height: float, light: tuple[float, float, float]) -> Scene:
    """The eye so high over the origin's level, and looking a little down."""
    camera = Camera(
        view_point=(0, height, 3),
        view_dir=(0, -0.03, -1),
        view_width=0.7,
        view_height=0.7 * 2 / 3,
    )
    lights = [PointLight(position=light)]
    return Scene(camera=camera, width=36, height=24, lights=lights, surfaces=surfaces)


def test_a_floor_to_the_horizon() -> None:
    # Within a pixel beside the horizon the floor comes nearer to the light, and leaves it again.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    no_worse_than_the_uniform_grid(low_over(floor, height=0.5, light=(1, 1, -6)), 2)


def test_a_shadow_seen_nearly_edge_on() -> None:
    # Both sides of a long shadow in one pixel, and most of what lies before and behind it.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    ball = Sphere(center=(0, 0.6, -16), radius=0.6, shader=RED)
    no_worse_than_the_uniform_grid(low_over(floor, ball, height=0.5, light=(-20, 5, -14)), 2)


@pytest.mark.parametrize(
    ("ball", "radius", "light"),
    [
        ((0.0605, 0.9, -5.6067), 0.456, (6.7206, 9, -4.3108)),
        ((0.0275, 0.9, -3.9131), 0.332, (5.8868, 9, 2.4878)),
    ],
)
def test_a_shadow_less_deep_than_its_pixels(
    ball: tuple[float, float, float], radius: float, light: tuple[float, float, float]
) -> None:
    # It is wider than they are: what is nearest to a pixel's centre does not cross the pixel.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    camera = Camera(view_point=(0, 0.5, 0), view_width=0.7, view_height=0.7 * 2 / 3)
    no_worse_than_the_uniform_grid(
        Scene(
            camera=camera,
            width=36,
            height=24,
            lights=[PointLight(position=light)],
            surfaces=[floor, Sphere(center=ball, radius=radius, shader=RED)],
        ),
        2,
    )


@pytest.mark.parametrize(("radius", "height"), [(20, 0.2), (400, 0.2), (2000, 0.5)])
def test_the_limb_of_the_ball_that_the_eye_is_next_to(radius: float, height: float) -> None:
    ground = Sphere(center=(0, -radius, 0), radius=radius)
    no_worse_than_the_uniform_grid(low_over(ground, height=height, light=(5, 9, 5)), 2)


@pytest.mark.parametrize("radius", [1e4, 6.4e6, 1e8])
@pytest.mark.parametrize("up", [0, 0.02, -0.02])
def test_the_horizon_of_a_planet(radius: float, up: float) -> None:
    # Rays to its horizon are at right angles to the way to its centre, or nearly.
    planet = Sphere(center=(0, -radius, 0), radius=radius)
    camera = Camera(view_point=(0, 2, 0), view_dir=(0, up, -1))
    scene = Scene(
        camera=camera,
        width=18,
        height=13,
        lights=[PointLight(position=(0, 1e3, -50))],
        surfaces=[planet],
    )
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))


def test_light_that_falls_off_towards_a_horizon() -> None:
    # On the near side of the horizon's line light falls from nearly all to nothing.
    camera = Camera(
        view_point=(0, 1.4, 0), view_dir=(0, 0.009, -1), proj_normal=(0, 0, 1), view_width=0.4
    )
    scene = Scene(
        camera=replace(camera, view_height=0.4 * 13 / 18),
        width=18,
        height=13,
        lights=[PointLight(position=(-100, 210, -160))],
        surfaces=[Box(min_pt=(-3e4, -1, -3e4), max_pt=(3e4, 0, 3e4))],
    )
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))


def test_a_shadow_on_the_far_part_of_what_a_pixel_sees() -> None:
    camera = Camera(
        view_point=(0, 0.31, 0), view_dir=(0, -0.034, -1), view_width=0.65, view_height=1.3 / 3
    )
    floor = Box(min_pt=(-6e4, -1, -6e4), max_pt=(6e4, 0, 6e4))
    out_of_sight = Box(min_pt=(-3.3, 2.7, -45.5), max_pt=(9.4, 6.6, -30.3))
    lights = [PointLight(position=(-360, 295, 131))]
    scene = Scene(camera=camera, width=24, height=16, lights=lights, surfaces=[floor, out_of_sight])
    no_worse_than_the_uniform_grid(scene, 2, numbers=(64, 256))


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_a_box_through_a_long_lens(distance: float) -> None:
    ahead = np.array([2.0, -3.0, 6.0]) / 7
    x, y, z = (-ahead * distance).tolist()
    camera = Camera(
        view_point=(x, y, z),
        view_dir=(2, -3, 6),
        proj_distance=distance,
        view_width=3,
        view_height=2,
    )
    box = Box(min_pt=(-0.5, -0.5, -0.5), max_pt=(0.5, 0.5, 0.5))
    lights = [PointLight(position=(-0.14, 3.7, -3.4))]
    scene = Scene(camera=camera, width=36, height=24, lights=lights, surfaces=[box])
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


def test_the_ends_of_a_thin_rod_far_away() -> None:
    camera = Camera(view_point=(0, 0, 1e4), proj_distance=1e4, view_width=0.03, view_height=0.02)
    rod = Box(min_pt=(-3, -0.0041, -0.01), max_pt=(0.0007, 0.0041, 0.01))
    lights = [PointLight(position=(3, 4, 9))]
    scene = Scene(camera=camera, width=36, height=24, lights=lights, surfaces=[rod])
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


@pytest.mark.parametrize("few", [True, False])
def test_a_light_on_a_ball(few: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # Its tangent plane there divides what it lights from what the ball shades: on the wall.
    if not few:
        monkeypatch.setattr(shadow, "_FEW", -1)
        monkeypatch.setattr(shadow, "_MOST", -1)
    wall = Box(min_pt=(-9, -9, -4), max_pt=(9, 9, -3))
    camera = Camera(
        view_point=(6, 1.02, 5),
        view_dir=(-3, 0, -8),
        proj_normal=(-3, 0, -8),
        view_width=0.6,
        view_height=0.4,
    )
    lights = [PointLight(position=(0, 1, 0))]
    scene = Scene(
        camera=camera, width=24, height=16, lights=lights, surfaces=[wall, Sphere(shader=RED)]
    )
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


@pytest.mark.parametrize("part", [0.1, 0.3, 0.7])
def test_a_wall_through_a_floor_seen_at_a_low_angle(part: float) -> None:
    # Its foot is so much of a pixel below the top of a row; behind it the floor is far away.
    step = 0.1 / 18
    up = -0.01 + part * step
    camera = Camera(
        view_point=(0, 0.1, 0),
        view_dir=(0, up, -1),
        proj_normal=(0, 0, 1),
        proj_distance=math.hypot(1, up),
        view_width=0.1,
        view_height=0.2 / 3,
    )
    floor = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
    wall = Box(min_pt=(-3, -1, -11), max_pt=(3, 2, -10), shader=RED)
    lights = [PointLight(position=(5, 20, 5))]
    scene = Scene(camera=camera, width=18, height=12, lights=lights, surfaces=[floor, wall])
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64, 256))


@pytest.mark.parametrize("aside", [-0.01, 0.01, 0.02])
def test_a_narrow_highlight_beside_a_shadow(aside: float) -> None:
    # The pixel's middle lies in the shadow of the plate, its highlight beside it.
    at = -2.5 + 2.5 * 3 / 11
    gloss = Phong(diffuse=(0.2, 0.2, 0.2), specular=(1, 1, 1), exponent=1e5)
    floor = Box(min_pt=(-9, -9, -1), max_pt=(9, 9, 0), shader=gloss)
    plate = Box(min_pt=(-3, -3, 4), max_pt=((at + aside) / 2, 3, 4.01))
    camera = Camera(
        view_point=(-2.5, 0, 3), view_dir=(at + 2.5, 0, -3), view_width=1, view_height=2 / 3
    )
    lights = [PointLight(position=(0, 0, 8))]
    scene = Scene(camera=camera, width=36, height=24, lights=lights, surfaces=[floor, plate])
    assert np.abs(render(scene, samples=64) - uniform(scene, 129)).max() <= 0.002


def test_a_terminator_of_many_dim_lights() -> None:
    # None of them alone shows.
    lights = [PointLight(position=(9, 5, -1.5), intensity=(1 / 300,) * 3)] * 300
    camera = Camera(view_point=(0, 0, 10), proj_distance=10, view_width=6.3, view_height=4.2)
    ball = Sphere(center=(0.1, 0.1, 0))
    scene = Scene(camera=camera, width=18, height=12, lights=lights, surfaces=[ball])
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


def test_a_smooth_surface_in_large_pixels() -> None:
    # No edge at all: the light alone changes, in a highlight, within a pixel.
    camera = Camera(view_point=(0, 0, 3), view_width=0.54, view_height=0.36)
    ball = Sphere(shader=Phong(diffuse=(0.4, 0.4, 0.4), specular=(1, 1, 1), exponent=50))
    lights = [PointLight(position=(1, 2, 5))]
    no_worse_than_the_uniform_grid(
        Scene(camera=camera, width=36, height=24, lights=lights, surfaces=[ball]), 2
    )


def test_more_lights_than_bits() -> None:
    lights = [PointLight(position=(3, 5, 4), intensity=(1 / 80,) * 3)] * 80
    ball = Sphere(center=(0, 0, -4), radius=1.2, shader=RED)
    no_worse_than_the_uniform_grid(
        Scene(camera=Camera(), width=48, height=48, lights=lights, surfaces=[WALL, ball]), 2
    )


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_looked_at_is_as_dark_as_what_is_not(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks, edges = 0, Shadows.edges

    def compared(self: Shadows, hits: Hits, facing: Bools, footprint: Floats) -> Any:
        nonlocal looks
        looks += 1
        blocked, borders = edges(self, hits, facing, footprint)
        assert np.array_equal(blocked[facing], self.blocked(hits, facing)[facing])
        return blocked, borders

    monkeypatch.setattr(Shadows, "edges", compared)
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    for seed in range(6):
        render(random_scene(kind, seed, 60, 40), samples=16, threads=1)
    assert looks


class Everything(NamedTuple):
    """A `Finder` of all pairs of points and objects."""

    occluders: Occluders

    def candidates(
        self, hits: Hits, facing: Bools, _: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """See `Finder.candidates`."""
        own, points = hits.own, hits.points(slice(None))
        others = own[:, None] != np.arange(self.occluders.size.size)
        for light, asked in enumerate(facing):
            point, other = np.nonzero(asked[:, None] & others)
            yield from candidates_by_kind(
                self.occluders, own, points, point, light, other, footprint
            )


def listed(look: ShadowEdges) -> set[tuple[int, int, int]]:
    """Points, lights and objects."""
    return set(zip(look.point.tolist(), look.light.tolist(), look.occluder.tolist(), strict=True))


def may_shade(finder: Any, light: int, own: int, other: int) -> bool:
    """Whether an object may keep a light from some of another, as far as stretches know."""
    key = light * len(finder.occluders.size) + own
    return any(
        other in lists.listed[lists.first[key] : lists.first[key + 1]] for lists in finder.lists
    )


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "crowd"])
def test_looks_list_what_all_pairs_would(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    looks, edges = 0, Shadows.edges

    def compared(self: Shadows, hits: Hits, facing: Bools, footprint: Floats) -> Any:
        nonlocal looks
        blocked, look = edges(self, hits, facing, footprint)
        if hits.own.size:
            looks += 1
            every: Any = Everything(self.occluders)
            all_blocked, expected = edges(self._replace(finder=every), hits, facing, footprint)
            assert np.array_equal(blocked[facing], all_blocked[facing])
            assert np.array_equal(look.dark[facing], expected.dark[facing])
            assert listed(look) <= listed(expected)
            for point, light, other in listed(expected) - listed(look):
                # A ball or box around a light and all points shades none of them; and some objects
                # cannot shade what is seen of others.
                around = self.occluders.side[light, other] == INSIDE
                assert around or not may_shade(self.finder, light, hits.own[point], other)
        return blocked, look

    monkeypatch.setattr(Shadows, "edges", compared)
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    monkeypatch.setattr(shadow, "_FEW", 10**9)
    for seed in range(4):
        render(random_scene(kind, seed, 48, 32), samples=16, threads=1)
    assert looks


@pytest.mark.parametrize("kind", KINDS)
def test_what_looks_have_found_is_as_dark_as_what_they_have_not(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known, blocked = 0, Shadows.blocked

    def compared(self: Shadows, hits: Hits, facing: Bools) -> Bools:
        nonlocal known
        found = blocked(self, hits, facing)
        if isinstance(self.finder, ShadowCache):
            known += hits.own.size
            afresh = blocked(self._replace(finder=self.finder.finder), hits, facing)
            assert np.array_equal(found[facing], afresh[facing])
        return found

    monkeypatch.setattr(Shadows, "blocked", compared)
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    # Light buffers for all shadows: stretches remember nothing.
    monkeypatch.setattr(shadow, "_FEW", -1)
    monkeypatch.setattr(shadow, "_MOST", -1)
    for seed in range(6):
        render(random_scene(kind, seed, 48, 32), samples=16, threads=1)
    assert known


def test_pictures_full_of_outlines_are_lattices() -> None:
    scene = crowd(3000, width=96, height=54)
    offsets = zip(*Lattice.of(4).points(), strict=True)
    mean = np.mean([render(scene, offset=offset, threads=1) for offset in offsets], axis=0)
    assert np.abs(render(scene, samples=16) - mean).max() <= 1e-12


BALL = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))


def view(
    *surfaces: Sphere | Box, light: tuple[float, float, float] = (0, 0, 10), pixels: int = 16
) -> Scene:
    """So many pixels a side, all together of size 4 on the plane z = 0, seen from far away."""
    return Scene(
        camera=Camera(view_point=(0, 0, 100), proj_distance=100, view_width=4, view_height=4),
        width=pixels,
        height=pixels,
        lights=(PointLight(position=light),),
        surfaces=surfaces,  # type: ignore[arg-type]
    )


def test_one_sample_is_the_centre() -> None:
    # Of three by three pixels in the place of each, the middle one has the same centre.
    fine = render(view(BALL, pixels=48), samples=1)[1::3, 1::3]
    np.testing.assert_allclose(render(view(BALL), samples=1), fine, atol=1e-12)


def test_other_numbers_are_rounded_up_to_squares() -> None:
    scene = view(BALL)
    assert np.array_equal(render(scene, samples=5), render(scene, samples=9))


def test_bands_change_nothing() -> None:
    # Many spheres and boxes that shade each other, three rows at a time and all at once.
    scene = small(SCENES[0].parent / "many-objects.xml")
    bands = render_bands(scene, 16, band_pixels=3 * scene.width)
    bands = np.concatenate([band.copy() for band in bands])
    assert np.array_equal(bands, render(scene, samples=16))


def test_fewer_than_one() -> None:
    with pytest.raises(ValueError, match="samples must be at least 1, is 0"):
        render(view(BALL), samples=0)


@pytest.mark.parametrize(("radius", "samples"), [(0.02, 1024), (0.05, 256), (0.1, 256)])
def test_objects_between_pixel_centres(radius: float, samples: int) -> None:
    # Centred on a corner of four pixels: no pixel's centre, 1/8 away, sees it.
    scene = view(Sphere(center=(0.5, 0.5, 0), radius=radius))
    assert not render(scene).any()
    assert (render(scene, samples=256) > 0).any(axis=2).sum() == 4
    image = render(scene, samples=samples)
    # A Lambertian disc under a light from the front shines with 2/3 on average; its four
    # quarters are spread over pixels of area 1/16.
    assert image[..., 0].sum() / 16 == pytest.approx(2 / 3 * np.pi * radius**2, rel=0.05)


def test_straight_edges_are_exact() -> None:
    # One edge to a pixel, at a slope or upright: its share of the pixel is known in closed form.
    wall = Box(min_pt=(-9, -9, -1), max_pt=(0.3, 9, 0))
    image = render(view(wall, pixels=64), samples=16)
    # The eye is 100 away and the wall in the plane of the picture: 0.3 is 4/5 into column 36.
    assert image[:, 36] == pytest.approx(0.8 * image[:, 35], abs=0.01)


@pytest.mark.parametrize("height", [0.37, 0.8125])
def test_a_level_horizon_is_exact(height: float) -> None:
    # The edge of a floor that begins behind the eye, level to the last bit: the light is so
    # far above it that only the background is dark.
    floor = Box(min_pt=(-99, -2, -10), max_pt=(99, -1, 100))
    window = Camera(view_width=4, view_height=4, proj_distance=8)
    scene = replace(view(floor, light=(0, 1e6, 0), pixels=64), camera=window)
    # The eye is 1 over the floor, which ends 10 ahead: 0.8 below the eye on a window 8 ahead,
    # raised until so much of row 32, 1/16 high, is floor.
    up = (1 - height) / 16 - 0.8
    window = replace(window, view_dir=(0, up / 8, -1), proj_normal=(0, 0, 1))
    image = render(replace(scene, camera=window), samples=16)
    # On the slant the window is a little nearer than it is told to be.
    assert image[32] == pytest.approx(height * image[33], abs=0.02)


@pytest.mark.parametrize("occluder", ["sphere", "box"])
@pytest.mark.parametrize("receiver", ["plane", "ball"])
def test_shadows_between_pixel_centres(occluder: str, receiver: str) -> None:
    # An object halfway to the light throws a shadow twice its size around a pixel corner.
    at, size = (0.25, 0.25, 5.0), 0.02
    ground: Sphere | Box = Box(min_pt=(-9, -9, -1), max_pt=(9, 9, 0))
    if receiver == "ball":
        ground = Sphere(center=(0, 0, -50), radius=50)
    small_one: Sphere | Box = Sphere(center=at, radius=size)
    if occluder == "box":
        low, high = (tuple(x + sign * size for x in at) for sign in (-1, 1))
        small_one = Box(min_pt=low, max_pt=high)  # type: ignore[arg-type]
    with_it, without = view(ground, small_one), view(ground)
    darker = render(without, samples=64) - render(with_it, samples=64)
    shadow = darker[5:7, 9:11]  # around (0.5, 0.5), where the shadow falls
    # Each of the four pixels loses a quarter of the shadow: a disc of radius 0.04, or more.
    assert (shadow > 0.5 * (np.pi * 0.04**2 / 4) * 16).all()
    assert np.array_equal(render(without)[5:7, 9:11], render(with_it)[5:7, 9:11])


@pytest.mark.parametrize("name", ["one-sphere", "four-spheres"])
def test_limbs_and_terminators_are_nearly_exact(name: str) -> None:
    # Both are known in closed form, with how light falls off towards them.
    scene = small(SCENES[0].parent / f"{name}.xml")
    converged = uniform(scene, 41)
    rmse, grid_rmse = (
        np.sqrt(((image - converged) ** 2).mean())
        for image in (render(scene, samples=16), uniform(scene, 4))
    )
    assert rmse <= grid_rmse / 8


def test_where_two_boxes_meet_is_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(antialias, "_DENSE", math.inf)
    # A wall that leans out of another: no edge of either, but a straight line between them.
    back = Box(min_pt=(-9, -9, -9), max_pt=(0.3, 9, 0))
    side = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -1), shader=RED)
    camera = Camera(
        view_point=(6, 0, 8),
        view_dir=(-6, 0, -8),
        view_up=(0.3, 1, 0),
        view_width=0.2,
        view_height=0.2,
    )
    lights = [PointLight(position=(40, 0, 30))]
    scene = Scene(camera=camera, width=9, height=9, lights=lights, surfaces=[back, side])
    np.testing.assert_allclose(render(scene, samples=16), uniform(scene, 201), atol=5e-4)


def test_tip_of_one_object_in_another() -> None:
    # A ball that comes a little way through a slab: a cap smaller than a pixel, at a corner.
    red = Phong(diffuse=(1, 0, 0))
    slab = Box(min_pt=(-9, -9, -5), max_pt=(9, 9, 0))
    cap = Sphere(center=(0.5, 0.5, -0.9999), radius=1, shader=red)
    assert (render(view(slab, cap))[..., 1] > 0).all()
    less = render(view(slab), samples=4096) - render(view(slab, cap), samples=4096)
    # The cap's radius is sqrt(2 * 0.0001).
    assert (less[5:7, 9:11, 1] > 0.5 * (np.pi * 0.0002 / 4) * 16).all()


def test_narrow_highlight() -> None:
    # A spot of some 0.03 around (0.15, 0.1), in pixels of 1/4.
    ball = Sphere(shader=Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=2000))
    scene = view(ball, light=(0.3, 0.2, 100))
    grid = uniform(scene, 8)
    assert np.abs(render(scene, samples=64) - grid).max() <= 0.02 * grid.max()
