"""The check against Mitsuba: its three verdicts, which pixels count, and its command.

What it makes of the project's scenes is in `test_cross_validation`, what it catches in
`test_mutations`.
"""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import scene_files
from PIL import Image
from probe import close_up, scale_and_shift, scene_of
from random_scenes import KINDS, random_scene
from running import file_names, run

from converters.rendering import Rendering
from converters.variant import SCALAR, use
from reference import check, report
from reference.check import STOCK, Limits, check_diffuse, check_scene, compare, main, near_edges
from reference.command import SCENES
from reference.regenerate import load_small
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, load_scene, render

BALL, DOT = Sphere(), Sphere(radius=0.3)
WALL = Box(min_pt=(-1, -1.2, -1), max_pt=(1.1, 1, 0))
PLATE = Box(min_pt=(-0.3, -0.3, 0), max_pt=(0.3, 0.3, 0))
RED_WALL = replace(WALL, shader=Lambertian(diffuse=(1, 0, 0)))
NARROW = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=1e5)

ODD = {
    "nothing": close_up(),
    "flat box": close_up(PLATE),
    "twice the same": close_up(DOT, DOT),
    "bright": close_up(replace(DOT, shader=Phong(exponent=0, specular=(2, 0, 0)))),
    # A narrow highlight keeps its digits in float32.
    "narrow": replace(
        close_up(replace(WALL, shader=NARROW)),
        **{"lights": (PointLight(position=(0.02, 0.01, 5)),), "width": 200, "height": 200},
    ),
    # Limits are relative in bright pictures.
    "brighter": replace(
        close_up(BALL), lights=(PointLight(position=(3, 4, 5), intensity=(300,) * 3),)
    ),
    # Rays start on a box around the scene, and it on none of its sides.
    **{
        f"along {axis}": scene_of(
            WALL,
            camera=Camera(view_point=5 * axis, view_dir=-axis, view_up=np.roll(axis, 1)),
            size=(24, 24),
            lights=[PointLight(position=9 * axis)],
        )
        for axis in (*np.eye(3), *-np.eye(3))
    },
    # Shadow rays start at lamps, which hang on surfaces.
    "lamp": replace(
        close_up(Box(min_pt=(-9, -9, -9), max_pt=(9, -1, 9)), PLATE, light=(0.1, -0.3, 0)),
        camera=Camera(view_point=(0, 1, 5), view_dir=(0, -0.4, -1)),
    ),
    "sun": close_up(BALL, light=(3e20, 5e20, 4e20)),
    # What is written is ten units large, even where float32 could not hold the scene.
    "tiny": scale_and_shift(close_up(DOT), 1e-45),
    "enormous": scale_and_shift(close_up(DOT), 1e45),
    **{
        f"{kind} {seed}": random_scene(kind, seed, 64, 48)
        for kind in ("scattered", "rooms", "far", "walled", "crowd")
        for seed in (1, 2)
    },
}


@pytest.mark.parametrize("name", ODD)
def test_odd_scenes_agree(name):
    result = check_scene(ODD[name], name)
    assert (result.verdict, result.remarks) == ("agrees", [])
    assert result.tracer.max() > {"nothing": -1, "brighter": 200}.get(name, 0.3)


def by_mitsuba(image: np.ndarray) -> Rendering:
    return Rendering(image, "scalar_rgb", 0.0)


def four_spheres() -> tuple[Scene, np.ndarray]:
    scene = scene_files.small("four-spheres", 80, 60)
    return scene, render(scene)


def test_ties_are_explained_pixel_by_pixel(monkeypatch):
    """A red box is in the place of a white one: Mitsuba may show either, but nothing else."""
    scene = close_up(RED_WALL, WALL)
    image, other = render(scene), render(close_up(WALL, RED_WALL))
    assert image[..., 1].max() == 0
    seen = image.copy()
    seen[5:, :9] = other[5:, :9]
    result = compare(scene, "walls", by_mitsuba(seen))
    assert (result.verdict, result.ties.sum(), result.figures.max) == ("agrees", 19 * 9, 0)
    assert np.array_equal(result.mitsuba, seen)
    assert "shows the other of surfaces that tie on 171 pixels" in result.report()
    # All of a picture may be ties; one pixel that is none is not drowned by them.
    assert compare(scene, "walls", by_mitsuba(other)).ties.all()
    seen = other.copy()
    seen[23, 23] = 0.5  # in the last of the parts that are asked about
    result = compare(scene, "walls", by_mitsuba(seen))
    assert (result.verdict, result.differing.sum(), result.first) == ("undecided", 1, (23, 23))
    # Of surfaces that tie the tracer has to show the first.
    wrong = compare(replace(scene, surfaces=scene.surfaces[::-1]), "walls", by_mitsuba(other))
    assert (wrong.verdict, wrong.differing.sum()) == ("agrees", 0)
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: other)
    assert compare(scene, "walls", by_mitsuba(image)).verdict == "DIFFERS"


