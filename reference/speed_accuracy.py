"""The speed-accuracy chart: how long each renderer takes to come how near to the true picture.

    python -m reference.speed_accuracy [--quick | --redraw]

writes `speed_accuracy.svg`, `.png` and `.csv` into this folder.  The error is the
root mean square of the linear radiance, over evenly spread rows of the picture,
against 129 x 129 samples in every pixel, traced one by one; these rows are
kept in the `build` folder.  At each number of samples, four times the one before,
all methods are timed in turns; those that would take too long stop.
Mitsuba's scalar variant would be slowed down by this project's plugins, which are
written in Python: its times are those of the stock plugins, its errors those of
the same samples in LLVM.
"""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from tqdm import tqdm

from converters.variant import LLVM, SCALAR, mi, use
from reference import alternatives, machine, rivals
from reference.charts import HALO, LOOKS, End, headline, label_ends, plt, read_csv, save, write_csv
from reference.command import SCENES, built, need_scenes, need_table, parser, result, run
from reference.timing import Task, Timing, interleaved, on_copies, process
from reference.truth import Truth, supersampled, truth_side
from reference.workloads import crowd, resized, to_xml
from tracer import Scene, load_scene, render
from tracer.arrays import Floats
from tracer.picture.png import quantise

__all__ = ["Lead", "Point", "main", "measure"]

Curve: TypeAlias = tuple[str, bool]
"""A method, and whether its whole process is timed, or rendering alone."""

_OURS = "this tracer"
# The same with 9, 36, 144, ... samples a pixel: the others have powers of four.
_BETWEEN = "this tracer, between"
_SCALAR = "Mitsuba scalar"
_POVRAY = "POV-Ray adaptive"
_SAMPLERS = ("independent", "stratified", "multijitter")
_LLVM = {sampler: f"Mitsuba {sampler}" for sampler in _SAMPLERS}
_LOOK_OF = {
    _OURS: "tracer",
    "uniform grid": "a",
    "float32, all pairs": "b",
    _POVRAY: "c",
    _LLVM["independent"]: "g",
    _LLVM["stratified"]: "e",
    _LLVM["multijitter"]: "f",
    _SCALAR: "h",
}
_RIVALS = {_SCALAR, _POVRAY, *_LLVM.values()}

# From rough to fine: threshold and depth of POV-Ray's adaptive supersampling.  Below 0.03 a lower
# threshold takes longer, and gains next to nothing, in all scenes but that of many small objects.
_ADAPTIVE = ((0.3, 2), (0.1, 3), (0.03, 4), (0.03, 5), (0.03, 6), (0.01, 7))

# Seconds: a point that is expected to take longer than the first is left out; any other is timed
# `_LEAST_ROUNDS` times, and on until its times add up to the second, at most `_ROUNDS` times.
_TOO_LONG, _ENOUGH, _LEAST_ROUNDS, _ROUNDS = 2.5, 0.3, 3, 15

# The error at which times are compared, as nearly as can be: that of rounding to 8 bits, about.
_LEVEL = 1e-3

# Errors within this factor pass for the same, where a curve ends; a speedup of no more is level.
_NEAR, _AHEAD = 1.5, 1.1


@dataclass(frozen=True, slots=True)
class Point:
    """One method on one scene, at one number of samples a pixel.

    Attributes
    ----------
    process : bool
        Whether the time is that of a whole process, or of rendering alone.
    error : float
        Root mean square of the linear radiance error.
    """

    scene: str
    method: str
    samples: int
    process: bool
    error: float
    time: Timing


# --- What is measured --------------------------------------------------------------------


def _all_pairs(scene: Scene, side: int) -> Floats:
    """The usual NumPy tracer in float32, `side` x `side` samples in every pixel."""
    shifts = ((np.arange(side) + 0.5) / side - 0.5).tolist()
    total = sum(
        alternatives.render(scene, alternatives.float32, offset=offset)
        for offset in product(shifts, shifts)
    )
    return np.asarray(total) / side**2


def _mitsuba(loaded: Any, samples: int, sensor: int = 0) -> Task:
    return lambda _: np.array(mi.render(loaded, sensor=sensor, spp=samples))


def _scalar_tasks(loaded: Any, k: int) -> dict[Curve, Task]:
    return {(_SCALAR, False): _mitsuba(loaded, 4**k)}


