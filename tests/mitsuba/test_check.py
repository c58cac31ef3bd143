"""The check against Mitsuba: its three verdicts, which pixels count, and its command.

`test_cross_validation` checks the project's scenes; `test_mutations` checks that mistakes are
detected.
"""

import shutil
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from probe import close_up, scene_of
from random_scenes import KINDS, random_scene
from running import file_names, run
from scene_files import HARD_SCENES, hard_scenes, small_scene

from converters.rendering import Rendering
from converters.variant import SCALAR, use_variant
from reference import check, report
from reference.check import STOCK, CheckResult, Limits, check_diffuse_light, check_scene, compare
from reference.command import SCENES
from reference.figures import Metrics
from reference.judges import exact
from reference.regenerate import load_small_scene
from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, load_scene, render
from tracer.command.failure import Failure

WALL = Box(min_pt=(-1, -1.2, -1), max_pt=(1.1, 1, 0))
RED_WALL = replace(WALL, shader=Lambertian(diffuse=(1, 0, 0)))


@pytest.mark.parametrize("hard", hard_scenes("brightest value"))
def test_hard_scenes_agree(hard):
    result = check_scene(hard.scene, "hard")
    assert (result.verdict, result.remarks) == ("agrees", [])
    assert result.tracer_image.max() > float(hard.fields["brightest value"])


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("kind", ["scattered", "rooms", "far", "walled", "crowd"])
def test_random_scenes_agree(kind, seed):
    result = check_scene(random_scene(kind, seed, 64, 48), "random")
    assert (result.verdict, result.remarks) == ("agrees", [])
    assert result.tracer_image.max() > 0.3


def test_a_scene_without_surfaces_agrees():
    assert check_scene(close_up(), "nothing").verdict == "agrees"


# Comparisons with pictures that stand for Mitsuba's


def compare_to(scene: Scene, mitsuba: np.ndarray, *limits: Limits) -> CheckResult:
    """Compare the tracer's picture of a scene with a picture that stands for Mitsuba's."""
    return compare(scene, "scene", Rendering(mitsuba, "scalar_rgb", 0.0), *limits)


def replace_tracer(monkeypatch: pytest.MonkeyPatch, image: np.ndarray) -> None:
    """Let the check use this picture in place of the tracer's."""
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: image)


def render_four_spheres() -> tuple[Scene, np.ndarray]:
    """Return a scene and its picture."""
    scene = small_scene("four-spheres", 80, 60)
    return scene, render(scene)


def test_ties_are_explained_pixel_by_pixel(monkeypatch):
    """A red box coincides with a white one: Mitsuba may show either, but no other colour."""
    scene = close_up(RED_WALL, WALL)
    red, white = render(scene), render(close_up(WALL, RED_WALL))
    assert red[..., 1].max() == 0
    mitsuba = red.copy()
    mitsuba[5:, :9] = white[5:, :9]
    result = compare_to(scene, mitsuba)
    assert (result.verdict, result.is_tie.sum(), result.metrics.max) == ("agrees", 19 * 9, 0)
    assert np.array_equal(result.mitsuba.image, mitsuba)
    assert "surfaces coincide, Mitsuba shows the other one in 171 pixels" in result.format_report()
    # All pixels of a picture may be ties; one pixel that is not a tie is still found.
    assert compare_to(scene, white).is_tie.all()
    mitsuba = white.copy()
    mitsuba[23, 23] = 0.5  # in the last batch
    result = compare_to(scene, mitsuba)
    assert (result.verdict, result.is_disputed.sum()) == ("undecided", 1)
    assert result.is_examined[23, 23]
    # If surfaces tie, the tracer must show the first.
    result = compare_to(replace(scene, surfaces=scene.surfaces[::-1]), white)
    assert (result.verdict, result.is_disputed.sum()) == ("agrees", 0)
    replace_tracer(monkeypatch, white)
    assert compare_to(scene, red).verdict == "DIFFERS"


def test_the_verdict_is_undecided_if_mitsuba_is_wrong():
    scene, image = render_four_spheres()
    image[:20] += 0.01
    result = compare_to(scene, image)
    assert (result.verdict, result.is_disputed.sum()) == ("undecided", 1600)
    assert 50 <= result.is_examined.sum() <= 100
    assert result.metrics.max == pytest.approx(0.01, rel=0.05)
    assert f"scene: undecided\n  SSIM {result.metrics.ssim:.6f}" in result.format_report()
    message = "the pictures differ in 1,600 pixels, for example at column 0, row 0"
    assert message in result.format_report()


