"""The flavours: Mitsuba loads them, and its pictures are as similar as each flavour can be."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from probe import close_up, scale_and_shift, scene_of
from running import run
from scene_files import small_scene

from converters import flavours
from converters.camera import compute_window, sample_visible_points
from converters.flavours import (
    DEFAULT_SAMPLES,
    convert,
    convert_to_exact,
    convert_to_stock,
    make_pixels_square,
)
from converters.mitsuba_xml import ConversionError, make_plugin
from converters.rendering import render_with_mitsuba
from converters.variant import SCALAR
from reference.check import check_scene
from reference.command import SCENES, list_scene_files
from reference.figures import measure_differences
from reference.regenerate import load_small_scene
from tracer import Box, Camera, Lambertian, Phong, Scene, Sphere, Surfaces, render

TINY = small_scene("one-sphere", 8, 8)


# The files, in Mitsuba


@pytest.mark.slow
def test_the_mitsuba_command_renders_the_stock_flavour(tmp_path):
    (tmp_path / "x.xml").write_text(convert(TINY, "stock", 1), encoding="utf-8")
    # With fewer threads, the writer of EXR files would wait for ever.
    command = [Path(sys.executable).with_name("mitsuba"), "-t", "3", "-m", SCALAR, "x.xml"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    assert (tmp_path / "x.exr").exists()


@pytest.mark.parametrize("is_variant_first", [True, False])
def test_load_file_reads_the_exact_flavour_after_one_import(tmp_path, is_variant_first):
    """The variant may be set before the plugins are imported, or after."""
    (tmp_path / "x.xml").write_text(convert(TINY, "exact"), encoding="utf-8")
    lines = [f"mi.set_variant({SCALAR!r})", "import converters.plugins"]
    if not is_variant_first:
        lines.reverse()
    render_file = "assert mi.TensorXf(mi.render(mi.load_file('x.xml'))).array.__len__() == 192"
    script = "\n".join(["import mitsuba as mi", *lines, render_file])
    status, _, err = run(python=("-c", script), cwd=tmp_path)
    assert status == 0, err


def test_the_exact_flavour_needs_an_rgb_variant(tmp_path):
    code = (
        "import mitsuba as mi\nmi.set_variant('scalar_spectral')\nimport converters.plugins\n"
        f"mi.load_string({convert(TINY, 'exact')!r})"
    )
    message = "needs an RGB variant of Mitsuba, not scalar_spectral"
    assert message in run(python=("-c", code), cwd=tmp_path)[2]


@pytest.mark.parametrize("flavour", DEFAULT_SAMPLES)
def test_shaders_that_no_surface_uses_are_not_converted(flavour):
    unused, used = Phong(exponent=1e39), Lambertian(diffuse=(0.1, 0.2, 0.3))
    surfaces = Surfaces(center=[(0, 0, 0)], radius=[1], shader_index=[1], shaders=[unused, used])
    scene = Scene(width=8, height=8, surfaces=surfaces)
    without = replace(scene, surfaces=[Sphere(shader=used)])
    assert convert(scene, flavour) == convert(without, flavour).replace("bsdf0", "bsdf1")


# Scenes that Mitsuba cannot represent


def test_more_samples_than_mitsuba_can_count_are_refused(monkeypatch):
    monkeypatch.setattr("converters.rendering.load_into_mitsuba", Mock())
    # 10 per pixel are rounded up to 16.
    with pytest.raises(ValueError, match=r"^4294967296 samples are too many"):
        render_with_mitsuba(replace(close_up(), width=1 << 14, height=1 << 14), samples=10)


def test_a_parameter_that_is_not_a_number_is_refused():
    with pytest.raises(ConversionError, match="radius would be nan, but Mitsuba's"):
        make_plugin("shape", "sphere", radius=float("nan"))


@pytest.mark.parametrize(
    ("camera", "fov"),
    [
        ({"proj_distance": 1e-60}, "180"),
        ({"proj_distance": 1e-5}, "179.999"),
        ({"view_width": 1e17, "view_height": 1e17}, "180"),
        ({"view_width": 1e-60, "view_height": 1e-60}, "1.14592e-59"),
    ],
)
def test_a_field_of_view_that_mitsuba_refuses_is_not_converted(camera, fov):
    scene = replace(TINY, camera=replace(TINY.camera, **camera))
    with pytest.raises(ConversionError, match=f"^its field of view would be {fov} degrees"):
        convert_to_stock(scene)
    assert np.isfinite(render_with_mitsuba(scene, variant=SCALAR)).all()


# The pictures of the stock flavour


@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-15, 0), (1e-4, 0), (1e25, 0), (1, 1e4), (1, 1e8), (1e-3, 1)]
)
def test_stock_pictures_do_not_depend_on_scale_and_place(scale, offset):
    scene = load_small_scene(SCENES / "four-spheres.xml")
    shifted = scale_and_shift(scene, scale, (offset,) * 3)
    images = [render_with_mitsuba(each, 16, None, "stock") for each in (shifted, scene)]
    assert measure_differences(*images).ssim > 0.99


def test_a_large_ground_has_no_speckles_in_the_stock_flavour():
    """The error of a hit grows with the sphere's radius; Mitsuba's shadow rays ignore this."""
    ground, ball = Sphere(center=(0, -1e4, 0), radius=1e4), Sphere(center=(0, 0.3, -1), radius=0.5)
    camera = Camera(view_point=(0, 1, 5))
    scene = scene_of(ground, ball, camera=camera, size=(60, 60), lights=(3, 6, 4))
    image = render_with_mitsuba(scene, 16, None, "stock")
    # The light of the stock flavour falls off, so the pictures differ, but not by much.
    assert image.mean() == pytest.approx(render(scene).mean(), rel=0.1)
    assert measure_differences(image, render(scene, samples=16)).ssim > 0.85


def test_a_large_ground_is_lit_in_the_exact_flavour():
    """The error of a hit on a large sphere puts no hit in shadow."""
    scene = close_up(Sphere(center=(0, -1000.3, 0), radius=1000))
    camera = replace(scene.camera, view_point=(0, 1, 5), view_dir=(0, -0.2, -1))
    scene = replace(scene, camera=camera)
    assert np.abs(render_with_mitsuba(scene, variant=SCALAR) - render(scene)).max() < 1e-4


def test_stock_scenes_keep_their_coordinates():
    assert list_scene_files()
    for path in list_scene_files():
        assert "moved and scaled" not in convert_to_stock(load_small_scene(path)).comment
    assert "moved and scaled" in convert_to_stock(scale_and_shift(TINY, 1, (1e6,) * 3)).comment


@pytest.mark.parametrize(
    "shader",
    [
        Lambertian(diffuse=(0.63, 0.35, 0.07)),
        # Reflectances above 1, and those of shaders with a highlight, are divided by a number by
        # which the lights are multiplied.  Here it is 1.26, and the highlight is too dark to see.
        Lambertian(diffuse=(1.26, 0.7, 0.14)),
        Phong(diffuse=(0.63, 0.35, 0.07), specular=(1e-6, 0, 0), exponent=1),
    ],
    ids=["matte", "bright", "with a highlight"],
)
def test_a_stock_light_is_exact_at_the_distance_that_its_comment_gives(shader):
    """The fall-off hardly varies over a small ball far from its light."""
    scene = close_up(Sphere(radius=0.5, shader=shader), light=(300, 400, 500))
    comment = convert_to_stock(scene).root.find("emitter")[0].text
    assert comment.startswith(" exact at a distance of ")
    assert float(comment.split()[-1]) == pytest.approx(707, rel=2e-3)
    # Over a hit at 707 units the distance varies by 1 in 700, its square by 1 in 350; and
    # 256 samples blur what the exact picture takes at the pixel's centre, so look inside.
    image, expected = render_with_mitsuba(scene, 256, None, "stock"), render_with_mitsuba(scene)
    np.testing.assert_allclose(image[10:14, 10:14], expected[10:14, 10:14], rtol=5e-3, atol=1e-3)


@pytest.mark.parametrize("specular", [0, 0.1])
def test_reflectances_are_halved_if_there_are_highlights(specular):
    shaders = Lambertian(diffuse=(0.9, 0.5, 0)), Phong(specular=(specular,) * 3, exponent=0)
    document = convert_to_stock(close_up(*(Sphere(shader=shader) for shader in shaders)))
    colors = [color.attrib for color in document.root.iter("rgb")]
    reflectances = [color["value"] for color in colors if color["name"] != "intensity"]
    halved = ["0.45 0.25 0.0", "1.0 1.0 1.0", "0.4 0.4 0.4"]
    assert reflectances == (halved if specular else ["0.9 0.5 0.0", "1.0 1.0 1.0"])
    assert ("divided by" in document.comment) == bool(specular)
    assert ("all are\ndivided by 2" in document.comment) == bool(specular)


def test_a_stock_highlight_has_the_right_height():
    """Eye and light in one direction: n = h = v at the centre, where the lobe is exact."""
    shader = Phong(diffuse=(0, 0, 0), specular=(0.6, 0.6, 0.6), exponent=40)
    scene = close_up(Sphere(radius=0.5, shader=shader), light=(0, 0, 500))
    image = render_with_mitsuba(replace(scene, width=101, height=101), 16, None, "stock")
    # Over the central pixel, .015 wide, the normal turns by up to .02: (cos .02)^40 = .992.
    assert image[50, 50, 0] == pytest.approx(0.6, rel=0.01)


# The content of the trees


def read_number(document, path: str, name: str = "value") -> float:
    """Return a number in the first element of a converted scene that a path matches."""
    return float(document.root.find(path).get(name))


def test_boxes_keep_their_thickness_wherever_they_are():
    thin = Box(min_pt=(1e6, 2e6, -1e6), max_pt=(1e6 + 2, 2e6 + 0.5, -1e6 + 1))
    flat = Box(min_pt=(0, 0, 0), max_pt=(1, 1, 0))
    for flavour, scale in (
        (convert_to_stock, 1.0),
        (convert_to_exact, flavours.choose_normalization(close_up(thin, flat)).scale),
    ):
        root = flavour(close_up(thin, flat)).root
        half_sizes, centers = (
            np.array([[float(step.get(axis)) for axis in "xyz"] for step in root.iter(tag)])
            for tag in ("scale", "translate")
        )
        np.testing.assert_allclose(half_sizes[0], np.array([1, 0.25, 0.5]) * scale, rtol=1e-9)
        assert half_sizes[1][0] == pytest.approx(0.5 * scale)
        # A flat box becomes so thick that float32 can distinguish its faces, and no thicker.
        assert half_sizes[1][2] == pytest.approx(1e-6 * np.abs(centers).max(), rel=1e-3)


def test_lights_get_the_same_number_of_samples_each():
    """Mitsuba's multijitter also needs a number that its own rounded square root divides."""
    cases = (3, 64, 72), (3, 2, 2), (5, 5, 15), (2, 9, 12), (0, 7, 7)
    for light_count, samples, expected in cases:
        scene = replace(TINY, lights=[*TINY.lights][:1] * light_count)
        document = convert_to_stock(scene, samples)
        assert read_number(document, ".//*[@name='sample_count']") == expected


