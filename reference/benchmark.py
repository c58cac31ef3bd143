"""How fast the tracer is beside compiled renderers, measured in one run.

    python -m reference.benchmark [--quick]

writes `benchmark.md` and `benchmark.csv` into this folder, and the tables that the
README quotes into the README.  What is compared is run in turns; times are
medians, followed by the fastest and the slowest.  The tracer renders fresh
scenes, each once; Mitsuba renders one scene again and again, its kernels
compiled and its scene built before the clock starts.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import geometric_mean
from time import perf_counter, sleep
from typing import Any, TypeAlias

import numpy as np

from converters.flavours import exact, stock
from converters.variant import SCALAR, mi, use
from reference import machine, minimal, rivals
from reference.command import HERE, SCENES, built, need_scenes, own_scenes, parser, result, run
from reference.tables import Ratio, Table, quote, write_records
from reference.timing import Task, Timing, interleaved, on_copies, process
from reference.workloads import CROWDS, calm, crowd, lit_by, resized, to_xml
from tracer import Scene, load_scene, render

__all__ = ["Section", "compact", "growth_exponent", "main", "peak", "tables"]

_FEW = ("one-sphere", "four-spheres", "sticks-perspective")
_SPEEDUPS = ("speedup over exact", "speedup over stock")
_SPEEDUP = "A speedup is the other's time over the tracer's: below 1 the tracer is slower."
_SMALL, _LARGE = (300, 300), (2560, 1440)


def growth_exponent(sizes: Sequence[float], timings: Sequence[Timing]) -> float:
    """Slope of time against size, both logarithmic, by least squares."""
    slope, _ = np.polyfit(np.log(sizes), np.log([t.median for t in timings]), 1)
    return float(slope)


# Short times vary most: up to `_MORE` times the rounds, until they add up to `_ENOUGH` seconds.
# Whole processes vary more than what goes on in one.
_MORE, _ENOUGH, _ENOUGH_OF_PROCESSES = 5, 0.5, 2.0


def _warm(tasks: dict[str, Task], rounds: int, enough: float = _ENOUGH) -> dict[str, Timing]:
    """Time tasks in turns, each after a run to warm up."""
    for task in tasks.values():
        task(-1)
    return interleaved(tasks, rounds, most=_MORE * rounds, seconds=enough)


def _processes(commands: dict[str, list[str]], rounds: int) -> dict[str, Timing]:
    """The same of whole processes."""
    tasks = {who: process(command) for who, command in commands.items()}
    return _warm(tasks, rounds, _ENOUGH_OF_PROCESSES)


def _tracer(scene: Scene, rounds: int, samples: int = 1) -> Task:
    return on_copies(partial(render, samples=samples), scene, _MORE * rounds)


def _tracer_alone(scene: Scene, rounds: int) -> Timing:
    return _warm({"": _tracer(scene, rounds)}, rounds)[""]


def _mitsuba(loaded: Any) -> Task:
    return lambda _: np.array(mi.render(loaded))


def _beside(scene: Scene, rounds: int, load: Callable[[Scene], Any]) -> tuple[Timing, Timing]:
    """The tracer and Mitsuba in turns, with no other scene of Mitsuba's alive."""
    gc.collect()
    tasks = {"tracer": _tracer(scene, rounds), "Mitsuba": _mitsuba(load(scene))}
    ours, theirs = _warm(tasks, rounds).values()
    return ours, theirs


def _speedup(of: Timing, over: Timing) -> Ratio:
    return Ratio(over.median / of.median)


# --- The tables --------------------------------------------------------------------------


