"""Compare the tracer's pictures with Mitsuba's, pixel by pixel, in linear radiance.

    python -m reference.check SCENE.xml ...    writes NAME.check.png

Both sample the pixels' centres.  With --flavour exact (the default) all light is compared, by this
project's small Mitsuba plugins; with --flavour stock diffuse light alone, by Mitsuba's own plugins.

The verdict is one of three:
  agrees     Mitsuba's picture is the tracer's.  Excluded are some pixels at edges, where Mitsuba's
             float32 may fall on the other side, and ties: where surfaces coincide, Mitsuba may
             show the other one.
  DIFFERS    Exact arithmetic contradicts the tracer, or the pictures differ too much as a whole.
  undecided  Exact arithmetic confirms the tracer: Mitsuba or the converter is wrong.

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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Literal, NamedTuple, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from converters.camera import Floats
from converters.flavours import (
    convert_exact,
    convert_stock,
    reflectance_divisor,
    with_square_pixels,
)
from converters.mitsuba_xml import plugin
from converters.rendering import Rendering, load_converted
from converters.to_mitsuba import (
    add_scene_arguments,
    choose_variant,
    mitsuba_errors_as_failure,
    skip_converted,
)
from converters.variant import LLVM, use_variant
from reference.command import make_parser
from reference.figures import Bools, Figures, measure_differences, write_comparison
from reference.judges import plain
from reference.judges.arrays import Ints
from tracer import Lambertian, PointLight, Scene, SceneWarning, Sphere, Surfaces, load_scene, render
from tracer.command.arguments import choose_output_paths, make_output_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import FAILED, MISUSED, attempt, print_line
from tracer.command.progress import track
from tracer.messages import printable

Verdict: TypeAlias = Literal["agrees", "DIFFERS", "undecided"]
STATUS: dict[Verdict, int] = {"agrees": 0, "DIFFERS": FAILED, "undecided": 3}
"""Exit statuses by verdict."""


class Limits(NamedTuple):
    """Tolerances for the differences that Mitsuba's float32 arithmetic causes.

    Attributes
    ----------
    difference : float
        Maximum difference in linear radiance.  In pictures brighter than 1 it is relative to the
        brightest pixel.
    shift : float
        Maximum distance, in pixels along each axis, from a pixel's centre to an edge at which the
        pixel may differ.
    """

    difference: float
    shift: float


EXACT = Limits(1e-4, 0.003)
# The stock camera is float32, and stock shadow rays start above the surface.
STOCK = Limits(1e-3, 0.03)

MAX_EDGES = 0.015  # maximum share of the picture's pixels that may differ because of edges
MIN_SSIM = 0.999
MAX_MEDIAN = 1e-6  # maximum median of the differences

# Number of pixels in one batch of exact arithmetic, which is slow.  Each batch is spread over the
# whole picture, and often the first batch decides.
_PIXELS_PER_BATCH = 100

# Relative difference of radii, and distance in pixels, below which float64 may not decide correctly
# which surface is in front.
_MAX_GROWTH, _MAX_SHIFT = 1e-12, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of comparing the tracer's and Mitsuba's pictures of a scene.

    Attributes
    ----------
    name : str
        Name of the scene.
    tracer, mitsuba : (h, w, 3) float array
        The two pictures, in linear radiance.
    edges : (h, w) bool array
        Pixels that differ, and that may do so because an edge is close to their centres.  They are
        excluded.
    ties : (h, w) bool array
        Pixels that differ where surfaces coincide: exact arithmetic gives both values.  They are
        excluded.
    differing : (h, w) bool array
        All other pixels that differ.
    examined : int
        Number of differing pixels that were traced in exact arithmetic and are no ties: all of
        them, or those of the first batches if these decide.
    wrong : int
        Number of examined pixels in which exact arithmetic contradicts the tracer.
    first : (row, column) or None
        The first wrong pixel, or the first examined pixel if none is wrong.
    figures : Figures
        Measures of the difference between `tracer` and `mitsuba`.  In pictures brighter than 1 they
        are relative to the brightest pixel.  Excluded pixels are treated as equal.
    variant : str
        Mitsuba's variant.
    tracer_seconds, mitsuba_seconds : float
        Times to render, after a first rendering if that takes longer.
    """

    name: str
    tracer: Floats
    mitsuba: Floats
    edges: Bools
    ties: Bools
    differing: Bools
    examined: int
    wrong: int
    first: tuple[int, int] | None
    figures: Figures
    variant: str
    tracer_seconds: float
    mitsuba_seconds: float

    @property
    def excluded(self) -> Bools:
        """Pixels (h, w) that affect no figure, because of edges or because surfaces tie."""
        return self.edges | self.ties

    @property
    def verdict(self) -> Verdict:
        """The verdict, which is one of three.

        - "agrees": the pictures agree.
        - "DIFFERS": exact arithmetic contradicts the tracer, or the figures are out of tolerance.
        - "undecided": pixels differ, but exact arithmetic confirms the tracer.
        """
        if self.differing.any():
            return "DIFFERS" if self.wrong else "undecided"
        return "DIFFERS" if out_of_tolerance(self.figures) else "agrees"

    @property
    def remarks(self) -> list[str]:
        """The reasons for the verdict: sentences without a full stop, possibly none."""
        row, column = self.first or (0, 0)
        place = f"{_format_pixel_count(self.differing)}, the first at column {column}, row {row}"
        sentences = []
        if self.ties.any():
            count = _format_pixel_count(self.ties)
            sentences.append(f"Mitsuba shows the other of surfaces that tie on {count}")
        if self.wrong:
            share = f"{self.wrong} of {self.examined} pixels that were examined"
            sentences.append(
                f"exact arithmetic contradicts the tracer on {share}; they differ on {place}"
            )
        elif self.differing.any():
            confirmed = (
                f"exact arithmetic confirms the tracer on {self.examined} that were examined"
            )
            sentences.append(f"Mitsuba or the converter is wrong on {place}; {confirmed}")
        else:
            sentences += [f"out of tolerance: {line}" for line in out_of_tolerance(self.figures)]
        return sentences

    def report(self) -> str:
        """Format the verdict, the figures, the times and the remarks as text of several lines."""
        lines = [
            f"{self.name}: {self.verdict}",
            f"  {self.figures}",
            f"  excluded: edge pixels that differ: {self.edges.sum()} ({self.edges.mean():.3%}),"
            f" ties: {self.ties.sum()}",
            f"  Mitsuba ({self.variant}) {self.mitsuba_seconds:.3f} s,"
            f" tracer {self.tracer_seconds:.3f} s",
        ]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])


