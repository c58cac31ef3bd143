"""The stability chart: where each method fails, and that this tracer does not.

``python -m reference.stability`` writes `stability.svg` and `.csv` into this folder.  A point is a
small picture of a scene that gets harder along the axis, held against arithmetic of 80 digits by
`reference.judges.plain`, which draws the methods that fail, too: by the largest error of the
radiance, or by the share of pixels that are decided wrongly.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from reference.figures import Floats
from reference.judges import plain
from reference.measured.charts import WIDTH, make_chart, plt
from tracer import Camera, Phong, PointLight, Scene, Sphere, render, to_codes

Vector: TypeAlias = Floats | tuple[float, float, float]
Method: TypeAlias = Callable[[Scene], Floats]

# Half a level of an 8-bit picture near white, where errors begin to be seen; smaller errors than
# the second are drawn as that.
_VISIBLE, _DIGITS = 1 / 512, 1e-17
# How far apart curves are that find nothing wrong.
_STEP = 1.7


def _scene(
    eye: Vector, ahead: Vector, light: Vector, *spheres: Sphere, view: Vector, pixels: int = 24
) -> Scene:
    """Spheres under one light; `view`: the window's distance, width and height."""
    distance, width, height = view
    camera = Camera(
        view_point=eye, view_dir=ahead, proj_distance=distance, view_width=width, view_height=height
    )
    size = {"width": pixels, "height": round(pixels * height / width)}
    return Scene(camera=camera, lights=[PointLight(position=light)], surfaces=spheres, **size)


def distant(distance: float, width: float = 1, height: float = 1) -> Scene:
    """A unit sphere, `distance` radii away; no silhouette and no shadow in so narrow a view."""
    way, view = np.array([2, -3, 6]) / 7, (distance, width, height)
    return _scene(distance * way, -way, (2, 0, 6), Sphere(), view=view, pixels=round(24 * width))


def silhouette(distance: float) -> Scene:
    """A millionth of a radius on both sides of a silhouette; float64 holds the rays exactly."""
    view = (distance, 2.0**-19, 2.0**-19)
    return _scene((1, 0, distance), (0, 0, -1), (8, 0, 2), Sphere(), view=view, pixels=64)


def moved(offset: float) -> Scene:
    """The sphere of `distant`, 4 radii away, with the whole scene moved."""
    places = np.array([(0, 0, 0), (1, 0, 4), (1, 2, 6)])
    center, eye, light = places + offset * np.array([1, -0.7, 0.4])
    return _scene(eye, (-1, 0, -4), light, Sphere(center=center), view=(4, 1, 1))


def ground(radius: float) -> Scene:
    """The ground as a huge sphere, the eye 1 above it."""
    sphere = Sphere(center=(0, -radius, 0), radius=radius)
    return _scene((0, 1, 0), (3, -4, 0), (2, 3, 1), sphere, view=(1, 0.5, 0.5))


def shiny(exponent: float) -> Scene:
    """A highlight that fills the picture, whatever its exponent."""
    gloss = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=exponent)
    size = 3 / max(exponent, 36.0) ** 0.5
    view = (18**0.5, size, size)
    return _scene((3, 0, 4), (-1, 0, -1), (-3, 0, 4), Sphere(shader=gloss), view=view, pixels=16)


def ball_on_ground(scale: float = 1, offset: float = 0, radius: float = 128) -> Scene:
    """A ball that touches a ground sphere; with powers of two every number is exact."""
    places = [(0, 1, 4), (4, 5, 3), (0, -radius, 0), (0, 0.5, 0)]
    eye, light, below, above = scale * np.array(places) + offset
    ground = Sphere(center=below, radius=scale * radius)
    ball = Sphere(center=above, radius=scale * 0.5)
    view = (2 * scale, 2 * scale, 1.125 * scale)
    return _scene(eye, (0, 0, -1), light, ground, ball, view=view, pixels=128)


