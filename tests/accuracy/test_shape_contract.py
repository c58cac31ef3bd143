"""The promises of `Shape`, checked for spheres, boxes, and cylinders, which only the tests know."""

from dataclasses import replace

import numpy as np
import pytest
from cylinder import Cylinder, Cylinders, PlainTracer, add_cylinders
from probe import scene_of
from shape_probe import (
    find_hits,
    prepare,
    random_scene,
    random_segments,
    scale_scene,
    trace,
)

from reference.judges import plain
from tracer import Box, Camera, Scene, Sphere, Surfaces, render
from tracer.arrays import Bools, Floats, dot, find, map_xyz, take
from tracer.geometry.box import Boxes
from tracer.geometry.camera import compute_frame
from tracer.geometry.rounding import OUTSIDE
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape
from tracer.geometry.sphere import Spheres
from tracer.world.prepared_scene import PreparedScene


@pytest.fixture(autouse=True)
def cylinders_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plug cylinders into the tracer, and into the plain renderer."""
    monkeypatch.setattr("tracer.world.prepared_scene.SHAPES", (Spheres, Boxes, Cylinders))
    monkeypatch.setattr(plain, "_PlainTracer", PlainTracer)


@pytest.mark.parametrize("seed", range(12))
def test_cylinders_are_visible_and_shadowed(seed: int) -> None:
    scene = random_scene(seed)
    assert any(isinstance(surface, Cylinder) for surface in scene.surfaces)
    with np.errstate(all="ignore"):
        expected = plain.render(scene)
    np.testing.assert_allclose(render(scene), expected, rtol=0, atol=1e-9)


def average(scene: Scene, side: int) -> Floats:
    """Average side * side pictures of the plain renderer, whose rays are a uniform grid."""
    offsets = (np.arange(side) + 0.5) / side - 0.5
    with np.errstate(all="ignore"):
        images = [plain.render(scene, (x, y)) for x in offsets for y in offsets]
    return np.asarray(np.mean(images, axis=0))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("seed", range(3))
def test_cylinders_are_antialiased(seed: int) -> None:
    scene = random_scene(seed, size=(48, 36))
    truth = average(scene, 12)
    error, grid_error = (
        np.sqrt(np.mean((image - truth) ** 2)) for image in (render(scene, 16), average(scene, 4))
    )
    # The errors are 0.17 to 0.25 times those of the grid; without creases 0.25 to 1.26 times.
    assert error < 0.3 * grid_error


EACH_SHAPE = pytest.mark.parametrize("shape_type", [Spheres, Boxes, Cylinders])
EACH_SEED = pytest.mark.parametrize("seed", range(4))


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_a_result_depends_on_its_pair_only(shape_type: type[Shape], seed: int) -> None:
    shape, objects = prepare(shape_type, seed)
    ray_x, ray_y, t, hit_data = trace(shape, objects, seed)
    assert 0 < np.count_nonzero(t < np.inf) < t.size
    for index in range(0, t.size, 7):
        pair = slice(index, index + 1)
        object_index = objects[index // 300 : index // 300 + 1]
        single = shape.intersect(object_index, ray_y[pair], ray_x[pair], np.array([1]))
        np.testing.assert_array_equal(single, (t[pair], hit_data[pair]))


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_ranges_of_rows_are_exact(shape_type: type[Shape], seed: int) -> None:
    shape, objects = prepare(shape_type, seed)
    y = np.random.default_rng(seed).uniform(0, shape.frame.height, 200)
    object_index, y = objects.repeat(y.size), np.tile(y, objects.size)
    left, right = shape.find_x_range(object_index, y, 0.0)
    appears = left <= right
    assert np.count_nonzero(appears) > 0
    ray_y, step = shape.frame.to_ray_y(y), np.minimum(1e-6, (right - left) / 4)

    def is_hit(x: Floats) -> Bools:
        t, _ = shape.intersect(object_index, ray_y, shape.frame.to_ray_x(x), None)
        return np.isfinite(t)

    assert is_hit((left + right) / 2)[appears].all()
    for inner_x, outer_x in ((left + step, left - step), (right - step, right + step)):
        assert is_hit(inner_x)[appears].all()
        assert not is_hit(outer_x)[appears].any()
    # Lines that the object does not meet.
    other = np.random.default_rng(1).uniform(0, shape.frame.width, y.size)
    assert not is_hit(other)[~appears].any()
    # A row contains the ranges of its lines.
    for height in (1e-3, 1.0):
        row_left, row_right = shape.find_x_range(object_index, y - height / 3, height)
        assert (row_left <= left + 1e-9)[appears].all()
        assert (row_right >= right - 1e-9)[appears].all()


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_an_object_is_everywhere_in_a_picture_from_inside(
    shape_type: type[Shape], seed: int
) -> None:
    shape, objects = prepare(shape_type, seed)
    low, high = (corner[:, 0] for corner in shape.compute_bounding_boxes())
    center = (low + high) / 2
    # The centre of a side of the bounding box is on the object.
    to_wall = np.eye(3)[seed % 3] * (high - low) / 2
    # The eye is at the centre, between the centre and the wall, and near the wall.
    for share in (0.0, 0.6, 1 - 1e-9):
        camera = {"view_point": center + share * to_wall, "view_width": 9, "view_height": 5}
        shape, objects = prepare(shape_type, seed, **camera)
        x, y = np.random.default_rng(seed).uniform(0, 1, (2, 200)) * [[60], [45]]
        object_index, frame = objects[:1].repeat(x.size), shape.frame
        t, _ = shape.intersect(object_index, frame.to_ray_y(y), frame.to_ray_x(x), None)
        assert np.isfinite(t).all()
        left, right = shape.find_x_range(object_index, y, 0.0)
        assert (left <= x).all()
        assert (x <= right).all()


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_the_ends_of_a_row_bound_its_hits(shape_type: type[Shape], seed: int) -> None:
    shape, objects = prepare(shape_type, seed)
    if not shape.are_rows_bounded_by_ends():
        return  # nothing is promised
    frame, hit_count = shape.frame, 0
    ray_x = frame.to_ray_x(np.arange(0, frame.width, 0.25))
    for object_index in objects[:, None]:
        for ray_y in frame.to_ray_y(np.arange(0.5, frame.height)).reshape(-1, 1):
            t, hit_data = shape.intersect(object_index, ray_y, ray_x, np.array([ray_x.size]))
            to_hit = t * np.array(np.broadcast_arrays(ray_x, ray_y, frame.depth))
            for face in np.unique(hit_data) if shape.has_planar_faces else [None]:
                index = find((t < np.inf) & (face is None or hit_data == face))
                hits = to_hit[:, index]
                hit_count += index.size
                for ends in (slice(0, None), slice(0, 5), slice(-7, None)):
                    row = hits[:, ends]
                    center = (row[:, :1] + row[:, -1:]) / 2
                    distance = np.sqrt(((row - center) ** 2).sum(axis=0))
                    assert (distance <= (1 + 1e-12) * distance[:1] + 1e-12).all()
    assert hit_count > 0


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_tangent_planes_contain_hits_and_face_the_eye(shape_type: type[Shape], seed: int) -> None:
    hits = find_hits(shape_type, seed)
    normal = hits.planes.normal
    np.testing.assert_allclose(dot(normal, normal), 1, atol=1e-12)
    height = -dot(normal, hits.to_hit)
    assert (height > -hits.tolerance).all()
    np.testing.assert_allclose(hits.planes.eye_height, height, atol=hits.tolerance)
    distance = hits.shape.measure_distance(hits.object_index, hits.points)
    np.testing.assert_allclose(distance, 0, atol=hits.tolerance)


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_codes_of_faces_tell_their_axes_and_signs(shape_type: type[Shape], seed: int) -> None:
    hits = find_hits(shape_type, seed)
    planes = hits.planes
    is_planar = planes.face_axis != NO_AXIS
    assert hits.shape.has_planar_faces == is_planar.any()
    assert hits.shape.has_curved_face == (~is_planar).any()
    planar_code = 2 * planes.face_axis + (planes.normal_sign > 0)
    np.testing.assert_array_equal(hits.face_code, np.where(is_planar, planar_code, CURVED_FACE))
    coordinate = np.array(hits.points)[planes.face_axis[is_planar], is_planar]
    np.testing.assert_allclose(planes.face_position[is_planar], coordinate, atol=hits.tolerance)


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_extended_faces_meet_rays_at_hits(shape_type: type[Shape], seed: int) -> None:
    hits = find_hits(shape_type, seed)
    for code in np.unique(hits.face_code).tolist():
        index = find(hits.face_code == code)
        object_index = hits.object_index[index]
        ray = map_xyz(lambda component, i=index: component[i][None], hits.ray)
        inverse_t = hits.shape.compute_inverse_t(code, object_index, ray)
        np.testing.assert_allclose(inverse_t[0] * hits.t[index], 1, atol=1e-9)
        if code == CURVED_FACE:
            normal = hits.shape.compute_normals(object_index, ray, inverse_t)
            cosine = dot(normal, take(hits.planes.normal, index))
            np.testing.assert_allclose(cosine, np.sqrt(dot(normal, normal)), rtol=1e-9)


@pytest.mark.parametrize("eye_height", [-0.5, 0, 0.5])
@np.errstate(all="ignore")
def test_curved_faces_are_extended_wherever_the_eye_is(eye_height: float) -> None:
    """In the sphere, on it and outside it."""
    camera = Camera(view_point=(0, 0, 1 + eye_height))
    sphere = Spheres.from_surfaces(compute_frame(camera, 1, 1), Surfaces.from_objects([Sphere()]))
    object_index, x, y = np.array([0]), np.array([0.25]), np.array([-0.125])
    t, _ = sphere.intersect(object_index, y, x, None)
    ray = x[None], y[None], np.full((1, 1), sphere.frame.depth)
    inverse_t = sphere.compute_inverse_t(CURVED_FACE, object_index, ray)
    np.testing.assert_allclose(inverse_t[0] * t, 1, atol=1e-12)


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_planes_of_faces_are_met_at_the_bounding_box(shape_type: type[Shape], seed: int) -> None:
    hits = find_hits(shape_type, seed)
    shape = hits.shape
    corners = np.array(shape.compute_bounding_boxes())  # axes: low or high, coordinate, object
    found = np.zeros((8, hits.t.size), dtype=np.bool_)
    for face in shape.intersect_other_faces(hits.object_index, hits.to_hit, 0.01):
        axis, is_positive = divmod(face.face_code, 2)
        index = shape.objects.to_local(hits.object_index[face.item_index])
        # The eye is outside.
        position = corners[is_positive, axis, index]
        from_eye = map_xyz(lambda x, f=face: f.t * x[f.item_index], hits.to_hit)
        coordinate = shape.frame.point_to_scene(from_eye)[axis]
        np.testing.assert_allclose(coordinate, position, atol=10 * hits.tolerance)
        np.testing.assert_array_equal(np.sign(face.footprint_radius), np.sign(face.t))
        found[face.face_code, face.item_index] = True
    is_planar = hits.face_code != CURVED_FACE
    assert found[hits.face_code[is_planar], is_planar].all()


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_capsules_agree_with_their_segments(shape_type: type[Shape], seed: int) -> None:
    shape, _ = prepare(shape_type, seed)
    object_index, start, end, _ = random_segments(shape, seed)
    rng = np.random.default_rng(seed)
    radius = 0.1 * rng.random(object_index.size)
    may_block, blocks_all = shape.test_capsules(object_index, start, end, radius)
    light_side = shape.find_light_side(object_index, end)
    grown_occludes = shape.occludes(object_index, start, end, light_side, radius)
    assert not (grown_occludes & ~may_block).any()
    assert may_block.any()
    # The test of `Shape` excludes nothing.
    assert may_block.all() == (shape_type.test_capsules is Shape.test_capsules)
    for _ in range(20):
        offset = rng.normal(size=(3, radius.size))
        offset *= radius * rng.random(radius.size) / np.linalg.norm(offset, axis=0)
        hit = map_xyz(np.add, start, (offset[0], offset[1], offset[2]))
        occludes = shape.occludes(object_index, hit, end, light_side)
        assert not (occludes & ~may_block).any()
        assert not (blocks_all & ~occludes).any()


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_an_object_that_shrinks_to_nothing_blocks_nothing(
    shape_type: type[Shape], seed: int
) -> None:
    shape, _ = prepare(shape_type, seed)
    object_index, start, end, _ = random_segments(shape, seed)
    light_side = shape.find_light_side(object_index, end)
    growth = np.full(object_index.size, -99.0)
    occludes = shape.occludes(object_index, start, end, light_side, growth)
    assert not occludes[light_side == OUTSIDE].any()


@EACH_SHAPE
@EACH_SEED
@np.errstate(all="ignore")
def test_segments_that_cross_the_surface_are_blocked(shape_type: type[Shape], seed: int) -> None:
    shape, objects = prepare(shape_type, seed)
    low, high = (corner[:, :1] for corner in shape.compute_bounding_boxes())
    center, size = (low + high) / 2, high - low
    inside = center[:, 0] + 0.2 * size[:, 0] * np.eye(3)[seed % 3]
    for camera, eye_sign in (({}, 1), ({"view_point": inside}, -1)):
        shape, _ = prepare(shape_type, seed, **camera)
        ray_x, ray_y, t, _ = trace(shape, objects[:1], seed)
        hits = find(t < np.inf)
        to_hit = ray_x[hits] * t[hits], ray_y[hits] * t[hits], shape.frame.depth * t[hits]
        hit, object_index = shape.frame.point_to_scene(to_hit), objects[:1].repeat(hits.size)
        spread = np.random.default_rng(seed).normal(size=(3, hits.size))
        light = tuple(center + spread * size)
        light_side = shape.find_light_side(object_index, light)
        occludes = shape.occludes(object_index, hit, light, light_side)
        position = np.linspace(0, 1, 200)[1:-1, None]
        points = tuple(x + position * (end - x) for x, end in zip(hit, light, strict=True))
        # Heights above the surface, on the side of the eye, in units of the object's size.
        height = eye_sign * shape.measure_distance(object_index, points) / size.max()
        is_on_both_sides = (height > 1e-3).any(axis=0) & (height < -1e-3).any(axis=0)
        stays = (height > 1e-4).all(axis=0) & (light_side == eye_sign)
        assert is_on_both_sides.any()
        assert stays.any()
        assert occludes[is_on_both_sides].all()
        assert not occludes[stays].any()


@EACH_SHAPE
@np.errstate(all="ignore")
def test_no_power_of_a_length_is_above_the_fourth(shape_type: type[Shape]) -> None:
    # Coordinates of up to 2^248 = 5e74, and lengths from 2^-243 = 7e-74.
    results = []
    for exponent in (0, 244, -240):
        scene = scale_scene(random_scene(0), 2.0**exponent)
        prepared = PreparedScene(scene)
        (shape,) = (shape for shape in prepared.shapes if isinstance(shape, shape_type))
        objects = shape.objects.list_indices()
        _, _, t, hit_data = trace(shape, objects, 0)
        object_index, start, end, object_width = random_segments(shape, 0)
        side = shape.find_light_side(object_index, end)
        segments = object_index, start, end
        radius = 0.1 * object_width
        x_range = shape.find_x_range(objects, np.full(objects.size, 20.5), 0.0)
        results.append(
            [
                t,
                np.zeros(0) if shape_type is Spheres else hit_data,
                shape.occludes(*segments, side),
                shape.occludes(*segments, side, radius),
                *shape.test_capsules(*segments, radius),
                *x_range,
                *shape.bounds,
            ]
        )
    for result in zip(*results, strict=True):
        np.testing.assert_allclose(result[1], result[0], rtol=1e-12)
        np.testing.assert_allclose(result[2], result[0], rtol=1e-12)


@np.errstate(all="ignore")
def test_equal_planes_are_met_at_the_same_t() -> None:
    # The caps of a cylinder, and the faces of two boxes, lie in the planes y = -1/3 and y = 0.1.
    low, high = -1 / 3, 0.1
    center, half_height = (low + high) / 2, (high - low) / 2
    low, high = center - half_height, center + half_height
    boxes = [Box(min_pt=(x, low, -9), max_pt=(x + 18, high, 9)) for x in (-9, -8)]
    for eye_y in (5.1, -3.7):
        camera = Camera(
            view_point=(0.3, eye_y, 0.2), view_dir=(0.1, -eye_y, 0.1), view_up=(0, 0, 1)
        )
        scene = scene_of(*boxes, camera=camera, size=(40, 40), lights=(0, 9, 0))
        disc = Cylinder(center=(0, center, 0), radius=9.0, half_height=half_height)
        shapes = PreparedScene(replace(scene, surfaces=add_cylinders(scene, disc))).shapes
        ts = [trace(s, s.objects.list_indices()[:1], 0)[2] for s in shapes]
        np.testing.assert_array_equal(ts[0], ts[1])
        second_box = trace(shapes[0], shapes[0].objects.list_indices()[1:], 0)[2]
        np.testing.assert_array_equal(ts[0], second_box)
        assert np.isfinite(ts[0]).all()
