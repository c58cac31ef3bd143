"""The command line, as the process that a user starts; how all commands start."""

import re
import resource
import signal
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import tqdm
from PIL import Image
from running import ROOT, SCENE, drop_jit, file_names, peak_memory, run, start_process, wait_until

import tracer
from converters import to_mitsuba
from reference import compare
from tracer.command import cli
from tracer.command.failure import Failure
from tracer.picture.lint import Exposure
from tracer.picture.png import Compressed
from tracer.picture.render import Tile

PNG = b"\x89PNG\r\n\x1a\n"
# A picture that takes long enough to do something meanwhile.
SLOW = SCENE.format(16384, 16384)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "ball.xml"
    path.write_text(SCENE.format(40, 30))
    return path


@pytest.mark.parametrize(
    ("arguments", "made"),
    [
        ("ball.xml", ["ball.xml.png"]),
        ("ball.xml --processes 2 --samples 4", ["ball.xml.png"]),
        ("ball.xml --size 80x60", ["ball.xml.png"]),
        ("ball.xml -o here.png", ["here.png"]),
        ("ball.xml --output=here", ["here"]),
        ("ball.xml -o there", ["there/ball.xml.png"]),
        ("ball.xml there/../there/other.xml -o new/deep/",
         ["new/deep/ball.xml.png", "new/deep/other.xml.png"]),
    ],
)  # fmt: skip
def test_pictures_are_written_where_they_should_be(scene, arguments, made):
    (scene.parent / "there").mkdir()
    other = scene.parent / "there" / "other.xml"
    other.write_text(SCENE.format(3, 3))
    status, out, err = run(*arguments.split(), cwd=scene.parent)
    assert (status, err) == (0, "")
    lines = [re.escape(name) + r": \d+ x \d+ pixels in \d+\.\d{3} s\n" for name in made]
    assert re.fullmatch("".join(lines), out)
    assert file_names(scene.parent) == sorted([*made, "there/other.xml"])
    size = (80, 60) if "--size" in arguments else (40, 30)
    right = replace(tracer.load_scene(scene), width=size[0], height=size[1])
    expected = tracer.to_codes(tracer.render(right, 4 if "--samples" in arguments else 1))
    with Image.open(scene.parent / made[0]) as picture:
        assert (np.asarray(picture) == expected).all()
    assert expected.max() > 0


@pytest.mark.parametrize(
    ("module", "missing"),
    [
        *(("tracer", m) for m in ("numpy", "numpy._core.gone")),
        *((f"reference.{m}", "mitsuba") for m in ("benchmark", "check", "regenerate", "report")),
        *((f"reference.{m}", "PIL") for m in ("compare", "regenerate")),
        *((f"reference.{m}", "matplotlib") for m in ("speed_accuracy", "stability")),
    ],
)
def test_a_command_without_its_packages_says_what_to_install(tmp_path, module, missing):
    package, error = missing.partition(".")[0], f"No module named {missing}"
    stub = f"raise ModuleNotFoundError({error!r}, name={missing!r})"
    (tmp_path / f"{package}.py").write_text(stub)
    status, out, err = run(python=("-m", module), env={"PYTHONPATH": f"{tmp_path}:{ROOT}"})
    error += f"; install it with python -m pip install {package.replace('PIL', 'pillow')}\n"
    assert (status, out, drop_jit(err)) == (2, "", error)


def test_version_and_help():
    assert run("--version") == (0, f"tracer {tracer.__version__}\n", "")
    status, out, _ = run("--help")
    assert status == 0
    assert "tracer scenes/one-sphere.xml" in out
    assert max(map(len, out.splitlines())) <= 88


