"""Culling: skipping objects that a ray or shadow segment cannot meet changes no picture.

Other tests count how many objects are tested, and how large batches are.
"""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise, product
from time import process_time, sleep
from typing import Annotated as Shaped
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import Vector, record_calls, scene_of
from random_scenes import FEW_OBJECTS, random_scene, scenes
from scene_files import HARD_SCENES, HardScene, hard_scenes

from reference.judges import plain
from reference.measured.workloads import build_crowd_scene
from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, load_scene, render
from tracer.antialias.lattice import PIXEL_CENTERS
from tracer.arrays import Bools, Floats
from tracer.geometry.camera import compute_frame
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.sphere import Spheres
from tracer.picture.parallel import WorkerPool
from tracer.picture.render_job import RenderJob
from tracer.trace import radiance as radiance_module
from tracer.trace.hits import Hits
from tracer.trace.radiance import compute_radiance
from tracer.trace.samples import ObjectSpans, Scattered
from tracer.world import cell_lists, prepared_scene
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights, PreparedScene, Shape


def render_by_brute_force(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Render a scene by testing every ray, and every segment to a light, with every object.

    The arithmetic is that of the tracer, so the picture must be the same to the last bit.
    """
    window = slice(0, scene.height), slice(0, scene.width)
    with (
        patch("tracer.trace.samples.find_object_spans", _cover_whole_bands),
        patch("tracer.trace.radiance.find_shadows", _test_all_occluders),
        patch.object(ScreenBounds, "is_in_picture", lambda self, _: np.full(self.top.size, True)),
        patch.object(ScreenBounds, "find_visible_pixels", lambda *_: window),
    ):
        return render(scene)


def _cover_whole_bands(
    shape: Shape, bounds: ScreenBounds, band_top: Floats, x_range: tuple[float, float], **_: float
) -> ObjectSpans:
    """Stand in for `find_object_spans`: every object covers every band."""
    band, index_in_shape = np.indices((band_top.size, shape.objects.size)).reshape(2, -1)
    left, right = np.full((band.size, 2), x_range).T
    object_index = index_in_shape + shape.objects.start
    return ObjectSpans(object_index=object_index, band=band, left=left, right=right)


@np.errstate(all="ignore")
def _test_all_occluders(hits: Hits, lights: Lights, faces_light: Bools) -> Bools:
    """Stand in for `find_shadows`: test all objects, one after the other."""
    is_blocked, own_object = np.zeros_like(faces_light), hits.hit_object
    for light, is_facing, blocked in zip(lights.position, faces_light, is_blocked, strict=True):
        for shape in hits.scene.shapes:
            for index in shape.objects.list_indices():
                hit = np.flatnonzero(is_facing & ~blocked & (own_object != index))
                x, y, z = np.full((3, hit.size), light[:, None])
                object_index = np.full(hit.size, index)
                side = shape.find_light_side(object_index, (x, y, z))
                blocked[hit] = shape.occludes(object_index, hits.get_points(hit), (x, y, z), side)
    return is_blocked


def assert_unchanged(scene: Scene) -> None:
    """Assert that the tracer renders the picture of `render_by_brute_force`, to the last bit.

    The tracer uses large packets, short packets, and packets of single hits, for rows of samples
    and for scattered samples.
    """
    expected = render_by_brute_force(scene)
    for packet_scale in (1e9, 1e-9, 0.2):
        with patch("tracer.world.prepared_scene._PACKET_SCALE", packet_scale):
            np.testing.assert_array_equal(render(scene), expected)
            np.testing.assert_array_equal(render_scattered(scene), expected)


@np.errstate(all="ignore")
def render_scattered(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Render a scene from scattered samples, in pixels up to eight times as large."""
    factor = math.gcd(scene.width, scene.height, 8)  # a power of two changes no bit of a ray
    coarse_scene = replace(scene, width=scene.width // factor, height=scene.height // factor)
    x, y = ((0.5 + np.arange(size)) / factor for size in (scene.width, scene.height))
    samples, order = Scattered.from_positions(np.tile(x, y.size), np.repeat(y, x.size))
    radiance = np.empty((3, order.size))
    radiance[:, order] = compute_radiance(PreparedScene(coarse_scene), samples)
    return np.moveaxis(radiance.reshape(3, y.size, x.size), 0, 2)


@settings(max_examples=3 * settings.default.max_examples)
@given(scenes(FEW_OBJECTS, st.just(23), st.just(31)))
def test_culling_changes_no_random_scene(scene):
    assert_unchanged(scene)


def test_culling_changes_no_crowd():
    assert_unchanged(random_scene("crowd", 0, 23, 31))


@pytest.mark.parametrize("hard_scene", hard_scenes("culling"))
def test_culling_changes_no_hard_scene(hard_scene: HardScene):
    scene = hard_scene.scene
    assert_unchanged(scene)
    for light in scene.lights if len(scene.lights) > 1 else ():
        assert_unchanged(replace(scene, lights=[light]))


@pytest.mark.slow
@settings(max_examples=3 * settings.default.max_examples)
@given(scenes(FEW_OBJECTS, st.integers(2, 200), st.integers(1, 100)), st.integers(0, 5))
def test_culling_changes_no_scene_however_large(scene, zooms):
    assert_unchanged(scene)
    for _ in range(zooms):
        # Zoom in on the pixel that differs most from its neighbour: on an outline or the edge of a
        # shadow, which is enlarged up to 10^6 times.
        jumps = np.abs(np.diff(render(scene).sum(axis=2), axis=1))
        row, column = np.unravel_index(jumps.argmax(), jumps.shape)
        frame = compute_frame(scene.camera, scene.width, scene.height)
        x, y = np.array([column + 1.0]), np.array([row + 0.5])
        direction = np.array([frame.to_ray_x(x)[0], frame.to_ray_y(y)[0], frame.depth])
        camera = replace(
            scene.camera,
            view_dir=direction @ frame.axes,
            proj_normal=scene.camera.normal,
            proj_distance=math.hypot(*direction),
            view_width=scene.camera.view_width / 16,
            view_height=scene.camera.view_height / 16,
        )
        scene = replace(scene, camera=camera)
        assert_unchanged(scene)


def assert_looks_like(scene: Scene, usual_scene: Scene) -> None:
    """Assert that culling changes nothing, and that the scene looks like the usual scene."""
    assert_unchanged(scene)
    np.testing.assert_allclose(render(scene), render(usual_scene), rtol=0, atol=1e-5)


@pytest.mark.parametrize(("size", "thickness"), [*product((1e18, 1e30, 1e75), (0, 1))])
def test_floors_without_end(size, thickness):
    scene = load_scene(HARD_SCENES / "floor-without-end.xml")
    floor, ball = scene.surfaces

    def resize_floor(size: float) -> Scene:
        corners = {"min_pt": (-size, -thickness, -size), "max_pt": (size, 0, size)}
        return replace(scene, surfaces=[replace(floor, **corners), ball])

    assert_looks_like(resize_floor(size), resize_floor(1e6))


@pytest.mark.parametrize("direction", [(1, 2, 1.5), (1, 1, 0), (0, 1, 0)])
@pytest.mark.parametrize("distance", [1e10, 1e13, 1e15, 1e20, 1e40])
def test_distant_lights(distance, direction):
    scene = load_scene(HARD_SCENES / "distant-light.xml")

    def move_light(distance: float) -> Scene:
        return replace(scene, lights=[PointLight(position=distance * np.array(direction))])

    assert_looks_like(move_light(distance), move_light(1e6))


def test_samples_are_traced_in_batches_if_many_objects_lie_behind_each_other(monkeypatch):
    # The number of pairs of a sample and an object in a batch limits memory.
    plates = [Box(min_pt=(-9, -9, -k / 10 - 2), max_pt=(9, 9, -k / 10 - 2)) for k in range(60)]
    scene = scene_of(*plates, size=(40, 30), lights=(0, 2, 0))
    sizes = record_calls(
        monkeypatch, radiance_module, "find_nearest_hits", lambda _, samples: samples.size
    )
    monkeypatch.setattr(prepared_scene, "_MAX_SAMPLE_PAIRS", 40 * 30 * 8)
    assert np.array_equal(render(scene), render_by_brute_force(scene))
    assert 0 < max(sizes) <= 40 * 30 * 8 / 60


@np.errstate(all="ignore")
def test_runs_consist_of_neighbours():
    # A row of the floor consists of several runs if balls hide parts of it.
    scene = build_crowd_scene(200, width=80, height=45)
    samples = PIXEL_CENTERS.place_in_pixels(slice(0, 45), slice(0, 80))
    for group in radiance_module.find_nearest_hits(PreparedScene(scene), samples).groups:
        ends = np.append(0, group.run_length.cumsum())
        assert (group.run_length > 1).any()
        for start, stop in pairwise(ends):
            run = group.sample_index[start:stop]
            assert np.array_equal(run, np.arange(run[0], run[0] + run.size))
            assert run[0] // 80 == run[-1] // 80


def place_nine_lights(scene: Scene) -> Scene:
    """Replace the lights of a scene by nine lights of two colours in a row."""
    lights = [replace(scene.lights[k % 2], position=(6 - k, 8, 7)) for k in range(9)]
    return replace(scene, lights=lights)


def test_lights_are_prepared_in_batches(monkeypatch):
    scene = place_nine_lights(build_crowd_scene(40, width=48, height=27))
    counts = record_calls(monkeypatch, LightGrid, "query", lambda g, *_: g.light_position.shape[1])
    monkeypatch.setattr(prepared_scene, "_MAX_LIGHTS", 9)
    expected = [render(scene, samples) for samples in (1, 16)]
    monkeypatch.setattr(prepared_scene, "_MAX_LIGHTS", 4)
    for max_bytes in (0, 1 << 26):
        monkeypatch.setattr(prepared_scene, "_MAX_CACHED_BYTES", max_bytes)
        for image, samples in zip(expected, (1, 16), strict=True):
            assert np.array_equal(render(scene, samples), image)
    assert {*counts} == {9, 4, 1}


def test_threads_share_prepared_lights(monkeypatch):
    # While one thread slowly prepares a batch of lights, all other threads request it, too.
    scene = place_nine_lights(build_crowd_scene(40, width=48, height=27))
    expected = render(scene)
    shared_scene = PreparedScene(scene)
    starts = list[int]()
    prepare_lights = PreparedScene.prepare_lights

    def prepare_slowly(self: PreparedScene, batch: slice) -> Lights:
        starts.append(batch.start)
        sleep(0.05)
        return prepare_lights(self, batch)

    monkeypatch.setattr(PreparedScene, "prepare_lights", prepare_slowly)
    with ThreadPoolExecutor(4) as pool:
        all_batches = [*pool.map(lambda _: [*shared_scene.iterate_light_batches()], range(4))]
        assert starts == [0, 4, 8]
        for first, *others in zip(*all_batches, strict=True):
            assert all(lights is first for lights in others)
        position = np.concatenate([lights.position for lights in all_batches[3]])
        np.testing.assert_array_equal(position, [light.position for light in scene.lights])
        # The same holds if threads render the tiles of a picture.
        monkeypatch.setattr("tracer.picture.tiles._MAX_TILE_SECONDS", 1e-4)
        assert len(RenderJob(scene).work.divide(WorkerPool.sharing)) > 10
        np.testing.assert_array_equal(render(scene, executor=pool), expected)


CAMERA = Camera(view_point=(0, 1, 6), view_dir=(0, -0.125, -1), view_width=1.5, view_height=1.5)
FLOOR = Box(min_pt=(-8, -1, -8), max_pt=(8, 0, 8), shader=Lambertian(diffuse=(1, 0.5, 0.25)))
BALL = Sphere(center=(0, 1, 0))


def test_a_hundred_equal_surfaces_take_no_longer_than_one():
    first, duplicate = (replace(BALL, shader=Lambertian(diffuse=(1, g, 0))) for g in (0, 1))
    images, seconds = [], []
    for surfaces in ((FLOOR, first), (FLOOR, first, *[duplicate, FLOOR] * 100)):
        scene = scene_of(*surfaces, camera=CAMERA, size=(120, 120), lights=(3, 5, 4))
        begin = process_time()
        images.append(render(scene, 16))
        seconds.append(process_time() - begin)
    assert np.array_equal(*images)
    assert seconds[1] < 5 * seconds[0] + 0.5


def test_a_ball_that_touches_the_eye_from_behind_is_not_visible():
    camera = Camera(view_point=(0.1, 0.2, 0.3), view_width=3, view_height=3)
    wall = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -8))
    scene = scene_of(wall, camera=camera, size=(120, 120), lights=(0.1, 5, 0))
    expected = render(scene)
    for radius in (0.1, 0.2, 0.3, 0.7, 1.1):
        ball = Sphere(center=(0.1, 0.2, 0.3 + radius), radius=radius)
        assert np.array_equal(render(replace(scene, surfaces=[wall, ball])), expected)


