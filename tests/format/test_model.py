"""Scenes that programs construct: copies, comparisons, files."""

import copy
import io
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tracer
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, Surfaces, load_scene

MATTE, SHINY = Lambertian(diffuse=(0.5, 0.5, 0.5)), Phong(specular=(1, 1, 1), exponent=9)

# In the order of the file: a sphere, a box, a sphere.
ARRAYS: dict[str, Any] = {
    "center": [(0, 0, 0), (1, 2, 3)],
    "radius": [1, 2],
    "min_pt": [(-1, -1, -1)],
    "max_pt": [(0, 0, 0)],
    "shader_index": [0, 1, 0],
    "file_index": [0, 2, 1],
    "shaders": (MATTE, SHINY),
}


def get_error(construct: Callable[[], object]) -> ValueError:
    """Call a function, and return the error that it raises."""
    with pytest.raises((tracer.SceneError, tracer.SceneFileError)) as caught:
        construct()
    return caught.value


def test_surfaces_copy_their_arrays():
    arrays = {name: np.array(value) for name, value in ARRAYS.items() if name != "shaders"}
    surfaces = Surfaces(**arrays, shaders=ARRAYS["shaders"])
    for array in arrays.values():
        array[:] = -1
    assert surfaces == Surfaces(**ARRAYS)
    for name in arrays:
        for same in (surfaces, copy.copy(surfaces), pickle.loads(pickle.dumps(surfaces))):
            with pytest.raises(ValueError, match="read-only"):
                getattr(same, name)[:] = -1


PICKLED = [lambda value, p=p: pickle.loads(pickle.dumps(value, p)) for p in range(6)]


@pytest.mark.parametrize("make_copy", [copy.copy, copy.deepcopy, *PICKLED])
def test_copies_are_equal(make_copy):
    lights = [PointLight(position=(1, 2, 3))]
    scene = Scene(width=4, height=3, lights=lights, surfaces=Surfaces(**ARRAYS))
    same = make_copy(scene)
    assert same == scene
    assert hash(same) == hash(scene)
    # The data types must be NumPy's own objects, not equal ones: see Surfaces.__setstate__.
    assert same.surfaces.center.dtype is np.dtype(np.float64)
    assert same.surfaces.file_index.dtype is np.dtype(np.intp)
    for error in get_error(lambda: Scene(width=0, height=-1)), get_error(lambda: load_scene("a")):
        same = make_copy(error)
        assert (type(same), vars(same), str(same)) == (type(error), vars(error), str(error))


