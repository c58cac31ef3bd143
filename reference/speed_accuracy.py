"""The speed-accuracy chart: how long a renderer takes to come how near to the true picture.

    python -m reference.speed_accuracy [--quick]

writes `speed_accuracy.svg`, `.png` and `.csv` into this folder.  The error is the
root mean square of the linear radiance against 64 x 64 samples in every pixel,
traced one by one; such pictures are kept in the `build` folder.  All methods
run in turns; each point is the median of some rounds.  Mitsuba's scalar variant
would be held up by this project's plugins, which are written in Python: its
times are those of the stock plugins, its errors those of the same samples in LLVM.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import mitsuba as mi
import numpy as np
from tqdm import tqdm

from converters.variant import LLVM, SCALAR, use
from reference import alternatives, machine, rivals
from reference.benchmark import SCENES, Task, Timing, interleaved, run
from reference.charts import HALO, LOOKS, End, label_ends, plt, save, write_csv
from reference.machine import BUILD
from reference.povray import to_pov
from reference.workloads import afresh, crowd, resized, to_xml
from tracer import Scene, load_scene, render
from tracer.render import render_bands
from tracer.scene import MAX_PIXELS, Floats

__all__ = ["Point", "converged", "main", "measure", "rmse", "supersampled"]

Picture: TypeAlias = Callable[[Scene], Floats]

Effort: TypeAlias = tuple[str, int]
"""A method, and how many samples it takes."""

_SCALAR = "Mitsuba scalar, stock plugins"

_SAMPLERS = ("independent", "stratified", "multijitter")
_LOOK_OF = {
    "this tracer": "tracer",
    "the same, uniform grid": "a",
    "all pairs, float32": "b",
    "POV-Ray, adaptive": "c",
    "Mitsuba LLVM, independent": "g",
    "Mitsuba LLVM, stratified": "e",
    "Mitsuba LLVM, multijitter": "f",
    "Mitsuba LLVM, orthogonal": "d",
    _SCALAR: "h",
}
# From rough to fine: threshold and depth of POV-Ray's adaptive supersampling.
_ADAPTIVE = ((0.3, 2), (0.1, 3), (0.03, 4), (0.01, 5), (0.003, 6))


@dataclass(frozen=True, slots=True)
class Point:
    """One method on one scene, at one effort.

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


def rmse(image: Floats, truth: Floats) -> float:
    """Root mean square of the difference."""
    return float(np.sqrt(np.mean((image - truth) ** 2)))


