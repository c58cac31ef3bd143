"""How fast, beside compiled renderers, in one run.

    python -m reference.benchmark [--quick]

writes `benchmark.md` and `benchmark.csv` into this folder, and the tables that the
README quotes into the README.  What is compared is
run in turns, so that a machine that is busy for a while slows down all alike;
times are medians, with the fastest and the slowest behind.  The tracer renders
fresh scenes, each once; Mitsuba renders one scene again and again, its kernels
compiled and its scene built before the clock starts.
"""

from __future__ import annotations

import argparse
import gc
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any, TypeAlias, TypeVar

import mitsuba as mi
import numpy as np

from converters.flavours import exact, stock
from converters.variant import use
from reference import machine, minimal, rivals
from reference.charts import HERE, write_csv
from reference.machine import BUILD
from reference.povray import to_pov
from reference.workloads import CROWDS, afresh, crowd, lit_by, resized, to_xml
from tracer import Scene, load_scene, render

__all__ = [
    "Section",
    "Table",
    "Timing",
    "growth_exponent",
    "interleaved",
    "main",
    "peak",
    "run",
    "tables",
]

Task: TypeAlias = Callable[[int], object]
"""Work to be timed, told which round it is."""

Name = TypeVar("Name", bound=Hashable)

SCENES = HERE.parent / "scenes"
_FEW = ("one-sphere", "four-spheres", "sticks-perspective")
_FASTER = ("faster than exact by", "faster than stock by")
_SMALL, _LARGE = (300, 300), (2560, 1440)


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds over some rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        """Sum up what was measured."""
        return cls(median(seconds), min(seconds), max(seconds))

    def __str__(self) -> str:
        if self.low == self.high:
            return _ms(self.median)
        return f"{_ms(self.median)} ({_ms(self.low)}–{_ms(self.high)})"


def _ms(seconds: float) -> str:
    ms = 1e3 * seconds
    return f"{ms:,.0f}" if ms >= 100 else f"{ms:.1f}"


def interleaved(tasks: dict[Name, Task], rounds: int) -> dict[Name, Timing]:
    """Time tasks in turns: a round runs each once."""
    taken: dict[Name, list[float]] = {name: [] for name in tasks}
    for k in range(rounds):
        for name, task in tasks.items():
            start = perf_counter()
            task(k)
            taken[name].append(perf_counter() - start)
    return {name: Timing.of(seconds) for name, seconds in taken.items()}


def growth_exponent(sizes: Sequence[float], timings: Sequence[Timing]) -> float:
    """Slope of time against size, both logarithmic, by least squares."""
    slope, _ = np.polyfit(np.log(sizes), np.log([t.median for t in timings]), 1)
    return float(slope)


@dataclass(frozen=True, slots=True)
class Table:
    """One table of the report; cells that are timings go to the CSV in full."""

    title: str
    note: str
    header: tuple[str, ...]
    rows: list[tuple[object, ...]]

    def markdown(self) -> str:
        """As GitHub shows it."""
        lines = [f"## {self.title}", "", self.note, "", "| " + " | ".join(self.header) + " |"]
        lines.append("|---" * len(self.header) + "|")
        lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"

    def records(self) -> Iterator[tuple[object, ...]]:
        """A line for each cell: table, row, column, value (median), low, high."""
        for row in self.rows:
            for name, cell in zip(self.header[1:], row[1:], strict=True):
                if isinstance(cell, Timing):
                    yield self.title, row[0], name, cell.median, cell.low, cell.high
                else:
                    yield self.title, row[0], name, cell, "", ""


def _cell(value: object) -> str:
    return f"{value:.2g}" if isinstance(value, float) else str(value)


def run(*command: str) -> None:
    """Run a process to its good end, in silence."""
    subprocess.run(command, check=True, capture_output=True)


