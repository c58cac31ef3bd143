"""Compare the tracer's pictures with Mitsuba's, pixel by pixel, in linear radiance.

    python -m reference.check SCENE.xml ...    writes NAME.check.png

Both renderers sample the centres of the pixels.  With --flavour exact (the default), all light is
compared, and Mitsuba uses this project's small plugins; with --flavour stock, only diffuse light is
compared, and Mitsuba uses its built-in plugins.

The verdict is one of three:
  agrees     The pictures are equal, apart from excluded pixels: pixels at edges, where float32 may
             show the other side, and ties, where two surfaces coincide and Mitsuba may show the
             other one.
  DIFFERS    Exact arithmetic contradicts the tracer, or the pictures differ too much as a whole.
  undecided  Exact arithmetic confirms the tracer: Mitsuba or the converter is wrong.

Exit status: 0 if all agree, 1 if one differs or cannot be compared, 2 for wrong usage or if
Mitsuba cannot run, 3 if one is undecided and none is worse.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import argparse
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Annotated as Shaped
from typing import Literal, NamedTuple, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from converters.flavours import (
    choose_reflectance_divisor,
    convert_to_exact,
    convert_to_stock,
    make_pixels_square,
)
from converters.mitsuba_xml import make_plugin
from converters.rendering import Rendering, load_into_mitsuba
from converters.to_mitsuba import (
    add_scene_arguments,
    mitsuba_errors_as_failure,
    set_up_mitsuba,
    skip_converted_scenes,
)
from converters.variant import LLVM, use_variant
from reference.command import make_parser
from reference.figures import Metrics, get_largest_difference, measure_differences, write_comparison
from reference.judges.arrays import Bools, Floats
from reference.judges.exact import judge_differing_pixels
from tracer import Lambertian, Scene, SceneWarning, Surfaces, load_scene, render, to_codes
from tracer.command.arguments import OUTPUT_REMEDY, choose_output_paths, make_output_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import FAILED, MISUSED, attempt, print_line
from tracer.command.progress import track
from tracer.messages import make_printable

Verdict: TypeAlias = Literal["agrees", "DIFFERS", "undecided"]
AGREES: Verdict = "agrees"
DIFFERS: Verdict = "DIFFERS"
UNDECIDED: Verdict = "undecided"
STATUS: dict[Verdict, int] = {AGREES: 0, DIFFERS: FAILED, UNDECIDED: 3}
"""Exit statuses by verdict."""


class Limits(NamedTuple):
    """Tolerances for the differences that Mitsuba's float32 arithmetic causes."""

    # Maximum difference of a pixel in linear radiance.  In pictures brighter than 1, it is relative
    # to the brightest pixel.
    difference: float
    # A pixel may differ more if an edge is this close to its centre, in pixels along each axis.
    shift: float


EXACT = Limits(difference=1e-4, shift=0.003)
# Mitsuba's built-in camera uses float32, and its shadow rays start above the surface.
STOCK = Limits(difference=1e-3, shift=0.03)