_FLOAT32 = partial(plain.render, arithmetic="float32")
METHODS: dict[str, Method] = {
    "this tracer": render,
    "float64, textbook": partial(plain.render, spheres="textbook"),
    "float64, multiplied out": partial(plain.render, spheres="expanded"),
    "float64, pow(n·h, e)": plain.render,
    "float32, closest approach": _FLOAT32,
    "float32, pow(n·h, e)": _FLOAT32,
    "float32, textbook": partial(_FLOAT32, spheres="textbook"),
    "t > 0": partial(plain.render, shadows="t>0"),
    "t > 1e-4": partial(plain.render, shadows="t>1e-4"),
    "t > 1e-6": partial(plain.render, shadows="t>1e-6"),
    "normal offset 1e-4": partial(plain.render, shadows="normal"),
    "offset of 256 ulp": partial(plain.render, shadows="ulps"),
}


def largest_error(image: Floats, exact: Floats) -> float:
    """Largest error of the radiance (NaN counts as 1)."""
    return float(np.nan_to_num(np.abs(image - exact), nan=1.0).max())


def wrong_share(image: Floats, exact: Floats) -> float:
    """Per cent of the pixels that are dark but should not be, or the reverse."""
    return 100 * float(((image > 0) != (exact > 0)).any(axis=2).mean())


@dataclass(frozen=True)
class Panel:
    """One family of scenes and how pictures of them are judged."""

    title: str
    axis: str
    at: NDArray[Any]
    scene: Callable[[float], Scene]
    judge: Callable[[Floats, Floats], float]
    methods: tuple[str, ...]
    guides: tuple[str, ...] = ()
    """Names of lines of ε, of float32 and of float64, times x; then times its square."""
    nearby: tuple[float, ...] = (1.0,)
    """A point shows the worst of the scenes at these multiples of its place on the axis."""


_HITS = ("float64, textbook", "float32, closest approach", "float32, textbook")
_SHADOWS = ("t > 0", "t > 1e-4", "t > 1e-6", "normal offset 1e-4", "offset of 256 ulp")
_SHINY = ("float64, pow(n·h, e)", "float32, pow(n·h, e)")
_MOVED = ("float64, multiplied out", "float32, closest approach")

# Multiplied out, |o - c|^2 is rounded once for all pixels, and not at all where the offset is a
# round number: so several are tried.
_NEARBY = tuple(np.sqrt([1.1, 1.2, 1.3, 1.5, 1.7]).tolist())

# fmt: off
PANELS = (
    Panel("A sphere far away", "distance / radius (D)", np.logspace(1, 8, 15), distant,
          largest_error, _HITS, ("ε D", "ε D²")),
    Panel("Hit or missed: within 10⁻⁶ of a silhouette", "distance / radius (D)",
          np.logspace(3, 25, 12, base=2), silhouette, wrong_share, _HITS),
    Panel("A scene far from the origin", "offset / radius", np.logspace(0, 8, 17), moved,
          largest_error, _MOVED, ("ε offset", "ε offset²"), _NEARBY),
    Panel("Lit or in shadow: far from the origin", "offset / radius of the ball",
          np.logspace(0, 28, 15, base=2), lambda x: ball_on_ground(offset=x),
          wrong_share, _SHADOWS),
    Panel("The ground as a huge sphere", "radius / height of the eye", np.logspace(1, 9, 17),
          ground, largest_error, _HITS, ("ε radius: rounding the scene itself",)),
    Panel("Lit or in shadow: on a huge ground sphere", "radius of the ground / radius of the ball",
          np.logspace(1, 27, 14, base=2), lambda x: ball_on_ground(radius=x / 2),
          wrong_share, _SHADOWS),
    Panel("A narrow highlight", "Phong exponent (e)", np.logspace(0, 8, 17), shiny,
          largest_error, _SHINY, ("ε e",)),
    Panel("Lit or in shadow: a scene in other units", "scale of the whole scene",
          np.logspace(-30, 30, 16, base=2), lambda x: ball_on_ground(scale=x),
          wrong_share, _SHADOWS),
)
# fmt: on


def measure(panel: Panel, name: str, at: Iterable[float]) -> Floats:
    """The judge's verdict on a method, at each place of a panel's axis."""
    draw, found = METHODS[name], list[float]()
    for x in at:
        scenes = [panel.scene(near * float(x)) for near in panel.nearby]
        found.append(max(panel.judge(draw(scene), _exact(scene)) for scene in scenes))
    return np.array(found)


@cache
def _exact(scene: Scene) -> Floats:
    return plain.render(scene, arithmetic="decimal")


