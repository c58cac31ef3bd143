"""Times of the tracer beside compiled renderers, measured in one run.

``python -m reference.benchmark`` writes `benchmark.md` into this folder.  Rivals run in
turns; Mitsuba's kernels are compiled, and its scene is built, before the clock starts.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import geometric_mean

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact, stock
from converters.variant import SCALAR, mi, use
from reference import povray
from reference.command import HERE, SCENES, built, own_scenes, parser
from reference.measured.measurements import Task, Timing, interleaved, measured_on, process
from reference.measured.workloads import field, resized
from tracer import Scene, load_scene, render, save_scene
from tracer.picture.parallel import processors

_FEW = ("one-sphere", "four-spheres", "sticks-perspective")
_SPEEDUPS = ("speedup over exact", "speedup over stock")
_SMALL, _MEDIUM, _LARGE = (320, 180), (1280, 720), (2560, 1440)

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

ROUNDS = 3


def _speedup(of: Timing, over: Timing) -> float:
    return over.median / of.median


def ratio(value: float) -> str:
    """Two digits at least: 0.50×, 3.0×, 42×."""
    places = 2 if value < 0.995 else 1 if value < 9.95 else 0
    return f"{value:.{places}f}×"


def table(title: str, note: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table as GitHub shows it; numbers are ratios."""
    shown = [
        [ratio(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows
    ]
    lines = [header, ["---"] * len(header), *shown]
    return "\n".join([f"## {title}\n\n{note}\n", *(f"| {' | '.join(line)} |" for line in lines)])


def _beside(scene: Scene, text: str) -> list[Timing]:
    """Time the tracer and Mitsuba, whose kernels choose among all objects alive, in turns."""
    gc.collect()
    loaded = mi.load_string(text)
    tasks: list[Task] = [partial(render, scene), lambda: np.array(mi.render(loaded))]
    return [*interleaved(dict(enumerate(tasks)), ROUNDS).values()]


def whole_process(quick: bool) -> str:
    """Time commands from XML to PNG."""
    variant, png = use().variant, str(built("out.png"))
    tracer = [sys.executable, "-m", "tracer", "--quiet", "-o", png]
    mitsuba = [sys.executable, "-c", _MITSUBA]
    rows: list[tuple[object, ...]] = []
    sizes, names = ((_SMALL,), _FEW[:1]) if quick else ((_SMALL, _LARGE), _FEW)
    for size, name in product(sizes, names):
        scene = resized(load_scene(SCENES / f"{name}.xml"), *size)
        save_scene(scene, ours := built("tracer.xml"))
        (exactly := built("exact.xml")).write_text(str(exact(scene)))
        (similar := built("stock.xml")).write_text(str(stock(scene, 1)))
        commands = {
            "import numpy": [sys.executable, "-c", "import numpy"],
            "tracer": [*tracer, str(ours)],
            "Mitsuba exact": [*mitsuba, variant, str(exactly), png],
            "Mitsuba stock": [*mitsuba, variant, str(similar), png],
            "the same, scalar": [*mitsuba, SCALAR, str(similar), png],
        }
        if povray.installed():
            commands["POV-Ray"] = povray.command(scene, Path(png))
        tasks = {who: process(command) for who, command in commands.items()}
        found = interleaved(tasks, ROUNDS, enough=2.0)
        rivals = ("Mitsuba exact", "Mitsuba stock", "the same, scalar")
        over_exact, *over_stock = (_speedup(found["tracer"], found[rival]) for rival in rivals)
        cells = (*found.values(), over_exact, min(over_stock))
        rows.append((f"{name} {size[0]}×{size[1]}", *cells))
    return table(
        "Whole process: from XML to PNG",
        f"Milliseconds, from the shell. Mitsuba {variant} with a warm kernel cache; its stock"
        f" plugins also in {SCALAR}, which has no kernels to load. The speedup over stock is over"
        " the faster of the two. `import numpy` starts OpenBLAS's threads; the tracer imports NumPy"
        " without them.",
        ("scene", *commands, *_SPEEDUPS),
        rows,
    )


def rendering(quick: bool) -> str:
    """Time one sample a pixel on every scene, in process, with everything ready."""
    variant = use().variant
    rows: list[tuple[object, ...]] = []
    for size in (_SMALL,) if quick else (_SMALL, _MEDIUM, _LARGE):
        found: list[tuple[float, float]] = []
        scenes = {path.stem: load_scene(path) for path in own_scenes()}
        scenes |= {f"field-{count}": field(count) for count in (1000, 10_000)}
        for name in _FEW if quick else scenes:
            scene = resized(scenes[name], *size)
            ours, exactly = _beside(scene, str(exact(scene)))
            again, stocks = _beside(scene, str(stock(scene, 1)))
            found.append((_speedup(ours, exactly), _speedup(again, stocks)))
            rows.append((f"{name} {size[0]}×{size[1]}", ours, exactly, stocks, *found[-1]))
        means = (geometric_mean(column) for column in zip(*found, strict=True))
        rows.append((f"geometric mean {size[0]}×{size[1]}", "", "", "", *means))
    return table(
        "Rendering alone",
        "Milliseconds in process, one sample a pixel, in turns with pauses of 20 ms: Mitsuba's"
        f" threads keep spinning that long. The tracer draws in one process, Mitsuba {variant} on"
        f" {processors()} processors, with scene and kernels ready. Exact: the same picture, by"
        " this project's plugins; stock: a similar one by Mitsuba's own, with one light a sample,"
        " in turns with a second timing of the tracer, to which its speedup refers.",
        ("scene", "tracer", "Mitsuba exact", "Mitsuba stock", *_SPEEDUPS),
        rows,
    )


def _each(frames: Callable[[], Iterator[object]]) -> None:
    """Draw frame after frame, and keep none."""
    deque(frames(), maxlen=0)


def frames(quick: bool) -> str:
    """Time a sequence of frames, alone and with the processes of an executor."""
    count, size = (5, _SMALL) if quick else (200, _MEDIUM)
    scene = resized(load_scene(SCENES / "sticks-perspective.xml"), *size)
    camera, eye = scene.camera, np.array(scene.camera.view_point)
    scenes = [
        replace(scene, camera=replace(camera, view_point=eye * (1 + k / count)))
        for k in range(count)
    ]
    with ProcessPoolExecutor(1) as one, ProcessPoolExecutor(2) as two:
        drawing: dict[str, Callable[[], Iterator[object]]]
        drawing = {"alone": partial(map, render, scenes)}
        for who, pool in (("1 worker", one), ("2 workers", two)):
            list(pool.map(abs, range(8)))  # its processes have started
            shared = partial(render, executor=pool)
            drawing[f"{who}, render(scene, executor=pool)"] = partial(map, shared, scenes)
            drawing[f"{who}, pool.map(render, scenes)"] = partial(pool.map, render, scenes)
        tasks = {name: partial(_each, frames) for name, frames in drawing.items()}
        found = interleaved(tasks, ROUNDS)
    return table(
        f"{count} frames of {size[0]}×{size[1]}",
        "Milliseconds for all of them, one sample a pixel, with a standard library's pool of"
        f" processes on {processors()} processors: each picture shared with it, or whole pictures"
        " given to it.",
        ("who draws", "time", "speedup"),
        [(name, time, _speedup(time, found["alone"])) for name, time in found.items()],
    )


SECTIONS = (whole_process, rendering, frames)


def main() -> None:
    """Measure, print tables as they are measured, and write the page."""
    options = parser("reference.benchmark", __doc__, "small sizes").parse_args()
    mi.set_log_level(mi.LogLevel.Error)
    page = [
        "# Benchmark\n\nMade by `python -m reference.benchmark`: median (fastest–slowest) of at"
        f" least {ROUNDS} rounds. A speedup is the other's time over the tracer's: below 1 the"
        f" tracer is slower. Measured on {measured_on()}."
    ]
    for section in SECTIONS:
        page.append(section(options.quick))
        print(page[-1], end="\n\n", flush=True)
    path = built("benchmark.md") if options.quick else HERE / "benchmark.md"
    path.write_text("\n\n".join(page) + "\n", encoding="utf-8")
