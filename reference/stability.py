"""The stability chart: where usual methods of ray tracing fail, and where this tracer does not.

``python -m reference.stability`` writes `stability.svg` and `stability.csv` into this folder.  Each
point of the chart is a small picture of a scene that gets harder along the axis.  The picture is
compared with the exact one, which is rendered in 80-digit decimal arithmetic.  Its error is the
largest error of the radiance, or the percentage of pixels that are wrongly lit or dark.
`reference.judges.plain` renders both the exact pictures and those of the usual methods.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated as Shaped
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from reference.judges import plain
from reference.judges.arrays import Floats
from reference.measured.charts import CHART_WIDTH, plt, run_chart_command
from tracer import Camera, Phong, PointLight, Scene, Sphere, render, to_codes
from tracer.command.progress import track

Vector: TypeAlias = Floats | tuple[float, float, float]
Method: TypeAlias = Callable[[Scene], Floats]

# The smallest visible error of the radiance: half a level of an 8-bit picture near white.
_VISIBLE_ERROR = 1 / 512
# The smallest error that the chart distinguishes from none.
_MIN_ERROR = 1e-17
# Ratio between the heights at which two curves without errors are drawn, so that both are visible.
_CURVE_SPACING = 1.7
# Names and dashes of the lines eps * x and eps * x^2, for eps of float32 and of float64.
_GUIDES = {"dotted": ":", "dash-dotted": "-."}


def _build_scene(
    eye: Shaped[Vector, "3"],
    view_dir: Shaped[Vector, "3"],
    light: Shaped[Vector, "3"],
    spheres: Sequence[Sphere],
    window: tuple[float, float, float],
    pixels: int = 24,
) -> Scene:
    """Build a scene of spheres under one light.

    `window` has the distance of the camera's window from the eye, its width and its height.  The
    picture is `pixels` pixels wide, and its pixels are square.
    """
    distance, width, height = window
    camera = Camera(
        view_point=eye,
        view_dir=view_dir,
        proj_distance=distance,
        view_width=width,
        view_height=height,
    )
    return Scene(
        camera=camera,
        width=pixels,
        height=round(pixels * height / width),
        lights=[PointLight(position=light)],
        surfaces=spheres,
    )


def build_distant_sphere_scene(distance: float, width: float = 1, height: float = 1) -> Scene:
    """Build a scene in which the camera views a unit sphere from a given distance.

    The camera's window passes through the centre of the sphere.  It has the given width and height,
    and 24 pixels per unit of length.  If both are 1, it shows neither the silhouette nor a shadow.
    """
    direction = np.array([2, -3, 6]) / 7
    return _build_scene(
        eye=distance * direction,
        view_dir=-direction,
        light=(2, 0, 6),
        spheres=[Sphere()],
        window=(distance, width, height),
        pixels=round(24 * width),
    )


def build_silhouette_scene(distance: float) -> Scene:
    """Build a scene with a close-up of a unit sphere's silhouette.

    The eye is at the given distance from the silhouette.  The picture shows a strip on each side of
    the silhouette, which is 2**-20 wide.  The directions of camera rays are exact in float64.
    """
    return _build_scene(
        eye=(1, 0, distance),
        view_dir=(0, 0, -1),
        light=(8, 0, 2),
        spheres=[Sphere()],
        window=(distance, 2.0**-19, 2.0**-19),
        pixels=64,
    )


def build_moved_sphere_scene(offset_factor: float) -> Scene:
    """Build a scene of a unit sphere that is far from the origin.

    All positions are moved by (1, -0.7, 0.4) times `offset_factor`.  The eye is about 4 radii away
    from the sphere's centre.
    """
    positions = np.array([(0, 0, 0), (1, 0, 4), (1, 2, 6)])
    center, eye, light = positions + offset_factor * np.array([1, -0.7, 0.4])
    spheres = [Sphere(center=center)]
    return _build_scene(eye, (-1, 0, -4), light, spheres, window=(4, 1, 1))


def build_ground_scene(radius: float) -> Scene:
    """Build a scene whose ground is a sphere of a given radius.  The eye is at a height of 1."""
    return _build_scene(
        eye=(0, 1, 0),
        view_dir=(3, -4, 0),
        light=(2, 3, 1),
        spheres=[Sphere(center=(0, -radius, 0), radius=radius)],
        window=(1, 0.5, 0.5),
    )


def build_highlight_scene(exponent: float) -> Scene:
    """Build a scene with a highlight that fills the picture for every Phong exponent."""
    shader = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=exponent)
    window_side = 3 / max(exponent, 36.0) ** 0.5
    return _build_scene(
        eye=(3, 0, 4),
        view_dir=(-1, 0, -1),
        light=(-3, 0, 4),
        spheres=[Sphere(shader=shader)],
        window=(18**0.5, window_side, window_side),
        pixels=16,
    )


def build_ball_scene(scale: float = 1, offset: float = 0, radius: float = 128) -> Scene:
    """Build a scene of a ball that touches the ground, which is a large sphere.

    The ball has a radius of 0.5, and the ground has the given radius.  Then all lengths are
    multiplied by `scale`, and all positions are moved by `offset` along each axis.
    """
    positions = [(0, 1, 4), (4, 5, 3), (0, -radius, 0), (0, 0.5, 0)]
    eye, light, ground, ball = scale * np.array(positions) + offset
    spheres = Sphere(center=ground, radius=scale * radius), Sphere(center=ball, radius=scale * 0.5)
    window = (2 * scale, 2 * scale, 1.125 * scale)
    return _build_scene(eye, (0, 0, -1), light, spheres, window=window, pixels=128)


_FLOAT32 = partial(plain.render, arithmetic="float32")
METHODS: dict[str, Method] = {
    "this tracer": render,
    "float64, textbook": partial(plain.render, sphere_method="textbook"),
    "float64, multiplied out": partial(plain.render, sphere_method="expanded"),
    "float64, pow(n·h, e)": plain.render,
    "float32, closest approach": _FLOAT32,
    "float32, pow(n·h, e)": _FLOAT32,
    "float32, textbook": partial(_FLOAT32, sphere_method="textbook"),
    "t > 0": partial(plain.render, shadow_method="t>0"),
    "t > 1e-4": partial(plain.render, shadow_method="t>1e-4"),
    "t > 1e-6": partial(plain.render, shadow_method="t>1e-6"),
    "normal offset 1e-4": partial(plain.render, shadow_method="normal"),
    "offset of 256 ulp": partial(plain.render, shadow_method="ulps"),
}
"""Maps the name of a method to a function that renders a scene with it."""


def measure_largest_error(
    image: Shaped[Floats, "height width 3"], exact_image: Shaped[Floats, "height width 3"]
) -> float:
    """Compute the largest error of an image's radiance; a NaN counts as an error of 1."""
    return float(np.nan_to_num(np.abs(image - exact_image), nan=1.0).max())


