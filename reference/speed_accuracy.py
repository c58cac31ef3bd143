"""The speed-accuracy chart: how long each renderer takes to come how near to the true picture.

``python -m reference.speed_accuracy`` writes `speed_accuracy.svg` and `.csv` into this folder.  The
error is the root mean square in linear radiance, against a certified picture
(`reference.judges.certificate`).  At each number of samples, four times the one before, all methods
are timed in turns, the certified tracer at a quarter of the error before.  Those that would take
too long stop, and those that come so near that the certified picture's own error would count.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import gc
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from tqdm import tqdm

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact
from converters.variant import LLVM, mi, use
from reference import povray
from reference.command import SCENES, built
from reference.figures import Floats
from reference.judges import plain
from reference.judges.certificate import certify
from reference.judges.true_picture import rmse, supersampled, true_picture
from reference.measured.charts import WIDTH, make_chart, plt
from reference.measured.measurements import interleaved
from reference.measured.workloads import crowd, resized
from tracer import Scene, load_scene, render

_OURS, _CERTIFIED, _POVRAY = "this tracer", "this tracer, certified", "POV-Ray adaptive"
_GRID, _ALL_PAIRS, _MITSUBA = "uniform grid", "float32, all pairs", "Mitsuba multijitter"
_METHODS = (_OURS, _GRID, _ALL_PAIRS, _POVRAY, _CERTIFIED, _MITSUBA)

# From rough to fine: threshold and depth of POV-Ray's adaptive supersampling.
_ADAPTIVE = ((0.3, 2), (0.1, 3), (0.03, 4), (0.03, 5), (0.03, 6), (0.01, 7))

# The error that the picture is certified to that all others are measured against.
_TRUE = 1 / 16384

# Seconds for a picture: the next one, with four times the samples, would take too long.
_LONG = 0.7

# About the error of rounding to 8 bits.
_EIGHT_BITS = 1e-3


# `samples` of the certified tracer is one over the error that it certifies; `rmse` is of the linear
# radiance; times, the median, the least and the largest, are in seconds.
_COLUMNS = ("scene", "method", "samples", "rmse", "seconds", "low", "high")


def _all_pairs(scene: Scene, side: int) -> Floats:
    """The usual NumPy tracer in float32, `side` x `side` samples in every pixel."""
    shifts = ((np.arange(side) + 0.5) / side - 0.5).tolist()
    total = sum(
        plain.render(scene, offset, arithmetic="float32") for offset in product(shifts, shifts)
    )
    return np.asarray(total) / side**2


def _tasks(scene: Scene, k: int) -> dict[tuple[str, int], Callable[[], Any]]:
    """Render with 4^k samples a pixel, times a number, by each method but POV-Ray."""
    gc.collect()  # Mitsuba's kernels choose among all scenes alive: there is to be one
    text = str(exact(scene, 4**k)).replace('"stratified"', '"multijitter"')
    loaded = mi.load_string(text)
    return {
        (_OURS, 1): partial(render, scene, 4**k),
        # With 9, 36, 144, ... samples a pixel: the others have powers of four.
        (_OURS, 9): partial(render, scene, 9 * 4**k),
        (_CERTIFIED, 8): lambda: certify(scene, 1 / (8 * 4**k)).image,
        (_GRID, 1): partial(supersampled, scene, 2**k),
        (_ALL_PAIRS, 1): partial(_all_pairs, scene, 2**k),
        (_MITSUBA, 1): lambda: np.array(mi.render(loaded)),
    }


def measure(name: str, scene: Scene, *, quick: bool) -> Iterator[tuple[object, ...]]:
    """Time all methods on one scene, and measure their errors: rows of the table."""
    certified = _TRUE * (16 if quick else 1)
    truth, target = true_picture(scene, certified).image, built("povray.ppm")
    # Each of these errs by more than the next.
    floor = rmse(true_picture(scene, 4 * certified).image, truth)
    long: set[tuple[str, int]] = set() if povray.installed() else {(_POVRAY, 1)}
    for k, (threshold, depth) in enumerate(_ADAPTIVE[: 3 if quick else None]):
        tasks = _tasks(scene, k)
        finer = ("+AM2", f"+A{threshold}", f"+R{depth}", "-J")
        # It is timed as it says, without its start, as the others are.
        tasks[_POVRAY, 1] = partial(povray.trace, povray.linear(scene, target, *finer))
        tasks = {key: task for key, task in tasks.items() if key not in long}
        for key, timing in interleaved(tasks, 3, enough=0.3).items():
            (method, times), picture = key, tasks[key]()
            error = rmse(povray.picture(target) if method == _POVRAY else picture, truth)
            if error > floor:
                yield (name, method, times * 4**k, error, *timing)
            if timing.median > _LONG or error <= floor:
                long.add(key)
        tasks.clear()  # so that Mitsuba's scene goes before the next comes


def _draw(rows: Sequence[Sequence[str]], quick: bool) -> Any:
    """A panel for each scene; the names of the curves stand in the last one."""
    figure, grid = plt.subplots(6, 1, figsize=(WIDTH, 19), sharex=True, sharey=True)
    for axes, scene in zip(grid, dict.fromkeys(row[0] for row in rows), strict=False):
        for method in _METHODS:
            points = [tuple(map(float, row[2:5])) for row in rows if row[:2] == [scene, method]]
            # Of numbers of samples that make the same picture, the last.
            curve = {error: (seconds, samples) for samples, error, seconds in sorted(points)}
            axes.loglog([seconds for seconds, _ in curve.values()], curve.keys(), label=method)
            for error, (seconds, samples) in curve.items():
                if method == _OURS:
                    _label(axes, f"{samples:g}", (seconds, error), (-5, -3), "#000000")
                elif method == _CERTIFIED:
                    _label(axes, f"1/{samples:g}", (seconds, error), (5, 3), "#009e73")
        axes.axhline(_EIGHT_BITS, color="#d0a080", lw=5, alpha=0.4, label="rounding to 8 bits")
        axes.set_title(scene)
        axes.minorticks_off()
        axes.tick_params(labelbottom=True)
        axes.set_ylabel("RMSE")
    grid[0].xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:g} ms")
    grid[-1].axis("off")
    grid[-1].legend(*grid[0].get_legend_handles_labels(), loc="center", fontsize=10)
    figure.subplots_adjust(0.14, 0.03, 0.97, 0.92, hspace=0.3)
    return figure


def _label(
    axes: Any, text: str, point: tuple[float, float], aside: tuple[int, int], color: str
) -> None:
    """Write a point's samples, or its certified error, `aside` of it."""
    align = {"ha": "left", "va": "bottom"} if aside[0] > 0 else {"ha": "right", "va": "top"}
    look = {"textcoords": "offset points", "fontsize": 6.5, "color": color}
    axes.annotate(text, point, aside, **align, **look)


