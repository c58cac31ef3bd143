"""Measure how fast the tracer renders, compared with compiled renderers.

``python -m reference.benchmark`` writes `benchmark.md` into this folder.  Renderers are timed
alternately.  If Mitsuba renders in this process, it compiles its kernels and builds its scene
before the clock starts.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
import shlex
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import geometric_mean
from time import perf_counter

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import convert_exact, convert_stock
from converters.variant import SCALAR, mi, use_variant
from reference import povray
from reference.command import HERE, SCENES, build_path, make_parser, own_scenes
from reference.measured.measurements import (
    Task,
    Timing,
    describe_origin,
    make_command_task,
    time_interleaved,
)
from reference.measured.workloads import field_scene, resize_picture
from tracer import Scene, load_scene, render, save_scene
from tracer.picture.parallel import count_processors

_FEW_SCENES = ("one-sphere", "four-spheres", "sticks-perspective")
_SPEEDUPS = ("speedup over exact", "speedup over stock")
_SMALL_SIZE, _MEDIUM_SIZE, _LARGE_SIZE = (320, 180), (1280, 720), (2560, 1440)

# A typical script that renders scenes with Mitsuba.  Its arguments are the variant, then pairs of a
# scene file and a picture.
_MITSUBA_SCRIPT = """
import sys
import mitsuba as mi
variant, *paths = sys.argv[1:]
mi.set_variant(variant)
for source, target in zip(paths[::2], paths[1::2]):
    if "unattenuated_point" in open(source).read():
        import converters.plugins
    mi.util.write_bitmap(target, mi.render(mi.load_file(source)), write_async=False)
"""

# A typical script that renders scenes with a pool of processes.  Its arguments are the number of
# processes, then scene files.
_POOL_SCRIPT = """
import sys
from concurrent.futures import ProcessPoolExecutor
import tracer
if __name__ == "__main__":
    workers, *paths = sys.argv[1:]
    with ProcessPoolExecutor(int(workers)) as pool:
        scenes = map(tracer.load_scene, paths)
        for path, png in zip(paths, pool.map(tracer.to_png, scenes)):
            open(f"{path}.png", "wb").write(png)
