"""Measure how fast the tracer renders, compared with compiled renderers.

``python -m reference.benchmark`` writes `benchmark.md` into this folder.  Renderers are timed
alternately.  If Mitsuba renders in this process, it compiles its kernels and builds its scene
before the clock starts.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import gc
import shlex
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import partial
from itertools import product
from statistics import geometric_mean
from time import perf_counter
from typing import NamedTuple

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import convert
from converters.variant import SCALAR, mi, use_variant
from reference import povray
from reference.command import REFERENCE_FOLDER, SCENES, build_path, list_scene_files, make_parser
from reference.measured.measurements import (
    Task,
    Timing,
    describe_origin,
    make_command_task,
    time_alternately,
)
from reference.measured.workloads import (
    build_animation,
    build_field_scene,
    copy_with_picture_size,
)
from tracer import Scene, load_scene, render, save_scene
from tracer.picture.parallel import count_processors

# Scenes of which whole processes are timed, and which are rendered with --quick.
_SELECTED_SCENES = ("one-sphere", "four-spheres", "sticks-perspective")

# Titles of the last two columns of a table.
_SPEEDUP_COLUMNS = ("speedup over exact", "speedup over stock")

# Widths and heights of the pictures in pixels.  Frames of an animation have the medium size.
_SMALL_SIZE = (320, 180)
_MEDIUM_SIZE = (1280, 720)
_LARGE_SIZE = (2560, 1440)

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

MIN_ROUNDS = 3
"""Minimum number of rounds in which each task is timed."""


def compute_speedup(timing: Timing, baseline_timing: Timing) -> float:
    """Compute how many times as fast as a baseline a task is, by median times."""
    return baseline_timing.median / timing.median


def format_ratio(ratio: float) -> str:
    """Format a positive ratio with at least two significant digits, such as 0.50×, 3.0× or 42×."""
    decimal_places = 2 if ratio < 0.995 else 1 if ratio < 9.95 else 0
    return f"{ratio:.{decimal_places}f}×"


def format_section(
    title: str, note: str, column_titles: Sequence[str], rows: Sequence[Sequence[object]]
) -> str:
    """Format a section of a Markdown page: a heading, a note and a table.

    Floats are formatted as ratios, other cells by `str`.
    """
    table = [column_titles, ["---"] * len(column_titles)]
    table += ([format_ratio(x) if isinstance(x, float) else str(x) for x in row] for row in rows)
    return "\n".join([f"## {title}\n\n{note}\n", *(f"| {' | '.join(cells)} |" for cells in table)])


class _PairTiming(NamedTuple):
    """Times of two renderers that were timed alternately."""

    tracer: Timing
    mitsuba: Timing

    @property
    def speedup(self) -> float:
        return compute_speedup(self.tracer, self.mitsuba)


def _summarize_speedups(
    size: tuple[int, int], speedups: Sequence[Sequence[float]], timing_column_count: int
) -> list[object]:
    """Make a table's row of the geometric mean of each speedup over all scenes.

    `speedups` has a sequence for each scene.  The columns of times are empty.
    """
    means = map(geometric_mean, zip(*speedups, strict=True))
    return [f"geometric mean {size[0]}×{size[1]}", *[""] * timing_column_count, *means]


def _time_tracer_and_mitsuba(scene: Scene, mitsuba_xml: str) -> _PairTiming:
    """Time alternately how the tracer and Mitsuba render a scene in this process.

    Mitsuba's scene, which `mitsuba_xml` describes, is loaded before the clock starts.
    """
    gc.collect()  # Mitsuba's kernels depend on all live objects, so keep only one scene loaded
    loaded_scene = mi.load_string(mitsuba_xml)
    tasks: dict[str, Task] = {
        "tracer": partial(render, scene),
        "Mitsuba": lambda: np.array(mi.render(loaded_scene)),
    }
    timings = time_alternately(tasks, MIN_ROUNDS)
    return _PairTiming(tracer=timings["tracer"], mitsuba=timings["Mitsuba"])


def _prepare_whole_process_commands(scene: Scene, variant: str) -> dict[str, list[str]]:
    """Write a scene in the format of each renderer, and return commands that render it.

    The files are in the build folder.  `variant` is Mitsuba's.  If POV-Ray is not installed, its
    command is missing.
    """
    tracer_file = build_path("tracer.xml")
    save_scene(scene, tracer_file)
    exact_file = build_path("exact.xml")
    exact_file.write_text(convert(scene, "exact"))
    stock_file = build_path("stock.xml")
    stock_file.write_text(convert(scene, "stock", 1))
    png_file = build_path("out.png")
    tracer_command = [sys.executable, "-m", "tracer", "--quiet", "-o", str(png_file)]
    mitsuba_script = [sys.executable, "-c", _MITSUBA_SCRIPT]
    commands = {
        "import numpy": [sys.executable, "-c", "import numpy"],
        "tracer": [*tracer_command, str(tracer_file)],
        "Mitsuba exact": [*mitsuba_script, variant, str(exact_file), str(png_file)],
        "Mitsuba stock": [*mitsuba_script, variant, str(stock_file), str(png_file)],
        "the same, scalar": [*mitsuba_script, SCALAR, str(stock_file), str(png_file)],
    }
    if povray.is_installed():
        commands["POV-Ray"] = povray.prepare_command(scene, png_file)
    return commands


def benchmark_whole_process(quick: bool) -> str:
    """Time each renderer's whole command, from a scene file to a PNG file.

    With `quick`, only one small scene is rendered.
    """
    variant = use_variant().variant
    rows: list[Sequence[object]] = []
    speedups: dict[tuple[int, int], list[list[float]]] = {}
    cases = [*product((_SMALL_SIZE, _LARGE_SIZE), _SELECTED_SCENES)]
    for size, scene_name in cases[:1] if quick else cases:
        scene = copy_with_picture_size(load_scene(SCENES / f"{scene_name}.xml"), *size)
        commands = _prepare_whole_process_commands(scene, variant)
        tasks = {name: make_command_task(command) for name, command in commands.items()}
        timings = time_alternately(tasks, MIN_ROUNDS, min_seconds=2.0)
        fastest_stock_timing = min(timings["Mitsuba stock"], timings["the same, scalar"])
        baselines = timings["Mitsuba exact"], fastest_stock_timing
        scene_speedups = [compute_speedup(timings["tracer"], baseline) for baseline in baselines]
        speedups.setdefault(size, []).append(scene_speedups)
        rows.append((f"{scene_name} {size[0]}×{size[1]}", *timings.values(), *scene_speedups))
    means = [_summarize_speedups(*item, len(commands)) for item in speedups.items()]
    return format_section(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell. Mitsuba and POV-Ray use {count_processors()} processors,"
        " and so does the tracer for large pictures. Mitsuba's kernels for"
        f" {variant} are cached. Its stock plugins are also timed in {SCALAR}, which needs no"
        " kernels; the speedup over stock is relative to the faster of the two. `import numpy`"
        " starts OpenBLAS's threads; the tracer imports NumPy without them.",
        ("scene", *commands, *_SPEEDUP_COLUMNS),
        [*means, *rows],
    )


def benchmark_rendering(quick: bool) -> str:
    """Time the rendering of every scene in this process, without reading or writing files.

    With `quick`, only a few small scenes are rendered.
    """
    variant = use_variant().variant
    scenes = {path.stem: load_scene(path) for path in list_scene_files()}
    scenes |= {f"field-{count}": build_field_scene(count) for count in (1000, 10_000)}
    means: list[Sequence[object]] = []
    rows: list[Sequence[object]] = []
    for size in (_SMALL_SIZE,) if quick else (_SMALL_SIZE, _MEDIUM_SIZE, _LARGE_SIZE):
        speedups = []
        for name in _SELECTED_SCENES if quick else scenes:
            scene = copy_with_picture_size(scenes[name], *size)
            exact = _time_tracer_and_mitsuba(scene, convert(scene, "exact"))
            stock = _time_tracer_and_mitsuba(scene, convert(scene, "stock", 1))
            speedups.append((exact.speedup, stock.speedup))
            times = exact.tracer, exact.mitsuba, stock.mitsuba
            rows.append((f"{name} {size[0]}×{size[1]}", *times, *speedups[-1]))
        means.append(_summarize_speedups(size, speedups, 3))
    return format_section(
        "Rendering alone",
        "Milliseconds for one sample per pixel. The renderers are timed alternately, with pauses of"
        " 20 ms until Mitsuba's threads stop spinning. The tracer uses one process; Mitsuba"
        f" {variant} uses {count_processors()} processors, and its scene and kernels are ready."
        " Exact: the same picture, by this project's plugins. Stock: a similar picture by Mitsuba's"
        " built-in plugins, with one light per sample, against a second timing of the tracer.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_SPEEDUP_COLUMNS),
        [*means, *rows],
    )


def benchmark_objects(quick: bool) -> str:
    """Time the loading and rendering of scenes with many objects.

    There are up to 100,000 objects, or 100 with `quick`.
    """
    use_variant()  # the fastest that works here
    rows: list[tuple[object, ...]] = []
    scene_file = build_path("objects.xml")
    for object_count in (10, 100) if quick else (100, 1000, 10_000, 100_000):
        save_scene(build_field_scene(object_count), scene_file)
        scene = load_scene(scene_file)
        mitsuba_xml = convert(scene, "exact")
        tasks: dict[str, Task] = {
            "parse": partial(ET.parse, scene_file),
            "load": partial(load_scene, scene_file),
            "render": partial(render, scene),
        }
        # Exempt Mitsuba's many objects from garbage collection, which would distort the timings.
        gc.collect()
        gc.freeze()
        timings = time_alternately(tasks, MIN_ROUNDS)
        gc.unfreeze()
        rows.append((f"{object_count:,}", *timings.values(), *_time_mitsuba_stages(mitsuba_xml)))
    return format_section(
        "Many objects",
        "Milliseconds for small objects above a floor, under two lights, 640×360, one sample per"
        " pixel. Loading turns XML text into a scene that is ready to render; `xml.etree` only"
        " parses the text. In Mitsuba, each object is a separate shape, and kernels are compiled"
        " before the first picture. Mitsuba is timed once. The tracer uses one process, Mitsuba"
        f" {count_processors()} processors.",
        ("objects", "xml.etree", "tracer: loading", "rendering",
         "Mitsuba: loading", "first picture", "next picture"),
        rows,
    )  # fmt: skip


def _time_mitsuba_stages(mitsuba_xml: str) -> list[Timing]:
    """Time how long Mitsuba takes to load a scene, and to render it twice.

    The first rendering includes the compilation of kernels.
    """
    timestamps = [perf_counter()]
    scene = mi.load_string(mitsuba_xml)
    timestamps.append(perf_counter())
    for _ in range(2):
        np.array(mi.render(scene))
        timestamps.append(perf_counter())
    return [Timing(seconds, seconds, seconds) for seconds in np.diff(timestamps).tolist()]


class _FrameFiles(NamedTuple):
    """The files and commands of an animation, frame by frame."""

    scene_files: list[str]
    mitsuba_paths: dict[str, list[str]]  # by flavour: a scene file and a picture for each frame
    povray_commands: list[list[str]]


def _write_frames(frame_count: int, size: tuple[int, int]) -> _FrameFiles:
    """Write an animation's frames as scene files in the build folder, for each renderer."""
    scene = copy_with_picture_size(load_scene(SCENES / "sticks-perspective.xml"), *size)
    frames = _FrameFiles(
        scene_files=[], mitsuba_paths={"exact": [], "stock": []}, povray_commands=[]
    )
    for frame_index, frame_scene in enumerate(build_animation(scene, frame_count)):
        scene_file = build_path(f"frame-{frame_index}.xml")
        save_scene(frame_scene, scene_file)
        frames.scene_files.append(str(scene_file))
        for flavour, paths in frames.mitsuba_paths.items():
            mitsuba_file = build_path(f"frame-{frame_index}.{flavour}.xml")
            mitsuba_file.write_text(convert(frame_scene, flavour, 1))
            paths += [str(mitsuba_file), f"{mitsuba_file}.png"]
        povray_picture = build_path(f"frame-{frame_index}.png")
        frames.povray_commands.append(povray.prepare_command(frame_scene, povray_picture))
    return frames