COUNT = "must be a whole number from 1 to 999999999, is"
SIZE = "argument --size: must be width and height in pixels, as 640x360, is"
INPUT = "-: a picture of standard input needs a name, with -o, and no --watch"
BOTH = "would both be written there; do them one by one"
OUTPUT = "standard output takes the picture of one scene, and no --watch"
FOLDER = "several scenes need a folder; to have it made, end it in /"
PIXEL = "argument --pixel: must be column and row, as 160,90, is"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ("", "the following arguments are required: SCENE.xml"),
        ("ball.xml --samples 0", f"argument --samples: {COUNT} '0'"),
        ("ball.xml --samples 1_0", f"argument --samples: {COUNT} '1_0'"),
        ("ball.xml -o=", "argument -o/--output: the name is empty; name a file"),
        ("ball.png -o ball.png", "ball.png: this would replace a scene; choose another with -o"),
        ("ball.xml -o ball.v2.jpg", "-o ball.v2.jpg: pictures are PNG files; name it ball.v2.png"),
        ("ball.xml --size 640", f"{SIZE} '640'"),
        ("ball.xml --size 0x10", f"{SIZE} '0x10'"),
        ("-", INPUT),
        ("- -o ball.png --watch", INPUT),
        ("ball.xml other.xml -o -", f"-o -: {OUTPUT}"),
        ("ball.xml -o - --watch", f"-o -: {OUTPUT}"),
        ("ball.xml other.xml -o here.png", f"-o here.png: {FOLDER}"),
        ("ball.xml ball.xml", f"ball.xml.png: ball.xml and ball.xml {BOTH}"),
        ("ball.xml sub/ball.xml -o .", f"./ball.xml.png: ball.xml and sub/ball.xml {BOTH}"),
        ("ball.xml --pixel=4,x", f"{PIXEL} '4,x'"),
        ("ball.xml --pixel=4,4 -o x.png", "--pixel cannot be combined with -o or --watch"),
    ],
)
def test_wrong_usage(scene, monkeypatch, capsys, arguments, error):
    monkeypatch.chdir(scene.parent)
    monkeypatch.setattr(cli, "sleep", None)  # so that watching ends
    with pytest.raises(SystemExit, match="2"):
        cli.main(arguments.split())
    out, err = capsys.readouterr()
    assert (out, err.splitlines()[-1]) == ("", f"tracer: error: {error}")
    assert file_names(scene.parent) == []


@pytest.mark.parametrize(
    ("main", "arguments", "status"),
    [
        (cli.main, ["x.xml"], 1),
        (to_mitsuba.main, ["x.xml"], 1),
        (compare.main, [__file__, __file__, "-o", "a.png"], 2),
    ],
)
def test_a_working_folder_that_is_gone(main, arguments, status, tmp_path, monkeypatch):
    (gone := tmp_path / "gone").mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    text = "the working folder cannot be found: No such file or directory; change to another"
    with pytest.raises(Failure) as caught:
        main(arguments)
    assert (str(caught.value), caught.value.status) == (text, status)


def test_a_faulty_scene_does_not_keep_the_others_from_being_rendered(scene):
    faulty = scene.with_name("faulty.xml")
    faulty.write_text("<scene>\n<camra/>\n</scene>")
    status, out, err = run(faulty, "missing.xml", scene, cwd=scene.parent)
    assert status == 1
    assert err.splitlines() == [
        f"{faulty}:1: scene: has no image; add <image> ... </image>",
        f"{faulty}:2: camra: unknown in scene; did you mean 'camera'?",
        "missing.xml: cannot be read: No such file or directory;"
        " check the path and its permissions",
    ]
    assert out.startswith(f"{scene}.png: ")
    assert file_names(scene.parent) == ["ball.xml.png", "faulty.xml"]


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        ("missing/ball.png", "No such file or directory"),
        ("/dev/null", "not a regular file"),
        ("ball.xml/ball.png", "Not a directory"),
        ("ball.xml/", "it is not a folder"),
        ("ball.xml/deep/", "it is not a folder"),
        ("nothing/", "it is not a folder"),
        (f"{'x' * 300}.png", "File name too long"),
        ("text.png", "a file of another kind is there"),
    ],
)
def test_a_picture_that_cannot_be_written(scene, monkeypatch, capsys, output, reason):
    monkeypatch.chdir(scene.parent)
    Path("text.png").write_text("<scene/>")
    Path("nothing").symlink_to("missing")
    assert cli.main(["ball.xml", "-o", output]) == 1
    error = f"{output}: cannot be written: {reason}; choose another with -o\n"
    assert capsys.readouterr() == ("", error)
    assert file_names(scene.parent) == ["text.png"]
    assert Path("text.png").read_text() == "<scene/>"
    assert Path("/dev/null").is_char_device()