def supersampled(scene: Scene, side: int) -> Floats:
    """`side` x `side` samples spread evenly over every pixel, by brute force.

    They are the pixels of a picture so many times as large, rendered one
    sample a pixel and averaged; where that is too large, of several.
    """
    width, height = scene.width, scene.height
    apart = 1
    while width * height * (side // apart) ** 2 > MAX_PIXELS:
        apart *= 2
    if side % apart:
        raise ValueError(f"{side} x {side} samples cannot be split into parts of {apart}")
    step = side // apart
    large = resized(scene, width * step, height * step)
    total = np.zeros((height, width, 3))
    shifts = (np.arange(apart) + 0.5) / apart - 0.5
    for dy in shifts.tolist():
        for dx in shifts.tolist():
            rows = max(1, (1 << 17) // (large.width * step)) * step
            top = 0
            for band in render_bands(large, offset=(dx, dy), band_pixels=rows * large.width):
                block = band.reshape(-1, step, width, step, 3).sum(axis=(1, 3))
                total[top : top + len(block)] += block
                top += len(block)
    return total / side**2


def converged(scene: Scene, side: int = 64) -> Floats:
    """`supersampled`, kept in the build folder for the next time."""
    BUILD.mkdir(exist_ok=True)
    name = hashlib.sha256(f"{side} {to_xml(scene)}".encode()).hexdigest()[:16]
    path = BUILD / f"converged-{name}.npy"
    if not path.exists():
        np.save(path, supersampled(scene, side))
    image: Floats = np.load(path)
    return image


def _all_pairs(scene: Scene, side: int) -> Floats:
    """The usual NumPy tracer in float32, `side` x `side` samples in every pixel."""
    shifts = ((np.arange(side) + 0.5) / side - 0.5).tolist()
    total = sum(
        alternatives.render(scene, alternatives.float32, offset=(dx, dy))
        for dy in shifts
        for dx in shifts
    )
    return np.asarray(total) / side**2


def _mitsuba(loaded: Any, samples: int, sensor: int = 0) -> Task:
    return lambda _: np.array(mi.render(loaded, sensor=sensor, spp=samples), dtype=np.float64)


def _scalar_timings(scene: Scene, rounds: int, quick: bool) -> dict[Effort, Timing]:
    """The scalar variant, with stock plugins: it would spend all its time in Python ones."""
    mi.set_variant(SCALAR)
    loaded = rivals.mitsuba_stock(scene)
    tasks = {(_SCALAR, 4**k): _mitsuba(loaded, 4**k) for k in range(3 if quick else 4)}
    return interleaved(tasks, rounds)


def _warm_tasks(scene: Scene, k: int, rounds: int) -> dict[Effort, Task]:
    """Rendering alone, with 4^k samples; round 0 renders the scene itself, others copies of it."""

    def fresh(picture: Picture) -> Task:
        copies = [afresh(scene, k) for k in range(rounds + 1)]
        return lambda k: picture(copies[k])

    tasks: dict[Effort, Task] = {}
    tasks["this tracer", 4**k] = fresh(partial(render, samples=4**k))
    if k < 5:
        tasks["the same, uniform grid", 4**k] = fresh(partial(supersampled, side=2**k))
        # A loaded scene can be rendered with one number of samples only.
        loaded = rivals.mitsuba_exact(scene, _SAMPLERS)
        for sensor, sampler in enumerate(_SAMPLERS):
            tasks[f"Mitsuba LLVM, {sampler}", 4**k] = _mitsuba(loaded, 4**k, sensor)
        # Orthogonal arrays come in squares of primes.
        loaded = rivals.mitsuba_exact(scene, ["orthogonal"])
        samples = (2, 3, 5, 11, 17)[k] ** 2
        tasks["Mitsuba LLVM, orthogonal", samples] = _mitsuba(loaded, samples)
    if k < 3:
        tasks["all pairs, float32", 4**k] = fresh(partial(_all_pairs, side=2**k))
    return tasks


def _process_tasks(scene: Scene, quick: bool) -> dict[Effort, Task]:
    """From the scene file to a PNG."""
    python, png = sys.executable, BUILD / "out.png"
    source = BUILD / "scene.xml"
    source.write_text(to_xml(scene))
    ours = (python, "-m", "tracer", "--quiet", "-o", str(png))
    theirs = (python, "-c", rivals.MITSUBA_PROCESS, LLVM)
    tasks: dict[Effort, Task] = {}
    for k in range(3 if quick else 6):
        command = (*ours, "--samples", str(4**k), str(source))
        tasks["this tracer", 4**k] = _shell(command)
        if k < 5:
            text = BUILD / f"scene.{4**k}.mitsuba.xml"
            text.write_text(rivals.mitsuba_text(scene, 4**k, ["multijitter"]))
            tasks["Mitsuba LLVM, multijitter", 4**k] = _shell((*theirs, str(text), str(png)))
    if rivals.povray_installed():
        pov = BUILD / "whole.pov"
        pov.write_text(to_pov(scene))
        for threshold, depth in _ADAPTIVE[: 2 if quick else None]:
            finer = rivals.povray_command(scene, pov, png, *_finer(threshold, depth))
            tasks["POV-Ray, adaptive", 4**depth] = _shell(finer)
    return tasks


def _shell(command: Sequence[str]) -> Task:
    return lambda _: run(*command)


def _finer(threshold: float, depth: int) -> tuple[str, ...]:
    return ("+AM2", f"+A{threshold}", f"+R{depth}", "-J")


def measure(name: str, scene: Scene, *, quick: bool) -> Iterator[Point]:
    """All methods on one scene, in turns."""
    rounds = 1 if quick else 3
    truth = converged(scene, _side(quick))
    # Scenes of one variant do not outlive a switch to another.
    scalar = _scalar_timings(scene, rounds, quick)
    mi.set_variant(LLVM)
    errors: dict[Effort, float] = {}
    timings: dict[Effort, Timing] = {}
    for k in range(3 if quick else 6):
        gc.collect()
        warm = _warm_tasks(scene, k, rounds)
        errors |= {key: rmse(np.asarray(task(0)), truth) for key, task in warm.items()}
        timings |= interleaved({key: _later(task) for key, task in warm.items()}, rounds)
    for (_, samples), time in scalar.items():
        timings[_SCALAR, samples] = time
        errors[_SCALAR, samples] = errors["Mitsuba LLVM, multijitter", samples]
    if rivals.povray_installed():
        for threshold, depth in _ADAPTIVE[: 2 if quick else None]:
            key = ("POV-Ray, adaptive", 4**depth)
            done = [rivals.povray(scene, *_finer(threshold, depth)) for _ in range(rounds)]
            errors[key] = rmse(done[0][0], truth)
            timings[key] = Timing.of([seconds for _, seconds in done])
    for (method, samples), time in timings.items():
        yield Point(name, method, samples, False, errors[method, samples], time)
    process = _process_tasks(scene, quick)
    for key, time in interleaved(process, rounds).items():
        yield Point(name, *key, True, errors[key], time)


def _side(quick: bool) -> int:
    """Samples a side of the pixel that count as the truth."""
    return 16 if quick else 64


def _later(task: Task) -> Task:
    return lambda k: task(k + 1)


# --- The chart ---------------------------------------------------------------------------


def _time_to(points: list[Point], error: float) -> float | None:
    """Seconds to an error, between the points that a method reaches; None beyond them."""
    ranked = sorted(points, key=lambda p: p.error)
    errors = np.log([p.error for p in ranked])
    if not errors[0] <= np.log(error) <= errors[-1]:
        return None
    times = np.log([p.time.median for p in ranked])
    return float(np.exp(np.interp(np.log(error), errors, times)))


def _draw(axes: Any, points: list[Point]) -> None:
    methods: dict[str, list[Point]] = {}
    for point in points:
        methods.setdefault(point.method, []).append(point)
    axes.set(xscale="log", yscale="log")
    ends: list[End] = []
    for method, found in methods.items():
        look = LOOKS[_LOOK_OF[method]]
        x = [p.time.median for p in found]
        y = [p.error for p in found]
        axes.plot(x, y, **look, markeredgecolor="white", mew=0.5)
        ends.append((x[-1], y[-1], method, look["color"]))
    left, right = axes.get_xlim()
    axes.set_xlim(left, right * (right / left) ** 0.25)
    decades = np.log10(right / left)
    steps = [1, 1.5, 2, 3, 5, 7] if decades < 1 else [1, 3] if decades < 2.5 else [1]
    places = np.outer(10.0 ** np.arange(-4, 4), steps).ravel()
    axes.set_xticks(places[(places >= left) & (places <= axes.get_xlim()[1])])
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:.3g} ms")
    axes.minorticks_off()
    label_ends(axes, ends, margin=False)
    # The head start on the fastest of the others, in the middle of what both reach.
    others = [found for method, found in methods.items() if "LLVM" in method]
    reached = [p.error for p in methods["this tracer"]]
    theirs_reached = [p.error for found in others for p in found]
    level = float(
        np.sqrt(max(min(reached), min(theirs_reached)) * min(max(reached), max(theirs_reached)))
    )
    ours = _time_to(methods["this tracer"], level)
    theirs = [t for t in (_time_to(found, level) for found in others) if t is not None]
    if ours is not None and theirs:
        axes.annotate(
            "",
            xy=(ours, level),
            xytext=(min(theirs), level),
            arrowprops={"arrowstyle": "-|>", "color": "#333333", "lw": 1.4, "shrinkA": 0},
        )
        axes.annotate(
            f"{min(theirs) / ours:.1f}×",
            (np.sqrt(ours * min(theirs)), level),
            xytext=(0, 5),
            textcoords="offset points",
            ha="center",
            weight="bold",
            path_effects=HALO,
            zorder=8,
        )


def _scenes(quick: bool) -> dict[str, Scene]:
    names = ("four-spheres", "sticks-perspective", "sunflower")
    scenes = {name: resized(load_scene(SCENES / f"{name}.xml"), 320, 180) for name in names}
    scenes["1,000 small objects"] = crowd(1000)
    return {"four-spheres": scenes["four-spheres"]} if quick else scenes


def main() -> None:
    """Measure, and write the chart."""
    parser = argparse.ArgumentParser(
        prog="python -m reference.speed_accuracy",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="one scene, few samples")
    quick = parser.parse_args().quick
    BUILD.mkdir(exist_ok=True)
    try:
        use(LLVM)
    except ImportError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")
    mi.set_log_level(mi.LogLevel.Error)
    scenes = _scenes(quick)
    where = machine.describe()
    height = 4.9 * len(scenes) + 1.1
    figure, grid = plt.subplots(len(scenes), 2, figsize=(14, height), squeeze=False, sharey="row")
    figure.subplots_adjust(
        left=0.06, right=0.92, top=1 - 1.45 / height, bottom=0.6 / height, wspace=0.16, hspace=0.34
    )
    figure.text(0.03, 1 - 0.45 / height, "Speed against accuracy", fontsize=19, weight="bold")
    figure.text(
        0.03, 1 - 0.8 / height,
        f"Time to a picture against its error (RMSE, linear) from one of {_side(quick) ** 2:,}"
        " samples a pixel; lower left is better.  Left: rendering alone.  Right: the whole process,"
        " file to PNG.",
        fontsize=11, color="#444444",
    )  # fmt: skip
    points: list[Point] = []
    for row, (name, scene) in zip(grid, tqdm(scenes.items(), disable=None), strict=True):
        found = list(measure(name, scene, quick=quick))
        points += found
        for axes, process in zip(row, (False, True), strict=True):
            what = "whole process" if process else "rendering"
            axes.set_title(f"{name}: {what}")
            _draw(axes, [p for p in found if p.process == process])
    write_csv(
        "speed_accuracy",
        where,
        ("scene", "method", "samples", "process", "rmse", "seconds", "low", "high"),
        (
            (
                p.scene,
                p.method,
                p.samples,
                p.process,
                p.error,
                p.time.median,
                p.time.low,
                p.time.high,
            )
            for p in points
        ),
    )
    save(figure, "speed_accuracy")


if __name__ == "__main__":
    main()
