"""Measure how much faster threads render, on a Python without a lock (free-threaded Python).

``python3.14t -m reference.threads`` writes `threads.md` into this folder.  It needs no package but
those of the tracer, because others have no wheels for such a Python.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import warnings
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from reference.command import REFERENCE_FOLDER, build_path, list_scene_files, make_parser
from reference.measured.measurements import describe_origin, time_alternately
from tracer import SceneWarning, load_scene, render
from tracer.command.failure import Failure
from tracer.picture.parallel import has_gil

# Minimum number of rounds in which each picture is timed.
_MIN_ROUNDS = 5

# Widths and heights of the pictures in pixels.
_SIZES = ((320, 180), (1280, 720), (2560, 1440))


def measure_scene(name: str, size: tuple[int, int]) -> str:
    """Time a scene with one thread and with all, and return a row of the Markdown table.

    `name` is that of a scene file without the suffix, and `size` the width and height of the
    picture.  Raise Failure if the two pictures differ.
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


def main() -> None:
    """Time all scenes, print each row as soon as it is measured, and write `threads.md`."""
    arguments = make_parser("reference.threads", quick_help="small sizes").parse_args()
    if has_gil():
        remedy = "run it with free-threaded Python, for example python3.14t"
        raise Failure("reference.threads", "this Python has a lock", remedy)
    warnings.simplefilter("ignore", SceneWarning)  # some windows are stretched
    names = [path.stem for path in list_scene_files()]
    lines = [_format_title()]
    print(lines[0], flush=True)
    for size, name in product(_SIZES[:1] if arguments.quick else _SIZES, names):
        lines.append(measure_scene(name, size))
        print(lines[-1], flush=True)
    page_path = build_path("threads.md") if arguments.quick else REFERENCE_FOLDER / "threads.md"
    page_path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _format_title() -> str:
    return (
        "# Threads\n\nWritten by `python -m reference.threads` on free-threaded Python: times"
        " of `tracer.render` in milliseconds, with `threads=1` and by default, one sample per"
        " pixel: median"
        f" (minimum–maximum) of at least {_MIN_ROUNDS} rounds, alternately. The pictures are"
        " bit-identical. A picture of an estimated 20 ms or less is rendered in one thread."
        f" Measured on {describe_origin()}.\n\n"
        "| scene | one thread | all processors | speedup |\n| --- | --- | --- | --- |"
    )