TOO_LARGE = (
    "cannot be rendered: not enough memory; make the image smaller than 3000 x 2000 pixels\n"
)


@pytest.mark.parametrize(
    ("size", "megabytes", "error"),
    [
        ((3000, 2000), 4, TOO_LARGE),
        ((40, 30), 16, ""),
    ],
)
def test_little_memory(scene, size, megabytes, error):
    """So much more than is in use once all modules are loaded."""
    scene.write_text(SCENE.format(*size))
    script = f"""if True:
        import resource, sys
        from tracer.command.cli import main
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + ({megabytes} << 20),) * 2)
        sys.exit(main([sys.argv[1], "--processes", "1"]))
    """
    status, _, err = run(scene, python=("-c", script))
    assert (status, err) == (1 if error else 0, error and f"{scene}: {error}")
    assert file_names(scene.parent) == ([] if error else ["ball.xml.png"])


@pytest.mark.parametrize("megabytes", [20, 40])
def test_too_little_memory_to_load_numpy(scene, megabytes):
    """With 60 to 80 MB some versions of OpenBLAS never end; above, Python may fail anywhere."""
    limit = megabytes << 20
    status, out, err = run(
        scene, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    )
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert re.match(r"the command cannot start: .*[.]so.*; give it more memory, or", err)
    assert file_names(scene.parent) == []


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1 << 28, 1), (1, 1 << 28)])
def test_a_picture_as_wide_or_as_high_as_can_be_needs_little_memory(scene, size):
    scene.write_text(SCENE.format(*size))
    assert peak_memory(sys.executable, "-m", "tracer", str(scene), "--quiet") < 150
    assert Path(f"{scene}.png").stat().st_size > 100_000


@pytest.mark.parametrize(
    ("draw", "error"),
    [
        (Mock(side_effect=MemoryError),
         "{0}: cannot be rendered: not enough memory;"
         " make the image smaller than 40 x 30 pixels or take fewer samples than 4\n"),
        (Mock(return_value=np.full((30, 40, 3), np.nan)),
         "{0}: cannot be rendered: an image must not contain NaN;"
         " this is a bug in the tracer; please report it with the scene\n"),
    ],
)  # fmt: skip
def test_a_picture_that_cannot_be_drawn(scene, monkeypatch, capsys, draw, error):
    """However it comes about: a line, and not a traceback."""
    monkeypatch.setattr("tracer.picture.render.RenderJob.render_tile", draw)
    assert cli.main([str(scene), "--samples", "4"]) == 1
    assert capsys.readouterr().err == error.format(scene)
    assert file_names(scene.parent) == []


# As on systems whose files have a name from the first.
NAMED = "import os; del os.O_TMPFILE; from tracer.__main__ import main; main()"


def test_an_interrupt_leaves_nothing_half_written_under_a_name_of_its_own(scene):
    """Nor do several, as of a user who is impatient."""
    scene.write_text(SLOW)
    picture = scene.with_name("ball.xml.png")
    picture.write_bytes(PNG + b"precious")
    process = start_process(scene, python=("-c", NAMED))
    wait_until(lambda: len(file_names(scene.parent)) > 1)
    for _ in range(5):
        process.send_signal(signal.SIGTERM)
    assert (*process.communicate(timeout=30), process.returncode) == ("", "", 130)
    assert file_names(scene.parent) == ["ball.xml.png"]
    assert picture.read_bytes() == PNG + b"precious"


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGCHLD])
def test_signals_that_the_caller_ignores(scene, ignored):
    """As in the background of a script; or in servers, where no process waits for its children."""
    ignore = lambda: signal.signal(ignored, signal.SIG_IGN)  # noqa: E731
    process = start_process(scene, "--quiet", "--processes", 2, preexec_fn=ignore)
    while process.poll() is None:
        process.send_signal(ignored)
        time.sleep(0.01)
    assert (*process.communicate(), process.returncode) == ("", "", 0)
    assert file_names(scene.parent) == ["ball.xml.png"]


