"""The certificate's bounds are sound: no sample, and no mean of many samples, exceeds them.

Single samples at random points test the bounds that hold everywhere in a cell.  Millions of samples
test the bounds on means.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from probe import scene_of
from random_scenes import KINDS, random_scene
from scene_files import HardScene, hard_scenes, small_scene

from reference.judges import cell_analysis, certificate, certified_scene
from reference.judges.arrays import Floats, Ints, find_in_sorted, sum_by_index
from reference.judges.cell_analysis import CellAnalysis
from reference.judges.cells import Cells, Contributions
from reference.judges.certificate import CellEstimates, certify
from reference.judges.certified_scene import CertifiedScene
from reference.judges.enclosures import CONSTANT, ERROR, UNKNOWN_Z, Enclosures
from reference.judges.ray_functions import Cone
from reference.judges.regions import Strips, divide_into_regions
from reference.judges.sampling import compute_rms_error, render_supersampled
from reference.judges.shadow_volumes import ShadowVolumes
from reference.measured.workloads import build_crowd_scene, copy_with_picture_size
from tracer import Box, Camera, Scene, Sphere, render
from tracer.trace.radiance import compute_radiance
from tracer.trace.samples import Scattered

KINDS_WITHOUT_CROWD = [kind for kind in KINDS if kind != "crowd"]

Patch = pytest.MonkeyPatch


class EnclosureSampler:
    """A comparison of all enclosures of radiance with samples at random points of each cell.

    The bound on a sample's error is the sum of the enclosure's maximum deviation, the region's
    sample error, and the jumps of all strips that contain the point.
    """

    max_excess: float  # maximum of a sample's error minus the bound on it
    sample_count: int

    def __init__(self, monkeypatch: Patch) -> None:
        self.max_excess, self.sample_count, self.rng = -np.inf, 0, np.random.default_rng(0)
        shade, estimate_means = certificate.shade, certificate.estimate_means

        def shade_and_check(analysis: CellAnalysis, *args: object) -> Contributions:
            contributions, cells = shade(analysis, *args), analysis.cells
            is_alone = np.bincount(cells.cell_index, minlength=cells.x.size)[cells.cell_index] == 1
            index = np.flatnonzero(is_alone & cells.covers_cell & cells.is_settled.all(axis=1))
            for _ in range(4):
                self.compare(cells.radiance[index], *self.sample(analysis, cells.cell_index[index]))
            return contributions

        def estimate_and_check(analysis: CellAnalysis, *args: object) -> CellEstimates:
            estimates = estimate_means(analysis, *args)
            for _ in range(4):
                self.check_estimates(analysis, estimates)
            return estimates

        monkeypatch.setattr(certificate, "shade", shade_and_check)
        monkeypatch.setattr(certificate, "estimate_means", estimate_and_check)

    def sample(self, analysis: CellAnalysis, cell_index: Ints) -> tuple[Floats, Floats, Floats]:
        """Compute the radiance (3, n) at one random point of each cell, and return its X and Y."""
        cells, (x, y) = analysis.cells, self.rng.uniform(-1, 1, (2, cell_index.size))
        half_width, radiance = cells.width / 2, np.empty((3, cell_index.size))
        positions = cells.x[cell_index] + half_width * x, cells.y[cell_index] + half_width * y
        samples, position_index = Scattered.from_positions(*positions)
        radiance[:, position_index] = compute_radiance(analysis.scene.prepared_scene, samples)
        self.sample_count += cell_index.size
        return radiance, x, y

    def compare(
        self, enclosures: Enclosures, radiance: Floats, x: Floats, y: Floats, extra_error: float = 0
    ) -> None:
        """Compare samples with enclosures whose error bounds are increased by `extra_error`."""
        powers = np.array([np.ones(x.size), x, y, x * x, x * y, y * y])
        estimate = (enclosures.coefficients[:UNKNOWN_Z] * powers[:, None]).sum(axis=0)
        excess = np.abs(radiance - estimate) - enclosures.max_deviation - extra_error
        self.max_excess = excess.max(initial=self.max_excess)

    def check_estimates(self, analysis: CellAnalysis, estimates: CellEstimates) -> None:
        """Compare one sample of each cell with the enclosure of the region that contains it."""
        strips, regions, cell_count = estimates.strips, estimates.regions, analysis.cells.x.size
        radiance, x, y = self.sample(analysis, np.arange(cell_count))
        height = strips.compute_height(x[strips.cell_index], y[strips.cell_index])
        bit = np.arange(strips.cell_index.size) - strips.cell_index.searchsorted(strips.cell_index)
        side_bit = (height > 0) * 2.0**bit
        side_bits = sum_by_index(strips.cell_index, side_bit, cell_count).astype(int)
        strip_jump = (np.abs(height) <= strips.half_width) * strips.jump
        extra_error = sum_by_index(strips.cell_index, strip_jump, cell_count)
        # Regions are sorted by cell and side bits; very small regions may be missing.
        region_keys = 32 * regions.cell_index + regions.side_bits
        region = find_in_sorted(region_keys, 32 * np.arange(cell_count) + side_bits)
        cell = np.flatnonzero(region >= 0)
        region, extra_error = region[cell], extra_error[cell] + estimates.sample_error[region[cell]]
        self.compare(estimates.radiance[region], radiance[:, cell], x[cell], y[cell], extra_error)
        self.max_excess = (radiance - estimates.max_radiance).max(initial=self.max_excess)
        # The error of a cell includes the worst case in its strips.
        strip_error = sum_by_index(strips.cell_index, strips.area * strips.jump, cell_count)
        max_error = np.maximum(estimates.mean, estimates.max_radiance - estimates.mean).max(axis=0)
        missing_error = np.fmin(strip_error, max_error) - estimates.error
        self.max_excess = missing_error.max(initial=self.max_excess)


def make_scenes(kinds: list[str], seeds: range, light_scale: float = 1.0) -> Iterator[Scene]:
    """Yield random scenes, with the positions of their lights multiplied by a factor."""
    for scene in (random_scene(kind, seed) for seed in seeds for kind in kinds):
        lights = [
            replace(light, position=tuple(np.multiply(light.position, light_scale)))
            for light in scene.lights
        ]
        yield replace(scene, lights=lights)


def check_samples(monkeypatch: Patch, scenes: Iterator[Scene], error: float = 1 / 32) -> int:
    """Certify scenes, skip those that cannot be certified, and return the number of samples."""
    sampler = EnclosureSampler(monkeypatch)
    for scene in scenes:
        try:
            certify(scene, error)
        except ValueError as refusal:
            if not re.search("the eye is on a surface|a light is farther", str(refusal)):
                raise
        assert sampler.max_excess <= 1e-9
    return sampler.sample_count


@pytest.mark.parametrize("kind", KINDS_WITHOUT_CROWD)
def test_points(kind: str, monkeypatch: Patch) -> None:
    assert check_samples(monkeypatch, make_scenes([kind], range(6))) > 400


@pytest.mark.parametrize("light_scale", [1e4, 1e12])
def test_points_lit_by_distant_lights(light_scale: float, monkeypatch: Patch) -> None:
    scenes = make_scenes(["scattered", "touching", "rooms"], range(3), light_scale)
    assert check_samples(monkeypatch, scenes) > 1000


def test_points_of_crowds(monkeypatch: Patch) -> None:
    small_scenes = small_scene("sunflower", 6, 6), small_scene("many-objects", 16, 9)
    scenes = copy_with_picture_size(build_crowd_scene(80), 16, 9), *small_scenes
    assert check_samples(monkeypatch, iter(scenes)) > 100_000


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_points_of_many_scenes(kind: str, monkeypatch: Patch) -> None:
    seed_end = {"crowd": 11, "grazing": 16}.get(kind, 66)
    assert check_samples(monkeypatch, make_scenes([kind], range(6, seed_end))) > 10_000


def scale_field(name: str, factor: float) -> Callable[..., Strips]:
    """Make a function that multiplies a field of strips by a factor."""
    return lambda strips, *_: strips._replace(**{name: getattr(strips, name) * factor})


def narrow_enclosures(enclosures: Enclosures, *_: object) -> Enclosures:
    enclosures.coefficients[ERROR] *= 0.7
    return enclosures


def narrow_cones(cone: Cone, *_: object) -> Cone:
    cone.function.coefficients[CONSTANT] -= 1e-4 * np.abs(cone.function.coefficients[CONSTANT])
    return cone


def remove_last_edges(_: object, analysis: CellAnalysis) -> None:
    del analysis.edges[-1]


def remove_cone_planes(volumes: ShadowVolumes, *_: object) -> ShadowVolumes:
    volumes.half_space[5:] = 0
    return volumes


def remove_some_occluders(triples: Ints, *_: object) -> Ints:
    return triples[:, np.arange(triples.shape[1]) % 3 > 0]


def lower_enclosures(enclosures: Enclosures, *_: object) -> Enclosures:
    return Enclosures(enclosures.coefficients - 0.3 * np.abs(enclosures.coefficients[:1]))


DEFECTS: dict[str, tuple[object, str, Callable[..., object]]] = {
    "narrow powers": (Enclosures, "power", narrow_enclosures),
    "narrow products": (Enclosures, "__mul__", narrow_enclosures),
    "narrow strips": (certificate, "enclose_in_strips", scale_field("half_width", 0.5)),
    "small jumps": (certificate, "enclose_in_strips", scale_field("jump", 0.7)),
    "narrow cones": (cell_analysis, "enclose_cone", narrow_cones),
    "planes of shadows missing": (certified_scene, "compute_shadow_volumes", remove_cone_planes),
    "no terminators": (CellAnalysis, "_find_terminators", remove_last_edges),
    "no intersections": (CellAnalysis, "_find_intersections", remove_last_edges),
    "occluders missing": (CertifiedScene, "find_occluders", remove_some_occluders),
    "faces hidden too early": (Enclosures, "subtract_independent", lower_enclosures),
}
"""Defects of the certificate: each changes the results of a function so that bounds are unsound."""


@pytest.mark.parametrize("name", DEFECTS)
def test_unsound_bounds_are_detected(name: str, monkeypatch: Patch) -> None:
    owner, function_name, change = DEFECTS[name]
    function = getattr(owner, function_name)
    monkeypatch.setattr(owner, function_name, lambda *args: change(function(*args), *args))
    own_names = "room", "highlights", "touching", "sticks-perspective"
    random_scenes = make_scenes(KINDS_WITHOUT_CROWD, range(40))
    with pytest.raises((AssertionError, RuntimeError), match=r"contradicts|<= 1e-09"):
        check_samples(monkeypatch, chain(map(small_scene, own_names), random_scenes), 1 / 128)


def test_a_region_has_a_sample_error_if_its_centroid_is_in_a_strip() -> None:
    # Strips around x = 0 and x = 0.02; the centroids are at -0.5, 0.01 and 0.51.
    strips = Strips(
        cell_index=np.zeros(2, dtype=np.intp),
        a=np.ones(2),
        b=np.zeros(2),
        c=np.array([0, -0.02]),
        half_width=np.array([0.1, 0.001]),
        jump=np.array([3.0, 5.0]),
    )
    regions = divide_into_regions(strips, 1)
    assert certificate._bound_sample_errors(strips, regions, 1).tolist() == [0, 3, 0]


@pytest.mark.parametrize(("distance", "error"), [(1e-13, np.inf), (1e-11, 0.0)])
def test_the_sample_of_a_region_of_almost_no_area_proves_nothing(
    distance: float, error: float
) -> None:
    """The centroid of the region between two lines at this distance is mostly rounding error."""
    strips = Strips(
        cell_index=np.zeros(2, dtype=np.intp),
        a=np.ones(2),
        b=np.zeros(2),
        c=np.array([0, -distance]),
        half_width=np.zeros(2),
        jump=np.ones(2),
    )
    regions = divide_into_regions(strips, 1)
    assert certificate._bound_sample_errors(strips, regions, 1).tolist() == [0, error, 0]


@pytest.mark.parametrize("width", [0.25, 1, 4])
def test_the_means_of_a_cell_in_its_pixels_are_exact(width: float) -> None:
    """A polynomial of X and Y is compared with its means over pixels, by Gauss's quadrature."""
    picture = certificate._Picture(
        scene_of(Sphere(center=(0, 0, -5)), size=(8, 8), lights=(0, 0, 0)), 0.1
    )
    no_pairs, no_radiance = np.zeros(0, dtype=np.intp), Enclosures(np.zeros((8, 3, 0)))
    cells = Cells(
        width=width,
        x=np.array([width / 2]),
        y=np.array([width / 2]),
        cell_index=no_pairs,
        face_index=no_pairs,
        covers_cell=no_pairs > 0,
        is_settled=np.zeros((0, 1), dtype=np.bool_),
        radiance=no_radiance,
        shadow_triples=np.zeros((3, 0), dtype=np.intp),
    )
    coefficients = np.random.default_rng(0).uniform(0.1, 1, (8, 3, 1))
    picture.add_cells(cells, np.array([0]), Enclosures(coefficients))
    pixel_width = min(width, 1)
    begin = np.arange(0, width, pixel_width)[:, None]
    nodes = 2 * (begin + pixel_width * (0.5 + np.array([-0.5, 0.5]) / np.sqrt(3))) / width - 1
    y, x = nodes[:, None, :, None], nodes[None, :, None, :]
    terms = np.array([1 + 0 * x * y, x + 0 * y, y + 0 * x, x * x + 0 * y, x * y, y * y + 0 * x])
    means = np.tensordot(coefficients[:UNKNOWN_Z, :, 0], terms.mean(axis=(3, 4)), (0, 0))
    expected = np.zeros(picture.image.shape)
    expected[:, : begin.size, : begin.size] = pixel_width**2 * means
    np.testing.assert_allclose(picture.image, expected, atol=1e-14)


