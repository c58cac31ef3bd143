"""The growth chart: how time grows with the number of objects, from 100 to 100,000.

``python -m reference.growth`` writes `growth.svg` and `.csv` into this folder, in some two minutes.
Small objects over a floor, under two lights, at 640 x 360 pixels and one sample a pixel: loading is
the time from a file's text to a scene, for Mitsuba with a shape per object.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
from collections.abc import Iterator, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact
from converters.variant import LLVM, mi, use
from reference.command import built
from reference.measured.charts import LOOKS, headline, make_chart, plt
from reference.measured.measurements import Task, interleaved
from reference.measured.workloads import field
from tracer import load_scene, render, save_scene

__all__ = ["main"]

_OURS, _LOADING = "this tracer", "loading in this tracer"
_MITSUBAS = "loading in Mitsuba", "Mitsuba, with loading", "Mitsuba, warm"
_LOOK_OF = {
    _OURS: LOOKS["tracer"],
    _LOADING: LOOKS["tracer"] | {"ls": ":", "lw": 1.6},
    **dict(zip(_MITSUBAS, (LOOKS["f"] | {"ls": ":"}, LOOKS["g"], LOOKS["f"]), strict=True)),
}

_COUNTS = (100, 300, 1000, 3000, 10_000, 30_000, 100_000)

# With more objects than this, Mitsuba loads a scene only once: it takes many seconds.
_ONCE = 1000


def _seconds(count: int) -> Iterator[tuple[str, float]]:
    """Time each curve's task with so many objects: its name, and the median."""
    save_scene(field(count), path := built("growth.xml"))
    scene, text = load_scene(path), exact(load_scene(path))
    tasks: dict[str, Task] = {_OURS: partial(render, scene), _LOADING: partial(load_scene, path)}
    yield from ((name, timing.median) for name, timing in interleaved(tasks, 3).items())
    # Mitsuba's kernels choose among all objects alive: a scene goes before the next one comes.
    rounds = [_mitsuba(text) for _ in range(1 if count > _ONCE else 3)]
    yield from zip(_MITSUBAS, np.median(rounds, axis=0).tolist(), strict=True)


def _mitsuba(text: str) -> tuple[float, float, float]:
    """Seconds that Mitsuba takes to load a scene, until its first picture, and for the next one."""
    gc.collect()
    begin = perf_counter()
    scene = mi.load_string(text)
    loaded = perf_counter()
    np.array(mi.render(scene))
    first = perf_counter()
    np.array(mi.render(scene))
    return loaded - begin, first - begin, perf_counter() - first


def _measure(quick: bool) -> Iterator[tuple[str, int, float]]:
    use(LLVM)
    mi.set_log_level(mi.LogLevel.Error)
    _mitsuba(exact(field(10)))  # threads start, and what is common to all kernels is compiled
    for count in _COUNTS[:3] if quick else _COUNTS:
        yield from ((name, count, seconds) for name, seconds in _seconds(count))


def _draw(rows: Sequence[Sequence[str]], quick: bool) -> Any:
    """One panel, both of its axes logarithmic."""
    figure, axes = plt.subplots(figsize=(9, 6.5))
    for name, look in _LOOK_OF.items():
        points = [(int(count), float(seconds)) for curve, count, seconds in rows if curve == name]
        axes.loglog(*zip(*points, strict=True), label=name, **look)
    axes.set_xlabel("objects")
    axes.set_ylabel("time")
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}")
    axes.yaxis.set_major_formatter(lambda y, _: f"{y:g} s" if y >= 1 else f"{1e3 * y:g} ms")
    axes.legend()
    note = "Small objects over a floor, two lights, 640×360, one sample a pixel."
    headline(figure, "Time against the number of objects", note)
    figure.subplots_adjust(0.1, 0.13, 0.98, 0.86)
    return figure


def main() -> None:
    """Measure, and draw the chart."""
    columns = ("curve", "objects", "seconds")
    make_chart("growth", __doc__, "up to 1,000 objects", columns, _measure, _draw)