def _rendering_tasks(scene: Scene, k: int) -> dict[Curve, Task]:
    """Rendering alone, with 4^k samples a pixel."""
    ours = {
        _OURS: partial(render, samples=4**k),
        _BETWEEN: partial(render, samples=9 * 4**k),
        "uniform grid": partial(supersampled, side=2**k),
        "float32, all pairs": partial(_all_pairs, side=2**k),
    }
    # A loaded scene can be rendered with one number of samples only.
    gc.collect()
    loaded = rivals.mitsuba_exact(scene, _SAMPLERS)
    return {
        **{(name, False): on_copies(picture, scene, _ROUNDS) for name, picture in ours.items()},
        **{
            (_LLVM[sampler], False): _mitsuba(loaded, 4**k, sensor)
            for sensor, sampler in enumerate(_SAMPLERS)
        },
    }


def _process_tasks(scene: Scene, k: int) -> dict[Curve, Task]:
    """The same from a scene file to a PNG."""
    png, ours, theirs = built("out.png"), built("scene.xml"), built("scene.mitsuba.xml")
    ours.write_text(to_xml(scene))
    theirs.write_text(rivals.mitsuba_text(scene, 4**k, ["multijitter"]))
    return {
        (_OURS, True): process(rivals.tracer_command(ours, png, 4**k)),
        (_BETWEEN, True): process(rivals.tracer_command(ours, png, 9 * 4**k)),
        (_LLVM["multijitter"], True): process(rivals.mitsuba_command(theirs, png)),
    }


def _sweep(
    tasks_of: Callable[[int], dict[Curve, Task]], levels: int
) -> Iterator[tuple[int, dict[Curve, Timing]]]:
    """Time the tasks for each k, all in turns, but for those that would take too long."""
    spent: dict[Curve, list[float]] = defaultdict(list)
    for k in range(levels):
        tasks = {
            curve: task
            for curve, task in tasks_of(k).items()
            if len(spent[curve]) == k and _next(curve[0], spent[curve]) <= _TOO_LONG
        }
        # Mitsuba compiles a kernel for each number of samples, and keeps it for the next process;
        # Python the modules of a first one.
        for (method, whole), task in tasks.items():
            if method in _LLVM.values() or (whole and method == _OURS):
                task(0)
        timings = interleaved(tasks, _LEAST_ROUNDS, most=_ROUNDS, seconds=_ENOUGH)
        for curve, timing in timings.items():
            spent[curve].append(timing.median)
        # Mitsuba's kernels choose among all scenes alive: the last one goes before the next comes.
        tasks.clear()
        yield k, timings


def _next(method: str, seconds: Sequence[float]) -> float:
    """Expected time of a curve's next point; of the first time, most is starting up."""
    if not seconds:
        return 0.0
    before = seconds[-2] if len(seconds) > 1 else 0.75 * seconds[-1]
    # Four times as many samples, but for POV-Ray, which has thresholds.
    growth = 1 if method == _POVRAY else 4
    return seconds[-1] + growth * max(seconds[-1] - before, 0.0)


def measure(name: str, scene: Scene, *, quick: bool) -> Iterator[Point]:
    """All methods on one scene."""
    levels = 3 if quick else 6
    truth = Truth.of(scene, truth_side(quick))
    # Scenes of one variant do not outlive a switch to another.
    mi.set_variant(SCALAR)
    scalar = dict(_sweep(partial(_scalar_tasks, rivals.mitsuba_stock(scene)), levels))
    mi.set_variant(LLVM)
    png = built("povray.png")
    pictures: dict[str, Floats] = {}
    traced: list[float] = []

    def kept(method: str, task: Task) -> Task:
        """The same task; its first picture is kept."""

        def draw(k: int) -> None:
            pictures.setdefault(method, np.asarray(task(k)))

        return draw

    def tasks_of(k: int) -> dict[Curve, Task]:
        pictures.clear()
        traced.clear()
        rendering = {
            (method, False): kept(method, task)
            for (method, _), task in _rendering_tasks(scene, k).items()
        }
        tasks = rendering | _process_tasks(scene, k)
        if rivals.povray_installed():
            threshold, depth = _ADAPTIVE[k]
            finer = ("+AM2", f"+A{threshold}", f"+R{depth}", "-J")
            command = rivals.povray_linear(scene, png, *finer)
            tasks[_POVRAY, True] = lambda _: traced.append(rivals.povray_trace(command))
        return tasks

    for k, timings in _sweep(tasks_of, levels):
        errors = {method: truth.error(picture) for method, picture in pictures.items()}
        if traced:
            errors[_POVRAY] = truth.error(rivals.povray_picture(png))
            timings[_POVRAY, False] = Timing.of(traced)
        if _LLVM["multijitter"] in errors:
            errors[_SCALAR] = errors[_LLVM["multijitter"]]
            timings |= scalar[k]
        for (method, whole), timing in timings.items():
            if method in errors:
                shown, times = (_OURS, 9) if method == _BETWEEN else (method, 1)
                yield Point(name, shown, times * 4**k, whole, errors[method], timing)


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
        """The least lead over any rival; None without one.

        At `_LEVEL`, or the least error above it that both reach.  A rival whose curve ends a little
        above the others' is met there: it may be the fastest.
        """
        curves = _curves(points)
        ours = curves.pop(_OURS, [])
        theirs = [curve for method, curve in curves.items() if method in _RIVALS]
        if not ours or not theirs:
            return None
        least = max(_LEVEL, _least(ours), min(map(_least, theirs)))
        leads = []
        for curve in theirs:
            level = max(least, _least(curve))
            if level <= _NEAR * least:
                own = next(p.time.median for p in ours if p.error <= level)
                leads.append(cls(level, own, _time_to(level, curve)))
        return min(leads, key=lambda lead: lead.speedup)

    @property
    def speedup(self) -> float:
        """Below 1 this tracer is slower."""
        return self.theirs / self.ours


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
    """Seconds to an error of at most `level`, which a curve reaches between two of its points."""
    ranked = sorted(curve, key=lambda p: p.error)
    logs = np.log([(p.error, p.time.median) for p in ranked]).T
    return float(np.exp(np.interp(np.log(level), *logs)))