def _tracer_task(scene: Scene, rounds: int) -> Task:
    """Render fresh copies of a scene, after one more to warm up."""
    copies = [afresh(scene, k) for k in range(rounds + 1)]
    render(copies.pop())
    return lambda k: render(copies[k])


def _mitsuba_task(loaded: Any) -> Task:
    """Render a loaded scene, whose kernels are compiled first."""

    def task(_: int) -> object:
        return np.array(mi.render(loaded))

    task(0)
    task(0)
    return task


def _beside(scene: Scene, rounds: int, load: Callable[[Scene], Any]) -> tuple[Timing, Timing]:
    """The tracer and Mitsuba in turns, with no other scene of Mitsuba's alive."""
    gc.collect()
    theirs = _mitsuba_task(load(scene))
    found = interleaved({"tracer": _tracer_task(scene, rounds), "Mitsuba": theirs}, rounds)
    return found["tracer"], found["Mitsuba"]


def _ratio(of: Timing, rival: Timing) -> str:
    """How many times faster than another."""
    return f"{rival.median / of.median:.2g}×"


def _ratios(found: dict[str, Timing]) -> tuple[str, str]:
    ours = found["tracer"]
    return _ratio(ours, found["Mitsuba exact"]), _ratio(ours, found["Mitsuba stock"])


# --- The tables --------------------------------------------------------------------------