MAX_EDGE_SHARE = 0.015
"""Maximum share of the picture's pixels that may differ because of edges."""
MIN_SSIM = 0.999
"""Minimum structural similarity of pictures that agree."""
MAX_MEDIAN = 1e-6
"""Maximum median of the pixels' differences in pictures that agree."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The comparison of two pictures of a scene, rendered by the tracer and by Mitsuba."""

    name: str  # of the scene
    tracer_image: Shaped[Floats, "height width 3"]
    tracer_seconds: float  # time of the second rendering, because the first takes longer
    mitsuba: Rendering
    # Pixels that differ, but may do so because an edge is close to their centre.
    differs_at_edge: Shaped[Bools, "height width"]
    # Pixels that differ, but are right in both pictures, because two surfaces coincide.
    is_tie: Shaped[Bools, "height width"]
    is_disputed: Shaped[Bools, "height width"]  # all other pixels that differ
    # Disputed pixels that were traced in exact arithmetic: a sample, or all of them.
    is_examined: Shaped[Bools, "height width"]
    # Examined pixels in which exact arithmetic contradicts the tracer.
    is_wrong: Shaped[Bools, "height width"]
    # Differences without edge pixels and ties.  In pictures brighter than 1, they are relative to
    # the brightest pixel.
    metrics: Metrics

    @property
    def is_excluded(self) -> Shaped[Bools, "height width"]:
        """Pixels that are excluded from the metrics: edge pixels and ties."""
        return self.differs_at_edge | self.is_tie

    @property
    def verdict(self) -> Verdict:
        """The verdict on the tracer's picture.

        - `AGREES`: The picture equals Mitsuba's within tolerance, apart from excluded pixels.
        - `DIFFERS`: Exact arithmetic contradicts the picture, or a metric is out of tolerance.
        - `UNDECIDED`: The picture differs from Mitsuba's, but exact arithmetic finds no error in
          the examined pixels.
        """
        if self.is_disputed.any():
            return DIFFERS if self.is_wrong.any() else UNDECIDED
        return DIFFERS if describe_exceeded_tolerances(self.metrics) else AGREES

    @property
    def remarks(self) -> list[str]:
        """The reasons for the verdict, as a list of sentences without full stops."""
        sentences = []
        if self.is_tie.any():
            ties = _format_pixel_count(self.is_tie)
            sentences.append(f"where surfaces coincide, Mitsuba shows the other one in {ties}")
        if self.is_disputed.any():
            return sentences + self._describe_disputed_pixels()
        clauses = describe_exceeded_tolerances(self.metrics)
        return sentences + [f"out of tolerance: {clause}" for clause in clauses]

    def _describe_disputed_pixels(self) -> list[str]:
        """State how many pixels are disputed, and which picture exact arithmetic confirms."""
        pixels = _format_pixel_count(self.is_disputed)
        examined_count = int(self.is_examined.sum())
        wrong_count = int(self.is_wrong.sum())
        if wrong_count:
            row, column = np.argwhere(self.is_wrong)[0]
            finding = f"contradicts the tracer in {wrong_count} of {examined_count} examined pixels"
            conclusion = f"exact arithmetic {finding}"
        else:
            row, column = np.argwhere(self.is_disputed)[0]
            finding = f"confirms the tracer in all {examined_count} examined pixels"
            conclusion = f"Mitsuba or the converter is wrong: exact arithmetic {finding}"
        example = f"column {column}, row {row}"
        return [f"the pictures differ in {pixels}, for example at {example}", conclusion]

    def format_report(self) -> str:
        """Format the verdict, metrics, rendering times and remarks as lines of text."""
        lines = [
            f"{self.name}: {self.verdict}",
            f"  {self.metrics}",
            f"  excluded from the metrics: {self.differs_at_edge.sum()} edge pixels"
            f" ({self.differs_at_edge.mean():.3%}) and {self.is_tie.sum()} ties",
            f"  Mitsuba ({self.mitsuba.variant}) {self.mitsuba.seconds:.3f} s,"
            f" tracer {self.tracer_seconds:.3f} s",
        ]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])


def _format_pixel_count(mask: Shaped[Bools, "height width"]) -> str:
    """Format the number of pixels that a mask marks, such as "1,234 pixels"."""
    pixel_count = int(mask.sum())
    return f"{pixel_count:,} pixel{'s' * (pixel_count != 1)}"


def describe_exceeded_tolerances(metrics: Metrics) -> list[str]:
    """Describe the measures that are out of tolerance, each as "SSIM 0.99800 is below 0.999"."""
    clauses = []
    if metrics.ssim < MIN_SSIM:
        clauses.append(f"SSIM {metrics.ssim:.5f} is below {MIN_SSIM}")
    if metrics.median > MAX_MEDIAN:
        clauses.append(f"median difference {metrics.median:.1e} exceeds {MAX_MEDIAN:.0e}")
    return clauses