def _measure_all(quick: bool) -> Iterator[tuple[object, ...]]:
    """Rows of the table."""
    for panel in tqdm(PANELS, disable=None):
        at = panel.at[:: 3 if quick else 1].tolist()
        for name in ("this tracer", *panel.methods):
            for x, value in zip(at, measure(panel, name, at).tolist(), strict=True):
                yield panel.title, x, name, value


# What goes wrong, in which scene, by which method.
STRIP = (
    ("Acne", ball_on_ground(radius=2.0**14), "t > 0"),
    ("Lost shadows", ball_on_ground(scale=2.0**-22), "t > 1e-4"),
    ("A far sphere in shreds", distant(2000.0, 4.0, 2.25), "float32, textbook"),
)


def _draw(rows: Sequence[Sequence[str]], _quick: bool) -> Any:
    """A strip of pictures and all panels, of the rows of the table; one below the other."""
    figure = plt.figure(figsize=(WIDTH, 40))
    parts: Any = figure.subfigures(2, 1, height_ratios=(1, 9))
    pictures = parts[0].subplots(2, len(STRIP))
    parts[0].subplots_adjust(left=0.03, right=0.97, top=0.66, bottom=0.0, wspace=0.06, hspace=0.0)
    for (title, scene, method), (above, below) in zip(STRIP, pictures.T, strict=True):
        for axes, draw in ((above, METHODS[method]), (below, render)):
            axes.imshow(to_codes(np.nan_to_num(draw(scene))))
            axes.axis("off")
        above.set_title(f"{title}\n{method}", fontsize=8)
    grid = parts[1].subplots(len(PANELS), 1)
    parts[1].subplots_adjust(left=0.13, right=0.95, top=0.98, bottom=0.055, hspace=1.05)
    for axes, panel in zip(grid, PANELS, strict=True):
        _panel(axes, panel, [row[1:] for row in rows if row[0] == panel.title])
    return figure


def _panel(axes: Any, panel: Panel, rows: Sequence[Sequence[str]]) -> None:
    """Draw the curves of a panel, of its rows: where on the axis, the method, the verdict."""
    names = ("this tracer", *panel.methods)
    curves = {name: np.array([r[::2] for r in rows if r[1] == name], float).T for name in names}
    error, at = panel.judge is largest_error, curves["this tracer"][0]
    scene = panel.scene(at[0])
    floor, top = (_DIGITS, 1.0) if error else (25 / (scene.width * scene.height), 100.0)
    # Curves at none lie below one another.
    none = {name: floor / _STEP**k for k, name in enumerate(curves)}
    limits = {"xlim": (at[0], at[-1]), "ylim": (min(none.values()) / 1.6, 1.6 * top)}
    axes.set(title=panel.title, xlabel=panel.axis, xscale="log", yscale="log", **limits)
    if error:
        look = {"color": "#fbe8dd", "lw": 0, "zorder": 0}
        axes.axhspan(_VISIBLE, 1.6, **look, label="visible in the picture")
        axes.set_yticks(10.0 ** np.arange(-16, 1, 4))
    else:
        axes.set_yticks([floor, 0.1, 1, 10, 100], ["none", "0.1 %", "1 %", "10 %", "100 %"])
    axes.minorticks_off()
    for name, (_, values) in curves.items():
        shown = np.where(values <= floor, none[name], np.minimum(values, top))
        axes.plot(at, shown, label=name, clip_on=False)
    for power, name in enumerate(panel.guides, 1):
        look = {"color": "#888888", "marker": "", "lw": 1, "ls": ":" if power == 1 else "-."}
        axes.plot(at, np.outer(at**power, (2.0**-24, 2.0**-53)), **look, label=[name, None])
    axes.legend(loc="upper center", bbox_to_anchor=(0.46, -0.3), fontsize=8, ncols=2)


def main() -> None:
    """Measure, and draw the chart."""
    columns = ("panel", "at", "method", "value")
    note = (
        "Above: as a usual method draws a scene; below it: as this tracer does.\n"
        "Each point is a picture held against arithmetic of 80 digits: the largest\n"
        "error of the radiance, no more than 1, or the share of wrong pixels."
    )
    texts = ("Where ray tracers fail, and how far", note)
    make_chart("stability", __doc__, columns, _measure_all, _draw, texts)