def test_where_mitsuba_errs_the_verdict_is_undecided():
    scene, image = four_spheres()
    image[:20] += 0.01
    result = compare(scene, "off", by_mitsuba(image))
    assert (result.verdict, result.wrong, result.differing.sum()) == ("undecided", 0, 1600)
    assert 50 <= result.asked <= 100
    assert result.figures.max == pytest.approx(0.01, rel=0.05)
    wrong = "Mitsuba or the converter is wrong on 1,600 pixels, the first at column 0, row 0"
    assert f"off: undecided\n  SSIM {result.figures.ssim:.6f}" in result.report()
    assert wrong in result.report()


def test_where_the_tracer_errs_the_verdict_is_differs(monkeypatch):
    scene, image = four_spheres()
    wrong = image.copy()
    wrong[7, 3] += 2e-4
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    # Beside pixels on which Mitsuba errs.
    image[50:, 70:] += 0.01
    monkeypatch.setattr(check, "_AT_A_TIME", 5000)
    result = compare(scene, "off", by_mitsuba(image))
    assert (result.verdict, result.wrong, result.first) == ("DIFFERS", 1, (7, 3))
    assert "against the tracer on 1 of 101 pixels that it was asked about" in result.report()


@pytest.mark.parametrize("figure", ["SSIM", "median difference"])
@pytest.mark.parametrize("tracer_errs", [True, False])
def test_pictures_that_are_too_far_apart_as_a_whole(monkeypatch, figure, tracer_errs):
    """No pixel is off by the limit: exact arithmetic is asked more closely."""
    scene, image = four_spheres()
    wrong, dark = image.copy(), image.max(axis=2) == 0
    if figure == "SSIM":  # a chequered sky
        wrong[dark & (np.indices(dark.shape).sum(axis=0) % 5 == 0)] = 9e-5
    else:
        wrong += 5e-6
    if tracer_errs:
        monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    result = compare(scene, "far", by_mitsuba(image if tracer_errs else wrong))
    assert any(fault.startswith(figure) for fault in check.faults(result.figures))
    assert result.verdict == ("DIFFERS" if tracer_errs else "undecided")
    if not tracer_errs:
        assert compare(scene, "near", by_mitsuba(image + 5e-7 * (image > 0))).verdict == "agrees"


def test_edges_that_differ_are_left_out_up_to_a_share():
    scene = load_small(SCENES / "four-spheres.xml")
    image = render(scene)
    aside = render(scene, offset=(0.03, 0.03))
    edges = np.abs(aside - image).max(axis=2) > 1e-2
    assert 0 < edges.sum() <= 0.015 * edges.size
    aside = np.where(edges[:, :, None], aside, image)
    result = compare(scene, "edges", by_mitsuba(aside), STOCK)
    assert (result.verdict, result.asked) == ("agrees", 0)
    assert np.array_equal(result.edges, edges)
    assert result.figures.max < 1e-4
    # What the tracer sees on neither side of an edge is no matter of rounding.
    seen = image + 2 * edges[:, :, None]
    assert compare(scene, "edges", by_mitsuba(seen), STOCK).verdict == "undecided"
    # More than one in fifty pixels are too many.
    scale_and_shift = render(scene, offset=(0.18, 0.18))
    far = np.abs(scale_and_shift - image).max(axis=2) > 1e-2
    assert 0.02 < far.mean() < 0.03
    scale_and_shift = np.where(far[:, :, None], scale_and_shift, image)
    result = compare(scene, "edges", by_mitsuba(scale_and_shift), Limits(1e-3, 0.18))
    assert (result.verdict, result.edges.sum()) == ("undecided", 0)


def test_edges_on_which_both_agree_are_not_left_out():
    # In pixels so tall a sample that moves a little meets an edge in many.
    scene = replace(load_scene(SCENES / "room.xml"), width=1, height=96)
    result = check_scene(scene, "thin")
    assert near_edges(scene, result.tracer, 0.003, 0).mean() > 0.05
    assert (result.verdict, result.left_out.any()) == ("agrees", False)


def hostile_scene(seed: int) -> Scene:
    """A scene that is hard for float32: of any kind; every third with many lights, or flat."""
    kinds = [kind for kind in KINDS if kind != "crowd"]
    scene, rng = random_scene(kinds[seed % len(kinds)], seed, 64, 48), np.random.default_rng(seed)
    if seed % 3 == 0:
        places = rng.normal(size=(rng.integers(8, 21), 3)) * 4
        more = [PointLight(position=p, intensity=rng.uniform(0.02, 0.1, 3)) for p in places]
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
    *(pytest.param(range(n, n + 14), marks=pytest.mark.slow) for n in range(4, 200, 14)),
]


@pytest.mark.parametrize("seeds", SEEDS)
def test_hostile_scenes_raise_no_false_alarm(seeds):
    # Mitsuba's float32 errs in most grazing scenes and beside huge balls, in few others.
    results = [
        checked(hostile_scene(seed), str(seed), SCALAR)
        for seed in seeds
        for checked in (check_scene, check_diffuse)
    ]
    use()
    assert [result.report() for result in results if result.verdict == "DIFFERS"] == []
    assert sum(result.verdict == "agrees" for result in results) >= len(results) / 2