def find_pixels_near_edges(
    scene: Scene, picture: Shaped[Floats, "height width 3"], shift: float, tolerance: float
) -> Shaped[Bools, "height width"]:
    """Find the pixels of another renderer's picture that a nearby edge can explain.

    The tracer renders the scene four times, each time with all samples shifted by `shift` pixels
    along both axes.  A nearby edge can explain a pixel if its radiance is in the range of these
    four pictures, widened by the tolerance on both sides.
    """
    shifts = (-shift, shift)
    shifted_pictures = [render(scene, offset=(dx, dy)) for dx in shifts for dy in shifts]
    lower_bound = np.min(shifted_pictures, axis=0) - tolerance
    upper_bound = np.max(shifted_pictures, axis=0) + tolerance
    is_near_edge: Bools = ((lower_bound <= picture) & (picture <= upper_bound)).all(axis=2)
    return is_near_edge


def check_file(
    path: Path, variant: str | None = None, flavour: Literal["exact", "stock"] = "exact"
) -> CheckResult:
    """Render a scene file with the tracer and with Mitsuba, and compare the two pictures.

    Raise Failure if the scene cannot be read, converted or compared.

    Parameters
    ----------
    variant
        Mitsuba's variant; None for the fastest that works on this machine.
    flavour
        "exact" to compare all light, using this project's Mitsuba plugins; "stock" to compare only
        diffuse light, using Mitsuba's built-in plugins.
    """
    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    with mitsuba_errors_as_failure(path, "compared"):
        check = check_scene if flavour == "exact" else check_diffuse_light
        return check(scene, make_printable(path.stem), variant)


