"""All that decides which pairs to test: what it leaves out, and that this changes nothing."""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain, pairwise, product
from time import process_time, sleep
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import Vector, record_calls, scene_of
from random_scenes import FEW_OBJECTS, random_scene, scenes
from scene_files import hard_scenes

from reference.measured.workloads import crowd
from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, render
from tracer.antialias.lattice import CENTRES
from tracer.arrays import Bools, Floats, Ints
from tracer.geometry.camera import ScreenBounds, camera_frame
from tracer.geometry.sphere import Spheres
from tracer.trace import radiance as radiance_module
from tracer.trace.hits import Hits
from tracer.trace.radiance import radiance_at
from tracer.trace.samples import Scattered
from tracer.world import light_grid, prepared_scene
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights, PreparedScene, Shape


def brute_force(scene: Scene) -> Floats:
    """The picture (height, width, 3) of a scene, by every ray against every object.

    The shapes and their arithmetic are the same, so the picture must be so to the last bit.
    """
    with (
        patch("tracer.trace.samples.spans", _all_rows),
        patch("tracer.trace.radiance.occlusion", _all_occluders),
        patch.object(ScreenBounds, "in_picture", lambda bounds, _: np.full(bounds.top.size, True)),
        patch.object(
            ScreenBounds, "window", lambda *_: (slice(0, scene.height), slice(0, scene.width))
        ),
    ):
        return render(scene)


