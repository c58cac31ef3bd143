"""The speed-accuracy chart: how much time each renderer takes to reach a certain error.

``python -m reference.speed_accuracy`` writes `speed_accuracy.svg`, and `speed_accuracy.csv` with
its table, into this folder.  The error is the root mean square error of the linear radiance,
compared with a certified picture (`reference.judges.certificate`).  From point to point, the number
of samples per pixel is multiplied by 4, and the permitted error of the certified tracer is divided
by 4.  All methods are timed alternately.  The curve of a method ends when its next picture would
take too long, or when its error comes close to that of the certified picture.
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
from reference.measured.workloads import copy_with_picture_size, crowd
from tracer import Scene, load_scene, render
from tracer.command.progress import track

_TRACER, _CERTIFIED_TRACER, _POVRAY = "this tracer", "this tracer, certified", "POV-Ray adaptive"
_GRID, _ALL_PAIRS, _MITSUBA = "uniform grid", "float32, all pairs", "Mitsuba multijitter"
_METHODS = (_TRACER, _GRID, _ALL_PAIRS, _POVRAY, _CERTIFIED_TRACER, _MITSUBA)

# Thresholds and depths of POV-Ray's adaptive supersampling, from coarse to fine.
_POVRAY_SETTINGS = ((0.3, 2), (0.1, 3), (0.03, 4), (0.03, 5), (0.03, 6), (0.01, 7))

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

# Titles of the table's columns.  For the certified tracer, `samples` is the reciprocal of the
# permitted error.  `seconds`, `low` and `high` are the median, the minimum and the maximum.
_COLUMNS = ("scene", "method", "samples", "rmse", "seconds", "low", "high")


def _render_by_brute_force(scene: Scene, samples_per_side: int) -> Floats:
    """Render a scene as simple NumPy tracers do: test every ray against every object, in float32.

    Parameters
    ----------
    scene : Scene
        The scene.
    samples_per_side : int
        Number of samples along each side of a pixel.

    Returns
    -------
    image : (height, width, 3) float array
        Mean linear RGB radiance of the samples in each pixel.
    """
    offsets = ((np.arange(samples_per_side) + 0.5) / samples_per_side - 0.5).tolist()
    render_at_offset = partial(plain.render, scene, arithmetic="float32")
    images = map(render_at_offset, product(offsets, offsets))
    return np.asarray(sum(images)) / samples_per_side**2


def _make_rendering_tasks(scene: Scene, level: int) -> dict[tuple[str, int], Callable[[], Any]]:
    """Make the functions to be timed, for all rendering methods except POV-Ray.

    Parameters
    ----------
    scene : Scene
        The scene.
    level : int
        Level of sampling.  Each level has 4 times the samples of the one before.

    Returns
    -------
    tasks : dict of (str, int) to callable
        Functions that return an image (height, width, 3), by method and factor.  An image has
        factor * 4**level samples per pixel; the certified tracer instead permits an error of
        1 / (factor * 4**level).
    """
    gc.collect()  # Mitsuba's kernels depend on all live objects, so keep only one scene loaded
    mitsuba_xml = convert(scene, "exact", 4**level).replace('"stratified"', '"multijitter"')
    loaded_scene = mi.load_string(mitsuba_xml)
    return {
        (_TRACER, 1): partial(render, scene, 4**level),
        # Sample counts between the powers of four: 9, 36, 144, ...
        (_TRACER, 9): partial(render, scene, 9 * 4**level),
        (_CERTIFIED_TRACER, 8): lambda: certify(scene, 1 / (8 * 4**level)).image,
        (_GRID, 1): partial(render_supersampled, scene, 2**level),
        (_ALL_PAIRS, 1): partial(_render_by_brute_force, scene, 2**level),
        (_MITSUBA, 1): lambda: np.array(mi.render(loaded_scene)),
    }


def measure_scene(name: str, scene: Scene, *, quick: bool) -> Iterator[tuple[object, ...]]:
    """Time all rendering methods on one scene, and measure their errors.

    Parameters
    ----------
    name : str
        Name of the scene in the table.
    scene : Scene
        The scene.
    quick : bool
        Whether to measure fewer points, against a less accurate reference picture.

    Yields
    ------
    row : tuple
        A row of the table: the scene, the method, the number of samples per pixel, the root mean
        square error, and the median, minimum and maximum of the time in seconds.
    """
    permitted_error = _REFERENCE_ERROR * (16 if quick else 1)
    reference_image = certify(scene, permitted_error).image
    # Errors smaller than the error of a coarser reference are too uncertain to be shown.
    less_accurate_image = certify(scene, 4 * permitted_error).image
    min_error = compute_rms_error(less_accurate_image, reference_image)
    povray_picture = build_path("povray.ppm")
    finished_tasks: set[tuple[str, int]] = set() if povray.is_installed() else {(_POVRAY, 1)}
    for level, (threshold, depth) in enumerate(_POVRAY_SETTINGS[: 3 if quick else None]):
        tasks = _make_rendering_tasks(scene, level)
        quality_options = ("+AM2", f"+A{threshold}", f"+R{depth}", "-J")
        command = povray.prepare_linear_command(scene, povray_picture, *quality_options)
        # The time that POV-Ray reports does not include its start.
        tasks[_POVRAY, 1] = partial(povray.render_and_time, command)
        tasks = {key: task for key, task in tasks.items() if key not in finished_tasks}
        for (method, factor), timing in time_alternately(tasks, _MIN_ROUNDS).items():
            result = tasks[method, factor]()
            image = povray.read_linear_picture(povray_picture) if method == _POVRAY else result
            error = compute_rms_error(image, reference_image)
            if error > min_error:
                yield (name, method, factor * 4**level, error, *timing)
            if timing.median > _MAX_SECONDS or error <= min_error:
                finished_tasks.add((method, factor))
        tasks.clear()  # delete Mitsuba's scene before the next one is loaded


def _draw_chart(rows: Sequence[Sequence[str]]) -> Any:
    """Draw a panel for each scene, in two columns, and a legend after the last panel.

    Parameters
    ----------
    rows : sequence of sequences of str
        The rows of the table: scene, method, samples per pixel, error, and the median, minimum and
        maximum time in seconds.

    Returns
    -------
    figure : Figure
        The chart.
    """
    figure, axes_grid = plt.subplots(3, 2, figsize=(CHART_WIDTH, 8.2), sharex=True, sharey=True)
    panels = axes_grid.ravel()
    for axes, title in zip(panels, dict.fromkeys(row[0] for row in rows), strict=False):
        for method in _METHODS:
            points = [tuple(map(float, row[2:5])) for row in rows if row[:2] == [title, method]]
            # If points have the same error, only the one with the most samples is drawn.
            curve = {error: (seconds, samples) for samples, error, seconds in sorted(points)}
            axes.loglog([seconds for seconds, _ in curve.values()], curve.keys(), label=method)
            for error, (seconds, samples) in curve.items():
                # Label only 1, 4, 16, ... samples, because 9 often give the same picture as 16.
                if method == _TRACER and int(samples).bit_count() == 1:
                    axes.annotate(f"{samples:g}", (seconds, error), (-5, -3), **_LABEL_STYLE)
        rounding_label = "error of rounding to 8 bits"
        axes.axhline(_EIGHT_BIT_ERROR, color="#d0a080", lw=5, alpha=0.4, label=rounding_label)
        axes.set(title=title, xlabel="time", ylabel="RMSE")
        axes.minorticks_off()
        axes.tick_params(labelbottom=True)
    panels[0].xaxis.set_major_formatter(lambda x, _: f"{x:g} s" if x >= 1 else f"{1e3 * x:g} ms")
    panels[-1].axis("off")
    panels[-1].legend(*panels[0].get_legend_handles_labels(), loc="center", fontsize=10)
    figure.subplots_adjust(0.08, 0.09, 0.98, 0.84, hspace=0.5, wspace=0.16)
    return figure


def _load_scenes(quick: bool) -> dict[str, Scene]:
    """Load the scenes to measure, in the order of the chart's panels.

    Parameters
    ----------
    quick : bool
        Whether to load only one scene.

    Returns
    -------
    scenes : dict of str to Scene
        The scenes, by the titles of their panels.
    """
    sticks = load_scene(SCENES / "sticks-perspective.xml")
    panels = [
        ("one-sphere", load_scene(SCENES / "one-sphere.xml"), 300, 300),
        ("four-spheres", load_scene(SCENES / "four-spheres.xml"), 320, 180),
        ("sticks-perspective", sticks, 320, 180),
        ("sticks-perspective", sticks, 1280, 720),
        ("1,000 small objects", crowd(1000), 320, 180),
    ]
    return {
        f"{name}, {width}×{height}": copy_with_picture_size(scene, width, height)
        for name, scene, width, height in (panels[1:2] if quick else panels)
    }


def _measure_all_scenes(quick: bool) -> Iterator[tuple[object, ...]]:
    """Measure the times and errors of all methods on all scenes.

    Parameters
    ----------
    quick : bool
        Whether to measure fewer points, on one scene only.

    Yields
    ------
    row : tuple
        A row of the table: scene, method, samples per pixel, error and times; see `measure_scene`.
    """
    use_variant(LLVM)
    mi.set_log_level(mi.LogLevel.Error)
    scenes = _load_scenes(quick)
    for name, scene in track(scenes.items(), len(scenes), "scenes"):
        yield from measure_scene(name, scene, quick=quick)


def main() -> None:
    """Measure the times and errors of all methods, store them in a table, and draw the chart."""
    note = (
        "Time of rendering alone, and root mean square error of the linear radiance compared with a"
        " certified picture.  Each point is\na picture with 1, 4, 16, ... samples per pixel; this"
        " tracer also has points with 9, 36, ... samples.  Its curve has steps, because it\ndivides"
        " pixels into quarters.  POV-Ray uses decreasing thresholds, and the certified tracer"
        " permits errors of 1/8, 1/32, ... in every pixel."
    )
    title = "Time against error: lower left is better"
    run_chart_command("speed_accuracy", _COLUMNS, _measure_all_scenes, _draw_chart, title, note)
