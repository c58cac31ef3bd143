"""The converter: its command line, and that Mitsuba reads what it writes and sees the same."""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from messages import told
from PIL import Image
from probe import close_up, moved
from scene_files import ONE_SPHERE, overflowing, small_one

from converters.flavours import WRITTEN, exact, normalisation, square_height, stock
from converters.rendering import render_mitsuba
from converters.to_mitsuba import main
from converters.variant import SCALAR, use
from converters.visible import bounds, visible_points
from reference.command import own_scenes
from reference.compare import figures
from reference.regenerate import load_small
from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    Sphere,
    Surfaces,
    load_scene,
    render,
)
from tracer.image import PNG

ROOT = Path(__file__).resolve().parent.parent
SCENES = own_scenes()


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "converters.to_mitsuba", *arguments]


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The converter as a process of its own."""
    return subprocess.run(
        command(*arguments),
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scene that is soon rendered."""
    return small_one(tmp_path, "40 30")


# The command line.


@pytest.mark.parametrize(
    ("flavour", "name"), [([], "ball.mitsuba.xml"), (["--exact"], "ball.exact.mitsuba.xml")]
)
def test_writes_beside_the_scene(tmp_path: Path, flavour: list[str], name: str) -> None:
    scene = tmp_path / "ball.xml"
    scene.write_bytes(ONE_SPHERE.read_bytes())
    assert main([*flavour, str(scene)]) == 0
    written = tmp_path / name
    assert ET.parse(written).getroot().tag == "scene"
    assert {path.name for path in tmp_path.iterdir()} == {name, "ball.xml"}


def test_writes_several_to_a_folder_that_is_made(tmp_path: Path) -> None:
    assert main([str(SCENES[0]), str(SCENES[1]), "-o", f"{tmp_path}/made/"]) == 0
    names = {path.name for path in (tmp_path / "made").iterdir()}
    assert names == {f"{path.stem}.mitsuba.xml" for path in SCENES[:2]}


