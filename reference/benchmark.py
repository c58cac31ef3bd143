"""Times of the tracer beside compiled renderers, measured in one run.

``python -m reference.benchmark`` writes `benchmark.md` and `.csv` into this folder.  Rivals run in
turns; Mitsuba's kernels are compiled, and its scene is built, before the clock starts.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import geometric_mean
from time import sleep
from typing import TypeAlias

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact, stock
from converters.variant import SCALAR, mi, use
from reference import povray
from reference.command import SCENES, built, own_scenes
from reference.measured.measurements import (
    Ratio,
    Table,
    Task,
    Timing,
    interleaved,
    measure_page,
    process,
)
from reference.measured.workloads import crowd, field, resized
from tracer import Scene, load_scene, render, save_scene
from tracer.picture.parallel import processors

__all__ = ["SECTIONS", "Section", "growth_exponent", "main", "peak"]

_FEW = ("one-sphere", "four-spheres", "sticks-perspective")
_SPEEDUPS = ("speedup over exact", "speedup over stock")
_SMALL, _MEDIUM, _LARGE = (320, 180), (1280, 720), (2560, 1440)

# Loading more objects takes Mitsuba most of a minute.
_MOST_OF_MITSUBA = 10_000

# What anyone's script to render one scene with Mitsuba amounts to.
_MITSUBA = """
import sys
import mitsuba as mi
variant, source, target = sys.argv[1:]
mi.set_variant(variant)
if "unattenuated_point" in open(source).read():
    import converters.plugins
mi.util.write_bitmap(target, mi.render(mi.load_file(source)), write_async=False)
"""

Section: TypeAlias = Callable[[int, bool], Table]
"""Measures one table, given the number of rounds, and whether to be quick."""


def growth_exponent(sizes: Sequence[float], timings: Sequence[Timing]) -> float:
    """Slope of time against size, both logarithmic, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log([t.median for t in timings]), 1)[0])


def _speedup(of: Timing, over: Timing) -> Ratio:
    return Ratio(over.median / of.median)


def _mitsuba(text: str) -> Task:
    loaded = mi.load_string(text)
    return lambda: np.array(mi.render(loaded))


def _beside(scene: Scene, rounds: int, text: str) -> list[Timing]:
    """Time the tracer and Mitsuba, whose kernels choose among all objects alive, in turns."""
    gc.collect()
    tasks: dict[str, Task] = {"ours": partial(render, scene), "theirs": _mitsuba(text)}
    return [*interleaved(tasks, rounds).values()]


def _tracer(source: Path) -> list[str]:
    return [sys.executable, "-m", "tracer", "--quiet", "-o", str(built("out.png")), str(source)]


def whole_process(rounds: int, quick: bool) -> Table:
    """Time commands from XML to PNG."""
    variant, png = use().variant, str(built("out.png"))
    mitsuba = [sys.executable, "-c", _MITSUBA]
    rows: list[tuple[object, ...]] = []
    for size, name in product((_SMALL,) if quick else (_SMALL, _LARGE), _FEW):
        scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
        save_scene(scene, ours := built("tracer.xml"))
        (exactly := built("exact.xml")).write_text(exact(scene))
        (similar := built("stock.xml")).write_text(stock(scene, 1))
        commands = {
            "import numpy": [sys.executable, "-c", "import numpy"],
            "tracer": _tracer(ours),
            "Mitsuba exact": [*mitsuba, variant, str(exactly), png],
            "Mitsuba stock": [*mitsuba, variant, str(similar), png],
            "the same, scalar": [*mitsuba, SCALAR, str(similar), png],
        }
        if povray.installed():
            commands["POV-Ray"] = povray.command(scene, Path(png))
        tasks = {who: process(command) for who, command in commands.items()}
        found = interleaved(tasks, rounds, enough=2.0)
        rivals = ("Mitsuba exact", "Mitsuba stock", "the same, scalar")
        over_exact, *over_stock = (_speedup(found["tracer"], found[rival]) for rival in rivals)
        cells = (*found.values(), over_exact, min(over_stock))
        rows.append((f"{name} {size[0]}×{size[1]}", *cells))
    return Table(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell. Mitsuba {variant} with a warm kernel cache; its stock"
        f" plugins also in {SCALAR}, which has no kernels to load. The speedup over stock is over"
        " the faster of the two. `import numpy` starts OpenBLAS's threads; the tracer imports NumPy"
        " without them.",
        ("scene", *commands, *_SPEEDUPS),
        rows,
    )