def record_sizes(monkeypatch: pytest.MonkeyPatch, owner: object, name: str) -> list[int]:
    """Record the sizes of the batches that a generator function of a module or a class yields.

    A batch is an array, or a tuple of arrays of the same length.  The list of sizes, which is
    returned, grows whenever the function is called during the test.
    """
    sizes, original = [], getattr(owner, name)

    def recording(*arguments: object) -> Iterator[object]:
        for batch in original(*arguments):
            sizes.append(batch[0].size)
            yield batch

    monkeypatch.setattr(owner, name, recording)
    return sizes


def build_balls(light: Vector, count: int, radius: float, ground: Sphere) -> Scene:
    """Build a scene with `count` equal balls at random positions, and a ground."""
    rng = np.random.default_rng(1)
    balls = [Sphere(center=c, radius=radius) for c in rng.uniform(-1, 1, (count, 3)).tolist()]
    camera = Camera(view_point=(0, 0, 9), proj_distance=4)
    return scene_of(*balls, ground, camera=camera, size=(60, 60), lights=light)


@pytest.mark.parametrize(
    ("distance", "ground_radius"),
    [*((10.0**k, 1.0) for k in (7, 9, 11, 13, 20, 40)), (1e9, 6.4e6), (1.5e11, 6.4e6)],
)
def test_distant_lights_and_planets_cause_no_more_tests(distance, ground_radius, monkeypatch):
    light = (0.3 * distance, 0.8 * distance, 0.5 * distance)
    planet = Sphere(center=(0, -ground_radius - 1, 0), radius=ground_radius)
    sizes = record_sizes(monkeypatch, LightGrid, "query")
    render(build_balls(light, 1000, 0.02, planet))
    assert 0 < sum(sizes) < 5 * 60 * 60