def whole_process(rounds: int, quick: bool) -> Table:
    """XML to PNG, from the shell."""
    variant = use().variant
    png = built("out.png")
    rows: list[tuple[object, ...]] = []
    for size in (_SMALL,) if quick else (_SMALL, _LARGE):
        for name in _FEW:
            scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
            texts = {"tracer": to_xml(scene), "exact": exact(scene), "stock": stock(scene, 1)}
            paths = {kind: built(f"{name}.{kind}.xml") for kind in texts}
            for kind, text in texts.items():
                paths[kind].write_text(text)
            commands = {
                "import numpy": [sys.executable, "-c", "import numpy"],
                "tracer": rivals.tracer_command(paths["tracer"], png),
                "Mitsuba exact": rivals.mitsuba_command(paths["exact"], png),
                "Mitsuba stock": rivals.mitsuba_command(paths["stock"], png),
                "the same, scalar": rivals.mitsuba_command(paths["stock"], png, SCALAR),
            }
            if rivals.povray_installed():
                commands["POV-Ray"] = rivals.povray_command(scene, png)
            found = _processes(commands, rounds)
            ours, stocks = found["tracer"], (found["Mitsuba stock"], found["the same, scalar"])
            least = min(stocks, key=lambda spent: spent.median)
            speedups = _speedup(ours, found["Mitsuba exact"]), _speedup(ours, least)
            rows.append((f"{name} {size[0]}×{size[1]}", *found.values(), *speedups))
    return Table(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell: median (fastest–slowest) of at least {rounds}. Mitsuba"
        f" {variant} with a warm kernel cache; by stock plugins also in {SCALAR}, which has no"
        " kernels to load; the speedup is over the faster of the two. (This project's plugins, in"
        " Python, would be slow there.) `import numpy`, all that a process does, starts"
        " OpenBLAS's threads; the tracer imports NumPy without them.",
        ("scene", *commands, *_SPEEDUPS),
        rows,
    )


def warm(rounds: int, quick: bool) -> Table:
    """In process, one sample a pixel, on every scene."""
    variant = use().variant
    sizes = ((320, 180),) if quick else ((320, 180), (1280, 720), _LARGE)
    names = [path.stem for path in own_scenes()]
    rows: list[tuple[object, ...]] = []
    # Both are ready: Mitsuba has compiled its kernels, and the tracer's helper is there.
    for _ in range(2):
        render(resized(load_scene(SCENES / f"{_FEW[-1]}.xml"), *_LARGE))
        sleep(0.5)
    for size in sizes:
        for name in _FEW if quick else names:
            scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
            ours, exactly = _beside(scene, rounds, rivals.mitsuba_exact)
            again, stocks = _beside(scene, rounds, rivals.mitsuba_stock)
            speedups = _speedup(ours, exactly), _speedup(again, stocks)
            rows.append((f"{name} {size[0]}×{size[1]}", ours, exactly, stocks, *speedups))
    return Table(
        "Warm: rendering alone",
        "Milliseconds in process, one sample a pixel: median (fastest–slowest) of at least"
        f" {rounds}, taken in turns with pauses of 20 ms: Mitsuba's threads keep spinning that"
        f" long. Mitsuba {variant}, scene and kernels ready, as is the tracer's helper. Exact: the"
        " same picture, by this project's plugins; stock: a similar one by Mitsuba's own, with one"
        " light a sample, in turns with a second timing of the tracer, to which its speedup"
        " refers.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_SPEEDUPS),
        rows,
    )


def compact(table: Table) -> Table:
    """`warm` with a row for each scene: over the exact flavour, and the mean over the stock one."""
    columns: dict[str, dict[str, dict[str, Any]]] = {}
    for row in table.rows:
        cells = dict(zip(table.header, row, strict=True))
        name, size = str(cells["scene"]).rsplit(" ", 1)
        columns.setdefault(size, {})[name] = cells
    rows: list[tuple[object, ...]] = []
    for name in next(iter(columns.values())):
        found = [column[name] for column in columns.values()]
        medians = [(Timing.of([cells["tracer"].median]), cells[_SPEEDUPS[0]]) for cells in found]
        rows.append((name, *chain(*medians)))
    whats = "geometric mean", "the same over stock plugins"
    for what, over in zip(whats, _SPEEDUPS, strict=True):
        means = [
            Ratio(geometric_mean([cells[over] for cells in column.values()]))
            for column in columns.values()
        ]
        rows.append((what, *chain(*(("", mean) for mean in means))))
    return Table(
        table.title,
        "The tracer's milliseconds in process, one sample a pixel, and its speedup over Mitsuba"
        f" {use().variant}, scene and kernels ready, for the same picture by this project's"
        " plugins (Mitsuba's stock ones draw a similar picture, with one light a sample);"
        " [all figures](reference/benchmark.md).",
        ("scene", *chain(*((size, "speedup") for size in columns))),
        rows,
    )


