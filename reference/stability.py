"""The stability chart: where each method fails, and that this tracer does not.

    python -m reference.stability [--quick | --redraw]

writes `stability.svg`, `.png` and `.csv` into this folder.  Every point is a
small picture of a scene that gets harder along the axis, compared with the same
picture in 50-digit decimals.  The left column shows the largest error of the
radiance, the right one the share of pixels that are decided wrongly: hit or
missed, lit or in shadow.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import converters.plugins  # noqa: F401 (registers the light without fall-off)
from converters.variant import LLVM, SCALAR, mi, use
from reference import alternatives
from reference.alternatives import closest_approach, exactly, expanded, float32, float64, textbook
from reference.charts import (
    HALO,
    LOOKS,
    End,
    headline,
    label_ends,
    label_losses,
    plt,
    save,
)
from reference.command import need_table, parser, result, run
from reference.tables import measured_on, read_csv, write_csv
from tracer import Camera, Phong, PointLight, Scene, Sphere, Surfaces, render
from tracer.arrays import Floats, Vector

__all__ = ["PANELS", "Panel", "measure", "methods_of"]

Method: TypeAlias = Callable[[Scene], Floats]

# Half a level of an 8-bit picture near white: where errors begin to be seen.
_VISIBLE = 1 / 512
# Smaller errors are drawn as this one; a curve ends where errors stay above the second.
_DIGITS = 1e-17
_LOST = 0.3
# Points above a panel for the names of curves that end there.
_ROOM = 48


# --- Scenes that get harder ------------------------------------------------------------


def _scene(camera: Camera, size: tuple[int, int], light: Vector, *spheres: Sphere) -> Scene:
    """Spheres under one light."""
    return Scene(
        camera=camera,
        width=size[0],
        height=size[1],
        lights=(PointLight(position=light),),
        surfaces=Surfaces.of(spheres),
    )


def distant(distance: float) -> Scene:
    """A unit sphere, `distance` radii away; no silhouette and no shadow in view."""
    x, y, z = 2 / 7, -3 / 7, 6 / 7
    camera = Camera(
        view_point=(distance * x, distance * y, distance * z),
        view_dir=(-x, -y, -z),
        proj_distance=distance,
    )
    return _scene(camera, (24, 24), (2.0, 0.0, 6.0), Sphere())


def limb(distance: float) -> Scene:
    """A millionth of a radius on both sides of a sphere's limb; float64 holds the rays exactly."""
    camera = Camera(
        view_point=(1.0, 0.0, distance),
        proj_distance=distance,
        view_width=2.0**-19,
        view_height=2.0**-19,
    )
    return _scene(camera, (64, 64), (8.0, 0.0, 2.0), Sphere())


def moved(offset: float) -> Scene:
    """The sphere of `distant`, 4 radii away, with the whole scene moved."""

    def at(x: float, y: float, z: float) -> Vector:
        return (offset + x, y - 0.7 * offset, z + 0.4 * offset)

    camera = Camera(view_point=at(1, 0, 4), view_dir=(-1.0, 0.0, -4.0), proj_distance=4.0)
    return _scene(camera, (24, 24), at(1, 2, 6), Sphere(center=at(0, 0, 0)))


def ground(radius: float) -> Scene:
    """The ground as a huge sphere, the eye 1 above it."""
    camera = Camera(
        view_point=(0.0, 1.0, 0.0), view_dir=(3.0, -4.0, 0.0), view_width=0.5, view_height=0.5
    )
    sphere = Sphere(center=(0.0, -radius, 0.0), radius=radius)
    return _scene(camera, (24, 24), (2.0, 3.0, 1.0), sphere)


def shiny(exponent: float) -> Scene:
    """A highlight that fills the picture, whatever its exponent."""
    size = 3 / np.sqrt(max(exponent, 36.0))
    camera = Camera(
        view_point=(3.0, 0.0, 4.0),
        view_dir=(-3.0, 0.0, -3.0),
        proj_distance=float(np.sqrt(18)),
        view_width=size,
        view_height=size,
    )
    gloss = Phong(diffuse=(0.0, 0.0, 0.0), specular=(1.0, 1.0, 1.0), exponent=exponent)
    return _scene(camera, (16, 16), (-3.0, 0.0, 4.0), Sphere(shader=gloss))