def assert_means_are_certified(scene: Scene, sample_count: int) -> None:
    """Assert that the means of many samples agree with the certified means."""
    certified, sampled_image = certify(scene, 1 / 256), render(scene, sample_count)
    assert certified.error.max() <= 1 / 256
    assert ((certified.low <= certified.image) & (certified.image <= certified.high)).all()
    assert sampled_image.max() > 0.3
    assert np.abs(certified.image - sampled_image).max() < 0.01
    assert compute_rms_error(certified.image, sampled_image) < 1e-3


@pytest.mark.parametrize("name", ["room", "highlights", "many-objects", "touching"])
def test_means(name: str) -> None:
    assert_means_are_certified(small_scene(name, 24, 14), 256)


@pytest.mark.parametrize("hard_scene", hard_scenes("certificate"))
def test_means_of_hard_scenes(hard_scene: HardScene) -> None:
    assert_means_are_certified(hard_scene.scene, *hard_scene.samples)


@np.errstate(all="ignore")
def test_the_rim_of_a_sheet_shows_its_face() -> None:
    """A ray through the rim hits a side of the sheet that has no area."""
    sheet = Box(min_pt=(-1, -1, -4), max_pt=(1, 1, -4))
    scene = CertifiedScene(scene_of(sheet, size=(8, 8), lights=(0, 0, 0)))
    _, sample_index, face_index = scene.trace_samples(np.array([4.0, 6, 2]), np.array([4.0, 4, 6]))
    assert sorted(sample_index) == [0, 1, 2]
    assert scene.faces.may_be_visible[face_index].all()