def test_surfaces_are_equal_as_sequences_are():
    surfaces = Surfaces(**ARRAYS)
    assert list(surfaces) == [
        Sphere(center=(0, 0, 0), radius=1, shader=MATTE),
        Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 0), shader=MATTE),
        Sphere(center=(1, 2, 3), radius=2, shader=SHINY),
    ]
    white = Lambertian()
    for same in (
        Surfaces.from_objects(list(surfaces)),
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
    assert Surfaces.from_objects(list(surfaces)[:2]) != surfaces
    assert surfaces != list(surfaces)
    assert Surfaces() == Surfaces()


def test_surfaces_have_the_order_of_the_objects():
    objects = [
        Box(min_pt=(0, 0, 0), max_pt=(k, k, k)) if k % 3 else Sphere(radius=k + 1) for k in range(7)
    ]
    surfaces = Surfaces.from_objects(objects)
    assert list(surfaces) == objects
    assert [surfaces[k] for k in range(-7, 7)] == objects * 2
    assert surfaces[5:1:-2] == tuple(objects[5:1:-2])


def test_scalars_of_numpy_are_stored_as_floats():
    """Type checkers accept them, too: see `test_types_of_documented_usage`."""
    camera = Camera(proj_distance=np.float32(1.5), view_width=np.int64(2), view_height=3)
    sphere, shader = Sphere(radius=np.float32(0.5)), Phong(exponent=np.int8(9))
    numbers = camera.proj_distance, camera.view_width, camera.view_height
    numbers = *numbers, sphere.radius, shader.exponent
    assert numbers == (1.5, 2, 3, 0.5, 9)
    assert {type(number) for number in numbers} == {float}


# Files


def test_all_digits_are_saved(tmp_path):
    third = (1 / 3, -0.0, 1e-75)
    scene = Scene(
        camera=Camera(view_point=third, proj_normal=(0, 1e-9, 1), view_height=0.1 + 0.2),
        width=4,
        height=3,
        lights=[PointLight(position=third, intensity=(1e75, 0.1, 0))],
        surfaces=[
            Sphere(center=third, radius=1e75, shader=SHINY),
            Box(min_pt=(-1e75, 0, -1 / 3), max_pt=third),
            Sphere(shader=SHINY),
            Sphere(shader=Phong(exponent=0)),
        ],
    )
    path = tmp_path / "a.xml"
    for target in (bytes(path), str(path), path):
        tracer.save_scene(scene, target)
        same = load_scene(target)
        assert same == scene
        assert repr(same) == repr(scene)
        assert list(map(repr, same.surfaces)) == list(map(repr, scene.surfaces))
    # Each shader is written once, but not the reader's default shader, which no surface uses.
    tracer.save_scene(same, path)
    assert path.read_text().count("<shader name") == 3
    assert len(same.surfaces.shaders) <= 4


def test_equal_shaders_are_saved_as_one(tmp_path):
    shaders = [Phong(exponent=9), Lambertian(), Phong(exponent=9), Phong(), Phong(exponent=8)]
    surfaces = [Sphere(shader=shader) for shader in (*shaders, shaders[0])] + [Sphere()]
    scene, path = Scene(width=4, height=3, surfaces=surfaces), tmp_path / "a.xml"
    tracer.save_scene(scene, path)
    assert path.read_text().count("<shader name") == 4
    assert load_scene(path) == scene


def test_only_scenes_are_replaced(tmp_path):
    scene, path = Scene(width=1, height=2), tmp_path / "scene.xml"
    for old_content in (
        b"",
        b"<scene/>",
        b'<?xml version="1.0"?>\n<!-- a\n--><!-- b -->\n<scene >',
        b"\xef\xbb\xbf<scene/>",
        "<scene/>".encode("utf-16"),
        b"<!-- %b --><scene/>" % (b"long " * 100_000),
    ):
        path.write_bytes(old_content)
        tracer.save_scene(scene, path)
        assert load_scene(path) == scene
    unreadable = [
        f'<?xml version="1.0" encoding="{name}"?><scene/>' for name in ("no", "shift-jis")
    ]
    others = '<scene version="3.0.0">', "<scenes>", "my notes", "<!-- <scene> --> text", *unreadable
    for old_content in others:
        path.write_text(old_content)
        with pytest.raises(FileExistsError):
            tracer.save_scene(scene, path)
        assert path.read_text() == old_content


SCENE_WITH_LINES = """<scene><image>4 3</image><camera/>
<surface type="Box"><minPt>0 0 0</minPt><maxPt>1 1 1</maxPt></surface>
<light><position>1 2 3</position></light>
<surface
  type="Sphere"/> <light><position>1 2 3</position></light>
</scene>"""


def test_objects_know_their_lines():
    scene = load_scene(io.BytesIO(SCENE_WITH_LINES.encode()))
    read = scene.surfaces
    for surfaces in read, pickle.loads(pickle.dumps(read)), Surfaces.from_objects(list(read)):
        assert [surface.line for surface in surfaces] == [2, surfaces[1].line] == [2, 4]
    assert [light.line for light in scene.lights] == [3, 5]
    ball, lights = Sphere(), [PointLight(position=(1, 2, 3))] * 2
    assert ball.line is lights[0].line is Surfaces.from_objects([ball])[0].line is None
    # Lines are ignored by ==, hash and repr.
    assert (read[1], scene.lights) == (ball, tuple(lights))
    assert (hash(read[1]), repr(read[1])) == (hash(ball), repr(ball))
    arrays = read.center, read.radius, read.min_pt, read.max_pt, read.shader_index, read.file_index
    assert 10 * read.line.nbytes < sum(array.nbytes for array in arrays)


def test_directions_are_refused_if_the_camera_would_be_inaccurate():
    """The limit is a sine or cosine of 1e-10."""
    for sign in (1, -1):
        Camera(view_up=(sign * 1.01e-10, 0, -1))
        with pytest.raises(tracer.SceneError, match="view_up: must not be parallel to view_dir"):
            Camera(view_up=(sign * 0.99e-10, 0, -1))
        Camera(proj_normal=(0, 1, sign * 1.01e-10), view_up=(1, 0, 0))
        with pytest.raises(tracer.SceneError, match="proj_normal: must not be perpendicular to"):
            Camera(proj_normal=(0, 1, sign * 0.99e-10), view_up=(1, 0, 0))