def prepare_animation_commands(
    frame_count: int, size: tuple[int, int]
) -> dict[str, list[list[str]]]:
    """Write an animation's frames as scene files, and return commands that render them.

    The keys of the result are names of the renderers.  Each renderer has a single command for all
    frames, except POV-Ray, which has one for each frame and is missing if it is not installed.
    """
    scene_files, mitsuba_paths, povray_commands = _write_frames(frame_count, size)
    tracer_command = [sys.executable, "-m", "tracer", "--quiet", "--processes"]
    half_commands = [shlex.join([*tracer_command, "1", *scene_files[start::2]]) for start in (0, 1)]
    pool_script = [sys.executable, "-c", _POOL_SCRIPT]
    mitsuba_script = [sys.executable, "-c", _MITSUBA_SCRIPT, use_variant().variant]
    commands = {
        "tracer, 1 process": [[*tracer_command, "1", *scene_files]],
        "tracer, 2 processes": [[*tracer_command, "2", *scene_files]],
        "two such commands, 1 process and half of the frames each": [
            ["sh", "-c", f"{half_commands[0]} & {half_commands[1]}; wait"]
        ],
        "pool.map(tracer.to_png), 1 worker": [[*pool_script, "1", *scene_files]],
        "pool.map(tracer.to_png), 2 workers": [[*pool_script, "2", *scene_files]],
        "Mitsuba exact": [[*mitsuba_script, *mitsuba_paths["exact"]]],
        "Mitsuba stock": [[*mitsuba_script, *mitsuba_paths["stock"]]],
    }
    return commands | ({"POV-Ray": povray_commands} if povray.is_installed() else {})