def test_the_verdict_is_differs_if_the_tracer_is_wrong(monkeypatch):
    scene, image = render_four_spheres()
    wrong = image.copy()
    wrong[7, 3] += 2e-4
    replace_tracer(monkeypatch, wrong)
    # Mitsuba is wrong, too, in other pixels.
    image[50:, 70:] += 0.01
    monkeypatch.setattr(exact, "_PIXELS_PER_BATCH", 5000)
    result = compare_to(scene, image)
    assert (result.verdict, np.argwhere(result.is_wrong).tolist()) == ("DIFFERS", [[7, 3]])
    assert "row 7\n  exact arithmetic contradicts the tracer in 1 of 101" in result.format_report()


@pytest.mark.parametrize("figure", ["SSIM", "median difference"])
@pytest.mark.parametrize("tracer_errs", [True, False])
def test_pictures_that_differ_too_much_as_a_whole(monkeypatch, figure, tracer_errs):
    """No pixel exceeds the tolerance, so exact arithmetic is used with a smaller one."""
    scene, image = render_four_spheres()
    wrong, is_dark = image.copy(), image.max(axis=2) == 0
    if figure == "SSIM":  # a chequered sky
        wrong[is_dark & (np.indices(is_dark.shape).sum(axis=0) % 5 == 0)] = 9e-5
    else:
        wrong += 5e-6
    if tracer_errs:
        replace_tracer(monkeypatch, wrong)
    result = compare_to(scene, image if tracer_errs else wrong)
    assert any(
        line.startswith(figure) for line in check.describe_exceeded_tolerances(result.metrics)
    )
    assert result.verdict == ("DIFFERS" if tracer_errs else "undecided")
    if not tracer_errs:
        assert compare_to(scene, image + 5e-7 * (image > 0)).verdict == "agrees"


# Tolerances


def test_tolerances_of_whole_pictures():
    def describe(ssim: float, median: float) -> list[str]:
        metrics = Metrics(ssim=ssim, max=0, percentile=0, rmse=0, median=median, differing_count=0)
        return check.describe_exceeded_tolerances(metrics)

    assert describe(0.99901, 0.99e-6) == []
    assert describe(0.99899, 0) == ["SSIM 0.99899 is below 0.999"]
    assert describe(1, 1.01e-6) == ["median difference 1.0e-06 exceeds 1e-06"]


@pytest.mark.parametrize(("error", "verdict"), [(0.9e-4, "agrees"), (1.1e-4, "undecided")])
def test_tolerance_of_a_pixel(error, verdict):
    scene, image = render_four_spheres()
    image[7, 3] += error
    assert compare_to(scene, image).verdict == verdict


def build_plate(distance: float, height: float) -> Scene:
    """Return a scene of a plate with an edge at this distance from the centres of column 17.

    The distance is in pixels, to the right.
    """
    pixel = 0.3 / 24 * 5  # width of a pixel in the plane of the plate
    edge = (5.5 + distance) * pixel
    return close_up(Box(min_pt=(-0.3, -height / 2, 0), max_pt=(edge, height / 2, 0)))


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("distance", "verdict"), [(0.0027, "agrees"), (0.0033, "undecided")])
def test_tolerance_of_the_distance_to_an_edge(side, distance, verdict):
    """The edge crosses few pixels, which may be excluded."""
    other_image = render(build_plate(side * -0.01, 0.38))
    result = compare_to(build_plate(side * distance, 0.38), other_image)
    assert result.verdict == verdict
    assert (result.differs_at_edge if verdict == "agrees" else result.is_disputed)[:, 17].sum() == 6


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("distance", "verdict"), [(1e-8, "agrees"), (1e-4, "DIFFERS")])
def test_the_tracer_may_err_if_an_edge_is_at_a_centre(monkeypatch, side, distance, verdict):
    """The edge crosses 4 % of the pixels: too many to be excluded without exact arithmetic."""
    scene = build_plate(side * distance, 2)
    image = render(scene)
    replace_tracer(monkeypatch, render(build_plate(side * -0.01, 2)))
    assert compare_to(scene, image).verdict == verdict


def test_a_bright_pixel_does_not_increase_the_tolerance(monkeypatch):
    """Whichever of the two pictures it is in."""
    scene, image = render_four_spheres()
    bright = image.copy()
    bright[0, 0] = 100
    bright[7, 3] += 1e-3
    assert compare_to(scene, bright).is_disputed.sum() == 2
    replace_tracer(monkeypatch, bright)
    assert compare_to(scene, image).is_disputed.sum() == 2