def _format_pixel_count(mask: Bools) -> str:
    """Format the number of True elements of a mask (h, w), for example "1,234 pixels"."""
    count = int(mask.sum())
    return f"{count:,} pixel{'s' * (count != 1)}"


def out_of_tolerance(measured: Figures) -> list[str]:
    """State which figures of a comparison are out of tolerance.

    Parameters
    ----------
    measured : Figures
        The figures of two pictures.

    Returns
    -------
    lines : list of str
        A clause for each figure that is out of tolerance.
    """
    lines = []
    if measured.ssim < MIN_SSIM:
        lines.append(f"SSIM {measured.ssim:.5f} is below {MIN_SSIM}")
    if measured.median > MAX_MEDIAN:
        lines.append(f"median difference {measured.median:.1e} exceeds {MAX_MEDIAN:.0e}")
    return lines


def find_pixels_near_edges(scene: Scene, picture: Floats, shift: float, tolerance: float) -> Bools:
    """Find the pixels of another renderer's picture whose value can be explained by an edge nearby.

    The tracer renders the scene with samples moved in four diagonal directions.

    Parameters
    ----------
    scene : Scene
        The scene.
    picture : (h, w, 3) float array
        The other renderer's picture of the scene, in linear radiance.
    shift : float
        Distance, in pixels along each axis, by which the tracer's samples are moved.
    tolerance : float
        Permitted difference in linear radiance.

    Returns
    -------
    is_near : (h, w) bool array
        Whether the pixel's value lies between the minimum and the maximum of the four renderings,
        within the tolerance.
    """
    shifts = (-shift, shift)
    moved_pictures = [render(scene, offset=(dx, dy)) for dx, dy in product(shifts, shifts)]
    low = np.min(moved_pictures, axis=0) - tolerance
    high = np.max(moved_pictures, axis=0) + tolerance
    is_near: Bools = ((low <= picture) & (picture <= high)).all(axis=2)
    return is_near


def check(path: Path, variant: str | None = None, flavour: str = "exact") -> CheckResult:
    """Render a scene file with the tracer and with Mitsuba, and compare the pictures.

    Parameters
    ----------
    path : Path
        The scene file.
    variant : str, optional
        Mitsuba's variant; the default is the fastest that works here.
    flavour : str
        "exact" to compare all light by this project's plugins, or "stock" to compare diffuse light
        by Mitsuba's own plugins.

    Returns
    -------
    result : CheckResult
        Both pictures, the measures of their difference, and the verdict.

    Raises
    ------
    Failure
        If the scene cannot be read, converted or compared.
    """
    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    with mitsuba_errors_as_failure(path, "compared"):
        check_flavour = {"exact": check_scene, "stock": check_diffuse}[flavour]
        return check_flavour(scene, printable(path.stem), variant)