def benchmark_frames(quick: bool) -> str:
    """Time each renderer's commands for rendering an animation; with `quick`, few small frames."""
    frame_count, size = (4, _SMALL_SIZE) if quick else (40, _MEDIUM_SIZE)
    renderer_commands = prepare_animation_commands(frame_count, size)
    tasks = {name: partial(run_commands, commands) for name, commands in renderer_commands.items()}
    total_timings = time_alternately(tasks, MIN_ROUNDS)
    timings = {name: timing.divided_by(frame_count) for name, timing in total_timings.items()}
    baseline = timings["tracer, 1 process"]
    return format_section(
        f"{frame_count} frames of {size[0]}×{size[1]}",
        "Milliseconds per frame, from the shell: reading the files, rendering one sample per pixel,"
        f" and writing PNG files, on {count_processors()} processors. Starting the programs is"
        " included. Mitsuba and POV-Ray use all processors; POV-Ray starts anew for"
        " each frame. Speedups are relative to the first row.",
        ("renderer", "time per frame", "speedup"),
        [(name, timing, compute_speedup(timing, baseline)) for name, timing in timings.items()],
    )


def run_commands(commands: Sequence[Sequence[str]]) -> None:
    """Run commands one after another, and raise CalledProcessError if one fails."""
    for command in commands:
        make_command_task(command)()


BENCHMARKS = (benchmark_whole_process, benchmark_rendering, benchmark_objects, benchmark_frames)


def main() -> None:
    """Run all benchmarks, print each result as soon as it is ready, and write `benchmark.md`."""
    arguments = make_parser("reference.benchmark", quick_help="small sizes").parse_args()
    mi.set_log_level(mi.LogLevel.Error)
    sections = [
        "# Benchmark\n\nWritten by `python -m reference.benchmark`: median (minimum–maximum) of at"
        f" least {MIN_ROUNDS} rounds. A speedup above 1 means that the tracer is faster. Measured"
        f" on {describe_origin()}."
    ]
    for benchmark in BENCHMARKS:
        sections.append(benchmark(arguments.quick))
        print(sections[-1], end="\n\n", flush=True)
    page_path = build_path("benchmark.md") if arguments.quick else REFERENCE_FOLDER / "benchmark.md"
    page_path.write_text("\n\n".join(sections) + "\n", encoding="utf-8")