def _scenes(quick: bool) -> dict[str, Scene]:
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    scenes = [
        ("one-sphere", load_scene(SCENES / "one-sphere.xml"), 300, 300),
        ("four-spheres", load_scene(SCENES / "four-spheres.xml"), 320, 180),
        ("sticks-perspective", sticks, 320, 180),
        ("sticks-perspective", sticks, 1280, 720),
        ("1,000 small objects", crowd(1000), 320, 180),
    ]
    return {
        f"{name}, {width}×{height}": resized(scene, width, height)
        for name, scene, width, height in (scenes[1:2] if quick else scenes)
    }


def _measure_all(quick: bool) -> Iterator[tuple[object, ...]]:
    use(LLVM)
    mi.set_log_level(mi.LogLevel.Error)
    for name, scene in tqdm(_scenes(quick).items(), unit="scene"):
        yield from measure(name, scene, quick=quick)


def main() -> None:
    """Measure, and draw the chart."""
    note = (
        "Rendering alone. Error: root mean square in linear radiance, against a\n"
        "certified picture. Points: 1, 4, 16, ... samples a pixel (this tracer: 9,\n"
        "36, ... too; it splits pixels into quarters, hence the stairs); POV-Ray's\n"
        "thresholds; for the certified tracer, the error that no pixel exceeds."
    )
    texts = ("Time against error: lower left is better", note)
    make_chart("speed_accuracy", __doc__, _COLUMNS, _measure_all, _draw, texts)