def check_scene(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare the tracer's picture of a scene with one rendered by this project's Mitsuba plugins.

    Parameters
    ----------
    scene : Scene
        The scene.
    name : str
        Name of the scene in the result.
    variant : str, optional
        Mitsuba's variant; the default is the fastest that works here.

    Returns
    -------
    result : CheckResult
        Both pictures, the measures of their difference, and the verdict.

    Raises
    ------
    ConversionError
        If Mitsuba cannot represent the scene.
    ValueError
        If a radiance is not finite.
    """
    render_loaded = load_converted(str(convert_exact(scene)), variant)
    if use_variant(variant).variant == LLVM:
        render_loaded()  # compiles the kernel
    return compare(scene, name, render_loaded())


def check_diffuse(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare the diffuse light of a scene with that rendered by Mitsuba's own plugins.

    Both pictures have square pixels, so their size may differ from that of the scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    name : str
        Name of the scene in the result.
    variant : str, optional
        Mitsuba's variant; the default is the fastest that works here.

    Returns
    -------
    result : CheckResult
        Both pictures, the measures of their difference, and the verdict.

    Raises
    ------
    ConversionError
        If Mitsuba cannot represent the scene.
    ValueError
        If a radiance is not finite.
    """
    surfaces = (replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces)
    matte = replace(with_square_pixels(scene), surfaces=Surfaces.from_objects(surfaces))
    image, start = np.zeros((matte.height, matte.width, 3)), perf_counter()
    for light in matte.lights:
        image += _render_diffuse_light(matte, light, variant)
    rendering = Rendering(image, use_variant(variant).variant, perf_counter() - start)
    return compare(matte, f"{name}, diffuse light by stock plugins", rendering, STOCK)


def _render_diffuse_light(matte: Scene, light: PointLight, variant: str | None) -> Floats:
    """Render a single light with Mitsuba's own plugins, and undo its fall-off with distance.

    The lights are rendered separately because Mitsuba would choose one of them at random.  The
    radiance is multiplied by the squared distance from the light to the points that Mitsuba
    reports.

    Parameters
    ----------
    matte : Scene
        A scene of Lambertian surfaces.
    light : PointLight
        A light of the scene.
    variant : str or None
        Mitsuba's variant; None for the fastest that works.

    Returns
    -------
    image : (h, w, 3) float array
        Linear radiance.
    """
    white = replace(light, intensity=(1.0, 1.0, 1.0))
    document = convert_stock(replace(matte, lights=(white,)), 1)
    plugins = {element.get("type"): element for element in document.root.iter()}
    integrator, sampler, emitter = plugins["direct"], plugins["multijitter"], plugins["point"]
    document.root.remove(integrator)
    document.root.append(plugin("integrator", "aov", integrator, aovs="p:position"))
    sampler.set("type", "stratified")
    ET.SubElement(sampler, "boolean", name="jitter", value="false")
    image = load_converted(str(document), variant)().image
    radiance, hit = image[..., :3], image[..., -3:]
    position, intensity = next(emitter.iter("point")), next(emitter.iter("rgb"))
    offset = hit - [float(position.get(axis, "")) for axis in "xyz"]
    # Mitsuba's radiance at distance 1 for a reflectance of 1 and light at right angles.
    unit = float(intensity.get("value", "").split()[0]) / (
        np.pi * reflectance_divisor(matte.surfaces)
    )
    undone: Floats = radiance * (offset * offset).sum(axis=2, keepdims=True) / unit
    return undone * light.intensity


def compare(scene: Scene, name: str, rendering: Rendering, limits: Limits = EXACT) -> CheckResult:
    """Compare the tracer's picture of a scene with Mitsuba's.

    The tracer renders the scene twice, and the second rendering is timed.  Pixels that differ are
    excluded if an edge is near, and otherwise traced in exact arithmetic.

    Parameters
    ----------
    scene : Scene
        The scene.
    name : str
        Name of the scene in the result.
    rendering : Rendering
        Mitsuba's picture, its variant and its time.
    limits : Limits
        Tolerances.

    Returns
    -------
    result : CheckResult
        Both pictures, the measures of their difference, and the verdict.

    Raises
    ------
    ValueError
        If a radiance in either picture is not finite.
    """
    mitsuba = rendering.image
    if not np.isfinite(mitsuba).all():
        raise ValueError(
            "Mitsuba's radiance is not finite; keep the colours and lights of the scene closer to 1"
        )
    render(scene)  # the first rendering takes longer, so the second is timed
    start = perf_counter()
    image = render(scene)
    seconds = perf_counter() - start
    # Tolerances are for radiance up to 1.  Above, they grow with the darker picture, so that no
    # mistake that makes one picture brighter increases them.
    unit = max(1.0, min(float(image.max()), float(mitsuba.max())))
    difference = np.abs(image - mitsuba).max(axis=2) / unit
    # If the pictures differ too much as a whole, pixels are compared again, with less tolerance.
    for tolerance in (limits.difference, MAX_MEDIAN):
        differing = difference > tolerance
        edges = differing.copy()
        if differing.any():
            edges &= find_pixels_near_edges(scene, mitsuba, limits.shift, tolerance * unit)
        if edges.mean() > MAX_EDGES:  # too many for rounding to be the cause: none is excluded
            edges = np.zeros_like(edges)
        examination = _examine_exactly(scene, image, mitsuba, differing & ~edges, tolerance * unit)
        excluded = edges | examination.ties
        # Excluded pixels of the tracer's picture are replaced by Mitsuba's, never the reverse.
        shown = np.where(excluded[:, :, None], mitsuba, image)
        mask = None if excluded.all() else excluded
        measured = measure_differences(shown / unit, mitsuba / unit, mask)
        if examination.examined or not out_of_tolerance(measured):
            break
    return CheckResult(
        name=name,
        tracer=image,
        mitsuba=mitsuba,
        edges=edges,
        **examination._asdict(),
        differing=differing & ~excluded,
        figures=measured,
        variant=rendering.variant,
        tracer_seconds=seconds,
        mitsuba_seconds=rendering.seconds,
    )


class _Examination(NamedTuple):
    """The result of tracing pixels in exact arithmetic.

    Attributes
    ----------
    ties : (h, w) bool array
        Pixels where surfaces coincide, and both pictures are right.
    examined : int
        Number of traced pixels that are no ties.
    wrong : int
        Number of traced pixels in which exact arithmetic contradicts the tracer.
    first : (row, column) or None
        The first wrong pixel, or the first examined pixel if none is wrong.
    """

    ties: Bools
    examined: int = 0
    wrong: int = 0
    first: tuple[int, int] | None = None


def _examine_exactly(
    scene: Scene, image: Floats, mitsuba: Floats, differing: Bools, tolerance: float
) -> _Examination:
    """Trace pixels in which two pictures differ in exact arithmetic, in batches.

    Batches are traced until one contains a pixel that is not a tie of coinciding surfaces.

    Parameters
    ----------
    scene : Scene
        The scene.
    image, mitsuba : (h, w, 3) float array
        The tracer's picture, and Mitsuba's.
    differing : (h, w) bool array
        Pixels to examine.
    tolerance : float
        Permitted difference between a picture and the exact radiance.

    Returns
    -------
    examination : _Examination
        Which pixels are ties, and what the first batch with others shows.
    """
    pixels, ties = np.argwhere(differing), np.zeros_like(differing)
    batch_count = -(-len(pixels) // _PIXELS_PER_BATCH)
    for k in range(batch_count):
        rows, columns = batch = pixels[k::batch_count].T
        is_right, is_tie = _compare_exactly(scene, image, mitsuba, batch, tolerance)
        is_tie &= is_right
        ties[rows[is_tie], columns[is_tie]] = True
        if not is_tie.all():
            deciding = ~is_tie if is_right.all() else ~is_right
            row, column = batch[:, deciding][:, 0].tolist()
            return _Examination(ties, int((~is_tie).sum()), int((~is_right).sum()), (row, column))
    return _Examination(ties)


def _compare_exactly(
    scene: Scene, image: Floats, mitsuba: Floats, pixels: Ints, tolerance: float
) -> tuple[Bools, Bools]:
    """Compare the values of some pixels in two pictures with exact arithmetic.

    The tracer is right if its value is exact for the scene, or for a scene so similar that float64
    cannot distinguish the two.  If surfaces tie, it must show the first in the scene file.

    Parameters
    ----------
    scene : Scene
        The scene.
    image, mitsuba : (h, w, 3) float array
        The tracer's picture, and Mitsuba's.
    pixels : (2, n) int array
        Row 0 contains the rows of the pixels, row 1 their columns.
    tolerance : float
        Permitted difference between a picture and the exact radiance.

    Returns
    -------
    is_right : (n,) bool array
        Whether the tracer's value is exact.
    is_tie : (n,) bool array
        Whether Mitsuba's value is exact, with either the first or the last of the surfaces that
        tie.
    """
    rows, columns = pixels
    is_right, is_tie = np.zeros((2, len(rows)), dtype=np.bool_)
    for near_scene, shift in _indistinguishable_scenes(scene):
        x, y = columns + 0.5 + shift, rows + 0.5 + shift
        for ties in ("first", "last"):
            exact_radiance = plain.trace(near_scene, x, y, arithmetic="decimal", ties=ties).radiance
            error = np.abs(mitsuba[rows, columns] - exact_radiance).max(axis=1)
            is_tie |= error <= tolerance
            if ties == "first":
                error = np.abs(image[rows, columns] - exact_radiance).max(axis=1)
                is_right |= error <= tolerance
        if is_right.all():
            break
    return is_right, is_tie


def _indistinguishable_scenes(scene: Scene) -> Iterator[tuple[Scene, float]]:
    """Yield a scene, and similar scenes that rounding to float64 may not distinguish from it.

    Yields
    ------
    near_scene : Scene
        The scene, or the scene with spheres that are slightly larger or smaller.
    shift : float
        Distance by which the samples are to be moved to the right and down, in pixels.
    """
    yield scene, 0.0
    for shift in (-_MAX_SHIFT, _MAX_SHIFT):
        yield scene, shift
    for factor in (1 - _MAX_GROWTH, 1 + _MAX_GROWTH):
        surfaces = (
            replace(s, radius=s.radius * factor) if isinstance(s, Sphere) else s
            for s in scene.surfaces
        )
        yield replace(scene, surfaces=Surfaces.from_objects(surfaces)), 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare the scenes that the command line names, and write and print the results.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default those of the process.

    Returns
    -------
    status : int
        The exit status: 0 if all scenes agree, 1 if one differs or cannot be compared, 3 if one is
        undecided and none is worse.

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the output folder cannot be made.
    SystemExit
        If the arguments are wrong.
    """
    command_parser = make_parser("reference.check")
    add_scene_arguments(command_parser)
    add = command_parser.add_argument
    add("--flavour", choices=("exact", "stock"), default="exact", help="see above")
    options = command_parser.parse_args(arguments)
    scenes = skip_converted(options.scenes)
    ending = ".check.png" if options.flavour == "exact" else f".{options.flavour}.check.png"
    default_paths = [str(scene.parent / f"{scene.stem}{ending}") for scene in scenes]
    names = [*map(str, scenes)]
    targets = choose_output_paths(command_parser, names, options.output, default_paths)
    choose_variant(options.variant, status=MISUSED)
    make_output_folder(options.output)
    # If a picture is black, the comparison shows it.
    warnings.simplefilter("ignore", SceneWarning)
    pairs = track(zip(scenes, map(Path, targets), strict=True), len(scenes), "scenes")
    return worst_status([attempt(_check_to_file, *pair, options) for pair in pairs])


def worst_status(results: Iterable[CheckResult | Failure]) -> int:
    """Return the exit status of a command after several comparisons.

    Parameters
    ----------
    results : iterable of CheckResult or Failure
        The comparisons, or the reasons why they were impossible.

    Returns
    -------
    status : int
        1 if one differs or was impossible, otherwise 3 if one is undecided, otherwise 0.
    """
    statuses = {
        FAILED if isinstance(result, Failure) else STATUS[result.verdict] for result in results
    }
    return FAILED if FAILED in statuses else max(statuses, default=0)


def _check_to_file(path: Path, target: Path, options: argparse.Namespace) -> CheckResult:
    """Compare one scene's pictures, write a picture of the comparison, and print the result.

    Parameters
    ----------
    path : Path
        The scene file.
    target : Path
        The picture to write, which shows both pictures and their difference.
    options : Namespace
        The command-line options `variant` and `flavour`.

    Returns
    -------
    result : CheckResult
        The comparison.

    Raises
    ------
    Failure
        If the scene cannot be read, converted or compared, or the picture cannot be written.
    """
    result = check(path, options.variant, options.flavour)
    labels = ("tracer", f"Mitsuba {result.variant}")
    with errors_as_failure(target, "written", "choose another with -o"):
        write_comparison(target, result.tracer, result.mitsuba, labels)
    print_line(sys.stdout, result.report())
    print_line(sys.stdout, printable(f"  {target}"))
    return result
