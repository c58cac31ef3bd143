"""Measure how much faster threads render, on a Python without a lock (free-threaded Python).

``python3.14t -m reference.threads`` writes `threads.md` into this folder.  It needs no package but
those of the tracer, because others have no wheels for such a Python.  With ``--with-lock python3``,
the command is also timed on that Python, on which its workers are processes.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from reference.command import REFERENCE_FOLDER, SCENES, build_path, list_scene_files, make_parser
from reference.measured.measurements import describe_origin, make_command_task, time_alternately
from reference.measured.workloads import build_animation, copy_with_picture_size
from tracer import SceneWarning, load_scene, render, save_scene
from tracer.command.failure import Failure
from tracer.picture.parallel import Threads, count_processors, has_gil

# Minimum number of rounds in which each picture is timed.
_MIN_ROUNDS = 5

# Widths and heights of the pictures in pixels.
_SIZES = ((320, 180), (1280, 720), (2560, 1440))

# Minimum number of rounds in which each command is timed.
_MIN_COMMAND_ROUNDS = 3

# Width and height of the frames of an animation, and of a large picture, in pixels.
_FRAME_SIZE = (1280, 720)
_LARGE_SIZE = (5120, 2880)

# A program that prints the version of its Python, with "t" if it has no lock.
_PRINT_VERSION = """
import platform, sys
has_lock = getattr(sys, "_is_gil_enabled", lambda: True)()
print("Python", platform.python_version() + "t" * (not has_lock), end="")
"""


def measure_scene(name: str, size: tuple[int, int]) -> str:
    """Time a scene of this project with one thread and with all, and return a row of the table.

    `size` is the width and the height of the picture in pixels.  Raise Failure if the picture
    depends on the number of threads.
    """
    width, height = size
    path = next(path for path in list_scene_files() if path.stem == name)
    scene = replace(load_scene(path), width=width, height=height)
    timings = time_alternately(
        {"one": partial(render, scene, threads=1), "all": partial(render, scene)}, _MIN_ROUNDS
    )
    if not np.array_equal(render(scene), render(scene, threads=1)):
        raise Failure(name, "its picture depends on the number of threads", "report it")
    one, several = timings["one"], timings["all"]
    ratio = one.median / several.median
    return f"| {name} {width}×{height} | {one} | {several} | {ratio:.2f}× |"


def measure_commands(python: str, inputs: dict[str, list[str]]) -> Iterator[str]:
    """Time the tracer's command, and yield rows of the table.

    `python` is the path of the Python that runs the command, once with one worker and once with one
    for each processor.  `inputs` maps the name of each row of the table to the scene files that the
    command renders.
    """
    name = subprocess.check_output([python, "-c", _PRINT_VERSION], text=True)
    for input_name, paths in inputs.items():
        command = [python, "-m", "tracer", "--quiet", *paths, "--processes"]
        tasks = {
            "one": make_command_task([*command, "1"]),
            "all": make_command_task([*command, str(count_processors())]),
        }
        timings = time_alternately(tasks, _MIN_COMMAND_ROUNDS)
        one = timings["one"].divided_by(len(paths))
        several = timings["all"].divided_by(len(paths))
        yield f"| {name}: {input_name} | {one} | {several} | {one.median / several.median:.2f}× |"


def write_inputs(quick: bool) -> dict[str, list[str]]:
    """Write scene files for the command; map the name of each row of the table to their paths."""
    frame_count = 4 if quick else 40
    scene = load_scene(SCENES / "sticks-perspective.xml")
    frames = build_animation(copy_with_picture_size(scene, *_FRAME_SIZE), frame_count)
    frame_paths = []
    for frame_index, frame in enumerate(frames):
        save_scene(frame, path := build_path(f"frame-{frame_index}.xml"))
        frame_paths.append(str(path))
    save_scene(copy_with_picture_size(scene, *_LARGE_SIZE), path := build_path("large.xml"))
    return {
        "each of {} frames of {}×{}".format(frame_count, *_FRAME_SIZE): frame_paths,
        "one picture of {}×{}".format(*_LARGE_SIZE): [str(path)],
    }


def main() -> None:
    """Time all scenes, print each row as soon as it is measured, and write `threads.md`."""
    parser = make_parser("reference.threads", quick_help="small sizes")
    parser.add_argument(
        "--with-lock", metavar="PYTHON", help="another Python on which the command is timed, too"
    )
    arguments = parser.parse_args()
    if has_gil():
        remedy = "run it with free-threaded Python, for example python3.14t"
        raise Failure("reference.threads", "this Python has a lock", remedy)
    warnings.simplefilter("ignore", SceneWarning)  # some windows are stretched
    lines = list[str]()
    for line in _measure_all(arguments.quick, arguments.with_lock):
        print(line, flush=True)
        lines.append(line)
    page_path = build_path("threads.md") if arguments.quick else REFERENCE_FOLDER / "threads.md"
    page_path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _measure_all(quick: bool, locked_python: str | None) -> Iterator[str]:
    """Yield the lines of the page, each as soon as it is measured."""
    yield (
        "# Threads\n\nWritten by `python -m reference.threads` on free-threaded Python: median"
        " (minimum–maximum) of several rounds, alternately, in milliseconds."
        f" Measured on {describe_origin()}."
    )
    yield (
        "\n## Pictures\n\nTimes of `tracer.render`, with `threads=1` and by default, one sample per"
        " pixel. The pictures are bit-identical. A picture of an estimated"
        f" {1e3 * Threads.sharing.min_seconds:.0f} ms or less is rendered in one thread.\n\n"
        "| scene | one thread | all processors | speedup |\n| --- | --- | --- | --- |"
    )
    names = [path.stem for path in list_scene_files()]
    for size, name in product(_SIZES[:1] if quick else _SIZES, names):
        yield measure_scene(name, size)
    yield (
        "\n## Commands\n\nTimes of `python -m tracer` from the shell, with `--processes 1` and"
        f" `--processes {count_processors()}`: reading the files, rendering one sample per pixel,"
        " and writing PNG files. The start of the program is included. On a Python with a lock,"
        " workers are processes.\n\n"
        "| Python and task | one worker | all processors | speedup |\n| --- | --- | --- | --- |"
    )
    inputs = write_inputs(quick)
    for python in filter(None, (sys.executable, locked_python)):
        yield from measure_commands(python, inputs)
