"""What each part of the tracer buys: the same pictures, with one part at a time left out.

``python -m reference.ablation`` writes `ablation.md` and `.csv` into this folder.  At one sample a
pixel no part changes what is seen or lit; antialiasing is judged by time and error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from reference.command import SCENES, run
from reference.measurements import Ratio, Table, Timing, interleaved, measure_page
from reference.truth import Truth, truth_side
from reference.workloads import crowd, resized, rods
from tracer import Scene, load_scene, render

__all__ = ["ANTIALIASING", "ONE_SAMPLE", "Part", "main", "without"]

_ALWAYS = 1 << 40

# As many for all: the fastest of more rounds would be faster.
_SAMPLES, _ROUNDS = 64, 5


class Part(NamedTuple):
    """Something that the tracer could do without.

    `instead` says what takes the place of what, below `tracer`: a value, or of a function one that
    is given the old one and its arguments.
    """

    name: str
    instead: Mapping[str, Any] = MappingProxyType({})
    processes: int = 1


def _nothing(*_: Any) -> Iterator[Any]:
    return iter(())


def _certain_of_nothing(capsules: Any, *arguments: Any) -> Any:
    meets, cuts = capsules(*arguments)
    return meets, np.zeros_like(cuts)


def _equal_weights(stratified: Any, lines: Any, count: int, lattice: Any) -> Any:
    points, n = stratified(lines, count, lattice), count * lattice.size
    return type(points)(*(m[:n] for m in points))._replace(weight=np.full(n, 1 / lattice.size))


def _upright(turned: Any, per_side: int) -> Any:
    """A grid in rows and columns, of about as many points."""
    side = round(np.sqrt(turned(per_side).size))
    return type(turned(per_side))(side, side)


ONE_SAMPLE = [
    Part("rows of points ask the light grids", {"shadow.packets._SIDE": _ALWAYS}),
    Part("squares of rows ask, however many objects", {"shadow.occluders._PART": _ALWAYS}),
    Part(
        "no packet certainly in shadow",
        {
            "shapes.sphere.Spheres.capsules": _certain_of_nothing,
            "shapes.box.Boxes.capsules": _certain_of_nothing,
        },
    ),
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
        {"antialias.refine.curvature": lambda _, light, ids, *__: (light, np.zeros(ids.size))},
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
            new = _in_place(value, old) if callable(value) else value
            stack.enter_context(mock.patch(f"tracer.{name}", new))
        yield


def _in_place(value: Any, old: Any) -> Any:
    # A plain function, so that it is bound to objects as the old one is.
    return lambda *arguments, **keywords: value(old, *arguments, **keywords)


def _render(scene: Scene, part: Part, samples: int) -> Any:
    with without(part):
        return render(scene, samples, processes=part.processes)


def _table(
    title: str, scenes: dict[str, Scene], parts: Sequence[Part], samples: int, *, quick: bool
) -> Table:
    """Times, in the first row in milliseconds, and errors where pixels are antialiased."""
    every = [Part("all as it is"), *parts]
    rows: list[list[object]] = [[part.name] for part in every]
    header = ["change"]
    for name, scene in scenes.items():
        # The fastest: other work of the machine only ever adds to a time.
        tasks = {part.name: partial(_render, scene, part, samples) for part in every}
        timings = interleaved(tasks, 1 if quick else _ROUNDS).values()
        first, *others = (timing.low for timing in timings)
        columns = [[Timing(first, first, first), *(Ratio(low / first) for low in others)]]
        if samples > 1:
            truth = Truth.of(scene, truth_side(quick))
            columns.append([f"{truth.error(task()):.6f}" for task in tasks.values()])
        header += (name, "RMSE")[: len(columns)]
        rows = [[*row, *cells] for row, *cells in zip(rows, *columns, strict=True)]
    note = (
        f"Milliseconds with all parts, in the fastest of {_ROUNDS} rounds; then how many times as"
        " long it takes with a change."
    )
    return Table(title, note, header, rows)


def _tables(quick: bool) -> Iterator[Table]:
    wide, small = ((64, 36), (64, 36)) if quick else ((1280, 720), (320, 180))
    objects = {"1,000 small objects": resized(crowd(1000), *small)}

    def scenes(size: tuple[int, int], *names: str) -> dict[str, Scene]:
        loaded = {name: resized(load_scene(SCENES / f"{name}.xml"), *size) for name in names}
        return loaded | objects

    one = scenes(wide, "four-spheres", "sticks-perspective", "sunflower", "many-objects")
    one["2,000 rods"] = resized(rods(2000), *small)
    yield _table("One sample a pixel", one, ONE_SAMPLE, 1, quick=quick)
    many = scenes(small, "four-spheres", "room", "sunflower")
    yield _table(f"{_SAMPLES} samples a pixel", many, ANTIALIASING, _SAMPLES, quick=quick)


def main() -> None:
    """Measure, and write the page."""
    head = (
        "# What each part buys\n\nMade by `python -m reference.ablation`: each line leaves out, or"
        " changes, one part of the tracer and keeps all others. One process, unless it says two."
        " 1280×720; the objects by number, and all antialiased pictures, 320×180."
    )
    measure_page("ablation", __doc__, "small pictures", head, _tables)


if __name__ == "__main__":
    run(main)