def test_a_stock_scene_beside_an_enormous_ball_stays_large_enough_for_shadow_rays():
    scene = close_up(Sphere(radius=0.5), Sphere(center=(0, -1e12 - 1, 0), radius=1e12))
    assert read_number(convert_to_stock(scene), ".//shape/float") > 1e-5


def test_shapes_are_in_the_order_of_the_file():
    scene = close_up(Box(min_pt=(0, 0, 0), max_pt=(1, 1, 1)), Sphere(), Sphere(radius=2))
    types = [shape.get("type") for shape in convert_to_exact(scene).root.iter("shape")]
    assert types == ["cube", "sphere", "sphere"]


def test_several_exact_samples_are_jittered():
    for samples, jitter in ((1, "false"), (4, "true")):
        root = convert_to_exact(TINY, samples).root
        assert root.find(".//*[@name='jitter']").get("value") == jitter


def test_the_near_plane_is_nearer_than_a_distant_window():
    camera = Camera(view_point=(0, 0, 4), proj_distance=4000, view_width=3000, view_height=3000)
    document = convert_to_stock(replace(close_up(Sphere()), camera=camera))
    assert read_number(document, ".//*[@name='near_clip']") < 3
    assert read_number(document, ".//*[@name='far_clip']") > 5


@pytest.mark.parametrize("z", [-1.0, 50.0])
@pytest.mark.parametrize("size", [1e-8, 1.0])
def test_stock_lights_are_right_for_objects_that_are_small_or_out_of_view(z, size):
    ball = Sphere(center=(0.63, 0.71, z), radius=0.05)
    camera = Camera(view_point=(0, 0, 9), proj_distance=1 / size, view_width=1 / size,
                    view_height=1 / size)  # fmt: skip
    scene = scale_and_shift(replace(close_up(ball, light=(0, 20, z)), camera=camera), size)
    root = convert_to_stock(scene).root
    intensity = float(root.find("emitter/rgb").get("value").split()[0])
    scale = float(root.find("shape/float").get("value")) / 0.05  # the scene may be scaled
    assert intensity / (np.pi * (19.3 * scale) ** 2) == pytest.approx(1, rel=0.02)