def check_scene(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare how the tracer and this project's Mitsuba plugins render a scene.

    Raise ConversionError if Mitsuba cannot represent the scene, and ValueError if a radiance is not
    finite.
    """
    render_with_mitsuba = load_into_mitsuba(str(convert_to_exact(scene)), variant)
    if use_variant(variant).variant == LLVM:
        render_with_mitsuba()  # compiles the kernel
    return compare(scene, name, render_with_mitsuba())


def check_diffuse_light(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare how the tracer and Mitsuba's stock plugins render the diffuse light of a scene.

    Stock plugins are built into Mitsuba.  They require square pixels, so the height of both
    pictures may differ from the scene's.  Raise ConversionError if Mitsuba cannot represent the
    scene, and ValueError if a radiance is not finite.
    """
    surfaces = Surfaces.from_objects(
        replace(surface, shader=Lambertian(diffuse=surface.shader.diffuse))
        for surface in scene.surfaces
    )
    diffuse_scene = replace(make_pixels_square(scene), surfaces=surfaces)
    image = np.zeros((diffuse_scene.height, diffuse_scene.width, 3))
    start_time = perf_counter()
    for light in diffuse_scene.lights:
        image += _render_diffuse_light(replace(diffuse_scene, lights=(light,)), variant)
    rendering = Rendering(image, use_variant(variant).variant, perf_counter() - start_time)
    return compare(diffuse_scene, f"{name}, diffuse light by stock plugins", rendering, STOCK)


def _render_diffuse_light(
    diffuse_scene: Scene, variant: str | None
) -> Shaped[Floats, "height width 3"]:
    """Render a scene of Lambertian surfaces that has one light, using Mitsuba's stock plugins.

    Lights in Mitsuba fall off with the square of the distance; lights in the scene format do not.
    So each pixel's radiance is multiplied by the squared distance from the light to the point that
    the pixel shows.
    """
    light = diffuse_scene.lights[0]
    white_light = replace(light, intensity=(1.0, 1.0, 1.0))
    mitsuba_document = convert_to_stock(replace(diffuse_scene, lights=(white_light,)), 1)
    _add_positions_and_center_samples(mitsuba_document.root)
    channels = load_into_mitsuba(str(mitsuba_document), variant)().image
    radiance = channels[..., :3]
    hit_position = channels[..., -3:]
    # The position and the intensity of the light in Mitsuba's units.
    emitter = next(mitsuba_document.root.iter("emitter"))
    point_element = next(emitter.iter("point"))
    rgb_element = next(emitter.iter("rgb"))
    light_position = [float(point_element.get(axis, "")) for axis in "xyz"]
    intensity = float(rgb_element.get("value", "").split()[0])
    squared_distance: Floats = ((hit_position - light_position) ** 2).sum(axis=2, keepdims=True)
    # Mitsuba's radiance of a white surface that faces the light at distance 1.
    divisor = np.pi * choose_reflectance_divisor(diffuse_scene.surfaces)
    radiance_at_distance_1 = intensity / divisor
    return radiance * squared_distance / radiance_at_distance_1 * light.intensity


def _add_positions_and_center_samples(root: ET.Element) -> None:
    """Change a stock Mitsuba scene, whose root element is given, in two ways.

    Mitsuba also outputs the position of each hit, in three more channels.  The samples are placed
    at the centres of the pixels.
    """
    plugins = {element.get("type"): element for element in root.iter()}
    integrator = plugins["direct"]
    root.remove(integrator)
    root.append(make_plugin("integrator", "aov", integrator, aovs="p:position"))
    sampler = plugins["multijitter"]
    sampler.set("type", "stratified")
    ET.SubElement(sampler, "boolean", name="jitter", value="false")


def compare(scene: Scene, name: str, rendering: Rendering, limits: Limits = EXACT) -> CheckResult:
    """Render a scene with the tracer, and compare the picture with Mitsuba's, `rendering`.

    Raise ValueError if a radiance in either picture is not finite.
    """
    if not np.isfinite(rendering.image).all():
        raise ValueError(
            "Mitsuba's radiance is not finite; keep the colours and lights of the scene closer to 1"
        )
    render(scene)  # the first rendering takes longer, so the second is timed
    start_time = perf_counter()
    image = render(scene)
    pictures = _Pictures(
        tracer_image=image, tracer_seconds=perf_counter() - start_time, mitsuba=rendering
    )
    result = _compare_pixels(scene, name, pictures, limits)
    if not result.is_examined.any() and describe_exceeded_tolerances(result.metrics):
        # The pictures differ too much as a whole, although no pixel does.
        result = _compare_pixels(scene, name, pictures, limits._replace(difference=MAX_MEDIAN))
    return result


class _Pictures(NamedTuple):
    """The two pictures of a scene: see `CheckResult`."""

    tracer_image: Shaped[Floats, "height width 3"]
    tracer_seconds: float
    mitsuba: Rendering


def _compare_pixels(scene: Scene, name: str, pictures: _Pictures, limits: Limits) -> CheckResult:
    """Find the pixels that differ by more than `limits.difference`, and judge them.

    A pixel is excluded if an edge or a tie explains it.  The metrics are computed without such
    pixels.
    """
    tracer_image = pictures.tracer_image
    mitsuba_image = pictures.mitsuba.image
    # Tolerances are for radiance up to 1.  Above 1, they scale with the darker picture's maximum,
    # so that a bug that brightens one picture cannot increase them.
    scale = max(1.0, min(float(tracer_image.max()), float(mitsuba_image.max())))
    tolerance = limits.difference * scale
    is_different = np.abs(tracer_image - mitsuba_image).max(axis=2) / scale > limits.difference
    differs_at_edge = _find_differences_at_edges(
        scene, mitsuba_image, is_different, limits.shift, tolerance
    )
    is_tie, is_examined, is_wrong = judge_differing_pixels(
        scene, tracer_image, mitsuba_image, is_different & ~differs_at_edge, tolerance
    )
    is_excluded = differs_at_edge | is_tie
    # Replace excluded pixels in the tracer's picture by Mitsuba's, never the reverse.
    compared_image = np.where(is_excluded[:, :, None], mitsuba_image, tracer_image)
    mask = None if is_excluded.all() else is_excluded
    return CheckResult(
        name=name,
        tracer_image=tracer_image,
        tracer_seconds=pictures.tracer_seconds,
        mitsuba=pictures.mitsuba,
        differs_at_edge=differs_at_edge,
        is_tie=is_tie,
        is_disputed=is_different & ~is_excluded,
        is_examined=is_examined,
        is_wrong=is_wrong,
        metrics=measure_differences(compared_image / scale, mitsuba_image / scale, mask),
    )


def _find_differences_at_edges(
    scene: Scene,
    mitsuba_image: Shaped[Floats, "height width 3"],
    is_different: Shaped[Bools, "height width"],
    shift: float,
    tolerance: float,
) -> Shaped[Bools, "height width"]:
    """Find the differing pixels that a nearby edge can explain (see `find_pixels_near_edges`).

    If more than `MAX_EDGE_SHARE` of all pixels were marked, none is: rounding causes fewer.
    """
    differs_at_edge = is_different.copy()
    if is_different.any():
        differs_at_edge &= find_pixels_near_edges(scene, mitsuba_image, shift, tolerance)
    if differs_at_edge.mean() > MAX_EDGE_SHARE:
        differs_at_edge[:] = False
    return differs_at_edge


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare the scenes on the command line, print the results, and write comparison pictures.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default, the arguments of this process.

    Returns
    -------
    exit_status : int
        0 if all scenes agree; 1 if one differs or cannot be compared; otherwise 3 (undecided).

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the output folder cannot be created.
    SystemExit
        If the arguments are wrong.
    """
    command_parser = make_parser("reference.check")
    add_scene_arguments(command_parser)
    flavours, flavour_help = ("exact", "stock"), "described above"
    command_parser.add_argument("--flavour", choices=flavours, default="exact", help=flavour_help)
    options = command_parser.parse_args(arguments)
    scene_paths = skip_converted_scenes(options.scenes)
    suffix = ".check.png" if options.flavour == "exact" else f".{options.flavour}.check.png"
    default_paths = [str(path.parent / f"{path.stem}{suffix}") for path in scene_paths]
    scenes = [*map(str, scene_paths)]
    outputs = choose_output_paths(command_parser, scenes, options.output, default_paths)
    set_up_mitsuba(options.variant, exit_status=MISUSED)
    make_output_folder(options.output)
    # Ignore warnings, for example of a black picture: the comparison shows what is wrong.
    warnings.simplefilter("ignore", SceneWarning)
    pairs = track(zip(scene_paths, map(Path, outputs), strict=True), len(scene_paths), "scenes")
    return choose_exit_status([attempt(_check_and_print, *pair, options) for pair in pairs])


def choose_exit_status(results: Iterable[CheckResult | Failure]) -> int:
    """Choose the exit status of a command that has compared several scenes.

    It is 0 if all scenes agree; 1 if one differs or cannot be compared; otherwise 3 (undecided).
    """
    statuses = (
        FAILED if isinstance(result, Failure) else STATUS[result.verdict] for result in results
    )
    severity_order = STATUS[AGREES], STATUS[UNDECIDED], FAILED
    return max(statuses, key=severity_order.index, default=0)


def _check_and_print(path: Path, comparison_path: Path, options: argparse.Namespace) -> CheckResult:
    """Check one scene, print the result, and write a comparison picture.

    `options` has the command's `variant` and `flavour`.  Raise Failure if the scene cannot be read,
    converted or compared, or if the picture cannot be written.
    """
    result = check_file(path, options.variant, options.flavour)
    picture_pair = to_codes(result.tracer_image), to_codes(result.mitsuba.image)
    difference = get_largest_difference(result.tracer_image - result.mitsuba.image)
    labels = ("tracer", f"Mitsuba {result.mitsuba.variant}")
    with errors_as_failure(comparison_path, "written", OUTPUT_REMEDY):
        write_comparison(comparison_path, picture_pair, difference, labels)
    print_line(sys.stdout, result.format_report())
    print_line(sys.stdout, make_printable(f"  {comparison_path}"))
    return result