def _all_rows(
    shape: Shape, prepared: PreparedScene, rows: Floats, columns: tuple[float, float], **_: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Every object covers every row."""
    row, obj = np.indices((rows.size, shape.objects.size)).reshape(2, -1)
    left, right = np.full((row.size, 2), columns).T
    return obj + shape.objects.start, row, left, right


@np.errstate(all="ignore")
def _all_occluders(hits: Hits, lights: Lights, frontlit: Bools) -> Bools:
    """See `occlusion`: every object may come between."""
    blocked, own, prepared = np.zeros_like(frontlit), hits.hit_object, hits.prepared
    for light, lit, dark in zip(lights.position, frontlit, blocked, strict=True):
        for shape in prepared.shapes:
            for obj in shape.objects.indices():
                at = np.flatnonzero(lit & ~dark & (own != obj))
                end = tuple(np.full((3, at.size), light[:, None]))
                every, p = np.full(at.size, obj), hits.points(at)
                dark[at] = shape.occludes(every, p, end, shape.side(every, end))
    return blocked


def assert_same(scene: Scene) -> None:
    """Hold the tracer's picture against that of all pairs.

    Made in all ways that there are: with large packets, single points and short packets; samples
    in rows, and scattered.
    """
    expected = brute_force(scene)
    for part in (1e9, 1e-9, 0.2):
        with patch("tracer.world.prepared_scene._PACKET_SCALE", part):
            np.testing.assert_array_equal(render(scene), expected)
            np.testing.assert_array_equal(scattered(scene), expected)


@np.errstate(all="ignore")
def scattered(scene: Scene) -> Floats:
    """A picture from samples that are scattered in pixels up to eight times as large."""
    # Powers of two change no bit of a ray.
    times = math.gcd(scene.width, scene.height, 8)
    width, height = scene.width // times, scene.height // times
    coarse = replace(scene, width=width, height=height)
    prepared = PreparedScene(coarse)
    x, y = ((0.5 + np.arange(n)) / times for n in (scene.width, scene.height))
    samples, order = Scattered.from_positions(np.tile(x, y.size), np.repeat(y, x.size))
    radiance = np.empty((3, order.size))
    radiance[:, order] = radiance_at(prepared, samples)
    return np.moveaxis(radiance.reshape(3, y.size, x.size), 0, 2)


@settings(max_examples=3 * settings.default.max_examples)
@given(scenes(FEW_OBJECTS, st.just(23), st.just(31)))
def test_culling_changes_no_random_scene(scene):
    assert_same(scene)


def test_culling_changes_no_crowd():
    assert_same(random_scene("crowd", 0, 23, 31))


@pytest.mark.parametrize("hard", hard_scenes("culling"))
def test_culling_changes_no_hard_scene(hard):
    assert_same(hard.scene)


@pytest.mark.slow
@settings(max_examples=3 * settings.default.max_examples)
@given(scenes(FEW_OBJECTS, st.integers(2, 200), st.integers(1, 100)), st.integers(0, 5))
def test_culling_changes_no_scene_however_large(scene, zooms):
    assert_same(scene)
    for _ in range(zooms):
        # On the first pixel that differs most from its neighbour: an outline or the edge of a
        # shadow, in the end 10^6 times as large.
        jumps = np.abs(np.diff(render(scene).sum(axis=2), axis=1))
        row, column = np.unravel_index(jumps.argmax(), jumps.shape)
        frame = camera_frame(scene.camera, scene.width, scene.height)
        x, y = np.array([column + 1.0]), np.array([row + 0.5])
        local = np.array([frame.across(x)[0], frame.down(y)[0], frame.depth])
        camera = replace(
            scene.camera,
            view_dir=local @ frame.axes,
            proj_normal=scene.camera.normal,
            proj_distance=math.hypot(*local),
            view_width=scene.camera.view_width / 16,
            view_height=scene.camera.view_height / 16,
        )
        scene = replace(scene, camera=camera)
        assert_same(scene)


CAMERA = Camera(view_point=(0, 1, 6), view_dir=(0, -0.125, -1), view_width=1.5, view_height=1.5)
FLOOR = Box(min_pt=(-8, -1, -8), max_pt=(8, 0, 8), shader=Lambertian(diffuse=(1, 0.5, 0.25)))
BALL = Sphere(center=(0, 1, 0))
CUBE = Box(min_pt=(-1, 0, -1), max_pt=(1, 2, 1))
DOWN = (0, -1, 0)


def seen(*surfaces, light=(3, 5, 4), camera=CAMERA, size=(120, 120)) -> Scene:
    return scene_of(*surfaces, camera=camera, size=size, lights=light)


def odd_sizes() -> Iterator[tuple[str, Scene]]:
    """Thin, tiny and enormous things; and none."""
    hairs = {
        "needle": Box(min_pt=(-2, 1, -1), max_pt=(2, 1, -1)),
        "point": Box(min_pt=(0, 1, 0), max_pt=(0, 1, 0)),
        "sheet": Box(min_pt=(-1, 1, -1), max_pt=(1, 1, 1)),
        "plate": Box(min_pt=(-1, 1, -1), max_pt=(1, 1 + 1e-12, 1)),
        "dust": Sphere(center=(0, 1, 0), radius=1e-12),
        "bead": Sphere(center=(0, 1, 0), radius=0.004),
        "planet": Sphere(center=(0, -(2.0**30), 0), radius=2.0**30 + 0.5),
        "sky": Box(min_pt=(-1e9, 4, -1e9), max_pt=(1e9, 1e9, 1e9)),
        # So large that the light and all points count as on its faces.
        "ceiling": Box(min_pt=(-1e14, 4, -1e14), max_pt=(1e14, 4.5, 1e14)),
    }
    for (name, hair), light in product(hairs.items(), ((3, 5, 4), (0, 3, 0), (-2.5, 1, 0))):
        yield f"{name}, light at {light}", seen(FLOOR, BALL, hair, light=light)
        yield f"{name} first, light at {light}", seen(hair, FLOOR, light=light)
    # Straight up, the inverse of the direction to the light is infinite, or nearly so.
    for size in (1.0, 2.0**27, 2.0**60):
        floor = Box(min_pt=(-10 * size, -size, -10 * size), max_pt=(10 * size, 0, 10 * size))
        beam = Box(min_pt=(3 * size, 2 * size, -size), max_pt=(5 * size, 2.5 * size, size))
        camera = Camera(view_point=(0, 20 * size, 0), view_dir=DOWN, view_up=(0, 0, 1),
                        view_width=2)  # fmt: skip
        yield f"beam of {size}", seen(floor, beam, light=(0, 10 * size, 0), camera=camera)
    # The ends of an edge are seen in almost the same direction, along none of the camera's axes.
    eye = (3e7, 5e7, 8e7)
    camera = Camera(view_point=eye, view_dir=(-3, -5, -8), proj_normal=(1, 5, 6), proj_distance=1e8,
                    view_width=4, view_height=4)  # fmt: skip
    yield "far box through an oblique window", seen(CUBE, light=eye, camera=camera)
    # A carpet lies on it but for rounding; it is seen so large that balls around points are tiny.
    ground = Sphere(center=(0, -1e8, 0), radius=1e8)
    carpet = Box(min_pt=(-12, -1, -12), max_pt=(12, 1e-6, 12))
    camera = Camera(view_point=(0, 1, 0), view_dir=(-5, -1, 0), view_width=1e-8, view_height=1e-8)
    horizon = seen(ground, carpet, light=(1000, 2e-5, 0), camera=camera)
    yield "light at the horizon of an enormous ball", horizon
    # Seen from inside a ball, near its wall: an arc of more than half a circle, of which the ball
    # on the chord holds least.
    for eye, toward, other, light in (
        ((0.5, -0.72, 0.37), (-0.6, 0.4, -0.7), (-0.3, -0.4, 0.6), (0.3, -0.4, 0.3)),
        ((0.15, -0.85, -0.39), (-0.2, 0.5, 1.2), (0.5, -0.5, 0), (-0.4, 0.4, -0.4)),
    ):
        camera = Camera(view_point=eye, view_dir=toward, view_up=(0.3, 1, 0.2), view_width=12,
                        view_height=2)  # fmt: skip
        walled = seen(
            Sphere(), Sphere(center=other, radius=0.1), light=light, camera=camera, size=(30, 8)
        )
        yield f"arc, {other}", walled
    # In the plane of the eye and the box's upper edge: an exact tie, and the box is closed.
    camera = Camera(view_point=(-1, 1, 1), view_dir=(0, -1, -2), view_width=2, view_height=4 / 3)
    box = Box(min_pt=(-3, -1, 0), max_pt=(-2, 0.5, 1))
    yield "rays along an edge", seen(box, camera=camera, size=(29, 19), light=(3, 5, 0))
    # What shines up from a table is not inside it because 0.3 is less than 0.1 + 0.2.
    table = Box(min_pt=(-1, 0, -1), max_pt=(1, 0.1 + 0.2, 1))
    yield "light on a table", seen(table, Sphere(center=(0, 0.9, 0), radius=0.5), light=(0, 0.3, 0))
    # Of equal surfaces the first is seen, whether the larger or the smaller.
    floor, plate = (
        Box(min_pt=(-n, -1, -n), max_pt=(n, 0, n), shader=Lambertian(diffuse=(1, 0, 1 / n)))
        for n in (9, 1)
    )
    camera = Camera(view_point=(0, 8, 0), view_dir=DOWN, view_up=(0, 0, -1))
    for both in ((floor, plate), (plate, floor)):
        yield f"equal, {both[0].max_pt}", seen(*both, camera=camera, size=(24, 24))
    yield "no objects", seen()
    yield "no lights", replace(seen(FLOOR, BALL), lights=())


@pytest.mark.parametrize("scene", [pytest.param(scene, id=name) for name, scene in odd_sizes()])
def test_odd_scenes(scene):
    assert_same(scene)


def without_end() -> Iterator[tuple[str, Scene, Scene]]:
    """Floors and suns, each with one of usual size that looks the same."""
    # Its corners are so far away that, along the camera's axes, they do not tell the eye's height.
    camera = replace(CAMERA, view_point=(0, 1, 0), view_dir=(0.3, -0.2, -1))
    ball = Sphere(center=(0, 0.5, -3), radius=0.5)
    for size, thick in product((1e18, 1e30, 1e75), (0, 1)):
        endless, usual = (
            seen(Box(min_pt=(-end, -thick, -end), max_pt=(end, 0, end)), ball, camera=camera)
            for end in (size, 1e6)
        )
        yield f"floor of {size}, {thick} thick", endless, usual
    # Their own rounding, much larger than the scene, is none of the points that they light.
    some = (
        Box(min_pt=(-6, -1, -6), max_pt=(6, 0, 6)),
        Box(min_pt=(-1, 0, -1), max_pt=(0, 1, 0)),
        Box(min_pt=(0.5, 0, 0), max_pt=(1.1, 0.6, 0.6)),
        Sphere(center=(-1.5, 0.5, 1), radius=0.5),
        Sphere(center=(-0.5, 1.3, -0.5), radius=0.3),
    )
    camera = Camera(view_point=(3, 4, 8), view_dir=(-3, -4, -8))
    for far, toward in product((1e10, 1e13, 1e15, 1e20, 1e40), ((1, 2, 1.5), (1, 1, 0), (0, 1, 0))):
        sun, usual = (
            seen(*some, camera=camera, size=(40, 40), light=distance * np.array(toward))
            for distance in (far, 1e6)
        )
        yield f"sun at {far}, {toward}", sun, usual


@pytest.mark.parametrize(
    ("scene", "usual"), [pytest.param(*both, id=name) for name, *both in without_end()]
)
def test_floors_and_suns_without_end(scene, usual):
    assert_same(scene)
    np.testing.assert_allclose(render(scene), render(usual), rtol=0, atol=1e-5)


def test_many_plates_behind_each_other(monkeypatch):
    # They are taken a few rows at a time: memory is for pairs of samples and objects.
    plates = [Box(min_pt=(-9, -9, -k / 10 - 2), max_pt=(9, 9, -k / 10 - 2)) for k in range(60)]
    scene = scene_of(*plates, size=(40, 30), lights=(0, 2, 0))
    sizes = record_calls(
        monkeypatch, radiance_module, "nearest_hits", lambda _, samples: samples.size
    )
    monkeypatch.setattr(prepared_scene, "_MAX_SAMPLE_PAIRS", 40 * 30 * 8)
    assert np.array_equal(render(scene), brute_force(scene))
    assert 0 < max(sizes) <= 40 * 30 * 8 / 60


@np.errstate(all="ignore")
def test_runs_are_of_neighbours():
    # The balls hide parts of the floor's rows: what is left of a row is several runs.
    scene = crowd(200, width=80, height=45)
    prepared = PreparedScene(scene)
    hits = radiance_module.nearest_hits(prepared, CENTRES.samples(slice(0, 45), slice(0, 80)))
    for group in hits.groups:
        starts = np.append(0, group.run_length.cumsum())
        assert (group.run_length > 1).any()
        for start, stop in pairwise(starts):
            run = group.sample[start:stop]
            assert np.array_equal(run, np.arange(run[0], run[0] + run.size))
            assert run[0] // 80 == run[-1] // 80


def test_many_lights_are_taken_some_at_a_time(monkeypatch):
    scene = crowd(40, width=48, height=27)
    lights = [replace(scene.lights[k % 2], position=(6 - k, 8, 7)) for k in range(9)]
    scene = replace(scene, lights=lights)
    groups = record_calls(monkeypatch, LightGrid, "query", lambda grid, *_: grid.light.shape[1])
    monkeypatch.setattr(prepared_scene, "_MAX_LIGHTS", 9)
    whole = [render(scene, samples) for samples in (1, 16)]
    monkeypatch.setattr(prepared_scene, "_MAX_LIGHTS", 4)
    for kept in (0, 1 << 26):
        monkeypatch.setattr(prepared_scene, "_MAX_CACHED_BYTES", kept)
        for image, samples in zip(whole, (1, 16), strict=True):
            assert np.array_equal(render(scene, samples), image)
    assert {*groups} == {9, 4, 1}
    # Also where all lights together have been prepared before.
    prepared = PreparedScene(scene)
    sizes = [
        {len(m) for m in (part.grid.light[0], part.side)}
        for part in chain([prepared.lights()], prepared.light_batches)
    ]
    assert sizes == [{9}, {4}, {4}, {1}]


def test_threads_share_prepared_lights(monkeypatch):
    # Each preparation of lights takes so long that all threads ask for the same batch meanwhile.
    scene = crowd(40, width=48, height=27)
    positions = [(6.0 - k, 8.0, 7.0) for k in range(9)]
    scene = replace(scene, lights=[replace(scene.lights[0], position=p) for p in positions])
    alone, prepared, prepare = render(scene), PreparedScene(scene), PreparedScene.lights
    starts = []

    def prepare_slowly(prepared: PreparedScene, index: slice) -> Lights:
        starts.append(index.start)
        sleep(0.05)
        return prepare(prepared, index)

    def batches(_: object) -> list[Lights]:
        return [*prepared.light_batches]

    monkeypatch.setattr(PreparedScene, "lights", prepare_slowly)
    with ThreadPoolExecutor(4) as pool:
        all_batches = [*pool.map(batches, range(4))]
        assert starts == [0, 4, 8]
        for lights in zip(*all_batches, strict=True):
            assert all(each is lights[0] for each in lights)
        found = np.concatenate([lights.position for lights in all_batches[3]])
        np.testing.assert_array_equal(found, positions)
        # The same for a picture whose tiles threads render.
        for name in ("_MIN_TILE_SAMPLES", "_MIN_TILE_PIXELS"):
            monkeypatch.setattr(f"tracer.picture.render.{name}", 100)
        np.testing.assert_array_equal(render(scene, executor=pool), alone)


def test_a_hundred_equal_surfaces_take_no_longer_than_one():
    red, ball = (replace(BALL, shader=Lambertian(diffuse=(1, g, 0))) for g in (0, 1))
    images, seconds = [], []
    for some in (seen(FLOOR, red), seen(FLOOR, red, *[ball, FLOOR] * 100)):
        begin = process_time()
        images.append(render(some, 16))
        seconds.append(process_time() - begin)
    assert np.array_equal(*images)
    assert seconds[1] < 5 * seconds[0] + 0.5


def test_a_ball_that_touches_the_eye_from_behind_is_not_seen():
    camera = Camera(view_point=(0.1, 0.2, 0.3), view_width=3, view_height=3)
    wall = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -8))
    alone = render(seen(wall, light=(0.1, 5, 0), camera=camera))
    for radius in (0.1, 0.2, 0.3, 0.7, 1.1):
        ball = Sphere(center=(0.1, 0.2, 0.3 + radius), radius=radius)
        assert np.array_equal(render(seen(wall, ball, light=(0.1, 5, 0), camera=camera)), alone)


def sizes_found(monkeypatch: pytest.MonkeyPatch, owner: object, name: str) -> list[int]:
    """How many pairs or cells a search of the grid finds at once."""
    sizes, real = [], getattr(owner, name)

    def record_calls(*arguments):
        for found in real(*arguments):
            sizes.append(found[0].size)
            yield found

    monkeypatch.setattr(owner, name, record_calls)
    return sizes


def balls_under(light: Vector, count: int, radius: float, *others: Sphere) -> Scene:
    """Balls side by side."""
    rng = np.random.default_rng(1)
    balls = [Sphere(center=c, radius=radius) for c in rng.uniform(-1, 1, (count, 3)).tolist()]
    camera = Camera(view_point=(0, 0, 9), proj_distance=4)
    return scene_of(*balls, *others, camera=camera, size=(60, 60), lights=light)


@pytest.mark.parametrize(
    ("far", "ground"),
    [*((10.0**k, 1.0) for k in (7, 9, 11, 13, 20, 40)), (1e9, 6.4e6), (1.5e11, 6.4e6)],
)
def test_suns_and_planets_cost_no_more(far, ground, monkeypatch):
    light = (0.3 * far, 0.8 * far, 0.5 * far)
    planet = Sphere(center=(0, -ground - 1, 0), radius=ground)
    sizes = sizes_found(monkeypatch, LightGrid, "query")
    render(balls_under(light, 1000, 0.02, planet))
    assert 0 < sum(sizes) < 5 * 60 * 60


def test_candidates_are_found_some_at_a_time(monkeypatch):
    # A crowd in one cell of the light's, and a ground from which ways to it are in many: memory is
    # not for all pairs at once.
    scene = balls_under((0.1, 3, 0.2), 300, 0.1, Sphere(center=(0, -1e6, 0), radius=1e6 - 1))
    whole = render(scene, 16)
    visited = sizes_found(monkeypatch, light_grid, "_overlapped_cells")
    sizes = sizes_found(monkeypatch, LightGrid, "query")
    monkeypatch.setattr(light_grid, "_PAIRS_PER_BATCH", 1000)
    monkeypatch.setattr(light_grid, "_CELLS_PER_BATCH", 1000)
    np.testing.assert_array_equal(render(scene, 16), whole)
    for some in (sizes, visited):
        assert 100 < max(some) <= 1000 < sum(some)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("up", [1e-75, 1e-60, 1.0])
@pytest.mark.parametrize("high", [1e-75, 1e-60, 0.5])
def test_no_packet_is_without_end(up, high, monkeypatch):
    # At the limits of the format a pixel sees a floor over 1e150 times its own width; cells of the
    # grid that such packets reach would be no numbers if they were infinite.
    radii = record_calls(monkeypatch, LightGrid, "query", lambda _, middle, radius, *rest: radius)
    floor, far = Box(min_pt=(-1e75, -1, -1e75), max_pt=(1e75, 0, 1e75)), (0, 1e75, -9e74)
    ball = Sphere(center=(0, 0.5, -3), radius=0.5)
    camera = Camera(view_point=(0, up, 0), view_width=1, view_height=high)
    lights = [PointLight(position=position) for position in (far, (3, 5, 4))]
    render(scene_of(floor, ball, camera=camera, size=(9, 8), lights=lights), 16)
    assert np.isfinite(np.concatenate(radii)).all()


@pytest.mark.usefixtures("pixels_are_split")
def test_what_is_seen_towards_a_horizon_costs_no_more_than_elsewhere(monkeypatch):
    # What a pixel sees there is larger than all else: every object may shade some of it.
    # 0.8 tests a pixel; where layers of depth are octaves 5, without layers 20.
    rng = np.random.default_rng(0)
    floor = Box(min_pt=(-1e6, -1, -1e6), max_pt=(1e6, 0, 1e6))
    at = rng.uniform((-20, -60), (20, -2), (200, 2)).tolist()
    balls = [Sphere(center=(x, 0.1, z), radius=0.1) for x, z in at]
    camera = Camera(view_point=(0, 1, 5), view_dir=(0, -0.1, -1))
    scene = scene_of(floor, *balls, camera=camera, size=(64, 64), lights=(30, 40, 20))
    tried = record_calls(monkeypatch, Spheres, "occludes", lambda _, owner, *rest: owner.size)
    render(scene, samples=4)
    assert 0 < sum(tried) < 64 * 64
