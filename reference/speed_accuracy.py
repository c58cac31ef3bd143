"""The speed-accuracy chart: how long each renderer takes to come how near to the true picture.

    python -m reference.speed_accuracy [--quick | --redraw]

writes `speed_accuracy.svg` and `.csv` into this folder.  The error is the root mean square of the
linear radiance, over evenly spread rows of the picture, against 129 x 129 samples in every pixel,
traced one by one; these rows are kept in the `build` folder.  At each number of samples, four times
the one before, all methods are timed in turns; those that would take too long stop.
"""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from converters.variant import LLVM, mi, use
from reference import plain, povray, rivals
from reference.charts import HALO, LOOKS, headline, plt, save
from reference.command import SCENES, built, need_scenes, need_table, parser, result, run
from reference.tables import measured_on, read_csv, write_csv
from reference.timing import Task, Timing, interleaved
from reference.truth import Truth, supersampled, truth_side
from reference.workloads import crowd, resized
from tracer import Scene, load_scene, render, to_codes

__all__ = ["Lead", "Point", "main", "measure"]

Floats: TypeAlias = NDArray[np.float64]

_OURS, _POVRAY = "this tracer", "POV-Ray adaptive"
# The same with 9, 36, 144, ... samples a pixel: the others have powers of four.
_BETWEEN = "this tracer, between"
_SAMPLERS = ("independent", "multijitter")
_MITSUBA = {sampler: f"Mitsuba {sampler}" for sampler in _SAMPLERS}
_LOOK_OF = {
    _OURS: "tracer",
    "uniform grid": "a",
    "float32, all pairs": "b",
    _POVRAY: "c",
    _MITSUBA["independent"]: "g",
    _MITSUBA["multijitter"]: "f",
}
_RIVALS = {_POVRAY, *_MITSUBA.values()}

# From rough to fine: threshold and depth of POV-Ray's adaptive supersampling.
_ADAPTIVE = ((0.3, 2), (0.1, 3), (0.03, 4), (0.03, 5), (0.03, 6), (0.01, 7))

# Seconds: a point that is expected to take longer is left out.
_TOO_LONG = 2.5

# The error at which times are compared, as nearly as can be: that of rounding to 8 bits, about.
_LEVEL = 1e-3


@dataclass(frozen=True, slots=True)
class Point:
    """One method on one scene, at one number of samples a pixel.

    `error` is the root mean square of the linear radiance error.
    """

    scene: str
    method: str
    samples: int
    error: float
    time: Timing


# --- Measuring ---------------------------------------------------------------------------


def _all_pairs(scene: Scene, side: int) -> Floats:
    """The usual NumPy tracer in float32, `side` x `side` samples in every pixel."""
    shifts = ((np.arange(side) + 0.5) / side - 0.5).tolist()
    total = sum(
        plain.render(scene, offset, arithmetic="float32") for offset in product(shifts, shifts)
    )
    return np.asarray(total) / side**2


def _mitsuba(loaded: Any, samples: int, sensor: int) -> Task:
    return lambda: np.array(mi.render(loaded, sensor=sensor, spp=samples))


def _tasks(scene: Scene, k: int) -> dict[str, Task]:
    """Render with 4^k samples a pixel, by each method but POV-Ray."""
    gc.collect()
    loaded = rivals.mitsuba_exact(scene, _SAMPLERS)
    return {
        _OURS: partial(render, scene, 4**k),
        _BETWEEN: partial(render, scene, 9 * 4**k),
        "uniform grid": partial(supersampled, scene, 2**k),
        "float32, all pairs": partial(_all_pairs, scene, 2**k),
        **{
            _MITSUBA[sampler]: _mitsuba(loaded, 4**k, sensor)
            for sensor, sampler in enumerate(_SAMPLERS)
        },
    }


def _expected(method: str, seconds: Sequence[float]) -> float:
    """Expected time of a curve's next point; of the first time, most is starting up."""
    if not seconds:
        return 0.0
    before = seconds[-2] if len(seconds) > 1 else 0.75 * seconds[-1]
    # Four times as many samples, but for POV-Ray, which has thresholds.
    growth = 1 if method == _POVRAY else 4
    return seconds[-1] + growth * max(seconds[-1] - before, 0.0)