@pytest.mark.slow
@np.errstate(all="ignore")
@pytest.mark.parametrize("name", ["four-spheres", "room", "highlights", "sticks-perspective"])
def test_means_where_thousands_of_samples_err(name: str) -> None:
    """Four million samples confirm the bounds where 65 x 65 samples err most: in two pixels."""
    scene = small_scene(name, 24, 14)
    certified, prepared_scene = certify(scene, 1 / 32768), CertifiedScene(scene).prepared_scene
    difference = np.abs(render_supersampled(scene, 65) - certified.image).max(axis=2)
    for row, column in np.argwhere(difference >= np.sort(difference, axis=None)[-2]):
        radiance_sum, grid_side = np.zeros(3), 2048
        offsets = (np.arange(grid_side) + 0.5) / grid_side
        for y in row + offsets:
            samples, _ = Scattered.from_positions(column + offsets, np.full(grid_side, y))
            radiance_sum += compute_radiance(prepared_scene, samples).sum(axis=1)
        finer_difference = np.abs(radiance_sum / grid_side**2 - certified.image[row, column]).max()
        assert finer_difference <= certified.error[row, column] + 2e-5
        assert finer_difference < difference[row, column] / 5


def test_scenes_and_errors_that_cannot_be_certified() -> None:
    scene = scene_of(Sphere(center=(0, 0, -1), radius=1), size=(4, 4), lights=(1, 2, 3))
    distant_light = scene_of(Sphere(center=(0, 0, -5)), size=(4, 4), lights=(1e15, 0, 0))
    message = r"a light is farther away than 1e\+14 times the size of an object; move it closer"
    with pytest.raises(ValueError, match=message):
        certify(distant_light, 0.1)
    with pytest.raises(ValueError, match="the eye is on a surface; move it off"):
        certify(replace(scene, camera=Camera(view_point=(0, 0, 0))), 1 / 32)
    for error in (0, -1, np.nan):
        with pytest.raises(ValueError, match="the error must be more than 0, not"):
            certify(scene, error)


def test_supersampling_averages_pictures_with_shifted_samples() -> None:
    scene, offsets = small_scene("sticks-perspective", 16, 9), np.arange(-3, 4, 2) / 8
    expected = np.mean([render(scene, offset=(x, y)) for x in offsets for y in offsets], axis=0)
    # The same rays, except for the last bit, which changes no visible surface here.
    np.testing.assert_allclose(render_supersampled(scene, 4), expected, rtol=0, atol=1e-12)