def _from_file(path: Path, _: int) -> object:
    return render(load_scene(path))


def _from_text(text: str, _: int) -> object:
    return np.array(mi.render(mi.load_string(text)))


# Loading so many objects takes Mitsuba most of a minute: once has to do.
_MOST_LOADED_AGAIN = 10_000


def growth_in_objects(rounds: int, quick: bool) -> Table:
    """N small objects, spread out, beside Mitsuba."""
    use()
    counts = (10, 100, 1000) if quick else (10, 100, 1000, 10_000, 100_000)
    rows: list[tuple[object, ...]] = []
    timings = []
    for count in counts:
        scene = crowd(count)
        path = built("many.xml")
        path.write_text(to_xml(scene))
        ours, merged = _beside(scene, rounds, rivals.mitsuba_merged)
        gc.collect()
        text = exact(scene)
        whole = _warm({"": partial(_from_file, path)}, rounds)[""]
        again = count <= _MOST_LOADED_AGAIN
        start = perf_counter()
        loaded = mi.load_string(text)
        np.array(mi.render(loaded))
        first = Timing.of([perf_counter() - start])
        shapes = interleaved({"": _mitsuba(loaded)}, rounds if again else 1)[""]
        del loaded
        if again:  # that was to warm up
            gc.collect()
            first = interleaved({"": partial(_from_text, text)}, rounds)[""]
        timings.append(ours)
        speedups = _speedup(whole, first), _speedup(ours, shapes), _speedup(ours, merged)
        rows.append((f"{count:,}", whole, first, ours, shapes, merged, *speedups))
    return Table(
        "Growth in objects: N small ones, two lights, 640×360",
        "Milliseconds, first from a scene's text to its picture, then warm; Mitsuba's kernels are"
        " ready for both, and its times at 100,000 are of one round. Mitsuba with a shape per"
        " object; and with all objects merged into one mesh of one material, spheres as"
        " icosahedra (the wrong picture, its fastest geometry). Objects shrink as N grows: together"
        " they cover about the same area. The tracer's time grows as"
        f" N^{growth_exponent(counts, timings):.2f}, in the last step as"
        f" N^{growth_exponent(counts[-2:], timings[-2:]):.2f}.",
        (
            "N",
            "tracer, first",
            "Mitsuba, first",
            "tracer, warm",
            "Mitsuba, warm",
            "Mitsuba merged, warm",
            "speedup, first",
            "speedup, warm",
            "speedup over merged",
        ),
        rows,
    )


def crowded(rounds: int, quick: bool) -> Table:
    """The same, for the tracer alone, where the objects crowd together."""
    counts = (10, 1000) if quick else (10, 100, 1000, 10_000, 100_000)
    rows: list[tuple[object, ...]] = []
    for kind, words in CROWDS.items():
        timings = [_tracer_alone(crowd(count, kind), rounds) for count in counts]
        rows.append((words, *timings, f"N^{growth_exponent(counts, timings):.2f}"))
    return Table(
        "Growth where objects crowd together",
        "Milliseconds for the tracer, 640×360, two lights.",
        ("objects", *(f"N = {count:,}" for count in counts), "grows as"),
        rows,
    )