def measure(name: str, scene: Scene, *, quick: bool) -> Iterator[Point]:
    """Time all methods on one scene, and measure their errors."""
    truth, png = Truth.of(scene, truth_side(quick)), built("povray.ppm")
    spent: dict[str, list[float]] = defaultdict(list)
    for k in range(3 if quick else 6):
        pictures: dict[str, Floats] = {}
        traced: list[float] = []

        def keep(method: str, task: Task, pictures: dict[str, Floats] = pictures) -> Task:
            """The same task; its picture is kept."""
            return lambda: pictures.update({method: np.asarray(task())})

        tasks = {method: keep(method, task) for method, task in _tasks(scene, k).items()}
        if povray.installed():
            threshold, depth = _ADAPTIVE[k]
            finer = ("+AM2", f"+A{threshold}", f"+R{depth}", "-J")
            tasks[_POVRAY] = partial(_trace, povray.linear(scene, png, *finer), traced)
        # A curve ends where its next point would take too long.
        tasks = {
            method: task
            for method, task in tasks.items()
            if len(spent[method]) == k and _expected(method, spent[method]) <= _TOO_LONG
        }
        timings = interleaved(tasks, 3, enough=0.3)
        for method, timing in timings.items():
            spent[method].append(timing.median)
        if traced:
            pictures[_POVRAY] = povray.picture(png)
            timings[_POVRAY] = Timing.of(traced)  # without its start, as the others' times are
        # Mitsuba's kernels choose among all scenes alive: this one goes before the next comes.
        tasks.clear()
        for method, timing in timings.items():
            shown, times = (_OURS, 9) if method == _BETWEEN else (method, 1)
            yield Point(name, shown, times * 4**k, truth.error(pictures[method]), timing)


def _trace(command: Sequence[str], traced: list[float]) -> None:
    traced.append(povray.trace(command))


# --- The chart ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Lead:
    """Seconds to the same error, for this tracer and for the fastest of its rivals.

    Rivals take any number of samples, so they reach it between two points of their curves; this
    tracer takes squares, and has to render the next picture of its curve that is as good.
    """

    level: float
    ours: float
    theirs: float

    @classmethod
    def of(cls, points: Sequence[Point]) -> Lead | None:
        """The lead over the fastest rival at `_LEVEL`, or the least error that both reach."""
        curves = _curves(points)
        ours = curves.pop(_OURS, [])
        theirs = [curve for method, curve in curves.items() if method in _RIVALS]
        if not ours or not theirs:
            return None
        level = max(_LEVEL, _least(ours), min(map(_least, theirs)))
        own = next(p.time.median for p in ours if p.error <= level)
        return cls(level, own, min(_time_to(level, curve) for curve in theirs))

    def __str__(self) -> str:
        times = self.theirs / self.ours
        return f"{times:.1f}× faster" if times >= 1 else f"{1 / times:.1f}× slower"


def _curves(points: Sequence[Point]) -> dict[str, list[Point]]:
    curves: dict[str, list[Point]] = defaultdict(list)
    for point in sorted(points, key=lambda point: point.samples):
        curves[point.method].append(point)
    # Two numbers of samples that make the same picture are one point.
    return {
        method: [*{point.error: point for point in curve}.values()]
        for method, curve in curves.items()
    }


def _least(curve: Sequence[Point]) -> float:
    return min(p.error for p in curve)


def _time_to(level: float, curve: Sequence[Point]) -> float:
    """Seconds to an error of at most `level`, between two points of a curve; infinite beyond."""
    ranked = sorted(curve, key=lambda p: p.error)
    if ranked[0].error > level:
        return np.inf
    logs = np.log([(p.error, p.time.median) for p in ranked]).T
    return float(np.exp(np.interp(np.log(level), *logs)))


