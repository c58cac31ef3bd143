"""The growth chart: how time grows with the number of objects, from 100 to 100,000.

``python -m reference.growth`` writes `growth.svg` and `.csv` into this folder, in some minutes.
Loading is the time from a file's text to a scene, for Mitsuba with a shape per object; `xml.etree`
only parses the text.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact
from converters.variant import LLVM, mi, use
from reference.command import built
from reference.measured.charts import WIDTH, make_chart, plt
from reference.measured.measurements import Task, interleaved
from reference.measured.workloads import field
from tracer import load_scene, render, save_scene

_OURS = ["this tracer", "loading in this tracer", "xml.etree alone"]
_CURVES = [*_OURS, "loading in Mitsuba", "Mitsuba, with loading", "Mitsuba, warm"]
_COUNTS = (100, 300, 1000, 3000, 10_000, 30_000, 100_000)

# With more objects than this, Mitsuba loads a scene only once: it takes many seconds.
_ONCE = 1000


def _seconds(count: int) -> list[float]:
    """Time each curve's task with so many objects: the medians."""
    save_scene(field(count), path := built("growth.xml"))
    scene, text = load_scene(path), str(exact(load_scene(path)))
    # As in a small process: no collection of garbage goes through all of Mitsuba's objects as well.
    gc.collect()
    gc.freeze()
    tasks: list[Task] = [partial(render, scene), partial(load_scene, path), partial(ET.parse, path)]
    ours = [timing.median for timing in interleaved(dict(enumerate(tasks)), 3).values()]
    gc.unfreeze()
    rounds = [_mitsuba(text) for _ in range(1 if count > _ONCE else 3)]
    return [*ours, *np.median(rounds, axis=0).tolist()]


def _mitsuba(text: str) -> tuple[float, float, float]:
    """Seconds that Mitsuba takes to load a scene, until its first picture, and for the next one."""
    gc.collect()  # its kernels choose among all objects alive: the last scene goes
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
    _mitsuba(str(exact(field(10))))  # threads start, and what is common to all kernels is compiled
    for count in _COUNTS[:3] if quick else _COUNTS:
        for name, seconds in zip(_CURVES, _seconds(count), strict=True):
            yield name, count, seconds


def _draw(rows: Sequence[Sequence[str]], quick: bool) -> Any:
    """One panel, both of its axes logarithmic."""
    figure, axes = plt.subplots(figsize=(WIDTH, 5))
    for name in _CURVES:
        points = [(int(count), float(seconds)) for curve, count, seconds in rows if curve == name]
        axes.loglog(*np.transpose(points), label=name)
    axes.set_xlabel("objects")
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}")
    axes.yaxis.set_major_formatter(lambda y, _: f"{y:g} s" if y >= 1 else f"{1e3 * y:g} ms")
    axes.legend()
    figure.subplots_adjust(0.14, 0.18, 0.97, 0.84)
    return figure


def main() -> None:
    """Measure, and draw the chart."""
    columns = ("curve", "objects", "seconds")
    note = "Small objects over a floor, two lights, 640×360, one sample a pixel."
    texts = ("Time against the number of objects", note)
    make_chart("growth", __doc__, columns, _measure, _draw, texts)