def growth_in_pixels_and_lights(rounds: int, quick: bool) -> Table:
    """Pixels and lights, on the 21-object scene."""
    scene = load_scene(SCENES / "sticks-perspective.xml")
    widths = (160, 320) if quick else (160, 320, 640, 1280, 2560, 5120)
    lights = (1, 2) if quick else (1, 2, 4, 8, 16, 32)
    by_size = [resized(scene, width, width * 9 // 16) for width in widths]
    by_light = [lit_by(resized(scene, 1280, 720), count) for count in lights]
    rows: list[tuple[object, ...]] = []
    for what, sizes, scenes in (
        ("pixels", [s.width * s.height for s in by_size], by_size),
        ("lights (1280×720)", list(lights), by_light),
    ):
        timings = [_tracer_alone(each, rounds) for each in scenes]
        exponent = growth_exponent(sizes[-3:], timings[-3:])
        rows += [
            (f"{what}: {size:,}", timing, f"^{exponent:.2f}" if size == sizes[-1] else "")
            for size, timing in zip(sizes, timings, strict=True)
        ]
    return Table(
        "Growth in pixels and in lights",
        "Milliseconds for the tracer on the 21-object scene; the exponent is that of the last"
        " three.",
        ("number", "tracer", "grows as"),
        rows,
    )


def smooth(rounds: int, quick: bool) -> Table:
    """What antialiasing costs where no pixel needs it."""
    sizes = ((320, 180),) if quick else ((320, 180), (1280, 720), _LARGE)
    numbers = (1, 4, 16, 64)
    rows: list[tuple[object, ...]] = []
    for width, height in sizes:
        for name, scene in calm(width=width, height=height).items():
            tasks = {str(samples): _tracer(scene, rounds, samples) for samples in numbers}
            one, *more = _warm(tasks, rounds).values()
            ratios = (Ratio(timing.median / one.median) for timing in more)
            rows.append((f"{name} {width}×{height}", one, *ratios))
    return Table(
        "Antialiasing where nothing needs it",
        "Milliseconds for the tracer at one sample a pixel, and how many times as long it takes for"
        " more, where all of the picture is one smooth surface: so much it costs to make sure.",
        ("picture", "one sample", *(f"{samples} samples" for samples in numbers[1:])),
        rows,
    )


def loading(rounds: int, quick: bool) -> Table:
    """Reading and validating many objects, against xml.etree alone."""
    count = 1000 if quick else 100_000
    path = built("many.xml")
    path.write_text(to_xml(crowd(count)))
    # As in a small process: etree makes many objects, and each garbage collection that these set
    # off would go through all of Mitsuba's as well.
    gc.collect()
    gc.freeze()
    found = interleaved(
        {"tracer": lambda _: load_scene(path), "etree": lambda _: ET.parse(path)}, rounds
    )
    gc.unfreeze()
    ratio = Ratio(found["tracer"].median / found["etree"].median)
    return Table(
        "Loading",
        "Milliseconds to read and validate a scene file, and for `xml.etree` only to parse it.",
        ("objects", "tracer", "xml.etree", "ratio"),
        [(f"{count:,}", found["tracer"], found["etree"], ratio)],
    )


# A process starts out with its parent's peak memory: a small one must be in between.
_WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak(*command: str) -> float:
    """Peak resident memory of a process and its workers, MB; what they share counts once."""
    command = (sys.executable, "-c", _WATCH, *command)
    together = 0.0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as watch:
        while watch.poll() is None:
            together = max(together, sum(map(_resident, _below(watch.pid))))
            sleep(0.005)
        alone, _ = watch.communicate()
    if watch.returncode:
        raise subprocess.CalledProcessError(watch.returncode, command)
    # Linux counts kibibytes, macOS bytes.
    return max(int(alone) * (1 if sys.platform == "darwin" else 1024) / 1e6, together)


def _below(pid: int) -> list[int]:
    """All processes that a process has started, where the system tells."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [process for child in map(int, children) for process in (child, *_below(child))]


def _resident(pid: int) -> float:
    """A process's share of resident memory (its proportional set size), MB."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def memory(rounds: int, quick: bool) -> Table:
    """Peak resident memory of whole processes."""
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    scenes = {"sticks-perspective 2560×1440": resized(sticks, *_LARGE)}
    if not quick:
        scenes["100,000 objects 640×360"] = crowd(100_000)
        scenes["sticks-perspective 8192×8192"] = resized(sticks, 8192, 8192)
    rows: list[tuple[object, ...]] = []
    for name, scene in scenes.items():
        path = built("scene.xml")
        path.write_text(to_xml(scene))
        most = peak(*rivals.tracer_command(path, built("out.png")))
        rows.append((name, f"{most:.0f}"))
    base = peak(sys.executable, "-c", "import numpy")
    return Table(
        "Memory",
        f"Peak resident MB of `python -m tracer` with its workers; Python with NumPy alone takes"
        f" {base:.0f}.",
        ("scene", "tracer"),
        rows,
    )


def limit(rounds: int, quick: bool) -> Table:
    """A compiled loop that knows the answer."""
    rows: list[tuple[object, ...]] = []
    for size in (_SMALL,) if quick else (_SMALL, _LARGE):
        for name in _FEW:
            scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
            loops = minimal.Minimal(scene)
            tasks: dict[str, Task] = {
                "tracer": _tracer(scene, rounds),
                "both": lambda _, loops=loops: (loops.find(), loops.shade()),  # type: ignore[misc]
                "shade": lambda _, loops=loops: loops.shade(),  # type: ignore[misc]
            }
            found = _warm(tasks, rounds)
            ratio = Ratio(found["tracer"].median / found["shade"].median)
            rows.append((f"{name} {size[0]}×{size[1]}", *found.values(), ratio))
    return Table(
        "How near the limit",
        "Milliseconds, one sample a pixel. The first C loop tests every ray against every object,"
        " and shades what it hits (one thread, -O3 -march=native); the second is told what each"
        " pixel sees and which lights reach it, and only computes the hit and its shading. The"
        " last column is the time of the tracer, with its helper, over the second's.",
        ("scene", "tracer", "C, all pairs", "C, knowing the answer", "tracer / C"),
        rows,
    )


Section: TypeAlias = Callable[[int, bool], Table]
"""Measures one table, given how many rounds, and whether to be quick."""


def tables(*, quick: bool) -> Iterator[tuple[Section, Table]]:
    """All tables, as they are measured, each after what measures it."""
    mi.set_log_level(mi.LogLevel.Error)
    rounds = 2 if quick else 3
    sections: list[Section] = [
        whole_process,
        warm,
        growth_in_objects,
        crowded,
        growth_in_pixels_and_lights,
        smooth,
        loading,
        memory,
    ]
    if minimal.compiler():
        sections.append(limit)
    for section in sections:
        yield section, section(rounds, quick)


def main() -> None:
    """Measure, and write the report."""
    used = parser("reference.benchmark", __doc__, quick="small sizes, two rounds")
    options = used.parse_args()
    need_scenes(used)
    where = machine.describe()
    found: dict[Section, Table] = {}
    for section, table in tables(quick=options.quick):
        print(table.markdown(), flush=True)
        found[section] = table
    head = f"# Benchmark\n\nMade by `python -m reference.benchmark` on {where}. {_SPEEDUP}\n"
    report = "\n".join([head, *(table.markdown() for table in found.values())])
    result("benchmark.md", quick=options.quick).write_text(report, encoding="utf-8")
    if not options.quick:
        shown = [
            found[whole_process],
            compact(found[warm]),
            found[growth_in_objects],
            found[memory],
        ]
        made = f"Measured by `python -m reference.benchmark` on {where}. {_SPEEDUP}"
        quote(HERE.parent / "README.md", "benchmark", made, shown)
    write_records(result("benchmark.csv", quick=options.quick), where, [*found.values()])


if __name__ == "__main__":
    run(main)