def _draw(scenes: dict[str, Scene], points: Sequence[Point], where: str) -> Any:
    """A panel for each scene; the names of the curves stand in the last one."""
    figure, grid = plt.subplots(2, 3, figsize=(13, 8.6), sharex=True, sharey=True)
    panels = dict(zip(scenes, grid.flat, strict=False))
    for name, axes in panels.items():
        curves = [point for point in points if point.scene == name]
        _panel(axes, curves)
        axes.set_title(name)
        axes.minorticks_off()
        _thumbnail(axes, scenes[name])
    first, last = grid.flat[0], grid.flat[-1]
    first.set_xlim(left=0.5 * min(point.time.median for point in points))
    first.xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:g} ms")
    last.axis("off")
    last.legend(*first.get_legend_handles_labels(), loc="center", frameon=False, fontsize=12)
    for axes in grid[:, 0]:
        axes.set_ylabel("RMSE")
    headline(
        figure,
        "Time against error: lower left is better",
        "Rendering alone. Error: root mean square in linear radiance. Points: 1, 4, 16, ... samples"
        " a pixel (this tracer: 9, 36, ... too), or POV-Ray's thresholds.\nArrows: from the fastest"
        " of Mitsuba and POV-Ray to this tracer, near the error of rounding to 8 bits.\n" + where,
    )
    figure.subplots_adjust(0.06, 0.06, 0.99, 0.82, wspace=0.06, hspace=0.2)
    return figure


def _panel(axes: Any, points: Sequence[Point]) -> None:
    """Draw the curves of one scene, and an arrow for this tracer's lead."""
    for method, curve in _curves(points).items():
        # It cannot take what lies between two of its points.
        style = "steps-post" if method == _OURS else "default"
        seconds, errors = [p.time.median for p in curve], [p.error for p in curve]
        axes.loglog(seconds, errors, drawstyle=style, label=method, **LOOKS[_LOOK_OF[method]])
    lead = Lead.of(points)
    if lead:
        arrow = {"arrowstyle": "-|>", "color": "#333333", "lw": 1.4, "shrinkA": 0}
        ends = {"xy": (lead.ours, lead.level), "xytext": (lead.theirs, lead.level)}
        axes.annotate("", **ends, arrowprops=arrow, zorder=6)
        axes.annotate(
            str(lead),
            (min(lead.ours, lead.theirs), lead.level),
            xytext=(-14, -11),  # to the lower left, where few curves are
            textcoords="offset points",
            ha="right",
            va="center",
            weight="bold",
            path_effects=HALO,
            zorder=8,
        )


def _thumbnail(axes: Any, scene: Scene) -> None:
    """Show the scene where no curve comes: at little time and little error."""
    small = resized(scene, round(160 * scene.width / scene.height), 160)
    inset = axes.inset_axes((0.015, 0.02, 0.33, 0.27), anchor="SW")
    inset.imshow(to_codes(render(small, 16)))
    inset.axis("off")


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


_COLUMNS = ("scene", "method", "samples", "rmse", "seconds", "low", "high")


def _stored(path: Path) -> tuple[str, list[Point]]:
    where, rows = read_csv(path)
    return where, [
        Point(scene, method, int(samples), float(error), Timing(*map(float, time)))
        for scene, method, samples, error, *time in rows
    ]


def main() -> None:
    """Measure, and draw the chart."""
    used = parser("reference.speed_accuracy", __doc__, quick="one scene, few samples", redraw=True)
    options = used.parse_args()
    need_scenes(used)
    scenes, table = _scenes(options.quick), result("speed_accuracy.csv", quick=options.quick)
    if options.redraw:
        need_table(used, table)
    else:
        try:
            use(LLVM)
        except ImportError as error:
            used.exit(1, f"{used.prog}: {error}\n")
        mi.set_log_level(mi.LogLevel.Error)
        points: list[Point] = []
        for name, scene in tqdm(scenes.items(), unit="scene"):
            points += measure(name, scene, quick=options.quick)
        rows = [(*astuple(p)[:-1], *astuple(p.time)) for p in points]
        write_csv(table, measured_on(), _COLUMNS, rows)
    # As the file has them, rounded: drawn again, the chart is the same.
    where, stored = _stored(table)
    save(_draw(scenes, stored, where), table.with_suffix(".svg"))


if __name__ == "__main__":
    run(main)