def test_the_light_grid_is_read_in_batches(monkeypatch):
    # Many balls lie in one cell of the light grid, and the shadow segments from the ground cross
    # many cells.  All pairs together would not fit into memory.
    ground = Sphere(center=(0, -1e6, 0), radius=1e6 - 1)
    scene = build_balls((0.1, 3, 0.2), 300, 0.1, ground)
    expected = render(scene, 16)
    cell_counts = record_sizes(monkeypatch, cell_lists, "_find_overlaps")
    pair_counts = record_sizes(monkeypatch, LightGrid, "query")
    monkeypatch.setattr(cell_lists, "_PAIRS_PER_BATCH", 1000)
    monkeypatch.setattr(cell_lists, "_CELLS_PER_BATCH", 1000)
    np.testing.assert_array_equal(render(scene, 16), expected)
    for sizes in (pair_counts, cell_counts):
        assert 100 < max(sizes) <= 1000 < sum(sizes)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("eye_height", [1e-75, 1e-60, 1.0])
@pytest.mark.parametrize("view_height", [1e-75, 1e-60, 0.5])
def test_packets_are_finite(eye_height, view_height, monkeypatch):
    # At the limits of the format, a pixel sees a floor over 1e150 times its own width.  If the
    # bounding sphere of such a packet were infinite, its cells in the light grid would be NaN.
    radii = record_calls(monkeypatch, LightGrid, "query", lambda _, centers, radii, *others: radii)
    floor = Box(min_pt=(-1e75, -1, -1e75), max_pt=(1e75, 0, 1e75))
    ball = Sphere(center=(0, 0.5, -3), radius=0.5)
    camera = Camera(view_point=(0, eye_height, 0), view_width=1, view_height=view_height)
    lights = [PointLight(position=position) for position in ((0, 1e75, -9e74), (3, 5, 4))]
    render(scene_of(floor, ball, camera=camera, size=(9, 8), lights=lights), 16)
    assert np.isfinite(np.concatenate(radii)).all()