def test_edges_that_differ_are_excluded_up_to_a_share():
    scene = load_small_scene(SCENES / "four-spheres.xml")
    image = render(scene)
    shifted = render(scene, offset=(0.03, 0.03))
    edges = np.abs(shifted - image).max(axis=2) > 1e-2
    assert 0 < edges.sum() <= 0.015 * edges.size
    result = compare_to(scene, np.where(edges[:, :, None], shifted, image), STOCK)
    assert (result.verdict, result.is_examined.any()) == ("agrees", False)
    assert np.array_equal(result.differs_at_edge, edges)
    assert result.metrics.max < 1e-4
    # A value that the tracer computes on neither side of an edge is not excluded.
    assert compare_to(scene, image + 2 * edges[:, :, None], STOCK).verdict == "undecided"
    # More than one in fifty pixels are too many.
    shifted = render(scene, offset=(0.18, 0.18))
    edges = np.abs(shifted - image).max(axis=2) > 1e-2
    assert 0.02 < edges.mean() < 0.03
    result = compare_to(scene, np.where(edges[:, :, None], shifted, image), Limits(1e-3, 0.18))
    assert (result.verdict, result.differs_at_edge.sum()) == ("undecided", 0)


def test_edges_on_which_both_agree_are_not_excluded():
    # The pixels are so tall that many contain an edge near the centre.
    scene = replace(load_scene(SCENES / "room.xml"), width=1, height=96)
    result = check_scene(scene, "thin")
    assert check.find_pixels_near_edges(scene, result.tracer_image, 0.003, 0).mean() > 0.05
    assert (result.verdict, result.is_excluded.any()) == ("agrees", False)


# False alarms


def build_hostile_scene(seed: int) -> Scene:
    """Return a scene that is hard for float32: every third has many lights, or flat boxes."""
    kinds = [kind for kind in KINDS if kind != "crowd"]
    scene, rng = random_scene(kinds[seed % len(kinds)], seed, 64, 48), np.random.default_rng(seed)
    if seed % 3 == 0:
        positions = rng.normal(size=(rng.integers(8, 21), 3)) * 4
        more = [PointLight(position=p, intensity=rng.uniform(0.02, 0.1, 3)) for p in positions]
        scene = replace(scene, lights=[*scene.lights, *more])
    if seed % 3 == 1:
        axis = np.eye(3)[rng.integers(3)]
        flat = [
            replace(s, max_pt=np.where(axis, s.min_pt, s.max_pt)) if isinstance(s, Box) else s
            for s in scene.surfaces
        ]
        scene = replace(scene, surfaces=flat)
    return scene


SEEDS = [
    range(4),
    *(pytest.param(range(n, n + 14), marks=pytest.mark.slow) for n in range(4, 102, 14)),
]


@pytest.mark.parametrize("seeds", SEEDS)
def test_hostile_scenes_raise_no_false_alarm(seeds):
    # Mitsuba's float32 errs in most grazing scenes and beside huge balls, and in few others.
    results = [
        checked(build_hostile_scene(seed), str(seed), SCALAR)
        for seed in seeds
        for checked in (check_scene, check_diffuse_light)
    ]
    use_variant()
    assert [result.format_report() for result in results if result.verdict == "DIFFERS"] == []
    assert sum(result.verdict == "agrees" for result in results) >= len(results) / 2


def test_near_ties_of_float64_are_not_mistakes_of_the_tracer():
    """A huge ball touches the floor: around that point their gap is lost in rounding."""
    red, floor = Lambertian(diffuse=(1, 0, 0)), Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9))
    ground = Sphere(center=(0, -65536, 0), radius=65536, shader=red)
    camera = Camera(view_point=(0, 0.007, 0), view_dir=(0, -1, 0), view_up=(0, 0, 1),
                    view_width=0.04, view_height=0.04)  # fmt: skip
    scene = scene_of(ground, floor, camera=camera, size=(24, 96), lights=(3, 4, 5))
    # All pixels but the point of contact show the floor.
    result = compare_to(scene, render(replace(scene, surfaces=[floor])))
    assert result.verdict == "agrees"
    assert result.is_tie.any()


# The command, and the report


VARIANT = ["--variant", SCALAR]


