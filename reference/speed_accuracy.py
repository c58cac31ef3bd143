"""The speed-accuracy chart: how much time each renderer takes to reach a certain error.

``python -m reference.speed_accuracy`` writes `speed_accuracy.svg`, and `speed_accuracy.csv` with
its table, into this folder.  The error is the root mean square error of the linear radiance,
compared with a certified picture (`reference.judges.certificate`).

Each point of a curve belongs to a *level*, from 0.  At a level, a picture has 4^level samples per
pixel, and the permitted error of the certified tracer is proportional to 1 / 4^level.  All methods
are timed alternately.  The curve of a method ends when its next picture would take too long, or
when its error comes close to that of the certified picture.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import gc
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import accumulate, product
from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import convert
from converters.variant import LLVM, mi, use_variant
from reference import povray
from reference.command import SCENES, build_path
from reference.judges import plain
from reference.judges.arrays import Floats
from reference.judges.certificate import certify
from reference.judges.sampling import compute_rms_error, render_supersampled
from reference.measured.charts import CHART_WIDTH, plt, run_chart_command
from reference.measured.measurements import time_alternately
from reference.measured.workloads import build_crowd_scene, copy_with_picture_size
from tracer import Scene, load_scene, render
from tracer.command.progress import track

# Names of the methods in the table.
_TRACER = "this tracer"
_CERTIFIED_TRACER = "this tracer, certified"
_POVRAY = "POV-Ray adaptive"
_GRID = "uniform grid"
_ALL_PAIRS = "float32, all pairs"
_MITSUBA = "Mitsuba multijitter"

# What the legend says about each method, in the order of the curves' styles.
_LABELS = {
    _TRACER: "this tracer",
    _GRID: "uniform grid: this tracer with n × n samples\nin every pixel, not antialiasing",
    _ALL_PAIRS: "float32, all pairs: plain NumPy that tests\nevery ray against every object",
    _POVRAY: "POV-Ray, adaptive antialiasing; all processors",
    _CERTIFIED_TRACER: "this tracer, certified (python -m reference.certify)",
    _MITSUBA: f"Mitsuba ({LLVM}), flavour exact, multijitter\nsampler; all processors",
}

# Two series of options of POV-Ray's adaptive antialiasing, by level.  A pixel is divided, at most R
# times, where neighbouring samples differ by more than the threshold A.  The first series is faster
# on most scenes, but on four-spheres, its error does not fall below 8.5e-4.  The chart shows the
# better of both.
_POVRAY_SCHEDULES = (
    {
        0: "+A0.3 +R2",
        1: "+A0.1 +R3",
        2: "+A0.03 +R4",
        3: "+A0.03 +R5",
        4: "+A0.01 +R6",
        5: "+A0.01 +R7",
    },
    {2: "+A0.001 +R5", 3: "+A0.001 +R6"},
)

# Name of the picture that POV-Ray writes into the build folder.
_POVRAY_PICTURE = "povray.ppm"

# Number of levels, and their number with the option --quick.
_LEVEL_COUNT = 6
_QUICK_LEVEL_COUNT = 3

# Permitted error of the certified picture with which all others are compared.
_REFERENCE_ERROR = 1 / 16384

# The curve of a method ends if a picture takes more than this many seconds: the next picture, with
# four times the samples, would take too long.
_MAX_SECONDS = 0.7

# Minimum number of rounds in which each picture is timed.
_MIN_ROUNDS = 3

# Approximate error of rounding to 8 bits.
_EIGHT_BIT_ERROR = 1e-3

# Style of the numbers of samples in the chart, next to the points of this tracer.
_LABEL_STYLE: Any = {"textcoords": "offset points", "fontsize": 6.5, "ha": "right", "va": "top"}

_PANEL_HEIGHT_INCHES = 2.5

# The header contains the title and the note; the footer, the lowest labels and the origin.
_HEADER_HEIGHT_INCHES = 1.45
_FOOTER_HEIGHT_INCHES = 0.7

# The note above the panels, line by line.
_NOTE_LINES = (
    "Time of rendering alone, and root mean square error of the linear radiance compared with a"
    " certified picture.  Each point is",
    "a picture with 1, 4, 16, ... samples per pixel; this tracer also has points with 9, 36, ..."
    " samples.  Its curve has steps, because it",
    "divides pixels into quarters.  POV-Ray uses thresholds from 0.3 to 0.001; only its best"
    " settings are shown.  The certified tracer",
    "permits errors of 1/8, 1/32, ... in every pixel.  Mitsuba and POV-Ray use all processors, the"
    " others one.",
)


class _Row(NamedTuple):
    """A row of the table, which is a point of a curve in the chart."""

    scene: str
    method: str
    # Samples per pixel.  For the certified tracer, the reciprocal of the permitted error; for
    # POV-Ray, its options.
    samples: str
    rmse: float
    seconds: float  # the median of all rounds
    low: float  # the minimum
    high: float  # the maximum


class _Series(NamedTuple):
    """Pictures of increasing quality that a method renders."""

    method: str
    number: int = 0  # distinguishes the series of a method


class _RenderingTask(NamedTuple):
    """A function to be timed, and the samples of its picture."""

    samples: str  # see `_Row`
    # Returns an image; for POV-Ray, the time that it reports, which does not include its start.
    render: Callable[[], Any]


def _render_by_brute_force(scene: Scene, samples_per_side: int) -> Shaped[Floats, "height width 3"]:
    """Render a scene as simple NumPy tracers do: test every ray against every object, in float32.

    Each pixel has a grid of `samples_per_side`^2 samples.
    """
    offsets = ((np.arange(samples_per_side) + 0.5) / samples_per_side - 0.5).tolist()
    render_at_offset = partial(plain.render, scene, arithmetic="float32")
    images = map(render_at_offset, product(offsets, offsets))
    return np.asarray(sum(images)) / samples_per_side**2


def _make_rendering_tasks(scene: Scene, level: int) -> dict[_Series, _RenderingTask]:
    """Make the tasks of one level, for all methods except POV-Ray."""
    gc.collect()  # Mitsuba's kernels depend on all live objects, so keep only one scene loaded
    samples = 4**level
    more_samples = 9 * samples  # between the powers of four: 9, 36, 144, ...
    reciprocal_error = 8 * samples
    mitsuba_xml = convert(scene, "exact", samples).replace('"stratified"', '"multijitter"')
    loaded_scene = mi.load_string(mitsuba_xml)
    render_by_brute_force = partial(_render_by_brute_force, scene, 2**level)
    return {
        _Series(_TRACER): _RenderingTask(str(samples), partial(render, scene, samples)),
        _Series(_TRACER, 1): _RenderingTask(
            str(more_samples), partial(render, scene, more_samples)
        ),
        _Series(_CERTIFIED_TRACER): _RenderingTask(
            str(reciprocal_error), lambda: certify(scene, 1 / reciprocal_error).image
        ),
        _Series(_GRID): _RenderingTask(str(samples), partial(render_supersampled, scene, 2**level)),
        _Series(_ALL_PAIRS): _RenderingTask(str(samples), render_by_brute_force),
        _Series(_MITSUBA): _RenderingTask(str(samples), lambda: np.array(mi.render(loaded_scene))),
    }


def _make_povray_tasks(scene: Scene, level: int) -> dict[_Series, _RenderingTask]:
    """Make the tasks of one level for POV-Ray; none if it is not installed."""
    tasks: dict[_Series, _RenderingTask] = {}
    for index, schedule in enumerate(_POVRAY_SCHEDULES if povray.is_installed() else ()):
        if level in schedule:
            options = "+AM2", *schedule[level].split(), "-J"
            picture_path = build_path(_POVRAY_PICTURE)
            command = povray.prepare_linear_command(scene, picture_path, *options)
            tasks[_Series(_POVRAY, index)] = _RenderingTask(
                samples=schedule[level], render=partial(povray.render_and_time, command)
            )
    return tasks


def measure_scene(name: str, scene: Scene, *, quick: bool) -> Iterator[_Row]:
    """Time all rendering methods on one scene, and yield the rows of the table.

    With `quick`, there are fewer points, and the reference picture is less accurate.
    """
    permitted_error = _REFERENCE_ERROR * (16 if quick else 1)
    reference_image = certify(scene, permitted_error).image
    # Errors smaller than the error of a less accurate reference are too uncertain to be shown.
    less_accurate_image = certify(scene, 4 * permitted_error).image
    min_error = compute_rms_error(less_accurate_image, reference_image)
    finished_series: set[_Series] = set()
    for level in range(_QUICK_LEVEL_COUNT if quick else _LEVEL_COUNT):
        tasks = _make_rendering_tasks(scene, level) | _make_povray_tasks(scene, level)
        tasks = {series: task for series, task in tasks.items() if series not in finished_series}
        timings = time_alternately(
            {series: task.render for series, task in tasks.items()}, _MIN_ROUNDS
        )
        for series, timing in timings.items():
            image = _render_once_more(series, tasks[series])
            error = compute_rms_error(image, reference_image)
            if error > min_error:
                yield _Row(
                    scene=name,
                    method=series.method,
                    samples=tasks[series].samples,
                    rmse=error,
                    seconds=timing.median,
                    low=timing.low,
                    high=timing.high,
                )
            if timing.median > _MAX_SECONDS or error <= min_error:
                finished_series.add(series)
        tasks.clear()  # delete Mitsuba's scene before the next one is loaded


def _render_once_more(series: _Series, task: _RenderingTask) -> Shaped[Floats, "height width 3"]:
    """Render the picture of a task again, because timing it kept no picture."""
    result = task.render()
    if series.method == _POVRAY:  # all series of POV-Ray write the same file
        result = povray.read_linear_picture(build_path(_POVRAY_PICTURE))
    return np.asarray(result, dtype=np.float64)  # Mitsuba's is float32


def _parse_row(cells: Sequence[str]) -> _Row:
    """Parse the cells of a row of the CSV file."""
    scene, method, samples, *numbers = cells
    rmse, seconds, low, high = map(float, numbers)
    return _Row(scene, method, samples, rmse, seconds, low, high)


def _draw_chart(csv_rows: Sequence[Sequence[str]]) -> Any:
    """Draw a panel for each scene in the table, in two columns, and then the legend."""
    rows = [_parse_row(cells) for cells in csv_rows]
    titles = list(dict.fromkeys(row.scene for row in rows))
    row_count = len(titles) // 2 + 1
    height = _HEADER_HEIGHT_INCHES + row_count * _PANEL_HEIGHT_INCHES + _FOOTER_HEIGHT_INCHES
    figure, axes_grid = plt.subplots(
        row_count, 2, figsize=(CHART_WIDTH, height), sharex=True, sharey=True
    )
    panels = axes_grid.ravel()
    for axes, title in zip(panels, titles, strict=False):
        _draw_panel(axes, title, [row for row in rows if row.scene == title])
    panels[0].xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:g} ms")
    for axes in panels[len(titles) :]:
        axes.axis("off")
    handles, labels = panels[0].get_legend_handles_labels()
    legend_style: Any = {"loc": "center", "fontsize": 8.5, "labelspacing": 0.7}
    panels[-1].legend(handles, labels, title="On one processor, unless stated", **legend_style)
    figure.subplots_adjust(
        left=0.08,
        right=0.98,
        bottom=_FOOTER_HEIGHT_INCHES / height,
        top=1 - _HEADER_HEIGHT_INCHES / height,
        hspace=0.5,
        wspace=0.16,
    )
    return figure


def _draw_panel(axes: Any, title: str, rows: Sequence[_Row]) -> None:
    """Draw the curve of each method, from the rows of one scene."""
    for method, label in _LABELS.items():
        curve = _find_curve(rows, method)
        axes.loglog([row.seconds for row in curve], [row.rmse for row in curve], label=label)
        for row in curve if method == _TRACER else ():
            # Label only 1, 4, 16, ... samples, because 9 often give the same picture as 16.
            if int(row.samples).bit_count() == 1:
                axes.annotate(row.samples, (row.seconds, row.rmse), (-5, -3), **_LABEL_STYLE)
    rounding_label = "error of rounding to 8 bits"
    axes.axhline(_EIGHT_BIT_ERROR, color="#d0a080", lw=5, alpha=0.4, label=rounding_label)
    axes.set(title=title, xlabel="time", ylabel="RMSE")
    axes.minorticks_off()
    axes.tick_params(labelbottom=True)


def _find_curve(rows: Sequence[_Row], method: str) -> list[_Row]:
    """Find the points of a method's curve, in the order in which they are connected.

    `rows` are those of one scene.  If points have the same error, only the one with the most
    samples is kept.  Of POV-Ray's points, only those are kept for which no other setting is both
    faster and more accurate.
    """
    points = [row for row in rows if row.method == method]
    if method == _POVRAY:
        by_time = sorted(points, key=lambda point: point.seconds)
        best_errors = accumulate((point.rmse for point in by_time), min, initial=np.inf)
        return [
            point for point, best in zip(by_time, best_errors, strict=False) if point.rmse < best
        ]
    by_samples = sorted(points, key=lambda point: int(point.samples))
    return list({point.rmse: point for point in by_samples}.values())


def _load_scenes(quick: bool) -> dict[str, Scene]:
    """Load the scenes to measure, by the titles of their panels; with `quick`, only one."""
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    panels = [
        ("one-sphere", load_scene(SCENES / "one-sphere.xml"), 300, 300),
        ("four-spheres", load_scene(SCENES / "four-spheres.xml"), 320, 180),
        ("sticks-perspective", sticks, 320, 180),
        ("sticks-perspective", sticks, 1280, 720),
        ("1,000 small objects", build_crowd_scene(1000), 320, 180),
    ]
    return {
        f"{name}, {width}×{height}": copy_with_picture_size(scene, width, height)
        for name, scene, width, height in (panels[1:2] if quick else panels)
    }


def _measure_all_scenes(quick: bool) -> Iterator[_Row]:
    """Yield the rows of all scenes; raise ImportError if Mitsuba's LLVM variant does not work."""
    use_variant(LLVM)
    mi.set_log_level(mi.LogLevel.Error)
    scenes = _load_scenes(quick)
    for name, scene in track(scenes.items(), len(scenes), "scenes"):
        yield from measure_scene(name, scene, quick=quick)


def main() -> None:
    """Measure the times and errors of all methods, store them in a table, and draw the chart."""
    title = "Time against error: lower left is better"
    note = "\n".join(_NOTE_LINES)
    run_chart_command("speed_accuracy", _Row._fields, _measure_all_scenes, _draw_chart, title, note)