@pytest.mark.usefixtures("pixels_are_split")
def test_a_horizon_causes_no_more_shadow_tests(monkeypatch):
    # Near the horizon, the footprint of a pixel is larger than the rest of the scene, so every
    # object may shade a part of it.  There are 0.8 tests per pixel.  There would be 20 without
    # layers of depth, and 5 if the layers were octaves.
    rng = np.random.default_rng(0)
    floor = Box(min_pt=(-1e6, -1, -1e6), max_pt=(1e6, 0, 1e6))
    positions = rng.uniform((-20, -60), (20, -2), (200, 2)).tolist()
    balls = [Sphere(center=(x, 0.1, z), radius=0.1) for x, z in positions]
    camera = Camera(view_point=(0, 1, 5), view_dir=(0, -0.1, -1))
    scene = scene_of(floor, *balls, camera=camera, size=(64, 64), lights=(30, 40, 20))
    sizes = record_calls(monkeypatch, Spheres, "occludes", lambda _, index, *others: index.size)
    render(scene, samples=4)
    assert 0 < sum(sizes) < 64 * 64


def test_objects_that_differ_in_one_number_are_no_duplicates():
    ball, box = Sphere(center=(1, 2, 3), radius=4), Box(min_pt=(1, 2, 3), max_pt=(4, 5, 6))
    variants = [(ball, replace(ball, radius=4.5))]
    for axis in range(3):
        step = [0.5 * (axis == i) for i in range(3)]
        for surface, field in ((ball, "center"), (box, "min_pt"), (box, "max_pt")):
            moved_point = tuple(np.add(getattr(surface, field), step).tolist())
            variants.append((surface, replace(surface, **{field: moved_point})))
    for pair in variants:
        for first, second in (pair, pair[::-1]):
            for items, expected in (((first, second, first), [0, 0, 1]), ((first, first), [0, 1])):
                scene = scene_of(*items, camera=CAMERA, size=(2, 2), lights=(3, 5, 4))
                assert PreparedScene(scene).is_duplicate.tolist() == expected, items
    # A box of which one face is hidden, and a box that is deeper: both are visible.
    scene = scene_of(
        Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 0), shader=Lambertian(diffuse=(1, 0, 0))),
        Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1), shader=Lambertian(diffuse=(0, 1, 0))),
        camera=Camera(view_point=(3, 3, 6), view_dir=(-3, -3, -6), view_width=0.5, view_height=0.5),
        size=(20, 20),
        lights=(3, 5, 9),
    )
    assert (render(scene)[..., 1] > 0).sum() > 100