@pytest.mark.parametrize(
    ("flavour", "verdict"),
    [
        ("exact", ": agrees"),
        pytest.param("stock", ", diffuse light by stock plugins: agrees", marks=pytest.mark.slow),
    ],
)
def test_the_command_prints_the_result_and_writes_the_comparison(odd_file, flavour, verdict):
    arguments = "--flavour", flavour, odd_file, "-o", f"{odd_file.parent}/new/"
    environment = {"DRJIT_LIBLLVM_PATH": "/nonexistent", "PYTHONIOENCODING": "utf-8"}
    status, out, err = run(*arguments, python=("-m", "reference.check"), env=environment)
    assert status == 0, err
    assert f"Mitsuba variant {SCALAR}: no usable libLLVM" in out
    assert f"\\udcff\\n{verdict}" in out
    middle = "" if flavour == "exact" else f".{flavour}"
    with Image.open(odd_file.parent / "new" / f"{odd_file.stem}{middle}.check.png") as picture:
        assert picture.width > 3 * 40


@pytest.mark.parametrize(
    ("command", "written"), [(check.main, "small.check.png"), (report.main, "report.html")]
)
@pytest.mark.parametrize(
    ("mitsuba_error", "tracer_error", "status", "verdict"),
    [(0, 0.01, 1, "DIFFERS"), (0.01, 0, 3, "undecided"), (0, 0, 0, "agrees")],
)
def test_the_status_of_the_commands_is_that_of_the_verdict(
    small_file, monkeypatch, capsys, command, written, mitsuba_error, tracer_error, status, verdict
):
    image = render(load_scene(small_file))
    rendering = Rendering(image + mitsuba_error, "scalar_rgb", 0.0)
    monkeypatch.setattr(check, "load_into_mitsuba", Mock(return_value=lambda: rendering))
    replace_tracer(monkeypatch, image + tracer_error)
    assert command([*VARIANT, str(small_file), "-o", f"{small_file.parent}/made/"]) == status
    assert command is report.main or f"small: {verdict}\n" in capsys.readouterr().out
    assert file_names(small_file.parent / "made") == [written]


def test_the_status_after_several_scenes_is_the_worst():
    verdicts = "agrees", "DIFFERS", "undecided"
    agrees, differs, undecided = (SimpleNamespace(verdict=verdict) for verdict in verdicts)
    assert check.choose_exit_status([]) == 0
    assert check.choose_exit_status([undecided, agrees]) == 3
    assert check.choose_exit_status([agrees, differs, undecided]) == 1
    assert check.choose_exit_status([undecided, Failure("a.xml", "cannot be read")]) == 1


@pytest.mark.parametrize("command", [check.main, report.main])
def test_scenes_after_one_that_cannot_be_compared_are_compared(small_file, capsys, command):
    bright = shutil.copy(HARD_SCENES / "brighter-than-float32.xml", small_file.parent)
    missing = str(small_file.with_name("missing.xml"))
    made = small_file.parent / "made"
    assert command([*VARIANT, bright, missing, str(small_file), "-o", f"{made}/"]) == 1
    captured = capsys.readouterr()
    first, second = captured.err.splitlines()
    assert first == (
        f"{bright}: cannot be compared: Mitsuba's radiance is not finite;"
        " keep the colours and lights of the scene closer to 1"
    )
    assert second.startswith(f"{missing}: cannot be read: ")
    if command is check.main:
        assert "small: agrees" in captured.out
    else:
        text = (made / "report.html").read_text(encoding="utf-8")
        assert text.count('<section class="scene"') == 1
        assert "<p>1 scene, " in text
        assert '<strong class="bad">1 agree.</strong>' in text
        assert "Where methods fail" not in text, "charts belong to the project's own scenes"
        assert f"Not compared: {first}" in text.replace("&#39;", "'")
        assert text.count("Not compared: ") == 2


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RuntimeError("Mitsuba\n  is lost"), "Mitsuba is lost"),
        (RuntimeError(), "RuntimeError"),
        (MemoryError(), "not enough memory; make the image smaller"),
        (ChildProcessError(9), "not enough memory; make the image smaller"),
    ],
)
def test_an_error_of_mitsuba_is_reported_in_a_line(small_file, monkeypatch, capsys, error, message):
    monkeypatch.setattr(check, "load_into_mitsuba", Mock(side_effect=error))
    assert check.main([*VARIANT, str(small_file)]) == 1
    assert capsys.readouterr().err == f"{small_file}: cannot be compared: {message}\n"
