"""Hold the tracer's pictures against Mitsuba's, pixel by pixel, in linear light.

    python -m reference.check SCENE.xml ...    writes NAME.check.png

Both sample the pixels' centres.  With --flavour exact (the default) all light is compared, by this
project's small Mitsuba plugins; with --flavour stock diffuse light alone, by Mitsuba's own parts.

The verdict is one of three:
  agrees     Mitsuba's picture is the tracer's.  Left out are some pixels at edges, where Mitsuba's
             float32 may fall on the other side, and ties: where surfaces coincide, Mitsuba may
             show the other one.
  DIFFERS    Exact arithmetic is against the tracer, or the pictures are too far apart as a whole.
  undecided  Exact arithmetic sides with the tracer: Mitsuba or the converter is wrong.

Exit status: 0 if all agree, 1 if one differs or cannot be compared, 2 for wrong usage or where
Mitsuba cannot run, 3 if one is undecided and none is worse.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from converters.camera import Floats
from converters.flavours import exact, gain, squared, stock
from converters.rendering import Rendering, load
from converters.to_mitsuba import add_scenes, guarded, ready, without_converted
from converters.variant import LLVM, use
from reference.command import parser
from reference.figures import Bools, Figures, figures, write_comparison
from reference.judges import plain
from tracer import Lambertian, Scene, SceneWarning, Sphere, Surfaces, load_scene, render
from tracer.command.arguments import output_paths
from tracer.command.process import FAILED, MISUSED, print_line
from tracer.messages import printable

Verdict: TypeAlias = Literal["agrees", "DIFFERS", "undecided"]
STATUS: dict[Verdict, int] = {"agrees": 0, "DIFFERS": FAILED, "undecided": 3}
"""Exit statuses."""


class Limits(NamedTuple):
    """What Mitsuba's float32 is allowed."""

    difference: float
    """Largest difference in linear radiance, in units of the brightest pixel where that is > 1."""
    shift: float
    """How far a sample moves, in pixels and both ways, to see if an edge is near."""


EXACT = Limits(1e-4, 0.003)
# The stock camera is float32, and stock shadow rays start above the surface.
STOCK = Limits(1e-3, 0.03)

MAX_EDGES = 0.015  # largest share of a picture whose edges may differ
MIN_SSIM = 0.999  # least SSIM
MAX_MEDIAN = 1e-6  # largest median of the differences

# Exact arithmetic is slow: it is asked about so many pixels at a time, evenly chosen.
_AT_A_TIME = 100

# How near, relatively and in pixels, is too near for float64 to tell apart.
_NEAR, _NEAR_SHIFT = 1e-12, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of a comparison of two linear pictures, (h, w, 3) float64, and masks (h, w).

    The figures are of `tracer` against `mitsuba`, in units of the brightest pixel where that is
    more than 1.  Pixels of `edges` and `ties` count in none, and are equal in both for the SSIM.
    Times are warm where that makes a difference.
    """

    name: str
    tracer: Floats
    mitsuba: Floats
    edges: Bools
    """Pixels at edges that differ."""
    ties: Bools
    """Pixels that differ, and where exact arithmetic shows both values: surfaces coincide."""
    differing: Bools
    """All others that differ."""
    asked: int
    """How many of `differing` were traced in exact arithmetic: not all, if the first say enough."""
    wrong: int
    """On how many of these exact arithmetic is against the tracer."""
    first: tuple[int, int] | None
    """Row and column of the first wrong one; if there is none, of the first one asked about."""
    figures: Figures
    variant: str
    tracer_seconds: float
    mitsuba_seconds: float

    @property
    def left_out(self) -> Bools:
        """Pixels that count in no figure."""
        return self.edges | self.ties

    @property
    def verdict(self) -> Verdict:
        """Whether the two agree, and if not, whether the tracer is at fault."""
        if self.differing.any():
            return "DIFFERS" if self.wrong else "undecided"
        return "DIFFERS" if faults(self.figures) else "agrees"

    @property
    def remarks(self) -> list[str]:
        """What there is to say of the verdict, in a sentence each."""
        row, column = self.first or (0, 0)
        where = f"{_pixels(self.differing)}, the first at column {column}, row {row}"
        found = []
        if self.ties.any():
            found.append(f"Mitsuba shows the other of surfaces that tie on {_pixels(self.ties)}")
        if self.wrong:
            asked = f"exact arithmetic is against the tracer on {self.wrong} of {self.asked}"
            found.append(f"{asked} pixels that it was asked about; they differ on {where}")
        elif self.differing.any():
            asked = f"exact arithmetic, asked about {self.asked}, sides with the tracer"
            found.append(f"Mitsuba or the converter is wrong on {where}; {asked}")
        else:
            found += [f"out of tolerance: {fault}" for fault in faults(self.figures)]
        return found

    def report(self) -> str:
        """The result in a few lines of text."""
        lines = [
            f"{self.name}: {self.verdict}",
            f"  {self.figures}",
            f"  left out: edge pixels that differ: {self.edges.sum()} ({self.edges.mean():.3%}),"
            f" ties: {self.ties.sum()}",
            f"  Mitsuba ({self.variant}) {self.mitsuba_seconds:.3f} s,"
            f" tracer {self.tracer_seconds:.3f} s",
        ]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])


def _pixels(mask: Bools) -> str:
    count = int(mask.sum())
    return f"{count:,} pixel{'s' * (count != 1)}"


def faults(measured: Figures) -> list[str]:
    """Say which figures of a comparison are out of tolerance."""
    found = []
    if measured.ssim < MIN_SSIM:
        found.append(f"SSIM {measured.ssim:.5f} is below {MIN_SSIM}")
    if measured.median > MAX_MEDIAN:
        found.append(f"median difference {measured.median:.1e} exceeds {MAX_MEDIAN:.0e}")
    return found


def near_edges(scene: Scene, picture: Floats, shift: float, tolerance: float) -> Bools:
    """Pixels (h, w) that lie between values which the tracer finds when its samples move.

    They move by `shift` pixels, both ways.
    """
    aside = (-shift, shift)
    seen = [render(scene, offset=(dx, dy)) for dx, dy in product(aside, aside)]
    low, high = np.min(seen, axis=0) - tolerance, np.max(seen, axis=0) + tolerance
    between: Bools = ((low <= picture) & (picture <= high)).all(axis=2)
    return between


def check(path: Path, variant: str | None = None, flavour: str = "exact") -> CheckResult:
    """Render a scene file with the tracer and with Mitsuba, and compare.

    The exact flavour compares all light, "stock" diffuse light, by stock parts alone.  Raises what
    `load_scene` and `converters.variant.use` do.
    """
    scene, name = load_scene(path), printable(path.stem)
    return {"exact": check_scene, "stock": check_diffuse}[flavour](scene, name, variant)


def check_scene(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare all light, by this project's plugins."""
    rendered = load(exact(scene), variant)
    if use(variant).variant == LLVM:
        rendered()  # compiles the kernel
    return compare(scene, name, rendered())