def _in_words(*speedups: float) -> str:
    """From the least speedup to the largest."""
    slow = [f"{1 / s:.1f}" for s in sorted(speedups) if s < 1 / _AHEAD]
    fast = [f"{s:.1f}" for s in sorted(speedups) if s > _AHEAD]
    ranges = [
        f"{'–'.join(dict.fromkeys([some[0], some[-1]]))}× {what}"
        for some, what in ((slow[::-1], "slower"), (fast, "faster"))
        if some
    ]
    if len(slow) + len(fast) < len(speedups):
        ranges.insert(bool(slow), "level")
    return ", ".join(ranges)


def _title(leads: dict[bool, list[Lead]], others: str) -> str:
    """Where this tracer is ahead; nothing where there is nothing to compare."""
    counts = []
    for whole, where in ((True, "from file to picture"), (False, "at rendering alone")):
        ahead = sum(lead.speedup > _AHEAD for lead in leads[whole])
        if leads[whole]:
            counts.append(f"in {ahead} of {len(leads[whole])} pictures {where}")
    if not counts:
        return "Time against error"
    return f"At the same error, this tracer is faster than {others}\n{', '.join(counts)}"


# Inches: what surrounds the panels, and the panels, rendering alone and whole processes.
_WIDTH, _LEFT, _NAMES, _GAP = 13.0, 0.85, 1.55, 0.3
_TOP, _ROW, _TITLE, _BOTTOM = 2.55, 2.2, 0.65, 0.6
_WIDE = (5.2, 3.4)


def _draw(scenes: dict[str, Scene], points: Sequence[Point], truth: int) -> Any:
    """A row for each scene: rendering alone, and the whole process."""
    height = _TOP + len(scenes) * (_ROW + _TITLE) - _TITLE + _BOTTOM
    figure = plt.figure(figsize=(_WIDTH, height))
    low, high = _limits([p.error for p in points])
    ylim = 0.6 * low, high
    leads: dict[bool, list[Lead]] = {False: [], True: []}
    left = _LEFT
    for whole, wide in zip((False, True), _WIDE, strict=True):
        low, high = _limits([p.time.median for p in points if p.process == whole])
        # On the left is place for the pictures and for the arrows' labels.
        xlim = low * (low / high) ** (0.42 if whole else 0.14), high
        bottom = height - _TOP - _ROW
        for name, scene in scenes.items():
            place = (left / _WIDTH, bottom / height, wide / _WIDTH, _ROW / height)
            axes = figure.add_axes(place, xscale="log", yscale="log", xlim=xlim, ylim=ylim)
            lead = _panel(axes, [p for p in points if (p.scene, p.process) == (name, whole)])
            if lead:
                leads[whole].append(lead)
            axes.set_title(name)
            if whole:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel("RMSE")
                _thumbnail(axes, scene)
            bottom -= _ROW + _TITLE
        what = "Whole process" if whole else "Rendering alone"
        if leads[whole]:
            what += f": {_in_words(*(lead.speedup for lead in leads[whole]))}"
        figure.text(left / _WIDTH, 1 - (_TOP - 0.45) / height, what, fontsize=13, weight="bold")
        left += wide + _NAMES + _GAP
    others = "Mitsuba and POV-Ray" if any(p.method == _POVRAY for p in points) else "Mitsuba"
    headline(
        figure,
        _title(leads, others),
        "Time against error: the root mean square, in linear radiance, from a picture of"
        f" {truth:,} samples a pixel.  Lower left is better.\n"
        "Points: 1, 4, 16, ... samples a pixel (9, 36, ... too for this tracer), or POV-Ray's"
        " thresholds; this tracer goes in steps.\nArrows: from the fastest"
        f" of {others} to this tracer, near the error of rounding to 8 bits.",
    )
    return figure