def whole_process(rounds: int, quick: bool) -> Table:
    """XML to PNG, from the shell."""
    variant = use().variant
    header = ["scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_FASTER]
    pov = rivals.povray_installed()
    if pov:
        header.insert(4, "POV-Ray")
    python = sys.executable
    rows: list[tuple[object, ...]] = []
    start = interleaved({"numpy": lambda _: run(python, "-c", "import numpy")}, rounds)["numpy"]
    for size in (_SMALL,) if quick else (_SMALL, _LARGE):
        for name in _FEW:
            scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
            texts = {
                "tracer.xml": to_xml(scene),
                "exact.xml": exact(scene),
                "stock.xml": stock(scene, 1),
                "pov": to_pov(scene),
            }
            paths = {kind: BUILD / f"{name}.{kind}" for kind in texts}
            for kind, text in texts.items():
                paths[kind].write_text(text)
            png = str(BUILD / "out.png")

            def mitsuba(source: Path, png: str = png) -> Task:
                command = (python, "-c", rivals.MITSUBA_PROCESS, variant, str(source), png)
                run(*command)
                return lambda _: run(*command)

            ours = (python, "-m", "tracer", "--quiet", "-o", png, str(paths["tracer.xml"]))
            tasks: dict[str, Task] = {
                "tracer": lambda _, ours=ours: run(*ours),  # type: ignore[misc]
                "Mitsuba exact": mitsuba(paths["exact.xml"]),
                "Mitsuba stock": mitsuba(paths["stock.xml"]),
            }
            if pov:
                theirs = rivals.povray_command(scene, paths["pov"], Path(png))
                tasks["POV-Ray"] = lambda _, theirs=theirs: run(*theirs)  # type: ignore[misc]
            found = interleaved(tasks, rounds)
            rows.append((f"{name} {size[0]}×{size[1]}", *found.values(), *_ratios(found)))
    return Table(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell: median (fastest–slowest) of {rounds}. Mitsuba {variant}"
        f" with a warm kernel cache. `python -c 'import numpy'` alone takes {start}.",
        tuple(header),
        rows,
    )


def warm(rounds: int, quick: bool) -> Table:
    """In process, one sample a pixel, on every scene."""
    variant = use().variant
    sizes = ((320, 180),) if quick else ((320, 180), (1280, 720), _LARGE)
    names = [path.stem for path in sorted(SCENES.glob("*.xml"))]
    rows: list[tuple[object, ...]] = []
    for size in sizes:
        for name in _FEW if quick else names:
            scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
            ours, theirs = _beside(scene, rounds, rivals.mitsuba_exact)
            again, stocks = _beside(scene, rounds, rivals.mitsuba_stock)
            ratios = _ratio(ours, theirs), _ratio(again, stocks)
            rows.append((f"{name} {size[0]}×{size[1]}", ours, theirs, stocks, *ratios))
    return Table(
        "Warm: rendering alone",
        f"Milliseconds in process, one sample a pixel: median (fastest–slowest) of {rounds}."
        f" Mitsuba {variant}, scene and kernels ready. Exact: the same picture, by this project's"
        " plugins; stock: a similar one by its own, compiled ones, with one light a sample.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_FASTER),
        rows,
    )


def growth_in_objects(rounds: int, quick: bool) -> Table:
    """N small objects, spread out, beside Mitsuba."""
    use()
    counts = (10, 100, 1000) if quick else (10, 100, 1000, 10_000, 100_000)
    rows: list[tuple[object, ...]] = []
    timings = []
    for count in counts:
        scene = crowd(count)
        ours, merged = _beside(scene, rounds, rivals.mitsuba_merged)
        gc.collect()
        text = exact(scene)
        # Loading takes Mitsuba most of a minute at the largest: once has to do.
        start = perf_counter()
        loaded = mi.load_string(text)
        np.array(mi.render(loaded))
        first = Timing.of([perf_counter() - start])
        shapes = interleaved({"": _mitsuba_task(loaded)}, rounds if count <= 10_000 else 1)[""]
        del loaded
        timings.append(ours)
        ratios = _ratio(ours, first), _ratio(merged, ours)
        rows.append((f"{count:,}", ours, first, shapes, merged, *ratios))
    return Table(
        "Growth in objects: N small ones, two lights, 640×360",
        "Milliseconds. Mitsuba with a shape per object: loading and first render, then warm;"
        " and warm with all objects merged into one mesh of one material, spheres as icosahedra"
        " (the wrong picture, its fastest geometry). The tracer's time grows as"
        f" N^{growth_exponent(counts, timings):.2f}.",
        (
            "N",
            "tracer",
            "Mitsuba load + first",
            "Mitsuba warm",
            "Mitsuba merged, warm",
            "faster than load + first by",
            "time / merged",
        ),
        rows,
    )


def crowded(rounds: int, quick: bool) -> Table:
    """The same when the objects crowd together."""
    counts = (10, 1000) if quick else (10, 100, 1000, 10_000, 100_000)
    rows: list[tuple[object, ...]] = []
    for kind, words in CROWDS.items():
        timings = [
            interleaved({"": _tracer_task(crowd(count, kind), rounds)}, rounds)[""]
            for count in counts
        ]
        rows.append((f"{words}", *timings, f"N^{growth_exponent(counts, timings):.2f}"))
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
        timings = [interleaved({"": _tracer_task(each, rounds)}, rounds)[""] for each in scenes]
        exponent = growth_exponent(sizes[-3:], timings[-3:])
        rows += [
            (f"{size:,} {what}", timing, f"^{exponent:.2f}" if size == sizes[-1] else "")
            for size, timing in zip(sizes, timings, strict=True)
        ]
    return Table(
        "Growth in pixels and in lights",
        "Milliseconds for the tracer on the 21-object scene; the exponent is that of the last"
        " three.",
        ("size", "tracer", "grows as"),
        rows,
    )


def loading(rounds: int, quick: bool) -> Table:
    """Reading and validating many objects, against xml.etree alone."""
    count = 1000 if quick else 100_000
    path = BUILD / "many.xml"
    path.write_text(to_xml(crowd(count)))
    found = interleaved(
        {"tracer": lambda _: load_scene(path), "etree": lambda _: ET.parse(path)}, rounds
    )
    ratio = _ratio(found["etree"], found["tracer"])
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
    """Peak resident memory of a process, MB."""
    watch = [sys.executable, "-c", _WATCH, *command]
    peak = int(subprocess.run(watch, check=True, capture_output=True).stdout)
    # Linux counts kilobytes, macOS bytes.
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def memory(rounds: int, quick: bool) -> Table:
    """Peak resident memory of whole processes."""
    python, png = sys.executable, str(BUILD / "out.png")
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    scenes = {"sticks-perspective 2560×1440": resized(sticks, *_LARGE)}
    if not quick:
        scenes["100,000 objects 640×360"] = crowd(100_000)
        scenes["sticks-perspective 8192×8192"] = resized(sticks, 8192, 8192)
    rows: list[tuple[object, ...]] = []
    for name, scene in scenes.items():
        path = BUILD / "scene.xml"
        path.write_text(to_xml(scene))
        most = peak(python, "-m", "tracer", "--quiet", "-o", png, str(path))
        rows.append((name, f"{most:.0f}"))
    base = peak(python, "-c", "import numpy")
    return Table(
        "Memory",
        f"Peak resident MB of `python -m tracer`; Python with NumPy alone takes {base:.0f}.",
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
            loops.find()
            tasks: dict[str, Task] = {
                "tracer": _tracer_task(scene, rounds),
                "find": lambda _, loops=loops: loops.find(),  # type: ignore[misc]
                "shade": lambda _, loops=loops: loops.shade(),  # type: ignore[misc]
            }
            found = interleaved(tasks, rounds)
            ratio = _ratio(found["shade"], found["tracer"])
            rows.append((f"{name} {size[0]}×{size[1]}", *found.values(), ratio))
    return Table(
        "How near the limit",
        "Milliseconds, one sample a pixel. The first C loop tests every ray against every object"
        " (one thread, -O3); the second is told what each pixel sees and which lights reach it,"
        " and only computes the hit and its shading. The last column is the tracer's time over"
        " the second's.",
        ("scene", "tracer", "C, all pairs", "C, knowing the answer", "ratio"),
        rows,
    )


Section: TypeAlias = Callable[[int, bool], Table]
"""Measures in so many rounds, quickly or not."""


def tables(*, quick: bool) -> Iterator[Table]:
    """All tables, as they are measured."""
    BUILD.mkdir(exist_ok=True)
    mi.set_log_level(mi.LogLevel.Error)
    rounds = 2 if quick else 3
    sections: list[Section] = [
        whole_process,
        warm,
        growth_in_objects,
        crowded,
        growth_in_pixels_and_lights,
    ]
    sections += [loading, memory]
    if minimal.compiler():
        sections.append(limit)
    for section in sections:
        yield section(rounds, quick)


def quote(readme: str, where: str, found: list[Table]) -> str:
    """The README's text with tables between its benchmark marks."""
    begin, end = "<!-- benchmark:begin -->\n", "<!-- benchmark:end -->"
    before, rest = readme.split(begin)
    # One heading level deeper than in the report.
    quoted = "\n".join("#" + table.markdown() for table in found)
    after = rest.split(end)[1]
    made = f"Measured by `python -m reference.benchmark` on {where}.\n"
    return f"{before}{begin}{made}\n{quoted}\n{end}{after}"


def main() -> None:
    """Measure, and write the report."""
    parser = argparse.ArgumentParser(
        prog="python -m reference.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, two rounds")
    quick = parser.parse_args().quick
    where = machine.describe()
    found = []
    for table in tables(quick=quick):
        print(table.markdown(), flush=True)
        found.append(table)
    head = f"# Benchmark\n\nMade by `python -m reference.benchmark` on {where}.\n"
    report = "\n".join([head, *(table.markdown() for table in found)])
    (HERE / "benchmark.md").write_text(report, encoding="utf-8")
    if not quick:
        readme = HERE.parent / "README.md"
        text = quote(readme.read_text(encoding="utf-8"), where, [found[0], found[2], found[-2]])
        readme.write_text(text, encoding="utf-8")
    records = (record for table in found for record in table.records())
    write_csv("benchmark", where, ("table", "row", "column", "value", "low", "high"), records)


if __name__ == "__main__":
    main()
