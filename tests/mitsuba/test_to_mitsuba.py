"""The converter's command line: the files it writes, its messages, and the files it leaves alone.

Also the choice of Mitsuba's variant: whether a libLLVM is absent, good or bad, it must neither end
this process nor mislead it.
"""

import os
import signal
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image
from running import ROOT, drop_jit, file_names, run

from converters.mitsuba_xml import FILE_START
from converters.to_mitsuba import main, skip_converted_scenes
from converters.variant import LLVM, SCALAR, VariantChoice, find_fastest_variant, mi, use_variant
from reference import check, report
from reference.command import list_scene_files
from tracer.command.failure import Failure

RENDER = ["--render", "--variant", SCALAR]
COMMAND = ["-m", "converters.to_mitsuba"]


@pytest.mark.parametrize(
    ("options", "written"),
    [([], "small.mitsuba.xml"), (["--flavour", "exact"], "small.exact.mitsuba.xml")],
)
def test_the_result_is_beside_the_scene_and_skipped_next_time(small_file, capsys, options, written):
    for _ in range(2):
        assert main([*options, *map(str, sorted(small_file.parent.glob("*.xml")))]) == 0
        assert {*file_names(small_file.parent)} == {written, "small.xml"}
    scene = small_file.with_name(written)
    assert ET.parse(scene).getroot().tag == "scene"
    assert f"{scene}: skipped, because it is a converted scene\n" in capsys.readouterr().out