def ball_on_ground(scale: float = 1.0, offset: float = 0.0, radius: float = 128.0) -> Scene:
    """A ball that touches a ground sphere; with powers of two every number is exact."""

    def at(x: float, y: float, z: float) -> Vector:
        return (scale * x + offset, scale * y + offset, scale * z + offset)

    camera = Camera(
        view_point=at(0, 1, 4),
        proj_distance=2 * scale,
        view_width=2 * scale,
        view_height=1.125 * scale,
    )
    ground = Sphere(center=at(0, -radius, 0), radius=scale * radius)
    ball = Sphere(center=at(0, 0.5, 0), radius=scale * 0.5)
    return _scene(camera, (128, 72), at(4, 5, 3), ground, ball)


# --- What is measured ------------------------------------------------------------------


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
    at: NDArray[np.floating[Any]]
    scene: Callable[[float], Scene]
    judge: Callable[[Floats, Floats], float]
    methods: tuple[str, ...]
    guides: tuple[tuple[str, int, str], ...] = ()
    nearby: tuple[float, ...] = (1.0,)
    """A point shows the worst of the scenes at these multiples of its place on the axis."""


_HITS = ("float64, textbook", "float32, closest approach", "float32, textbook")
_MITSUBA = ("Mitsuba scalar", "Mitsuba LLVM")
_STARTS = tuple(alternatives.SHADOW_STARTS)

PANELS = (
    Panel(
        "A sphere far away",
        "distance / radius (D)",
        10.0 ** np.arange(1, 8.1, 0.5),
        distant,
        largest_error,
        (*_HITS, *_MITSUBA),
        (("εD", 1, "below"), ("εD²", 2, "below")),
    ),
    Panel(
        "Hit or missed: within 10⁻⁶ of the limb",
        "distance / radius (D)",
        2.0 ** np.arange(3, 27, 2),
        limb,
        wrong_share,
        _HITS,
    ),
    Panel(
        "A scene far from the origin",
        "offset / radius",
        10.0 ** np.arange(0, 8.1, 0.5),
        moved,
        largest_error,
        ("float64, multiplied out", "float32, closest approach", *_MITSUBA),
        (("ε · offset", 1, "above"), ("ε · offset²", 2, "above")),
        # Multiplied out, |o - c|^2 is rounded once for all pixels, and not at all where the offset
        # is a round number: so several are tried.
        nearby=tuple(np.sqrt([1.1, 1.2, 1.3, 1.5, 1.7]).tolist()),
    ),
    Panel(
        "Lit or in shadow: far from the origin",
        "offset / radius of the ball",
        2.0 ** np.arange(0, 29, 2),
        lambda x: ball_on_ground(offset=x),
        wrong_share,
        (*_STARTS, *_MITSUBA),
    ),
    Panel(
        "The ground as a huge sphere",
        "radius / height of the eye",
        10.0 ** np.arange(1, 9.1, 0.5),
        ground,
        largest_error,
        (*_HITS, *_MITSUBA),
        (("ε · radius", 1, "above"),),
    ),
    Panel(
        "Lit or in shadow: on a huge ground sphere",
        "radius of the ground / radius of the ball",
        2.0 ** np.arange(1, 29, 2),
        lambda x: ball_on_ground(radius=x / 2),
        wrong_share,
        (*_STARTS, *_MITSUBA),
    ),
    Panel(
        "A narrow highlight",
        "Phong exponent (e)",
        10.0 ** np.arange(0, 8.1, 0.5),
        shiny,
        largest_error,
        ("float64, pow(n·h, e)", "float32, pow(n·h, e)"),
        (("εe", 1, "below"),),
    ),
    Panel(
        "Lit or in shadow: a scene in other units",
        "scale of the whole scene",
        2.0 ** np.arange(-30, 31, 4),
        lambda x: ball_on_ground(scale=x),
        wrong_share,
        (*_STARTS, *_MITSUBA),
    ),
)