def test_a_bad_scene_is_told_and_spares_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.xml"
    bad.write_text("<scene><camera/><image>8 8</image><light/></scene>")
    assert main([str(bad), str(ONE_SPHERE), "-o", f"{tmp_path}/"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{bad}:1: light: ")
    assert (tmp_path / "one-sphere.mitsuba.xml").exists()
    assert not (tmp_path / "bad.mitsuba.xml").exists()


@pytest.mark.parametrize("name", [".", "/", "loop"])
def test_a_path_that_is_no_file_spares_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    name = str(tmp_path / name) if name == "loop" else name
    assert main([name, str(ONE_SPHERE), "-o", f"{tmp_path}/"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{name}: ")
    assert error.count("\n") == 1
    assert (tmp_path / "one-sphere.mitsuba.xml").exists()


@pytest.mark.parametrize(
    ("what", "line"),
    [([], ".mitsuba.xml: stock flavour"), (["--check", "--variant", SCALAR], ": agrees")],
)
def test_names_that_are_not_text_are_escaped(small: Path, what: list[str], line: str) -> None:
    odd = small.rename(os.fsdecode(os.fsencode(small.parent) + b"/\xff\n.xml"))
    done = run(*what, str(odd), PYTHONIOENCODING="utf-8")
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert f"\\udcff\\n{line}\n" in done.stdout


def test_names_that_the_terminal_cannot_show(small: Path) -> None:
    target = small.with_name("\u00e4.xml")
    done = run(str(small), "-o", str(target), PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{small.parent}/\\xe4.xml: stock flavour\n"
    assert target.exists()


@pytest.mark.parametrize(
    ("name", "reason"),
    [("missing/x.xml", "No such file or directory"), ("x" * 300, "File name too long")],
)
def test_what_cannot_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, reason: str
) -> None:
    target = tmp_path / name
    assert main([str(ONE_SPHERE), "-o", str(target)]) == 1
    assert capsys.readouterr().err == f"{target}: cannot be written: {reason}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", [[], ["--check", "--variant", SCALAR]])
def test_no_one_reads_the_output(small: Path, what: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    target = small.with_name("written")
    try:
        done = subprocess.run(
            command(*what, str(small), "-o", str(target)),
            cwd=ROOT,
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
        )
    finally:
        os.close(write)
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "cannot be written" not in done.stderr
    assert target.exists()


def test_no_room_for_the_output(small: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(str(small)), cwd=ROOT, stdout=full, stderr=subprocess.PIPE, timeout=120
        )
    assert (done.returncode, done.stderr) == (0, b"")
    assert small.with_name("small.mitsuba.xml").exists()


def children(process: subprocess.Popen[str]) -> str:
    """The processes that it has started."""
    return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()


@pytest.mark.usefixtures("signals_heeded")
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
@pytest.mark.parametrize("when", ["numpy is imported", "the variant is probed"])
def test_an_interrupt(small: Path, kind: signal.Signals, when: str) -> None:
    process = subprocess.Popen(
        command("--check", str(small)),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    loaded = Path(f"/proc/{process.pid}/maps")
    while not (
        "_multiarray_umath" in loaded.read_text()
        if when == "numpy is imported"
        else children(process)
    ):
        assert process.poll() is None
    process.send_signal(kind)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (130, "")
    assert told(err) == ""
    assert list(small.parent.iterdir()) == [small]


@pytest.mark.parametrize("what", [[], ["--render"], ["--check"]])
def test_what_is_no_regular_file_stays(
    small: Path, capsys: pytest.CaptureFixture[str], what: list[str]
) -> None:
    pipe = small.with_name("pipe")
    os.mkfifo(pipe)
    assert main([*what, str(small), "-o", str(pipe)]) == 1
    assert capsys.readouterr().err == f"{pipe}: cannot be written: not a regular file\n"
    assert pipe.is_fifo()
    assert sorted(small.parent.iterdir()) == [pipe, small]


@pytest.mark.parametrize("what", [[], ["--render"], ["--check"]])
def test_what_is_of_another_kind_stays(
    small: Path, capsys: pytest.CaptureFixture[str], what: list[str]
) -> None:
    other = small.with_name("other.xml")
    other.write_text("<scene>")
    assert main([*what, str(small), "-o", str(other)]) == 1
    assert (
        capsys.readouterr().err == f"{other}: cannot be written: a file of another kind is there\n"
    )
    assert other.read_text() == "<scene>"
    assert sorted(small.parent.iterdir()) == [other, small]


@pytest.mark.parametrize(("named", "bad"), [("x.png", "x.exr"), ("x.exr", "x.png")])
def test_the_file_that_cannot_be_written_is_the_one_told(
    small: Path, capsys: pytest.CaptureFixture[str], named: str, bad: str
) -> None:
    folder = small.with_name(bad)
    folder.mkdir()
    assert main(["--render", str(small), "-o", str(small.with_name(named))]) == 1
    assert capsys.readouterr().err == f"{folder}: cannot be written: not a regular file\n"


@pytest.mark.parametrize(
    ("what", "written", "magic"),
    [
        ([], "x.xml", WRITTEN.encode()),
        (["--render"], "x.png", PNG),
        (["--render"], "x.exr", b"\x76\x2f\x31\x01"),
        (["--check"], "x.png", PNG),
    ],
)
def test_links_are_followed(small: Path, what: list[str], written: str, magic: bytes) -> None:
    (small.parent / "real").write_bytes(magic + b"old")
    (small.parent / written).symlink_to("real")
    target = small.with_name("x.png" if what else "x.xml")
    variant = ["--variant", SCALAR] if what else []
    assert main([*what, *variant, str(small), "-o", str(target)]) == 0
    assert (small.parent / written).is_symlink()
    assert (small.parent / "real").read_bytes().startswith(magic)
    use()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.xml", "b.xml", "-o", "c.xml"], "several scenes need a folder"),
        (
            ["a/x.xml", "b/x.xml", "-o", "/tmp"],
            "/tmp/x.mitsuba.xml: a/x.xml and b/x.xml would both be written there",
        ),
        (["a.xml", "-o", "a.xml"], "would replace a scene"),
        (["--render", "a.exr", "-o", "a.png"], "would replace a scene"),
        (["a.xml", "--samples", "0"], "must be a whole number from 1 to 999999999, is '0'"),
        (["a.xml", "--check", "--samples", "4"], "it takes no --samples"),
        (["a.xml", "--check", "--render"], "not allowed with"),
        (["a.xml", "--variant", "nope"], "--variant is for --render and --check"),
        (["a.xml", "-o", ""], "argument -o/--output: the name is empty; name a file"),
        (["a.xml", ""], "argument SCENE.xml: the name is empty; name a file"),
        ([], "the following arguments are required: SCENE.xml"),
    ],
)
def test_wrong_usage_ends_with_status_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert message in capsys.readouterr().err


def test_converting_needs_no_mitsuba(tmp_path: Path) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ImportError('not installed')")
    done = run(str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    done = run("--render", str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (1, "Mitsuba cannot run: not installed\n")


@pytest.mark.parametrize("option", ["--exact", "--check"])
def test_without_numpy(tmp_path: Path, option: str) -> None:
    (tmp_path / "numpy.py").write_text("raise ModuleNotFoundError('No module named numpy')")
    done = run(option, str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert re.fullmatch("(.*: )?No module named numpy; install it with .*\n", done.stderr)


@pytest.mark.parametrize(
    ("module", "stub", "reason"),
    [
        (
            "mitsuba",
            "raise ModuleNotFoundError('No module named mitsuba')",
            "No module named mitsuba; install it with pip install -e '.[reference]'",
        ),
        (
            "skimage",
            "raise ModuleNotFoundError('No module named skimage')",
            "No module named skimage; install it with pip install -e '.[reference]'",
        ),
        # As drjit ends where a library of the system is missing.
        (
            "mitsuba",
            "try:\n    raise ImportError('libatomic.so.1: cannot open shared object file')\n"
            "except ImportError:\n    extension",
            "libatomic.so.1: cannot open shared object file",
        ),
    ],
)
def test_what_mitsuba_lacks_is_told(module: str, stub: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / f"{module}.py").write_text(stub)
    done = run("--check", str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, told(done.stderr)) == (1, f"Mitsuba cannot run: {reason}\n")


def test_render_writes_a_png_and_an_exr(small: Path, tmp_path: Path) -> None:
    assert main(["--render", "--samples", "4", "--variant", SCALAR, str(small)]) == 0
    mi = importlib.import_module("mitsuba")
    exr = np.array(mi.Bitmap(str(tmp_path / "small.mitsuba.exr")))
    shown = np.asarray(Image.open(tmp_path / "small.mitsuba.png"))
    assert exr.shape == shown.shape == (30, 40, 3)
    np.testing.assert_array_equal(shown, np.round(255 * np.clip(exr, 0, 1) ** (1 / 2.2)))
    use()


@pytest.mark.parametrize("name", ["x.png", "x.exr"])
def test_either_file_of_a_rendering_may_be_named(small: Path, name: str) -> None:
    assert (
        main(["--render", "--variant", SCALAR, str(small), "-o", str(small.with_name(name))]) == 0
    )
    assert {path.name for path in small.parent.iterdir()} == {"small.xml", "x.png", "x.exr"}
    assert small.with_name("x.png").read_bytes().startswith(b"\x89PNG")
    assert small.with_name("x.exr").read_bytes().startswith(b"\x76\x2f\x31\x01")
    use()


def test_names_with_dots_have_an_exr_each(small: Path) -> None:
    for name in ("room.v1", "room.v2", "A.EXR"):
        done = ["--render", "--variant", SCALAR, str(small), "-o", str(small.with_name(name))]
        assert main(done) == 0
    names = {path.name for path in small.parent.iterdir()} - {"small.xml"}
    assert names == {"room.v1", "room.v1.exr", "room.v2", "room.v2.exr", "A.png", "A.EXR"}
    assert small.with_name("A.EXR").read_bytes().startswith(b"\x76\x2f\x31\x01")
    use()


def test_check_reports_and_writes_the_comparison(tmp_path: Path) -> None:
    done = run("--check", str(ONE_SPHERE), "-o", f"{tmp_path}/", DRJIT_LIBLLVM_PATH="/nonexistent")
    assert done.returncode == 0, done.stderr
    assert f"Mitsuba variant {SCALAR}: no usable libLLVM" in done.stdout
    assert "one-sphere: agrees" in done.stdout
    with Image.open(tmp_path / "one-sphere.check.png") as picture:
        assert picture.width > 3 * 300


def test_check_ends_with_status_1_where_a_tolerance_is_broken(
    small: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("reference.check.MAX_DIFFERENCE", 1e-12)
    assert main(["--check", str(small)]) == 1
    told = capsys.readouterr().out
    assert "small: DIFFERS" in told
    assert "exceeds 1e-12" in told
    assert small.with_name("small.check.png").exists()


def test_a_radiance_that_overflows_is_told_and_spares_the_others(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bright = overflowing(small)
    assert main(["--check", str(bright), str(small)]) == 1
    captured = capsys.readouterr()
    assert captured.err == (
        f"{bright}: Mitsuba's radiance is not finite;"
        " keep the colours and lights of the scene closer to 1\n"
    )
    assert "small: agrees" in captured.out


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (RuntimeError("Mitsuba\n  is lost"), "Mitsuba is lost"),
        (RuntimeError(), "RuntimeError"),
        (MemoryError(), "not enough memory; make the image smaller"),
        (ChildProcessError(9), "not enough memory; make the image smaller"),
    ],
)
def test_what_mitsuba_stumbles_over_is_told_in_a_line(
    small: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    line: str,
) -> None:
    def fail(*_arguments: object) -> None:
        raise error

    monkeypatch.setattr("reference.check.check", fail)
    assert main(["--check", str(small)]) == 1
    assert capsys.readouterr().err == f"{small}: {line}\n"


@pytest.mark.parametrize("variant", ["nope", "scalar_spectral", "llvm_ad_mono", ""])
@pytest.mark.parametrize("what", ["--check", "--render"])
def test_variants_without_rgb_are_refused(
    small: Path, capsys: pytest.CaptureFixture[str], what: str, variant: str
) -> None:
    assert main([what, "--variant", variant, str(small)]) == 1
    error = capsys.readouterr().err
    shown = variant or "''"
    assert error.startswith(f"Mitsuba cannot run: {shown} is no RGB variant; choose one of ")
    assert SCALAR in error
    assert "spectral" not in error.partition("choose")[2]


# What Mitsuba makes of it.


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_plain_mitsuba_reads_the_stock_flavour(path: Path) -> None:
    """In a process without the plugins; and the picture is like the exact one."""
    scene = replace(load_small(path), width=48, height=27)
    loaded = importlib.import_module("mitsuba")
    use(SCALAR)
    image = np.array(loaded.render(loaded.load_string(stock(scene, 1))))
    use()
    square = round(48 * scene.camera.view_height / scene.camera.view_width)
    assert image.shape == (square, 48, 3)
    assert np.isfinite(image).all()
    assert image.max() > 0.05


def test_the_mitsuba_command_reads_the_stock_flavour(tmp_path: Path) -> None:
    scene = replace(load_scene(ONE_SPHERE), width=16, height=16)
    (tmp_path / "x.xml").write_text(stock(scene, 1), encoding="utf-8")
    command = Path(sys.executable).with_name("mitsuba")
    subprocess.run(
        [command, "-m", SCALAR, "x.xml"], cwd=tmp_path, check=True, capture_output=True, timeout=60
    )
    assert (tmp_path / "x.exr").exists()


@pytest.mark.parametrize("variant_first", [True, False])
def test_load_file_reads_the_exact_flavour_after_one_import(
    tmp_path: Path, variant_first: bool
) -> None:
    """With a variant set before the plugins are imported, or after, or both."""
    (tmp_path / "x.xml").write_text(exact(replace(load_scene(ONE_SPHERE), width=8, height=8)))
    set_variant, plugins = f"mi.set_variant({SCALAR!r})", "import converters.plugins"
    lines = [set_variant, plugins] if variant_first else [plugins, set_variant]
    code = "\n".join(
        ["import mitsuba as mi", *lines, "scene = mi.load_file('x.xml')",
         "assert mi.TensorXf(mi.render(scene)).array.__len__() == 192"]
    )  # fmt: skip
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
        timeout=60,
    )


def test_the_exact_flavour_asks_for_an_rgb_variant() -> None:
    text = exact(replace(load_scene(ONE_SPHERE), width=8, height=8))
    code = (
        "import mitsuba as mi\nmi.set_variant('scalar_spectral')\nimport converters.plugins\n"
        f"mi.load_string({text!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "needs an RGB variant of Mitsuba; scalar_spectral is none" in done.stderr


@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-15, 0), (1e-4, 0), (1e15, 0), (1, 1e4), (1, 1e8), (1e-3, 1)]
)
def test_stock_pictures_at_any_scale_and_place(scale: float, offset: float) -> None:
    scene = load_small(ROOT / "scenes" / "four-spheres.xml")
    use()
    mi = importlib.import_module("mitsuba")
    here, there = (
        np.array(mi.render(mi.load_string(stock(s, 16))), dtype=np.float64)
        for s in (scene, moved(scene, scale, (offset,) * 3))
    )
    assert figures(there, here).ssim > 0.99


def test_a_large_ground_is_not_speckled_in_the_stock_flavour() -> None:
    """Hit points err by a part of its radius, which Mitsuba's shadow rays do not heed."""
    ground, ball = Sphere(center=(0, -1e4, 0), radius=1e4), Sphere(center=(0, 0.3, -1), radius=0.5)
    scene = Scene(
        camera=Camera(view_point=(0, 1, 5)),
        width=60,
        height=60,
        lights=(PointLight(position=(3, 6, 4)),),
        surfaces=(ground, ball),
    )
    use()
    mi = importlib.import_module("mitsuba")
    image = np.array(mi.render(mi.load_string(stock(scene, 16))), dtype=np.float64)
    # It differs as the flavour does, whose light falls off.
    assert image.mean() == pytest.approx(render(scene).mean(), rel=0.1)
    assert figures(image, render(scene, samples=16)).ssim > 0.85


def test_a_planet_does_not_shrink_the_stock_scene_to_nothing() -> None:
    """Shadow rays start 1e-4 above surfaces, however small these are."""
    planet = Sphere(center=(0, -1e9, 0), radius=1e9 - 1)
    root = ET.fromstring(stock(close_up(planet, Sphere())))
    radii = sorted(
        float(m.get("value", "")) for m in root.iter("float") if m.get("name") == "radius"
    )
    assert radii == pytest.approx([1e-4, 1e5], rel=1e-6)


def test_a_light_may_be_as_far_away_as_the_sun() -> None:
    far = PointLight(position=(3e20, 5e20, 4e20))
    scene = replace(close_up(Sphere()), lights=(far,))
    use()
    np.testing.assert_allclose(render_mitsuba(scene), render(scene), rtol=0, atol=1e-6)


@pytest.mark.parametrize("flavour", [stock, exact])
def test_what_nothing_is_made_of_is_left_out(flavour: Callable[[Scene], str]) -> None:
    odd, plain = Phong(exponent=1e39), Lambertian(diffuse=(0.1, 0.2, 0.3))
    surfaces = Surfaces(
        center=np.zeros((1, 3)), radius=np.ones(1), sphere_shader=[1], shaders=[odd, plain]
    )
    scene = Scene(width=8, height=8, surfaces=surfaces)
    assert flavour(scene) == flavour(replace(scene, surfaces=[Sphere(shader=plain)])).replace(
        "bsdf0", "bsdf1"
    )


def test_more_samples_than_mitsuba_can_count() -> None:
    with pytest.raises(ValueError, match=r"^4294967296 samples are too many"):
        render_mitsuba(replace(close_up(), width=4, height=4), samples=1 << 28)


def test_stock_scenes_stay_where_they_are() -> None:
    for path in SCENES:
        assert "moved and scaled" not in stock(load_scene(path))
    assert "moved and scaled" in stock(moved(load_scene(ONE_SPHERE), 1, (1e6,) * 3))


def test_the_distance_at_which_a_stock_light_is_right_is_told() -> None:
    scene = replace(close_up(Sphere(radius=0.5)), lights=(PointLight(position=(300, 400, 500)),))
    told = re.findall(r"<!-- right at a distance of ([\d.]+) -->", stock(scene))
    assert [float(number) for number in told] == [pytest.approx(707, rel=2e-3)]


def test_stock_matte_picture_is_exact_at_the_distance_that_counts() -> None:
    """A small matte ball far from its light: fall-off hardly varies over it."""
    scene = close_up(Sphere(radius=0.5, shader=Lambertian(diffuse=(0.9, 0.5, 0.1))))
    scene = replace(scene, lights=(PointLight(position=(300, 400, 500), intensity=(0.7,) * 3),))
    mi = importlib.import_module("mitsuba")
    use()
    approximate = np.array(mi.render(mi.load_string(stock(scene, 256))), dtype=np.float64)
    # Over a hit at 707 units the distance varies by 1 in 700, its square by 1 in 350; and
    # 256 samples blur what the exact picture takes at the pixel's centre, so look inside.
    inside = np.s_[10:14, 10:14]
    np.testing.assert_allclose(
        approximate[inside], render_mitsuba(scene)[inside], rtol=5e-3, atol=1e-3
    )


def test_stock_highlight_has_the_right_height() -> None:
    """Eye and light in one direction: n = h = v at the centre, where the lobe is exact."""
    shader = Phong(diffuse=(0, 0, 0), specular=(0.6, 0.6, 0.6), exponent=40)
    scene = replace(close_up(Sphere(radius=0.5, shader=shader)), width=101, height=101)
    scene = replace(scene, lights=(PointLight(position=(0, 0, 500)),))
    mi = importlib.import_module("mitsuba")
    use()
    approximate = np.array(mi.render(mi.load_string(stock(scene, 16))), dtype=np.float64)
    # Over the central pixel, .015 wide, the normal turns by up to .02: (cos .02)^40 = .992.
    assert approximate[50, 50, 0] == pytest.approx(0.6, rel=0.01)


def test_boxes_keep_their_thickness_wherever_they_are() -> None:
    thin = Box(min_pt=(1e6, 2e6, -1e6), max_pt=(1e6 + 2, 2e6 + 0.5, -1e6 + 1))
    flat = Box(min_pt=(0, 0, 0), max_pt=(1, 1, 0))
    for flavour, scale in ((stock, 1.0), (exact, normalisation(close_up(thin, flat)).scale)):
        root = ET.fromstring(flavour(close_up(thin, flat)))
        halves = [[float(s.get(k, "")) for k in "xyz"] for s in root.iter("scale")]
        np.testing.assert_allclose(halves[0], np.array([1, 0.25, 0.5]) * scale, rtol=1e-9)
        assert halves[1][0] == pytest.approx(0.5 * scale)
        assert 0 < halves[1][2] < 3 * scale


# The stock flavour's camera and lights.


def test_the_window_may_be_measured_in_pixels() -> None:
    camera = Camera(view_point=(0, 0, 4), proj_distance=4000, view_width=3000, view_height=3000)
    root = ET.fromstring(stock(replace(close_up(Sphere()), camera=camera)))
    near, far = (float(root.find(f".//*[@name='{k}_clip']").get("value")) for k in ("near", "far"))
    assert near < 3
    assert far > 5


@pytest.mark.parametrize("z", [-1.0, 50.0])
@pytest.mark.parametrize("size", [1e-8, 1.0])
def test_lights_are_as_strong_as_needed_for_what_is_small_or_out_of_view(
    z: float, size: float
) -> None:
    ball = Sphere(center=(0.63 * size, 0.71 * size, z * size), radius=0.05 * size)
    camera = Camera(view_point=(0, 0, 9 * size), proj_distance=1, view_width=1, view_height=1)
    light = PointLight(position=(0, 20 * size, z * size))
    root = ET.fromstring(stock(replace(close_up(ball), camera=camera, lights=(light,))))
    strength = float(root.find(".//emitter/rgb").get("value").split()[0])
    # The scene may have been scaled.  Reflectances are halved, for blends.
    scale = float(root.find(".//shape/float").get("value")) / ball.radius
    assert strength / (2 * np.pi * (19.3 * size * scale) ** 2) == pytest.approx(1, rel=0.02)


# Numbers that Mitsuba cannot hold.


@pytest.mark.parametrize("flavour", [[], ["--exact"]])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<position>3 5 4", "<position>1e70 5 4"),
        ("<viewPoint>5 4 3", "<viewPoint>5e69 4e69 1e70"),
        (".25 .5 .85", "1e308 .5 .85"),
        ("<center>0 0 0", "<center>-1e70 1e70 1e70"),
    ],
)
def test_huge_numbers_are_told(
    small: Path, capsys: pytest.CaptureFixture[str], flavour: list[str], old: str, new: str
) -> None:
    text = small.read_text(encoding="utf-8")
    assert old in text
    small.write_text(text.replace(old, new), encoding="utf-8")
    assert main([*flavour, str(small)]) == 1
    assert re.fullmatch(
        rf"{small}: cannot be converted: \w+ would be (inf|[\d.]+e\+\d+), and Mitsuba's numbers"
        r" end at 3\.4e\+38; keep the numbers of the scene closer to 1\n",
        capsys.readouterr().err,
    )
    assert list(small.parent.iterdir()) == [small]


@pytest.mark.parametrize("width", ["1e-70", "1e-20"])
def test_a_picture_of_too_many_square_pixels_is_told(
    small: Path, capsys: pytest.CaptureFixture[str], width: str
) -> None:
    text = small.read_text(encoding="utf-8")
    small.write_text(text.replace("<viewWidth>2.5", f"<viewWidth>{width}"), encoding="utf-8")
    assert main([str(small)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{small}: cannot be converted: Mitsuba's pixels are square, and ")
    assert error.endswith(" too many; make viewWidth larger or viewHeight smaller\n")
    assert list(small.parent.iterdir()) == [small]


def test_a_picture_of_square_pixels_has_a_row() -> None:
    assert square_height(Scene(camera=Camera(view_height=1e-3), width=9, height=9)) == 1


# Normalisation.


def test_normalised_scene_is_centred_and_ten_units_large() -> None:
    scene = close_up(Sphere(center=(7, 8, -9), radius=1), view_dir=(7, 8, -14))
    place = normalisation(scene)
    seen = place(visible_points(scene))
    np.testing.assert_allclose(seen.min(axis=0) + seen.max(axis=0), 0, atol=1e-9)
    assert np.ptp(seen, axis=0).max() == pytest.approx(10)


def test_bounds_hold_every_surface() -> None:
    scene = close_up(Sphere(center=(1, 0, 0), radius=2), Box(min_pt=(0, -5, 0), max_pt=(1, 1, 0.5)))
    np.testing.assert_array_equal(bounds(scene.surfaces), [[-1, -5, -2], [3, 2, 2]])


def test_visible_points_are_many_of_what_is_small() -> None:
    for radius in (0.02, 0.03, 0.1):
        assert len(visible_points(close_up(Sphere(radius=radius)))) >= 12


def test_visible_points_lie_on_the_nearest_surface() -> None:
    scene = close_up(Sphere(radius=1), Box(min_pt=(-9, -9, -2), max_pt=(9, 9, -1)))
    points = visible_points(scene)
    on_ball = np.isclose(np.linalg.norm(points, axis=1), 1) & (points[:, 2] > 0)
    assert (on_ball | np.isclose(points[:, 2], -1)).all()
    assert on_ball.any()


def test_equal_shaders_share_a_bsdf() -> None:
    scene = close_up(*(Sphere(center=(x, 0, 0), shader=Phong(exponent=3)) for x in range(5)))
    root = ET.fromstring(exact(scene))
    assert len(root.findall("bsdf")) == 1
    assert len(root.findall("shape")) == 5