@pytest.mark.parametrize("degrees", [-80, -62, 62, 80])
@pytest.mark.parametrize("axis", [0, 1])
def test_culling_with_a_window_turned_far_from_the_view_direction(degrees, axis):
    angle = math.radians(degrees)
    direction = [0.0, 0.0, -math.cos(angle)]
    direction[axis] = math.sin(angle)
    camera = Camera(
        view_point=(0, 0, 5),
        view_dir=tuple(direction),
        proj_normal=(0, 0, 1),
        proj_distance=3 / math.cos(angle),
        view_width=2,
        view_height=2,
    )
    # The picture's centre shows this point, at z = 0.
    x, y, _ = np.multiply(direction, 5 / -direction[2]).tolist()
    ball = Sphere(center=(x, y, 0), radius=0.4)
    # Its sides are not in the plane of a row or column of samples.
    box = Box(min_pt=(x + 0.013, y + 0.017, -1), max_pt=(x + 1, y + 1, 0.05))
    scene = scene_of(ball, box, camera=camera, size=(45, 35), lights=(x + 1, y + 3, 5))
    assert_unchanged(scene)
    image = render(scene)
    assert 50 < (image > 0).all(axis=2).sum() < 1000
    np.testing.assert_allclose(image, plain.render(scene), rtol=0, atol=1e-9)