def measure_wrong_pixels(
    image: Shaped[Floats, "height width 3"], exact_image: Shaped[Floats, "height width 3"]
) -> float:
    """Compute the percentage of pixels that are dark but should be lit, or vice versa.

    Such a pixel has a channel that is 0 in one image and above 0 in the other.
    """
    return 100 * float(((image > 0) != (exact_image > 0)).any(axis=2).mean())


@dataclass(frozen=True)
class Panel:
    """A panel of the chart: a family of scenes, and the measure of errors in their pictures."""

    title: str
    axis_label: str
    positions: Shaped[NDArray[Any], "n"]  # on the horizontal axis
    build_scene: Callable[[float], Scene]  # for a position
    # Whether an error is the largest one of the radiance, or the percentage of wrong pixels.
    measures_radiance: bool
    methods: tuple[str, ...]  # to show in addition to this tracer: keys of `METHODS`
    # Labels of the guide lines to draw: first eps * x, then eps * x^2 (see `_GUIDES`).
    guides: tuple[str, ...] = ()
    # A scene is built for each position times each of these factors.  A point of a curve shows the
    # largest error in the scenes of its position.
    position_factors: tuple[float, ...] = (1.0,)

    def measure_error(
        self,
        image: Shaped[Floats, "height width 3"],
        exact_image: Shaped[Floats, "height width 3"],
    ) -> float:
        if self.measures_radiance:
            return measure_largest_error(image, exact_image)
        return measure_wrong_pixels(image, exact_image)


