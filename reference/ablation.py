"""What each part of the tracer buys: the same pictures, with one part at a time left out.

    python -m reference.ablation [--quick]

writes `ablation.md` and `ablation.csv` into this folder.  At one sample a pixel no part changes
what is seen or which lights reach it; antialiasing is judged by time and error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest import mock

import numpy as np

from reference.command import SCENES, need_scenes, parser, result, run
from reference.tables import Ratio, Table, measured_on, write_tables
from reference.timing import Task, Timing, interleaved
from reference.truth import Truth, truth_side
from reference.workloads import crowd, resized, rods
from tracer import Scene, load_scene, render
from tracer.antialias import classify
from tracer.antialias import refine as antialias
from tracer.antialias.classify import Classification
from tracer.antialias.edges import Seen
from tracer.antialias.lattice import Lattice
from tracer.antialias.lines import Lines
from tracer.antialias.regions import Points, stratified
from tracer.arrays import Floats, Ints
from tracer.light import shading
from tracer.picture import bands
from tracer.shadow import occluders, occlusion
from tracer.shadow.occlusion import NearbyShadows
from tracer.shapes.box import Boxes
from tracer.shapes.sphere import Spheres
from tracer.view import visibility

__all__ = ["ANTIALIASING", "ONE_SAMPLE", "Part", "main", "without"]

_ALL = "all as it is"
_NEVER, _ALWAYS = -1, 1 << 40

_SAMPLES = 64

# As many for all: the fastest of more rounds would be faster.
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Part:
    """Something that the tracer could do without, and what is put in its place.

    Attributes
    ----------
    name : str
    instead : sequence of (object, str, object)
        What to patch: an object, the name of its attribute, and the value in its place.
    processes : int
    """

    name: str
    instead: Sequence[tuple[Any, str, Any]]
    processes: int = 1


def _uncertain(shape: Any) -> tuple[Any, str, Any]:
    """Nothing is certainly in the shadow of a shape."""
    capsules = shape.capsules

    def only_meets(*arguments: Any) -> tuple[Any, Any]:
        meets, cuts = capsules(*arguments)
        return meets, np.zeros_like(cuts)

    return shape, "capsules", only_meets


def _flat(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
    """No curvature anywhere."""
    return np.zeros_like(radiance), np.zeros(key.size)


def _forgotten(found: Classification) -> NearbyShadows:
    """What may shade samples is sought anew, whatever is known of their cells."""
    return NearbyShadows(found.shadow_edges, np.full(found.id.size, -1))


def _undivided(lines: Lines, count: int, x: Floats, y: Floats) -> Points:
    """All points in a cell have the same weight, whatever lines lie between them."""
    return stratified(lines.take(slice(0)), count, x, y)


def _none(*_: Any) -> tuple[()]:
    """No edges of a kind, or no places."""
    return ()


def _upright(per_side: int, turned: Any = Lattice.of) -> Lattice:
    """A grid in rows and columns, of about as many points."""
    side = round(np.sqrt(turned(per_side).size))
    return Lattice(side, side)


ONE_SAMPLE = [
    Part("no tiles: short packets ask the grid", [(occluders, "LONGEST", occlusion._SHORT)]),
    Part("no short packets: tiles of long ones ask the grid", [(occluders, "_FEW", _ALWAYS)]),
    Part("no packet certainly in shadow", [_uncertain(Spheres), _uncertain(Boxes)]),
    Part("no objects with arrays of their own", [(visibility, "_LARGE", _ALWAYS)]),
    Part("no bands: the picture in one", [(bands, "_TILE_SAMPLES", _ALWAYS)]),
    Part("bands of 16,384 pixels", [(bands, "_TILE_SAMPLES", 1 << 14)]),
    Part("no highlights from cosines: from vectors", [(shading, "_SHOWS", -1.0)]),
    Part("two processes", [], processes=2),
]
"""Parts without which a picture of one sample a pixel takes longer."""

ANTIALIASING = [
    Part("samples everywhere", [(antialias, "dense", lambda *_: True)]),
    Part("no quarters: samples in all pixels that are not smooth", [(antialias, "_LAST", _ALWAYS)]),
    Part("quarters once more before samples", [(antialias, "_LAST", 1)]),
    Part("no silhouettes", [(classify, "silhouettes", _none)]),
    Part("no intersections", [(Seen, "intersections", _none)]),
    Part("no edges of shadows", [(Seen, "shadows", _none)]),
    Part("no terminators", [(Seen, "terminators", _none)]),
    Part("no creases", [(Seen, "creases", _none)]),
    Part("no narrow highlights", [(classify, "narrow_highlights", _none)]),
    Part(
        "no regions: all samples in a cell weigh the same", [(antialias, "stratified", _undivided)]
    ),
    Part("no memory of shadows: sought anew", [(Classification, "nearby", _forgotten)]),
    Part("no curvature: centres as they are", [(antialias, "curvature", _flat)]),
    Part("no turn: upright grids of as many samples", [(Lattice, "of", _upright)]),
]
"""Parts without which an antialiased picture takes longer, or errs more."""


@contextmanager
def without(part: Part) -> Iterator[None]:
    """Patch the tracer to do without a part, as long as this lasts."""
    with ExitStack() as stack:
        for where, name, value in part.instead:
            stack.enter_context(mock.patch.object(where, name, value))
        yield


def _table(
    title: str, scenes: dict[str, Scene], parts: Sequence[Part], samples: int, *, quick: bool
) -> Table:
    """Times, in the first row in milliseconds, and errors where pixels are antialiased."""
    every = [Part(_ALL, []), *parts]
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


def _render(scene: Scene, part: Part, samples: int) -> Floats:
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