def _limits(values: Sequence[float]) -> tuple[float, float]:
    return 0.75 * min(values), 1.35 * max(values)


def _panel(axes: Any, points: Sequence[Point]) -> Lead | None:
    ends: list[End] = []
    for method, curve in _curves(points).items():
        look = LOOKS[_LOOK_OF[method]]
        # It cannot take what lies between two of its points.
        style = "steps-post" if method == _OURS else "default"
        seconds, errors = [p.time.median for p in curve], [p.error for p in curve]
        axes.plot(seconds, errors, drawstyle=style, **look)
        ends.append((curve[-1].time.median, curve[-1].error, method, look["color"]))
    low, high = axes.get_xlim()
    steps = [1] if high > 100 * low else [1, 5]
    ticks = np.outer(10.0 ** np.arange(-4, 3), steps).ravel()
    axes.set_xticks(ticks[(low <= ticks) & (ticks <= high)])
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:g} ms")
    axes.minorticks_off()
    label_ends(axes, ends)
    lead = Lead.of(points)
    if lead:
        axes.annotate(
            "",
            xy=(lead.ours, lead.level),
            xytext=(lead.theirs, lead.level),
            arrowprops={"arrowstyle": "-|>", "color": "#333333", "lw": 1.4, "shrinkA": 0},
            zorder=6,
        )
        axes.annotate(
            _in_words(lead.speedup),
            (min(lead.ours, lead.theirs), lead.level),
            xytext=(-18, -11),  # to the lower left, where few curves are
            textcoords="offset points",
            ha="right",
            va="center",
            weight="bold",
            path_effects=HALO,
            zorder=8,
        )
    return lead


def _thumbnail(axes: Any, scene: Scene) -> None:
    """The scene, where no curve comes: at little time and little error."""
    small = resized(scene, round(160 * scene.width / scene.height), 160)
    inset = axes.inset_axes((0.012, 0.03, 0.5, 0.36), anchor="SW")
    inset.imshow(quantise(render(small, 16)))
    inset.axis("off")


def _scenes(quick: bool) -> dict[str, Scene]:
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    spheres = load_scene(SCENES / "four-spheres.xml")
    scenes = [
        ("one-sphere", load_scene(SCENES / "one-sphere.xml"), 300, 300),
        ("four-spheres", spheres, 320, 180),
        ("sticks-perspective", sticks, 320, 180),
        ("sticks-perspective", sticks, 1280, 720),
        ("1,000 small objects", crowd(1000), 320, 180),
    ]
    return {
        f"{name}, {width}×{height}": resized(scene, width, height)
        for name, scene, width, height in (scenes[1:2] if quick else scenes)
    }


_COLUMNS = ("scene", "method", "samples", "process", "rmse", "seconds", "low", "high")


def _stored(path: Path) -> list[Point]:
    return [
        Point(
            scene,
            method,
            int(samples),
            whole == "True",
            float(error),
            Timing(float(median), float(low), float(high)),
        )
        for scene, method, samples, whole, error, median, low, high in read_csv(path)
    ]


def main() -> None:
    """Measure, and write the chart."""
    used = parser("reference.speed_accuracy", __doc__, quick="one scene, few samples", redraw=True)
    options = used.parse_args()
    need_scenes(used)
    scenes, chart = _scenes(options.quick), result("speed_accuracy.csv", quick=options.quick)
    if options.redraw:
        need_table(used, chart)
    else:
        try:
            use(LLVM)
        except ImportError as error:
            used.exit(1, f"{used.prog}: {error}\n")
        mi.set_log_level(mi.LogLevel.Error)
        points: list[Point] = []
        where = machine.describe()
        minutes = 2 * len(scenes)
        print(f"About {minutes} minutes, or less where the build folder has the truth already")
        for name, scene in tqdm(scenes.items(), unit="scene"):
            points += measure(name, scene, quick=options.quick)
        write_csv(
            chart,
            where,
            _COLUMNS,
            ((p.scene, p.method, p.samples, p.process, p.error, *astuple(p.time)) for p in points),
        )
    # As the file has them, rounded: drawn again, the chart is the same.
    save(_draw(scenes, _stored(chart), truth_side(options.quick) ** 2), chart)


if __name__ == "__main__":
    run(main)