def test_no_one_reads_the_output_or_the_errors(scene, pipe_without_reader):
    other = scene.with_name("other.xml")
    other.write_text(SCENE.format(3, 3))
    assert run(scene, other, stdout=pipe_without_reader) == (0, None, "")
    assert file_names(scene.parent) == ["ball.xml.png", "other.xml", "other.xml.png"]
    Path(f"{scene}.png").unlink()
    assert run("none.xml", scene, stderr=pipe_without_reader)[0] == 1
    with Path("/dev/full").open("w") as full:
        assert run(other, stdout=full) == (0, None, "")
        assert run("--version", stdout=full, env={"PYTHONUNBUFFERED": ""})[0] == 1
        error = "-: cannot be written: No space left on device; choose another with -o\n"
        assert run(other, "-o", "-", stdout=full) == (1, None, error)
    assert file_names(scene.parent) == ["ball.xml.png", "other.xml", "other.xml.png"]
    assert run(scene, "-o", "-", stdout=pipe_without_reader) == (141, None, "")
    assert run(scene, "--pixel", "3,3", stdout=pipe_without_reader) == (141, None, "")
    assert run("--help", stdout=pipe_without_reader, env={"PYTHONUNBUFFERED": ""}) == (
        141,
        None,
        "",
    )


def test_names_that_the_terminal_cannot_show(scene):
    odd = scene.with_name("b\u00e4ll\n.xml")
    scene.rename(odd)
    status, out, err = run(odd, env={"PYTHONIOENCODING": "ascii"})
    assert (status, err) == (0, "")
    assert out.startswith(f"{odd.parent}/b\\xe4ll\\n.xml.png: 40 x 30 pixels in ")
    assert out.count("\n") == 1


@pytest.mark.parametrize("bar", ["shown", "missing", "refused"])
def test_a_slow_picture_shows_its_progress_or_does_without(bar, scene, monkeypatch, capsys):
    """Slow as the clock has it; tqdm reads its settings when it is imported."""
    for module in [name for name in sys.modules if name.partition(".")[0] == "tqdm"]:
        monkeypatch.delitem(sys.modules, module)
    if bar == "missing":
        monkeypatch.setitem(sys.modules, "tqdm", None)
    if bar == "refused":
        monkeypatch.setenv("TQDM_MININTERVAL", "often")
    monkeypatch.setattr(cli, "perf_counter", iter(range(0, 1000, 10)).__next__)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert cli.main([str(scene)]) == 0
    shown = capsys.readouterr().err
    assert ("ball.xml.png" in shown and "px" in shown) if bar == "shown" else shown == ""
    with Image.open(f"{scene}.png") as image:
        assert image.size == (40, 30)


def test_the_bar_counts_pixels(monkeypatch):
    shown = []

    class Bar(tqdm.tqdm):
        def update(self, n: float | None = 1) -> None:
            super().update(n)
            shown.append((self.n, self.total))

    monkeypatch.setattr("tqdm.tqdm", Bar)
    monkeypatch.setattr(cli, "perf_counter", iter([0, 0.9, 1.1]).__next__)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    progress = cli._Progress("a.png", 600, show=True)
    exposures = Exposure(), Exposure(), Exposure(is_black=False, lit=7, clipped=2)
    tiles = [
        Tile(Compressed(b"", 0, 0), 100 * k, e) for k, e in zip((1, 2, 3), exposures, strict=True)
    ]
    watched = progress.watch(iter(tiles))
    assert [next(watched), next(watched), progress.exposure] == [*tiles[:2], Exposure()]
    assert [*watched, progress.exposure] == [tiles[2], exposures[2]]
    assert shown == [(300, 600), (600, 600)]  # none before a second has passed