def mitsuba_render(scene: Scene, variant: str) -> Floats:
    """Mitsuba's own sensor, shapes, material and shadow rays; a light without fall-off.

    For scenes of white Lambertian spheres under one light, seen through square pixels.
    """
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    camera, light = scene.camera, scene.lights[0]
    w = -np.array(camera.view_dir) / np.linalg.norm(camera.view_dir)
    u = np.cross(camera.view_up, w)
    u /= np.linalg.norm(u)
    to_world = np.eye(4)
    to_world[:3] = np.column_stack([-u, np.cross(w, u), -w, camera.view_point])
    film = {
        "type": "hdrfilm",
        "width": scene.width,
        "height": scene.height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    loaded = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f(to_world.tolist()),
                "fov": float(
                    np.degrees(2 * np.arctan(camera.view_width / 2 / camera.proj_distance))
                ),
                "near_clip": camera.proj_distance * 1e-2,
                "far_clip": camera.proj_distance * 1e4,
                "film": film,
                "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
            },
            "light": {
                "type": "unattenuated_point",
                "position": list(light.position),
                "intensity": [float(np.pi)] * 3,
            },
            "white": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
            **{
                f"sphere{k}": {
                    "type": "sphere",
                    "center": sphere.center,
                    "radius": sphere.radius,
                    "bsdf": {"type": "ref", "id": "white"},
                }
                for k, sphere in enumerate(scene.surfaces)
                if isinstance(sphere, Sphere)
            },
        }
    )
    return np.array(mi.render(loaded), dtype=np.float64)


def methods_of() -> dict[str, Method]:
    """Every method that this machine can run, by the name the chart gives it."""
    draw = alternatives.render
    variants = {SCALAR, use().variant}
    return {
        "this tracer": render,
        "float64, textbook": partial(draw, arithmetic=float64, roots=textbook),
        "float64, multiplied out": partial(draw, arithmetic=float64, roots=expanded),
        "float32, closest approach": partial(draw, arithmetic=float32, roots=closest_approach),
        "float32, textbook": partial(draw, arithmetic=float32, roots=textbook),
        "float64, pow(n·h, e)": partial(draw, arithmetic=float64),
        "float32, pow(n·h, e)": partial(draw, arithmetic=float32),
        **{
            name: partial(draw, arithmetic=float64, shadow_start=start)
            for name, start in alternatives.SHADOW_STARTS.items()
        },
        **{
            name: partial(mitsuba_render, variant=variant)
            for name, variant in zip(_MITSUBA, (SCALAR, LLVM), strict=True)
            if variant in variants
        },
    }


_LOOK_OF = {
    "this tracer": "tracer",
    "float64, textbook": "a",
    "float64, multiplied out": "a",
    "float64, pow(n·h, e)": "a",
    "float32, closest approach": "b",
    "float32, pow(n·h, e)": "b",
    "float32, textbook": "c",
    "t > 0": "a",
    "t > 1e-4": "b",
    "t > 1e-6": "c",
    "normal offset 1e-4": "d",
    "offset of 256 ulp": "e",
    "Mitsuba scalar": "f",
    "Mitsuba LLVM": "g",
}


def measure(panel: Panel, methods: dict[str, Method], at: Iterable[float]) -> dict[str, Floats]:
    """The judge's verdict on every method of a panel, at each place of the axis."""
    names = ["this tracer", *(name for name in panel.methods if name in methods)]
    found: dict[str, list[float]] = {name: [] for name in names}
    for x in at:
        verdicts: dict[str, list[float]] = {name: [] for name in names}
        for near in panel.nearby:
            scene = panel.scene(near * float(x))
            exact = alternatives.render(scene, exactly)
            for name in names:
                verdicts[name].append(panel.judge(methods[name](scene), exact))
        for name in names:
            found[name].append(max(verdicts[name]))
    return {name: np.array(values) for name, values in found.items()}


# --- The chart -------------------------------------------------------------------------