def test_a_pipe_is_not_read_to_recognise_converted_scenes(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writing_end = os.open(pipe, os.O_RDWR)
    try:
        os.write(writing_end, FILE_START.encode())
        assert skip_converted_scenes([str(pipe)]) == [pipe]
    finally:
        os.close(writing_end)


def test_scenes_after_one_that_cannot_be_read_are_converted(tmp_path, capsys):
    bad = tmp_path / "bad.xml"
    bad.write_text("<scene><camera/><image>8 8</image><light/></scene>")
    names = [str(bad), "/"]
    assert main([*names, *map(str, list_scene_files()[:2]), "-o", f"{tmp_path}/made/"]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert [error.partition(":")[0] for error in errors] == names
    expected = {f"{path.stem}.mitsuba.xml" for path in list_scene_files()[:2]}
    assert {*file_names(tmp_path / "made")} == expected


@pytest.mark.parametrize("flavour", ["stock", "exact"])
def test_converting_needs_no_mitsuba_and_escapes_names_that_are_not_text(odd_file, flavour):
    odd_file.with_name("mitsuba.py").write_text("raise ImportError('not installed')")
    environment = {"PYTHONPATH": odd_file.parent, "PYTHONIOENCODING": "utf-8"}
    status, out, err = run(
        "--flavour", flavour, odd_file, python=COMMAND, cwd=ROOT, env=environment
    )
    assert (status, err) == (0, "")
    assert f"{odd_file.parent}/\\udcff\\n." in out


# Dr.Jit's error if a library of the system is missing.
BROKEN = """
try:
    raise ImportError('libatomic.so.1: cannot open shared object file')
except ImportError:
    extension
"""
PACKAGES = "install it with pip install -e '.[reference]'\n"


@pytest.mark.parametrize(
    ("option", "module", "stub", "status", "message"),
    [
        ("--samples=4", "numpy", "", 2, "No module named numpy; install it with python -m pip in"),
        ("--render", "numpy", "", 1, f"Mitsuba cannot run: No module named numpy; {PACKAGES}"),
        ("--render", "mitsuba", "", 1, f"Mitsuba cannot run: No module named mitsuba; {PACKAGES}"),
        ("--render", "mitsuba", BROKEN, 1, "Mitsuba cannot run: libatomic.so.1: cannot open share"),
    ],
)
def test_a_missing_package_is_named(small_file, option, module, stub, status, message):
    missing = f"raise ModuleNotFoundError('No module named {module}')"
    small_file.with_name(f"{module}.py").write_text(stub or missing)
    path = {"PYTHONPATH": small_file.parent}
    result, _, err = run(option, small_file, python=COMMAND, cwd=ROOT, env=path)
    assert (result, drop_jit(err).count("\n")) == (status, 1)
    assert drop_jit(err).startswith(message)


@pytest.mark.parametrize(
    ("flavour", "output", "written"),
    [
        ("exact", None, "small.mitsuba.png small.mitsuba.exr"),
        ("stock", None, "small.stock.mitsuba.png small.stock.mitsuba.exr"),
        # Either file may be named.
        ("exact", "x.png", "x.png x.exr"),
        ("exact", "x.exr", "x.png x.exr"),
        ("exact", "A.EXR", "A.png A.EXR"),
        ("exact", "room.v1", "room.v1.png room.v1.exr"),
    ],
)
def test_render_writes_a_png_and_an_exr(small_file, flavour, output, written):
    output = ["-o", str(small_file.with_name(output))] if output else []
    assert main([*RENDER, "--flavour", flavour, "--samples", "4", str(small_file), *output]) == 0
    assert {*file_names(small_file.parent)} == {"small.xml", *written.split()}
    png, exr = (small_file.with_name(name) for name in written.split())
    codes = np.asarray(Image.open(png, formats=["PNG"]))
    radiance = np.array(mi.Bitmap(str(exr)))
    # Stock flavours have square pixels.
    assert radiance.shape == codes.shape == (30 if flavour == "exact" else 40, 40, 3)
    np.testing.assert_array_equal(codes, np.round(255 * radiance.clip(0, 1) ** (1 / 2.2)))
    use_variant()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs Linux")
def test_rendering_ends_on_one_processor(small_file):
    """Mitsuba's writer and reader of EXR files would wait forever for a second thread."""
    exr = small_file.with_name("small.mitsuba.exr")
    read = "from converters.variant import mi, use_variant"
    read += f"; use_variant({SCALAR!r}); mi.Bitmap({str(exr)!r})"

    def begin() -> None:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        signal.alarm(60)

    for python in ([*COMMAND, *RENDER, str(small_file)], ["-c", read]):
        status, out, err = run(python=python, preexec_fn=begin)
        assert (status, drop_jit(err)) == (0, "")
        # Mitsuba does not warn of Python plugins in a scalar variant.
        assert "WARN" not in out


NUMBERS = "but Mitsuba's numbers end at 3.4e+38; keep the numbers of the scene closer to 1"


@pytest.mark.parametrize(
    ("flavour", "old", "new", "message"),
    [
        ("exact", "<position>3 5", "<position>1e70 5", f"position would be 7.21065e+70, {NUMBERS}"),
        ("stock", "<position>3 5 4", "<position>1e70 5 4", f"position would be 1e+70, {NUMBERS}"),
        ("exact", ".25 .5 .85", "1e70 .5 .85", f"diffuse would be 1e+70, {NUMBERS}"),
        ("stock", ".25 .5 .85", "1e70 .5 .85", f"intensity would be 1.2595e+72, {NUMBERS}"),
        ("exact", "<viewPoint>5 4 3", "<viewPoint>5e69 4 3", f"eye would be 2.5e+70, {NUMBERS}"),
        ("stock", "<viewPoint>5 4 3", "<viewPoint>5e69 4 3", f"to_world would be 5e+69, {NUMBERS}"),
        ("stock", "<viewWidth>2.5", "<viewWidth>1e-70",
         "Mitsuba's pixels are square, but 40 x 1e+72 are too many;"
         " make viewWidth larger or viewHeight smaller"),
    ],
)  # fmt: skip
def test_scenes_beyond_mitsubas_range_are_refused(small_file, capsys, flavour, old, new, message):
    text = small_file.read_text(encoding="utf-8")
    assert old in text
    small_file.write_text(text.replace(old, new), encoding="utf-8")
    arguments = ["--flavour", flavour, str(small_file), "-o", f"{small_file.parent}/made/"]
    for command in (main, check.main):
        assert command(arguments) == 1
        assert capsys.readouterr().err == f"{small_file}: cannot be converted: {message}\n"
    assert file_names(small_file.parent) == ["small.xml"]


def test_an_exr_does_not_replace_a_file_of_another_kind(small_file, capsys):
    exr = small_file.with_name("small.mitsuba.exr")
    exr.write_text("notes")
    assert main([*RENDER, str(small_file)]) == 1
    message = f"{exr}: cannot be written: a file of another kind is there"
    assert capsys.readouterr().err == f"{message}; choose another with -o\n"
    assert exr.read_text() == "notes"
    use_variant()


# The choice of a variant


@pytest.mark.parametrize(
    ("kernel", "variant", "reason"),
    [
        ("pass", LLVM, "libLLVM works"),
        ("import os; os.abort()", SCALAR, "the libLLVM found here kills the process with SIGABRT"),
        ("raise ImportError('not there')", SCALAR, "no usable libLLVM: ImportError: not there"),
        ("raise SystemExit(3)", SCALAR, "no usable libLLVM: no message"),
        ("import time; time.sleep(60)", SCALAR, "the libLLVM found here hangs"),
        ("import os; assert not os.path.isdir(os.path.expanduser('~'))", LLVM, "libLLVM works"),
    ],
)
def test_the_probe_reports_how_its_child_process_ended(
    kernel, variant, reason, tmp_path, monkeypatch
):
    # It finds no kernels in the home folder.
    (tmp_path / ".drjit").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    options = {"timeout": 0.5} if "hangs" in reason else {}
    assert find_fastest_variant(kernel, **options) == VariantChoice(variant, reason)


def test_the_probe_runs_once_per_process_and_scalar_is_always_available():
    assert use_variant() is use_variant()
    assert use_variant(SCALAR).variant == SCALAR
    use_variant()


def test_a_request_for_a_variant_that_does_not_work_gives_the_reason():
    code = f"from converters.variant import use_variant; use_variant({LLVM!r})"
    status, _, err = run(python=("-c", code), env={"DRJIT_LIBLLVM_PATH": "/nonexistent"})
    assert status == 1
    assert f"ImportError: {LLVM} does not work here: no usable libLLVM" in err


@pytest.mark.parametrize("variant", ["nope", "scalar_spectral", ""])
def test_variants_without_rgb_are_refused(small_file, variant):
    options = "--variant", variant, str(small_file), "-o", f"{small_file.parent}/made/"
    for command, status in ((main, 1), (check.main, 2), (report.main, 2)):
        arguments = ["--render", *options] if command is main else options
        with pytest.raises(Failure) as caught:
            command(arguments)
        assert caught.value.exit_status == status
        start, _, choices = str(caught.value).partition("; choose one of ")
        assert start == f"Mitsuba cannot run: {variant or repr(variant)} is not an RGB variant"
        assert SCALAR in choices
        assert "spectral" not in choices
    assert file_names(small_file.parent) == ["small.xml"]