# Windows and visible points


def test_a_picture_of_square_pixels_has_a_row_and_shows_the_window():
    scene = Scene(camera=Camera(view_width=3, view_height=4), width=10, height=2)
    square = make_pixels_square(scene)
    assert (square.height, square.camera.view_height) == (13, pytest.approx(3.9))
    assert make_pixels_square(square) == square
    cameras = Camera(view_height=1e-3), Camera(view_height=1.03)
    flat, inexact = (Scene(camera=camera, width=9, height=9) for camera in cameras)
    assert make_pixels_square(flat).height == 1
    # The number of rows is right, but not the window's height.
    assert make_pixels_square(inexact).camera == Camera()


def test_the_window_of_an_oblique_camera():
    """The expected numbers are computed by hand."""
    camera = Camera(view_point=(1, 2, 3), view_dir=(-3, 0, -4), proj_normal=(0, 0, 2),
                    proj_distance=10, view_width=4, view_height=2)  # fmt: skip
    window = compute_window(camera)
    np.testing.assert_allclose(window.axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-15)
    np.testing.assert_allclose(window.offset, [-6, 0, 8], atol=1e-14)
    np.testing.assert_allclose(window.compute_vectors_from_eye(0, 0), [-8, 1, -8], atol=1e-14)
    np.testing.assert_allclose(window.compute_vectors_from_eye(1, 0.5), [-4, 0, -8], atol=1e-14)
    # No square of a length overflows.
    ahead = compute_window(Camera(view_dir=(3e300, 0, -4e300))).axes[2]
    np.testing.assert_allclose(ahead, [0.6, 0, -0.8], rtol=1e-15)