def rendering(rounds: int, quick: bool) -> Table:
    """Time one sample a pixel on every scene, in process, with everything ready."""
    variant = use().variant
    rows: list[tuple[object, ...]] = []
    for size in (_SMALL,) if quick else (_SMALL, _MEDIUM, _LARGE):
        found: list[tuple[Ratio, Ratio]] = []
        scenes = {path.stem: load_scene(path) for path in own_scenes()}
        scenes |= {f"field-{count}": field(count) for count in (1000, 10_000)}
        for name in _FEW if quick else scenes:
            scene = resized(scenes[name], *size)
            ours, exactly = _beside(scene, rounds, exact(scene))
            again, stocks = _beside(scene, rounds, stock(scene, 1))
            found.append((_speedup(ours, exactly), _speedup(again, stocks)))
            rows.append((f"{name} {size[0]}×{size[1]}", ours, exactly, stocks, *found[-1]))
        means = (Ratio(geometric_mean(column)) for column in zip(*found, strict=True))
        rows.append((f"geometric mean {size[0]}×{size[1]}", "", "", "", *means))
    return Table(
        "Rendering alone",
        "Milliseconds in process, one sample a pixel, in turns with pauses of 20 ms: Mitsuba's"
        f" threads keep spinning that long. Mitsuba {variant}, scene and kernels ready, as are the"
        " tracer's workers. Exact: the same picture, by this project's plugins; stock: a similar"
        " one by Mitsuba's own, with one light a sample, in turns with a second timing of the"
        " tracer, to which its speedup refers.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_SPEEDUPS),
        rows,
    )


def growth_in_objects(rounds: int, quick: bool) -> Table:
    """Time N small objects, spread out, beside Mitsuba."""
    use()
    counts = (10, 100, 1000) if quick else (10, 100, 1000, 10_000, 100_000)
    rows: list[tuple[object, ...]] = []
    timings = []
    for count in counts:
        save_scene(scene := crowd(count), path := built("many.xml"))
        tasks: dict[str, Task] = {
            "first": lambda path=path: render(load_scene(path)),  # type: ignore[misc]
            "warm": partial(render, scene),
        }
        if count <= _MOST_OF_MITSUBA:
            gc.collect()
            text = exact(scene)
            tasks["Mitsuba, first"] = lambda text=text: _mitsuba(text)()  # type: ignore[misc]
            tasks["Mitsuba, warm"] = _mitsuba(exact(scene))
        found = interleaved(tasks, rounds)
        tasks.clear()
        timings.append(found["warm"])
        pairs = [(found[kind], found.get(f"Mitsuba, {kind}")) for kind in ("first", "warm")]
        speedups = (_speedup(ours, theirs) if theirs else "–" for ours, theirs in pairs)
        times = (timing or "–" for pair in pairs for timing in pair)
        rows.append((f"{count:,}", *times, *speedups))
    return Table(
        "Growth in objects: N small ones, two lights, 640×360",
        "Milliseconds, first from a scene's text to its picture, then warm. Mitsuba has a shape per"
        f" object, and is not asked for more than {_MOST_OF_MITSUBA:,}. Objects shrink as N grows:"
        " together they cover about the same area. The tracer's warm time grows as"
        f" N^{growth_exponent(counts, timings):.2f}, in the last step as"
        f" N^{growth_exponent(counts[-2:], timings[-2:]):.2f}.",
        ("N", "tracer, first", "Mitsuba, first", "tracer, warm", "Mitsuba, warm", "first", "warm"),
        rows,
    )


def loading(rounds: int, quick: bool) -> Table:
    """Time reading and validating many objects, against xml.etree alone."""
    count = 1000 if quick else 100_000
    save_scene(crowd(count), path := built("many.xml"))
    # As in a small process: no collection of garbage goes through all of Mitsuba's objects as well.
    gc.collect()
    gc.freeze()
    tasks: dict[str, Task] = {"tracer": partial(load_scene, path), "etree": partial(ET.parse, path)}
    found = interleaved(tasks, rounds)
    gc.unfreeze()
    ratio = _speedup(found["etree"], found["tracer"])
    return Table(
        "Loading",
        "Milliseconds to read and validate a scene file, and for `xml.etree` only to parse it.",
        ("objects", "tracer", "xml.etree", "ratio"),
        [(f"{count:,}", *found.values(), ratio)],
    )