"""

ROUNDS = 3
"""Minimum number of rounds in which each task is timed."""


def compute_speedup(timing: Timing, other_timing: Timing) -> float:
    """Compute how many times as fast as another task a task is, by their median times.

    The result is above 1 if the first task is faster.
    """
    return other_timing.median / timing.median


def format_ratio(ratio: float) -> str:
    """Format a positive ratio with at least two significant digits: 0.50×, 3.0×, 42×."""
    decimals = 2 if ratio < 0.995 else 1 if ratio < 9.95 else 0
    return f"{ratio:.{decimals}f}×"


def format_section(
    title: str, note: str, columns: Sequence[str], rows: Sequence[Sequence[object]]
) -> str:
    """Format a section of a Markdown page: a heading, a note and a table.

    Parameters
    ----------
    title, note : str
        The heading, and a paragraph that describes the table.
    columns : sequence of str
        Titles of the table's columns.
    rows : sequence of sequences
        The rows of the table.  Floats are formatted as ratios, all other objects by `str`.

    Returns
    -------
    section : str
        The section, without a line end after its last line.
    """
    cells = [[format_ratio(x) if isinstance(x, float) else str(x) for x in row] for row in rows]
    lines = [columns, ["---"] * len(columns), *cells]
    return "\n".join([f"## {title}\n\n{note}\n", *(f"| {' | '.join(line)} |" for line in lines)])


def _time_tracer_and_mitsuba(scene: Scene, mitsuba_scene: str) -> tuple[Timing, Timing]:
    """Time how the tracer and Mitsuba render a scene in this process, alternately.

    Parameters
    ----------
    scene : Scene
        The scene for the tracer.
    mitsuba_scene : str
        The same scene in Mitsuba's XML format.  It is loaded before the clock starts.

    Returns
    -------
    tracer_timing, mitsuba_timing : Timing
        Times in which each of them renders one picture.
    """
    gc.collect()  # Mitsuba's kernels depend on all objects alive, so only one scene may be loaded
    loaded_scene = mi.load_string(mitsuba_scene)
    tasks: dict[str, Task] = {"tracer": partial(render, scene)}
    tasks["Mitsuba"] = lambda: np.array(mi.render(loaded_scene))
    timings = time_interleaved(tasks, ROUNDS)
    return timings["tracer"], timings["Mitsuba"]


def benchmark_whole_process(quick: bool) -> str:
    """Time each renderer's whole command, from a scene file to a PNG file.

    Parameters
    ----------
    quick : bool
        Whether to render one scene in a small picture only.

    Returns
    -------
    section : str
        The section of the Markdown page with these times.
    """
    variant, png_path = use_variant().variant, str(build_path("out.png"))
    tracer_command = [sys.executable, "-m", "tracer", "--quiet", "-o", png_path]
    mitsuba_script = [sys.executable, "-c", _MITSUBA_SCRIPT]
    rows: list[tuple[object, ...]] = []
    pictures = [*product((_SMALL_SIZE, _LARGE_SIZE), _FEW_SCENES)]
    for size, name in pictures[:1] if quick else pictures:
        scene = resize_picture(load_scene(SCENES / f"{name}.xml"), *size)
        save_scene(scene, scene_file := build_path("tracer.xml"))
        (exact_file := build_path("exact.xml")).write_text(str(convert_exact(scene)))
        (stock_file := build_path("stock.xml")).write_text(str(convert_stock(scene, 1)))
        commands = {
            "import numpy": [sys.executable, "-c", "import numpy"],
            "tracer": [*tracer_command, str(scene_file)],
            "Mitsuba exact": [*mitsuba_script, variant, str(exact_file), png_path],
            "Mitsuba stock": [*mitsuba_script, variant, str(stock_file), png_path],
            "the same, scalar": [*mitsuba_script, SCALAR, str(stock_file), png_path],
        }
        if povray.is_installed():
            commands["POV-Ray"] = povray.write_scene_and_command(scene, Path(png_path))
        tasks = {name: make_command_task(command) for name, command in commands.items()}
        timings = time_interleaved(tasks, ROUNDS, min_seconds=2.0)
        speedup_over_exact, *speedups_over_stock = (
            compute_speedup(timings["tracer"], timings[other])
            for other in ("Mitsuba exact", "Mitsuba stock", "the same, scalar")
        )
        cells = (*timings.values(), speedup_over_exact, min(speedups_over_stock))
        rows.append((f"{name} {size[0]}×{size[1]}", *cells))
    return format_section(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell. Mitsuba {variant} has a warm kernel cache. Its stock"
        f" plugins are also timed in {SCALAR}, which has no kernels to load; the speedup over stock"
        " is over the faster of the two. `import numpy` starts OpenBLAS's threads; the tracer"
        " imports NumPy without them.",
        ("scene", *commands, *_SPEEDUPS),
        rows,
    )


def benchmark_rendering(quick: bool) -> str:
    """Time the rendering of every scene in this process, without reading and writing files.

    Parameters
    ----------
    quick : bool
        Whether to render a few scenes in small pictures only.

    Returns
    -------
    section : str
        The section of the Markdown page with these times.
    """
    variant = use_variant().variant
    rows: list[tuple[object, ...]] = []
    for size in (_SMALL_SIZE,) if quick else (_SMALL_SIZE, _MEDIUM_SIZE, _LARGE_SIZE):
        speedups: list[tuple[float, float]] = []
        scenes = {path.stem: load_scene(path) for path in own_scenes()}
        scenes |= {f"field-{count}": field_scene(count) for count in (1000, 10_000)}
        for name in _FEW_SCENES if quick else scenes:
            scene = resize_picture(scenes[name], *size)
            exact_scene, stock_scene = str(convert_exact(scene)), str(convert_stock(scene, 1))
            timing, exact_timing = _time_tracer_and_mitsuba(scene, exact_scene)
            second_timing, stock_timing = _time_tracer_and_mitsuba(scene, stock_scene)
            over_exact = compute_speedup(timing, exact_timing)
            speedups.append((over_exact, compute_speedup(second_timing, stock_timing)))
            cells = timing, exact_timing, stock_timing, *speedups[-1]
            rows.append((f"{name} {size[0]}×{size[1]}", *cells))
        means = (geometric_mean(column) for column in zip(*speedups, strict=True))
        rows.append((f"geometric mean {size[0]}×{size[1]}", "", "", "", *means))
    return format_section(
        "Rendering alone",
        "Milliseconds in one process, one sample per pixel, timed alternately with pauses of 20 ms,"
        " because Mitsuba's threads keep spinning that long. The tracer uses one process, Mitsuba"
        f" {variant} {count_processors()} processors, with scene and kernels ready. Exact: the same"
        " picture, by this project's plugins. Stock: a similar one by Mitsuba's own plugins, with"
        " one light per sample; its speedup refers to a second timing of the tracer.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_SPEEDUPS),
        rows,
    )


def benchmark_objects(quick: bool) -> str:
    """Time the loading and rendering of scenes with up to 100,000 objects.

    Parameters
    ----------
    quick : bool
        Whether to use 10 and 100 objects only.

    Returns
    -------
    section : str
        The section of the Markdown page with these times.
    """
    use_variant()
    rows: list[tuple[object, ...]] = []
    for count in (10, 100) if quick else (100, 1000, 10_000, 100_000):
        save_scene(field_scene(count), path := build_path("objects.xml"))
        scene = load_scene(path)
        mitsuba_scene = str(convert_exact(scene))
        tasks: dict[str, Task] = {"parse": partial(ET.parse, path)}
        tasks |= {"load": partial(load_scene, path), "render": partial(render, scene)}
        # Mitsuba's many objects must not slow down the garbage collector, nor its kernels.
        gc.collect()
        gc.freeze()
        timings = time_interleaved(tasks, ROUNDS)
        gc.unfreeze()
        rows.append((f"{count:,}", *timings.values(), *_time_mitsuba_once(mitsuba_scene)))
    return format_section(
        "Many objects",
        "Milliseconds for small objects above a floor, under two lights, 640×360, one sample per"
        " pixel. Loading is the time from the text to the scene, for Mitsuba with one shape per"
        " object. `xml.etree` only parses the text. Mitsuba's first picture compiles its kernels."
        " Mitsuba is timed once.",
        ("objects", "xml.etree", "tracer: loading", "rendering",
         "Mitsuba: loading", "first picture", "next picture"),
        rows,
    )  # fmt: skip


def _time_mitsuba_once(mitsuba_scene: str) -> list[Timing]:
    """Time once how Mitsuba loads a scene, renders it, and renders it again.

    Parameters
    ----------
    mitsuba_scene : str
        The scene in Mitsuba's XML format.

    Returns
    -------
    timings : list of three Timing
        Times of loading, of the first picture, for which kernels are compiled, and of the second
        picture.
    """
    times = [perf_counter()]
    scene = mi.load_string(mitsuba_scene)
    times.append(perf_counter())
    for _ in range(2):
        np.array(mi.render(scene))
        times.append(perf_counter())
    return [Timing(seconds, seconds, seconds) for seconds in np.diff(times).tolist()]


def write_frames_and_commands(count: int, size: tuple[int, int]) -> dict[str, list[list[str]]]:
    """Write an animation's frames as scene files, and return each renderer's commands for them.

    The files are written to the build folder, in the format of each renderer.  The eye moves away
    from the scene, from frame to frame.

    Parameters
    ----------
    count : int
        Number of frames.
    size : (int, int)
        Width and height of each frame in pixels.

    Returns
    -------
    commands : dict of str to list of commands
        For the name of each renderer, commands to run one after the other.  A command is a list of
        the program and its arguments.  Only POV-Ray, if it is installed, needs more than one
        command.
    """
    scene = resize_picture(load_scene(SCENES / "sticks-perspective.xml"), *size)
    camera, eye = scene.camera, np.array(scene.camera.view_point)
    files, povray_commands = list[str](), list[list[str]]()
    mitsuba_files = {"exact": list[str](), "stock": list[str]()}
    for k in range(count):
        frame = replace(scene, camera=replace(camera, view_point=eye * (1 + k / count)))
        save_scene(frame, path := build_path(f"frame-{k}.xml"))
        files.append(str(path))
        converted = {"exact": convert_exact(frame), "stock": convert_stock(frame, 1)}
        for flavour, mitsuba_scene in converted.items():
            (path := build_path(f"frame-{k}.{flavour}.xml")).write_text(str(mitsuba_scene))
            mitsuba_files[flavour] += [str(path), f"{path}.png"]
        picture = build_path(f"frame-{k}.png")
        povray_commands.append(povray.write_scene_and_command(frame, picture))
    tracer = [sys.executable, "-m", "tracer", "--quiet", "--processes"]
    halves = [shlex.join([*tracer, "1", *files[k::2]]) for k in (0, 1)]
    pool_script = [sys.executable, "-c", _POOL_SCRIPT]
    mitsuba_script = [sys.executable, "-c", _MITSUBA_SCRIPT, use_variant().variant]
    commands = {
        "tracer, 1 process": [[*tracer, "1", *files]],
        "tracer, 2 processes": [[*tracer, "2", *files]],
        "two such commands, 1 process and half of the frames each": [
            ["sh", "-c", f"{halves[0]} & {halves[1]}; wait"]
        ],
        "pool.map(tracer.to_png), 1 worker": [[*pool_script, "1", *files]],
        "pool.map(tracer.to_png), 2 workers": [[*pool_script, "2", *files]],
        "Mitsuba exact": [[*mitsuba_script, *mitsuba_files["exact"]]],
        "Mitsuba stock": [[*mitsuba_script, *mitsuba_files["stock"]]],
    }
    return commands | ({"POV-Ray": povray_commands} if povray.is_installed() else {})


def benchmark_frames(quick: bool) -> str:
    """Time the commands with which each renderer renders the frames of an animation.

    Parameters
    ----------
    quick : bool
        Whether to render a few small frames only.

    Returns
    -------
    section : str
        The section of the Markdown page with these times.
    """
    count, size = (4, _SMALL_SIZE) if quick else (40, _MEDIUM_SIZE)
    renderers = write_frames_and_commands(count, size)
    tasks = {name: partial(run_commands, commands) for name, commands in renderers.items()}
    timings = time_interleaved(tasks, ROUNDS)
    timings = {name: timing.divided_by(count) for name, timing in timings.items()}
    first_timing = timings["tracer, 1 process"]
    return format_section(
        f"{count} frames of {size[0]}×{size[1]}",
        "Milliseconds per frame: files are read, one sample per pixel is rendered, and PNG files"
        f" are written, from the shell, on {count_processors()} processors. Starting the"
        " programs is included. Mitsuba and POV-Ray use all processors; POV-Ray starts anew for"
        " each frame. A speedup is over the first row.",
        ("renderer", "time per frame", "speedup"),
        [(name, timing, compute_speedup(timing, first_timing)) for name, timing in timings.items()],
    )


def run_commands(commands: Sequence[Sequence[str]]) -> None:
    """Run commands one after the other; raise CalledProcessError if one fails."""
    for command in commands:
        make_command_task(command)()


SECTIONS = (benchmark_whole_process, benchmark_rendering, benchmark_objects, benchmark_frames)


def main() -> None:
    """Measure all sections, print each when it is measured, and write the Markdown page."""
    arguments = make_parser("reference.benchmark", "small sizes").parse_args()
    mi.set_log_level(mi.LogLevel.Error)
    page = [
        "# Benchmark\n\nWritten by `python -m reference.benchmark`: median (minimum–maximum) of at"
        f" least {ROUNDS} rounds. A speedup above 1 means that the tracer is faster. Measured on"
        f" {describe_origin()}."
    ]
    for section in SECTIONS:
        page.append(section(arguments.quick))
        print(page[-1], end="\n\n", flush=True)
    path = build_path("benchmark.md") if arguments.quick else HERE / "benchmark.md"
    path.write_text("\n\n".join(page) + "\n", encoding="utf-8")