def _draw(axes: Any, panel: Panel, at: NDArray[np.floating[Any]], found: dict[str, Floats]) -> None:
    error = panel.judge is largest_error
    first = panel.scene(float(at[0]))
    floor = _DIGITS if error else 25.0 / (first.width * first.height)
    top = 1.0 if error else 100.0
    axes.set(
        xlabel=panel.axis,
        xscale="log",
        yscale="log",
        xlim=(at[0], at[-1]),
        ylim=(floor / 1.6, 1.6 * top),
    )
    axes.set_title(panel.title, pad=_ROOM if error else 10)
    if error:
        axes.axhspan(_VISIBLE, 1.6, color="#fbe8dd", lw=0, zorder=0)
        # In an SVG, ordinary spaces at the beginning do not count.
        label = "\u00a0\u00a0visible in the picture"
        axes.text(
            at[0], _VISIBLE, label, va="bottom", color="#a04000", fontsize=8.5, style="italic"
        )
        axes.set_yticks(10.0 ** np.arange(-16, 1, 4))
    else:
        # Nothing is named above these, so they may be taller.
        box, more = axes.get_position(), (_ROOM - 10) / 72 / axes.figure.get_figheight()
        axes.set_position((box.x0, box.y0, box.width, box.height + more))
        axes.set_yticks([floor, 0.1, 1, 10, 100], ["none", "0.1 %", "1 %", "10 %", "100 %"])
    axes.minorticks_off()
    for name, power, side in panel.guides:
        for eps in (2.0**-24, 2.0**-53):
            axes.plot(at, eps * at**power, color="#888888", lw=1, ls=(0, (1, 2.5)), zorder=1)
        k = len(at) // 3 if power == 2 else len(at) - 2
        away = (3, -13) if side == "below" else (-3, 5)
        axes.annotate(
            name, (at[k], eps * at[k] ** power), xytext=away, textcoords="offset points",
            ha="left" if side == "below" else "right", color="#555555", fontsize=9,
            path_effects=HALO, zorder=7,
        )  # fmt: skip
    ends: list[End] = []
    lost: list[End] = []
    for name, values in found.items():
        look = LOOKS[_LOOK_OF[name]]
        shown = np.clip(values, floor, top)
        kept = len(at) - int(np.argmax(shown[::-1] < _LOST)) if error else len(at)
        dies = kept < len(at) or (error and shown[-1] >= _LOST)
        last = min(kept, len(at) - 1)
        axes.plot(at[: last + 1], shown[: last + 1], **look, clip_on=False)
        end = (float(at[last]), float(shown[last]), name, look["color"])
        (lost if dies else ends).append(end)
    label_ends(axes, ends)
    label_losses(axes, lost)


_COLUMNS = ("panel", "axis", "at", "method", "measure", "value")


def _rows(methods: dict[str, Method], step: int) -> Iterator[tuple[object, ...]]:
    """What is measured in all panels, at every so many points of their axes."""
    for panel in tqdm(PANELS, disable=None):
        at = panel.at[::step]
        unit = "largest radiance error" if panel.judge is largest_error else "% of pixels wrong"
        for name, values in measure(panel, methods, at).items():
            for x, value in zip(at, values, strict=True):
                yield panel.title, panel.axis, float(x), name, unit, float(value)


def _chart(path: Path) -> Any:
    """The figure of a stored table: as the file has the numbers, rounded."""
    figure, grid = plt.subplots(4, 2, figsize=(14, 17))
    figure.subplots_adjust(left=0.06, right=0.865, top=0.895, bottom=0.04, wspace=0.52, hspace=0.62)
    headline(
        figure,
        "Where ray tracing loses its digits",
        "Each point is a picture held against 50-digit arithmetic.  Left: largest error of the"
        " radiance (✕: useless from there on).  Right: share of pixels decided wrongly.",
    )
    curves: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for title, _, at, name, _, value in read_csv(path)[1]:
        curves[title][name].append((float(at), float(value)))
    for axes, panel in zip(grid.ravel(), PANELS, strict=True):
        found = {name: np.array(points).T for name, points in curves[panel.title].items()}
        at = next(iter(found.values()))[0]
        _draw(axes, panel, at, {name: values for name, (_, values) in found.items()})
    return figure


def main() -> None:
    """Measure, and write the chart."""
    used = parser("reference.stability", __doc__, quick="every third point only", redraw=True)
    options = used.parse_args()
    chart = result("stability.csv", quick=options.quick)
    if options.redraw:
        need_table(used, chart)
    else:
        where = measured_on()
        # All of them before the stored table is replaced.
        rows = [*_rows(methods_of(), step=3 if options.quick else 1)]
        write_csv(chart, where, _COLUMNS, rows)
    save(_chart(chart), chart.with_suffix(".svg"))


if __name__ == "__main__":
    run(main)