def frames(rounds: int, quick: bool) -> Table:
    """Time a sequence of frames, alone and with the processes of an executor."""
    count = 10 if quick else 200
    scene = resized(load_scene(SCENES / "sticks-perspective.xml"), *_MEDIUM)
    camera, eye = scene.camera, np.array(scene.camera.view_point)
    scenes = [
        replace(scene, camera=replace(camera, view_point=eye * (1 + k / count)))
        for k in range(count)
    ]

    def alone() -> None:
        for each in scenes:
            render(each)

    with ProcessPoolExecutor(1) as one, ProcessPoolExecutor(2) as two:
        for pool in (one, two):
            list(pool.map(abs, range(8)))  # its processes have started

        def sharing(pool: Executor) -> None:
            for each in scenes:
                render(each, executor=pool)

        found = interleaved(
            {
                "alone": alone,
                "1 worker, render(scene, executor=pool)": partial(sharing, one),
                "2 workers, render(scene, executor=pool)": partial(sharing, two),
                "1 worker, pool.map(render, scenes)": lambda: list(one.map(render, scenes)),
                "2 workers, pool.map(render, scenes)": lambda: list(two.map(render, scenes)),
            },
            rounds,
        )
    return Table(
        f"{count} frames of {_MEDIUM[0]}×{_MEDIUM[1]}",
        "Milliseconds for all of them, one sample a pixel, with a standard library's pool of"
        f" processes on {processors()} processors: each picture shared with it, or whole pictures"
        " given to it.",
        ("who draws", "time", "speedup"),
        [(name, time, _speedup(time, found["alone"])) for name, time in found.items()],
    )


# A process starts out with its parent's peak memory: a small one must be in between.
_WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak(*command: str) -> float:
    """Peak resident memory of a process and its workers, MB; what they share counts once."""
    watched, together = (sys.executable, "-c", _WATCH, *command), 0.0
    with subprocess.Popen(watched, stdout=subprocess.PIPE, text=True) as watch:
        while watch.poll() is None:
            together = max(together, _resident(watch.pid))
            sleep(0.005)
        alone = int(watch.communicate()[0])  # in kibibytes on Linux, in bytes on macOS
    return max(alone * (1 if sys.platform == "darwin" else 1024) / 1e6, together)


def _resident(pid: int | str) -> float:
    """Memory of all that a process has started, MB (Linux' proportional set sizes), or 0."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        shares = " ".join(Path(f"/proc/{child}/smaps_rollup").read_text() for child in children)
    except OSError:
        return 0.0
    kibibytes = sum(map(int, re.findall(r"\bPss: +(\d+)", shares)))
    return kibibytes * 1024 / 1e6 + sum(map(_resident, children))


def memory(rounds: int, quick: bool) -> Table:
    """Measure the peak resident memory of whole processes."""
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    scenes = {"sticks-perspective 2560×1440": resized(sticks, *_LARGE)}
    if not quick:
        scenes["100,000 objects 640×360"] = crowd(100_000)
        scenes["sticks-perspective 8192×8192"] = resized(sticks, 8192, 8192)
    rows, path = list[tuple[str, str]](), built("scene.xml")
    for name, scene in scenes.items():
        save_scene(scene, path)
        rows.append((name, f"{peak(*_tracer(path)):.0f}"))
    note = (
        "Peak resident MB of `python -m tracer` with its workers; Python with NumPy alone takes"
        f" {peak(sys.executable, '-c', 'import numpy'):.0f}."
    )
    return Table("Memory", note, ("scene", "tracer"), rows)


SECTIONS: list[Section] = [whole_process, rendering, growth_in_objects, loading, frames, memory]


def _tables(quick: bool) -> Iterator[Table]:
    mi.set_log_level(mi.LogLevel.Error)
    for section in SECTIONS:
        yield section(2 if quick else 3, quick)


def main() -> None:
    """Measure, and write the page."""
    head = (
        "# Benchmark\n\nMade by `python -m reference.benchmark`: median (fastest–slowest) of at"
        " least 3 rounds. A speedup is the other's time over the tracer's: below 1 the tracer is"
        " slower."
    )
    measure_page("benchmark", __doc__, "small sizes, two rounds", head, _tables)