def test_near_ties_of_float64_are_no_mistakes_of_the_tracer():
    """A huge ball that touches the floor: beside that point their gap is lost in rounding."""
    red, floor = Lambertian(diffuse=(1, 0, 0)), Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9))
    ground = Sphere(center=(0, -65536, 0), radius=65536, shader=red)
    camera = Camera(view_point=(0, 0.007, 0), view_dir=(0, -1, 0), view_up=(0, 0, 1),
                    view_width=0.04, view_height=0.04)  # fmt: skip
    scene = scene_of(ground, floor, camera=camera, size=(24, 96), lights=(3, 4, 5))
    white = render(replace(scene, surfaces=[floor]))
    # All but the point of contact is the floor's.
    result = compare(scene, "contact", by_mitsuba(white))
    assert result.verdict == "agrees"
    assert result.ties.any()


VARIANT = ["--variant", SCALAR]


@pytest.mark.parametrize(
    ("flavour", "said"),
    [
        ("exact", ": agrees"),
        pytest.param("stock", ", diffuse light by stock plugins: agrees", marks=pytest.mark.slow),
    ],
)
def test_command_reports_and_writes_the_comparison(odd, flavour, said):
    arguments = "--flavour", flavour, odd, "-o", f"{odd.parent}/new/"
    none = {"DRJIT_LIBLLVM_PATH": "/nonexistent", "PYTHONIOENCODING": "utf-8"}
    status, out, err = run(*arguments, python=("-m", "reference.check"), env=none)
    assert status == 0, err
    assert f"Mitsuba variant {SCALAR}: no usable libLLVM" in out
    assert f"\\udcff\\n{said}" in out
    middle = "" if flavour == "exact" else f".{flavour}"
    with Image.open(odd.parent / "new" / f"{odd.stem}{middle}.check.png") as picture:
        assert picture.width > 3 * 40


@pytest.mark.parametrize(
    ("command", "made"), [(main, "small.check.png"), (report.main, "report.html")]
)
@pytest.mark.parametrize(
    ("wrong", "status", "verdict"),
    [((0, 0.01), 1, "DIFFERS"), ((0.01, 0), 3, "undecided"), ((0, 0), 0, "agrees")],
)
def test_commands_end_with_the_status_of_the_verdict(
    small, monkeypatch, capsys, command, made, wrong, status, verdict
):
    by_mitsuba_too, by_tracer = wrong
    image = render(load_scene(small))
    drawn = Mock(return_value=lambda: by_mitsuba(image + by_mitsuba_too))
    monkeypatch.setattr(check, "load", drawn)
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: image + by_tracer)
    assert command([*VARIANT, str(small), "-o", f"{small.parent}/made/"]) == status
    assert command is report.main or f"small: {verdict}\n" in capsys.readouterr().out
    assert file_names(small.parent / "made") == [made]


@pytest.mark.parametrize("command", [main, report.main])
def test_what_cannot_be_compared_is_told_and_spares_the_others(small, capsys, command):
    bright, missing = scene_files.overflowing(small), str(small.with_name("missing.xml"))
    made = small.parent / "made"
    assert command([*VARIANT, str(bright), missing, str(small), "-o", f"{made}/"]) == 1
    captured = capsys.readouterr()
    first, second = captured.err.splitlines()
    assert first == (
        f"{bright}: Mitsuba's radiance is not finite;"
        " keep the colours and lights of the scene closer to 1"
    )
    assert second.startswith(f"{missing}: cannot be read: ")
    if command is main:
        assert "small: agrees" in captured.out
    else:
        text = (made / "report.html").read_text(encoding="utf-8")
        assert text.count('<section class="scene"') == 1
        assert "<p>1 scene, " in text
        assert "All agree." not in text
        assert f"Not compared: {first}" in text.replace("&#39;", "'")
        assert text.count("Not compared: ") == 2


def test_a_comparison_that_cannot_be_written_is_told(small, capsys):
    assert main([*VARIANT, str(small), "-o", f"{small}/x.png"]) == 1
    wrong = f"{small}/x.png: cannot be written: Not a directory\n"
    assert capsys.readouterr().err == wrong


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (RuntimeError("Mitsuba\n  is lost"), "Mitsuba is lost"),
        (RuntimeError(), "RuntimeError"),
        (MemoryError(), "not enough memory; make the image smaller"),
        (ChildProcessError(9), "not enough memory; make the image smaller"),
    ],
)
def test_what_mitsuba_stumbles_over_is_told_in_a_line(small, monkeypatch, capsys, error, line):
    monkeypatch.setattr(check, "check", Mock(side_effect=error))
    assert main([*VARIANT, str(small)]) == 1
    assert capsys.readouterr().err == f"{small}: {line}\n"