def check_diffuse(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare diffuse light, by Mitsuba's own parts alone, in square pixels.

    Each light is rendered by itself, for Mitsuba would pick one of them at random, and its fall-off
    undone by the distance of the points that Mitsuba sees.
    """
    surfaces = (replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces)
    matte = replace(squared(scene), surfaces=Surfaces.of(surfaces))
    image, start = np.zeros((matte.height, matte.width, 3)), perf_counter()
    for light in matte.lights:
        white = replace(light, intensity=(1.0, 1.0, 1.0))
        root = ET.fromstring(stock(replace(matte, lights=(white,)), 1))
        parts = {part.get("type"): part for part in root.iter("*")}
        root.remove(parts["direct"])
        aov = ET.SubElement(root, "integrator", type="aov")
        ET.SubElement(aov, "string", name="aovs", value="p:position")
        aov.append(parts["direct"])
        parts["multijitter"].set("type", "stratified")
        ET.SubElement(parts["multijitter"], "boolean", name="jitter", value="false")
        seen = load(ET.tostring(root, encoding="unicode"), variant)().image
        place, strength = parts["point"].findall("*")
        away = seen[..., -3:] - [float(place.get(axis, "")) for axis in "xyz"]
        unit = float(strength.get("value", "").split()[0]) / (np.pi * gain(matte.surfaces))
        falloff = (away * away).sum(axis=2, keepdims=True) / unit
        image += seen[..., :3] * falloff * light.intensity
    rendering = Rendering(image, use(variant).variant, perf_counter() - start)
    return compare(matte, f"{name}, diffuse light by stock plugins", rendering, STOCK)


def compare(scene: Scene, name: str, rendering: Rendering, limits: Limits = EXACT) -> CheckResult:
    """Hold the tracer's picture of a scene against one that Mitsuba has made.

    Raises ValueError if a radiance of either is not finite.
    """
    mitsuba = rendering.image
    if not np.isfinite(mitsuba).all():
        raise ValueError(
            "Mitsuba's radiance is not finite; keep the colours and lights of the scene closer to 1"
        )
    render(scene)  # so that the next, which is timed, is warm
    start = perf_counter()
    image = render(scene)
    seconds = perf_counter() - start
    # Limits are for radiance up to 1, and grow with the darker picture: no mistake widens them.
    unit = max(1.0, min(float(image.max()), float(mitsuba.max())))
    difference = np.abs(image - mitsuba).max(axis=2) / unit
    # Where the pictures are too far apart as a whole, the pixels are looked at again, more closely.
    for tolerance in (limits.difference, MAX_MEDIAN):
        differing = difference > tolerance
        edges = differing.copy()
        if differing.any():
            edges &= near_edges(scene, mitsuba, limits.shift, tolerance * unit)
        if edges.mean() > MAX_EDGES:  # too many to be a matter of rounding: none is excused
            edges = np.zeros_like(edges)
        judged = _judge(scene, image, mitsuba, differing & ~edges, tolerance * unit)
        left_out = edges | judged.ties
        # The tracer takes Mitsuba's pixels where these do not count, never the other way round.
        shown = np.where(left_out[:, :, None], mitsuba, image)
        found = figures(shown / unit, mitsuba / unit, None if left_out.all() else left_out)
        if judged.asked or not faults(found):
            break
    return CheckResult(
        name=name,
        tracer=image,
        mitsuba=mitsuba,
        edges=edges,
        **judged._asdict(),
        differing=differing & ~left_out,
        figures=found,
        variant=rendering.variant,
        tracer_seconds=seconds,
        mitsuba_seconds=rendering.seconds,
    )


class _Judgement(NamedTuple):
    """See `CheckResult`."""

    ties: Bools
    asked: int = 0
    wrong: int = 0
    first: tuple[int, int] | None = None


def _judge(
    scene: Scene, image: Floats, mitsuba: Floats, differing: Bools, tolerance: float
) -> _Judgement:
    """Ask exact arithmetic about pixels that differ, until one is no tie."""
    pixels, ties = np.argwhere(differing), np.zeros_like(differing)
    step = -(-len(pixels) // _AT_A_TIME)
    for k in range(step):
        rows, columns = at = pixels[k::step].T
        right, tied = np.zeros((2, len(rows)), dtype=np.bool_)
        for near, shift in _nearby(scene):
            first, last = (
                plain.trace(
                    near, columns + 0.5 + shift, rows + 0.5 + shift, arithmetic="decimal", ties=of
                ).radiance
                for of in ("first", "last")
            )
            ours, *theirs = (
                np.abs(picture[rows, columns] - exact).max(axis=1) <= tolerance
                for picture, exact in ((image, first), (mitsuba, first), (mitsuba, last))
            )
            right |= ours
            tied |= theirs[0] | theirs[1]
            if right.all():
                break
        tied &= right
        ties[rows[tied], columns[tied]] = True
        if not tied.all():
            row, column = at[:, ~tied if right.all() else ~right][:, 0].tolist()
            return _Judgement(ties, int((~tied).sum()), int((~right).sum()), (row, column))
    return _Judgement(ties)


def _nearby(scene: Scene) -> Iterator[tuple[Scene, float]]:
    """Yield a scene and others, so near that rounding may tell them apart, and shifts in pixels.

    The tracer is right if it is exact for one of these: that is a near-tie.
    """
    yield scene, 0.0
    for shift in (-_NEAR_SHIFT, _NEAR_SHIFT):
        yield scene, shift
    for growth in (1 - _NEAR, 1 + _NEAR):
        surfaces = (
            replace(s, radius=s.radius * growth) if isinstance(s, Sphere) else s
            for s in scene.surfaces
        )
        yield replace(scene, surfaces=Surfaces.of(surfaces)), 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    used = parser("reference.check", __doc__)
    add_scenes(used)
    used.add_argument("--flavour", choices=("exact", "stock"), default="exact", help="see above")
    options = used.parse_args(arguments)
    scenes = without_converted(options.scenes)
    ending = ".check.png" if options.flavour == "exact" else f".{options.flavour}.check.png"
    beside = [str(scene.parent / f"{scene.stem}{ending}") for scene in scenes]
    targets = output_paths(used, [*map(str, scenes)], options.output, beside)
    if not ready(options):
        return MISUSED
    # Of a black picture the comparison says enough.
    warnings.simplefilter("ignore", SceneWarning)
    pairs = zip(scenes, map(Path, targets), strict=True)
    return worst_status([guarded(_checked, *pair, options) for pair in pairs])


def worst_status(results: Iterable[CheckResult | None]) -> int:
    """Return the exit status after some comparisons; None is a scene that could not be compared."""
    statuses = {FAILED if result is None else STATUS[result.verdict] for result in results}
    return FAILED if FAILED in statuses else max(statuses, default=0)


def _checked(path: Path, target: Path, options: argparse.Namespace) -> CheckResult:
    """Check one scene, write the comparison, and print the result."""
    result = check(path, options.variant, options.flavour)
    labels = ("tracer", f"Mitsuba {result.variant}")
    write_comparison(target, result.tracer, result.mitsuba, labels)
    print_line(sys.stdout, result.report())
    print_line(sys.stdout, printable(f"  {target}"))
    return result