_HIT_METHODS = ("float64, textbook", "float32, closest approach", "float32, textbook")
_SHADOW_METHODS = ("t > 0", "t > 1e-4", "t > 1e-6", "normal offset 1e-4", "offset of 256 ulp")
_HIGHLIGHT_METHODS = ("float64, pow(n·h, e)", "float32, pow(n·h, e)")
_OFFSET_METHODS = ("float64, multiplied out", "float32, closest approach")

# If |o - c|^2, for a ray from o and a sphere around c, is multiplied out, it has the same rounding
# error in all pixels, and none if the offset is a round number.  So several offsets are tried.
_NEARBY_FACTORS = tuple(np.sqrt([1.1, 1.2, 1.3, 1.5, 1.7]).tolist())

PANELS = (
    Panel(
        title="A sphere far away",
        axis_label="distance / radius (D)",
        positions=np.logspace(1, 8, 15),
        build_scene=build_distant_sphere_scene,
        measures_radiance=True,
        methods=_HIT_METHODS,
        guides=("ε D", "ε D²"),
    ),
    Panel(
        title="Hit or missed: within 10⁻⁶ of a silhouette",
        axis_label="distance / radius (D)",
        positions=2.0 ** np.arange(3, 26, 2),
        build_scene=build_silhouette_scene,
        measures_radiance=False,
        methods=_HIT_METHODS,
    ),
    Panel(
        title="A scene far from the origin",
        axis_label="offset / radius",
        positions=np.logspace(0, 8, 17),
        build_scene=build_moved_sphere_scene,
        measures_radiance=True,
        methods=_OFFSET_METHODS,
        guides=("ε offset", "ε offset²"),
        position_factors=_NEARBY_FACTORS,
    ),
    Panel(
        title="Lit or in shadow: far from the origin",
        axis_label="offset / radius of the ball",
        positions=2.0 ** np.arange(0, 29, 2),
        build_scene=lambda x: build_ball_scene(offset=x),
        measures_radiance=False,
        methods=_SHADOW_METHODS,
    ),
    Panel(
        title="The ground as a huge sphere",
        axis_label="radius / height of the eye",
        positions=np.logspace(1, 9, 17),
        build_scene=build_ground_scene,
        measures_radiance=True,
        methods=_HIT_METHODS,
        guides=("ε radius",),
    ),
    Panel(
        title="Lit or in shadow: on a huge ground sphere",
        axis_label="radius of the ground / radius of the ball",
        positions=2.0 ** np.arange(1, 28, 2),
        build_scene=lambda x: build_ball_scene(radius=x / 2),
        measures_radiance=False,
        methods=_SHADOW_METHODS,
    ),
    Panel(
        title="A narrow highlight",
        axis_label="Phong exponent (e)",
        positions=np.logspace(0, 8, 17),
        build_scene=build_highlight_scene,
        measures_radiance=True,
        methods=_HIGHLIGHT_METHODS,
        guides=("ε e",),
    ),
    Panel(
        title="Lit or in shadow: a scene in other units",
        axis_label="scale of the whole scene",
        positions=2.0 ** np.arange(-30, 31, 4),
        build_scene=lambda x: build_ball_scene(scale=x),
        measures_radiance=False,
        methods=_SHADOW_METHODS,
    ),
)