def test_warnings_and_a_size_that_makes_pixels_oblong(scene, capsys):
    assert cli.main([str(scene), "--size", "20x20"]) == 0
    window = "20 x 20 pixels show a window of 40 x 30, stretched"
    warning = f"{window}; viewWidth 30, or 27 columns, would make them square"
    assert capsys.readouterr().err == f"{scene}: warning: {warning}\n"
    scene.write_text(SCENE.format(40, 30).replace("0 0 5", "0 0 -5"))
    assert cli.main([str(scene), "--size", "20x20"]) == 0
    seen = capsys.readouterr().err
    assert seen.startswith(f"{scene}: warning: {warning}\n{scene}: warning: no object is in view")
    assert cli.main([str(scene), "--size", "20x20", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert cli.main([str(scene), "--size", "99999x99999"]) == 1
    error = "--size: width, height: 99999 x 99999 pixels are too many"
    assert capsys.readouterr().err.startswith(error)


def test_standard_input_and_output(scene):
    status, out, err = run("-", "-o", "-", input=scene.read_bytes(), text=False)
    assert status == 0
    assert re.fullmatch(rb"-: 40 x 30 pixels in \d+\.\d{3} s\n", err)
    assert cli.main([str(scene)]) == 0
    assert out == Path(f"{scene}.png").read_bytes()
    status, _, err = run("-", "-o", "x.png", input="<scene>", cwd=scene.parent)
    assert status == 1
    assert ":1: " in err
    assert file_names(scene.parent) == ["ball.xml.png"]


def test_watch(scene):
    """A file that is saved, is faulty, is mended, is replaced, is removed."""
    other = scene.with_name("other.xml")
    other.write_text(SCENE.format(3, 3))
    with start_process(scene, other, "--watch") as process:
        out, err = process.stdout, process.stderr
        assert "ball.xml.png: 40 x 30" in out.readline()
        assert "other.xml.png: 3 x 3" in out.readline()
        other.write_text(SCENE.format(5, 5))
        assert "other.xml.png: 5 x 5" in out.readline()
        scene.write_text("<scene>")
        assert "ball.xml:1: " in err.readline()
        new = scene.with_name("new")
        new.write_text(SCENE.format(8, 6))
        new.replace(scene)
        assert "ball.xml.png: 8 x 6" in out.readline()
        other.unlink()
        shown = err.readline()
        while "other.xml: cannot be read" not in shown:
            assert "ball.xml:" in shown  # more faults of the one before
            shown = err.readline()
        process.send_signal(signal.SIGINT)
        assert (process.wait(), out.read(), err.read()) == (130, "", "")


def test_watch_waits_until_a_file_is_whole(scene, monkeypatch):
    """An editor may write it in pieces, each after a look at the file."""
    whole, rendered = scene.read_text(), []
    new = whole + "\n"
    steps = [partial(scene.write_text, text) for text in (new[:20], new[:40], new)]
    following = iter([*steps, dict, dict, sys.exit])
    monkeypatch.setattr(cli, "sleep", lambda _seconds: next(following)())
    monkeypatch.setattr(cli, "_render", lambda path, *_: rendered.append(Path(path).read_text()))
    with pytest.raises(SystemExit):
        cli.main([str(scene), "--watch"])
    assert rendered == [whole, new]


START = "the command cannot start: not enough memory; give it more memory, or install it again\n"
THREADS = "return int(os.environ['OPENBLAS_NUM_THREADS'])"  # no more than someone asked for


@pytest.mark.parametrize(
    ("code", "environment", "status", "error"),
    [
        ("raise MemoryError", {}, 1, START),
        (THREADS, {}, 1, ""),
        (THREADS, {"OPENBLAS_NUM_THREADS": "2"}, 2, ""),
    ],
)
def test_how_any_command_starts(tmp_path, code, environment, status, error):
    (tmp_path / "other.py").write_text(f"import os\ndef main(): {code}")
    script = "from tracer.command.process import run\nrun('other')"
    found = run(python=("-c", script), env=environment, cwd=tmp_path)
    assert found == (status, "", error)


def test_a_small_picture_does_not_wait_for_modules_it_does_not_need(scene):
    script = (
        "import sys, numpy\nbefore = set(sys.modules)\n"
        "from tracer.command.cli import main\n"
        f"main([{str(scene)!r}])\nprint(*set(sys.modules) - before)"
    )
    loaded = set(run(python=("-c", script))[1].split())
    assert "tracer.picture.render" in loaded
    assert not loaded & {"tqdm", "PIL", "difflib", "multiprocessing", "concurrent.futures.process"}
