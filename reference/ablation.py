"""What each part of the tracer buys: the same pictures, with one part at a time left out.

    python -m reference.ablation [--quick]

writes `ablation.md` and `ablation.csv` into this folder.  At one sample a pixel no part changes
what is seen or which lights reach it; antialiasing is judged by time and error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pkgutil import resolve_name
from typing import Any
from unittest import mock

import numpy as np

from reference.command import SCENES, need_scenes, parser, result, run
from reference.tables import Ratio, Table, measured_on, write_tables
from reference.timing import Task, Timing, interleaved
from reference.truth import Truth, truth_side
from reference.workloads import crowd, resized, rods
from tracer import Scene, load_scene, render

__all__ = ["ANTIALIASING", "ONE_SAMPLE", "Part", "main", "without"]

_ALL = "all as it is"
_ALWAYS = 1 << 40

_SAMPLES = 64

# As many for all: the fastest of more rounds would be faster.
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Part:
    """Something that the tracer could do without.

    Attributes
    ----------
    name : str
    instead : mapping
        What takes the place of what, below `tracer`: a value, or of a function a function that is
        given the old one and its arguments.
    processes : int
    """

    name: str
    instead: Mapping[str, Any] = field(default_factory=dict)
    processes: int = 1


def _nothing(*_: Any) -> Iterator[Any]:
    return iter(())


def _certain_of_nothing(capsules: Any, *arguments: Any) -> Any:
    meets, cuts = capsules(*arguments)
    return meets, np.zeros_like(cuts)


def _equal_weights(stratified: Any, lines: Any, count: int, x: Any, y: Any) -> Any:
    points, n = stratified(lines, count, x, y), count * x.size
    return type(points)(*(m[:n] for m in points))._replace(weight=np.full(n, 1 / x.size))


def _upright(turned: Any, per_side: int) -> Any:
    """A grid in rows and columns, of about as many points."""
    side = round(np.sqrt(turned(per_side).size))
    return type(turned(per_side))(side, side)


ONE_SAMPLE = [
    Part("short packets ask the light grids", {"shadow.occluders.LONGEST": 6}),
    Part("long packets ask, however many objects", {"shadow.occluders._FEW": _ALWAYS}),
    Part(
        "no packet certainly in shadow",
        {
            "shapes.sphere.Spheres.capsules": _certain_of_nothing,
            "shapes.box.Boxes.capsules": _certain_of_nothing,
        },
    ),
    Part("no large objects with numbers for their data", {"view.visibility._LARGE": _ALWAYS}),
    Part("one tile", {"picture.bands._TILE_SAMPLES": _ALWAYS}),
    Part("tiles of 16,384 pixels", {"picture.bands._TILE_SAMPLES": 1 << 14}),
    Part("highlights from vectors, not cosines", {"light.shading._SHOWS": -1.0}),
    Part("two processes", processes=2),
]
"""Parts without which a picture of one sample a pixel takes longer."""

_EDGES = "antialias.edges.Seen"

ANTIALIASING = [
    Part("samples everywhere", {"antialias.refine.dense": lambda *_: True}),
    Part("no quarters", {"antialias.refine._LAST": 1 << 10}),
    Part("no second lattice", {"antialias.refine.mixed": lambda *_: np.zeros(0, dtype=int)}),
    Part("no regions: equal weights", {"antialias.refine.stratified": _equal_weights}),
    Part("no silhouettes", {"antialias.classify.silhouettes": _nothing}),
    Part("no lines where surfaces meet", {f"{_EDGES}.intersections": _nothing}),
    Part("no edges of shadows", {f"{_EDGES}.shadows": _nothing}),
    Part("no terminators", {f"{_EDGES}.terminators": _nothing}),
    Part("no creases", {f"{_EDGES}.creases": _nothing}),
    Part("no narrow highlights", {"antialias.classify.narrow_highlights": _nothing}),
    Part(
        "no curvature",
        {"antialias.refine.curvature": lambda _, light, ids, *__: (0 * light, np.zeros(ids.size))},
    ),
    Part("upright lattices", {"antialias.lattice.Lattice.of": _upright}),
]
"""Parts without which an antialiased picture takes longer, or errs more."""


@contextmanager
def without(part: Part) -> Iterator[None]:
    """Patch the tracer to do without a part, as long as this lasts."""
    with ExitStack() as stack:
        for name, value in part.instead.items():
            target, attribute = f"tracer.{name}".rsplit(".", 1)
            old = getattr(resolve_name(target), attribute)
            # A plain function, so that it is bound to objects as the old one is.
            new = _in_place(value, old) if callable(value) else value
            stack.enter_context(mock.patch(f"tracer.{name}", new))
        yield


def _in_place(value: Any, old: Any) -> Any:
    def new(*arguments: Any, **keywords: Any) -> Any:
        return value(old, *arguments, **keywords)

    return new


def _table(
    title: str, scenes: dict[str, Scene], parts: Sequence[Part], samples: int, *, quick: bool
) -> Table:
    """Times, in the first row in milliseconds, and errors where pixels are antialiased."""
    every = [Part(_ALL), *parts]
    rows: list[list[object]] = [[part.name] for part in every]
    header = ["change"]
    for name, scene in scenes.items():
        tasks: dict[str, Task] = {
            part.name: partial(_render, scene, part, samples) for part in every
        }
        spent = interleaved(tasks, 1 if quick else _ROUNDS)
        truth = Truth.of(scene, truth_side(quick)) if samples > 1 else None
        header += [name, "RMSE"] if truth else [name]
        for row, part in zip(rows, every, strict=True):
            # The fastest: other work of the machine only ever adds to a time.
            low, whole = spent[part.name].low, spent[_ALL].low
            row.append(Timing(low, low, low) if part is every[0] else Ratio(low / whole))
            if truth:
                row.append(f"{truth.error(_render(scene, part, samples)):.6f}")
    return Table(
        title,
        f"Milliseconds with all parts, in the fastest of {_ROUNDS} rounds; then how many times as"
        " long it takes with a change.",
        tuple(header),
        [tuple(row) for row in rows],
    )


def _render(scene: Scene, part: Part, samples: int) -> Any:
    with without(part):
        return render(scene, samples, processes=part.processes)


def _scenes(*names: str, size: tuple[int, int]) -> dict[str, Scene]:
    return {name: resized(load_scene(SCENES / f"{name}.xml"), *size) for name in names}


def main() -> None:
    """Measure, and write the page."""
    used = parser("reference.ablation", __doc__, quick="small pictures")
    options = used.parse_args()
    need_scenes(used)
    wide, small = ((64, 36), (64, 36)) if options.quick else ((1280, 720), (320, 180))
    one = _scenes("four-spheres", "sticks-perspective", "sunflower", "many-objects", size=wide)
    one["1,000 small objects"] = resized(crowd(1000), *small)
    one["2,000 rods"] = resized(rods(2000), *small)
    many = _scenes("four-spheres", "room", "sunflower", size=small)
    many["1,000 small objects"] = resized(crowd(1000), *small)
    found = [
        _table("One sample a pixel", one, ONE_SAMPLE, 1, quick=options.quick),
        _table(f"{_SAMPLES} samples a pixel", many, ANTIALIASING, _SAMPLES, quick=options.quick),
    ]
    head = (
        "# What each part buys\n\nMade by `python -m reference.ablation`: each line leaves out, or"
        " changes, one part of the tracer and keeps all others. One process, unless it says two."
        f" {wide[0]}×{wide[1]}; the objects by number, and all antialiased pictures,"
        f" {small[0]}×{small[1]}."
    )
    write_tables(result("ablation.md", quick=options.quick), head, measured_on(), found)


if __name__ == "__main__":
    run(main)