def measure_errors(panel: Panel, method: str, positions: Iterable[float]) -> Shaped[Floats, "n"]:
    """Measure the errors of a rendering method, a key of `METHODS`, at positions in a panel."""
    max_errors = []
    for position in positions:
        errors = []
        for factor in panel.position_factors:
            scene = panel.build_scene(factor * float(position))
            errors.append(panel.measure_error(METHODS[method](scene), _render_exactly(scene)))
        max_errors.append(max(errors))
    return np.array(max_errors)


@cache
def _render_exactly(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Render a scene in 80-digit decimal arithmetic.  Images are cached."""
    return plain.render(scene, arithmetic="decimal")


# The note above the chart, line by line.
_NOTE_LINES = (
    "Above: pictures by the usual methods; below them: the same scenes by this tracer.  Each point"
    " shows how far a picture is from",
    "that computed with 80 digits: the largest error of the radiance (at most 1), or the percentage"
    " of pixels that are wrongly lit or dark.",
)


class _Row(NamedTuple):
    """A row of the table, which is a point of a curve."""

    panel: str  # its title
    position: float
    method: str
    error: float


def _measure_all_panels(quick: bool) -> Iterator[_Row]:
    """Yield the rows of the table; with `quick`, only those of every third position."""
    for panel in track(PANELS, len(PANELS), "panels"):
        positions = panel.positions[:: 3 if quick else 1].tolist()
        for method in ("this tracer", *panel.methods):
            errors = measure_errors(panel, method, positions).tolist()
            for position, error in zip(positions, errors, strict=True):
                yield _Row(panel=panel.title, position=position, method=method, error=error)


EXAMPLES = (
    ("Acne", build_ball_scene(radius=2.0**14), "t > 0"),
    ("Lost shadows", build_ball_scene(scale=2.0**-22), "t > 1e-4"),
    ("A distant sphere in shreds", build_distant_sphere_scene(2e3, 4.0, 2.25), "float32, textbook"),
)
"""Pictures at the top of the chart, each with its title, its scene and the method that fails."""


def _parse_row(cells: Sequence[str]) -> _Row:
    """Parse the cells of a row of the CSV file."""
    panel, position, method, error = cells
    return _Row(panel=panel, position=float(position), method=method, error=float(error))


def _draw_chart(csv_rows: Sequence[Sequence[str]]) -> Any:
    """Draw the chart: example pictures, and below them two columns of panels.

    The left column contains the panels about hits and highlights.  The right column contains the
    panels about shadows, followed by the legends of both columns.
    """
    rows = [_parse_row(cells) for cells in csv_rows]
    left_panels = [panel for panel in PANELS if panel.methods != _SHADOW_METHODS]
    right_panels = [panel for panel in PANELS if panel.methods == _SHADOW_METHODS]
    subfigure_heights = 3.8, 1.9 * len(left_panels)
    figure: Any = plt.figure(figsize=(CHART_WIDTH, sum(subfigure_heights)))
    pictures_subfigure, panels_subfigure = figure.subfigures(2, 1, height_ratios=subfigure_heights)
    _draw_examples(pictures_subfigure)
    axes_grid = panels_subfigure.subplots(len(left_panels), 2)
    panels_subfigure.subplots_adjust(0.07, 0.07, 0.98, 0.96, wspace=0.2, hspace=0.8)
    left_legend_axes, right_legend_axes = axes_grid[len(right_panels) :, 1]
    _draw_column("left", left_panels, rows, axes_grid[:, 0], left_legend_axes)
    _draw_column("right", right_panels, rows, axes_grid[:, 1], right_legend_axes)
    return figure


def _draw_examples(subfigure: Any) -> None:
    """Draw `EXAMPLES`: pictures by methods that fail, and this tracer's pictures below them."""
    picture_axes = subfigure.subplots(2, len(EXAMPLES))
    subfigure.subplots_adjust(0.02, 0.03, 0.98, 0.68, wspace=0.03, hspace=0.03)
    for (title, scene, method), axes_pair in zip(EXAMPLES, picture_axes.T, strict=True):
        for axes, render_scene in zip(axes_pair, (METHODS[method], render), strict=True):
            axes.imshow(to_codes(np.nan_to_num(render_scene(scene))))
            axes.axis("off")
        axes_pair[0].set_title(f"{title}\n{method}", fontsize=9)


def _draw_column(
    side: str,
    panels: Sequence[Panel],
    rows: Sequence[_Row],
    all_axes: Any,
    legend_axes: Any,
) -> None:
    """Draw the panels of the left or right column from top to bottom, and their legend.

    `rows` are those of the whole table, and `all_axes` are at least as many as there are panels.
    """
    methods = dict.fromkeys(method for panel in panels for method in panel.methods)
    styles = dict(zip(["this tracer", *methods], plt.rcParams["axes.prop_cycle"], strict=False))
    handles: dict[str, Any] = {}
    for axes, panel in zip(all_axes, panels, strict=False):
        _draw_panel(axes, panel, [row for row in rows if row.panel == panel.title], styles)
        panel_handles, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, panel_handles, strict=True))
    legend_axes.axis("off")
    legend_title = f"In the {side} column"
    legend_axes.legend(handles.values(), handles, loc="center", title=legend_title, ncols=2)