def test_a_normalised_scene_is_centred_and_ten_units_large():
    scene = close_up(Sphere(center=(7, 8, -9), radius=1), view_dir=(7, 8, -14))
    points = flavours.choose_normalization(scene)(sample_visible_points(scene))
    np.testing.assert_allclose(points.min(axis=0) + points.max(axis=0), 0, atol=1e-9)
    assert np.ptp(points, axis=0).max() == pytest.approx(10)


@pytest.mark.parametrize(
    "room", [Sphere(radius=3), Box(min_pt=(-2, -3, -4), max_pt=(2, 3, 4))], ids=["sphere", "box"]
)
def test_a_room_is_normalised_by_what_is_visible_from_inside(room):
    camera = Camera(view_point=(0.5, 0.25, 0), view_width=2, view_height=2)
    scene = scene_of(room, camera=camera, size=(24, 24), lights=(0, 0, 0))
    assert flavours.choose_normalization(scene).center[2] < -1
    result = check_scene(scene, "room")
    assert (result.verdict, result.tracer_image.min() > 0) == ("agrees", True)


def test_more_rays_are_traced_if_few_hit_a_surface():
    """Few of the first 12 x 12 rays hit the small ball; all of them hit the ball or the wall."""
    assert len(sample_visible_points(close_up(Sphere(radius=0.1)))) >= 12
    wall = Box(min_pt=(-9, -9, -2), max_pt=(9, 9, -1))
    points = sample_visible_points(close_up(Sphere(radius=0.45), wall))
    assert len(points) == 144
    assert 0 < np.isclose(points[:, 2], -1).sum() < 144