def _draw_panel(axes: Any, panel: Panel, rows: Sequence[_Row], styles: dict[str, Any]) -> None:
    """Draw the curves and the guide lines of one panel.

    `rows` are the rows of the panel, and `styles` are the line styles of the methods.
    """
    curves = {
        method: np.array([(row.position, row.error) for row in rows if row.method == method]).T
        for method in ("this tracer", *panel.methods)
    }
    x = curves["this tracer"][0]
    scene = panel.build_scene(x[0])
    min_percentage = 25 / (scene.width * scene.height)  # a quarter of one pixel
    min_error, max_error = (_MIN_ERROR, 1.0) if panel.measures_radiance else (min_percentage, 100.0)
    # Errors of zero are drawn at a different height for each curve, so that all are visible.
    zero_height = {method: min_error / _CURVE_SPACING**index for index, method in enumerate(curves)}
    axes.set(
        title=panel.title,
        xscale="log",
        yscale="log",
        xlim=(x[0], x[-1]),
        ylim=(min(zero_height.values()) / 1.6, 1.6 * max_error),
    )
    if panel.measures_radiance:
        axes.axhspan(_VISIBLE_ERROR, 1.6, color="#fbe8dd", lw=0, zorder=0, label="visible error")
        axes.set_yticks(10.0 ** np.arange(-16, 1, 4))
    else:
        axes.set_yticks([min_error, 0.1, 1, 10, 100], ["none", "0.1 %", "1 %", "10 %", "100 %"])
    axes.minorticks_off()
    for method, (_, errors) in curves.items():
        heights = np.where(errors <= min_error, zero_height[method], np.minimum(errors, max_error))
        axes.plot(x, heights, label=method, clip_on=False, **styles[method])
    _draw_guides(axes, panel, x)


def _draw_guides(axes: Any, panel: Panel, x: Shaped[Floats, "n"]) -> None:
    """Draw the lines eps * x and eps * x^2 that a panel needs, and explain them below the axis."""
    names = [f"{dashes}: {name}" for dashes, name in zip(_GUIDES, panel.guides, strict=False)]
    axes.set(xlabel=";   ".join([panel.axis_label, *names]))
    for power, dashes in enumerate(_GUIDES.values(), 1):
        if power <= len(panel.guides):
            style = {"color": "#888888", "marker": "", "lw": 1, "ls": dashes}
            axes.plot(x, np.outer(x**power, (2.0**-24, 2.0**-53)), **style)


def main() -> None:
    """Measure the errors of all rendering methods, store them in a table, and draw the chart."""
    note = "\n".join(_NOTE_LINES)
    title = "Where the usual methods of ray tracing fail"
    run_chart_command("stability", _Row._fields, _measure_all_panels, _draw_chart, title, note)
