"""The certificate's bounds are sound: no sample, and no mean of many samples, exceeds them.

Single samples at random points test the bounds on all points of a cell.  Millions of samples test
the bounds on means.
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

from reference.judges import cell_analysis, certificate
from reference.judges.arrays import Floats, Ints, find_in_sorted
from reference.judges.cell_analysis import CellAnalysis, Contributions
from reference.judges.certificate import CellEstimates, certify
from reference.judges.enclosures import CONSTANT, RADIUS, UNKNOWN, Enclosures
from reference.judges.faces import Faces
from reference.judges.regions import Strips, divide_into_regions
from reference.judges.sampling import render_supersampled, root_mean_square_error
from reference.measured.workloads import build_crowd, resize_picture
from tracer import Box, Camera, Scene, Sphere, render
from tracer.trace.radiance import compute_radiance
from tracer.trace.samples import Scattered

HARD = [kind for kind in KINDS if kind != "crowd"]

Patch = pytest.MonkeyPatch


class SampledPoints:
    """Compare every enclosure that is computed with single samples, at random points of each cell.

    Attributes
    ----------
    max_excess : float
        Maximum excess of a sample over its bound.  The bound is the sum of the radius, the
        region's doubt, and the jumps of all strips that contain the point.
    count : int
        Number of samples.
    """

    def __init__(self, monkeypatch: Patch) -> None:
        self.max_excess, self.count, self.rng = -np.inf, 0, np.random.default_rng(0)
        shade, estimate_means = CellAnalysis.shade, certificate.estimate_means

        def checked_shade(analysis: CellAnalysis, *args: object) -> Contributions:
            contributions, cells = shade(analysis, *args), analysis.cells
            is_alone = np.bincount(cells.pair_cell, minlength=cells.x.size)[cells.pair_cell] == 1
            pair = np.flatnonzero(is_alone & cells.covers_cell & cells.is_settled.all(axis=1))
            for _ in range(4):
                self.compare(cells.radiance[pair], *self.sample(analysis, cells.pair_cell[pair]))
            return contributions

        def checked_estimate(analysis: CellAnalysis, *args: object) -> CellEstimates:
            result = estimate_means(analysis, *args)
            for _ in range(4):
                self.check(analysis, result)
            return result

        monkeypatch.setattr(CellAnalysis, "shade", checked_shade)
        monkeypatch.setattr(certificate, "estimate_means", checked_estimate)

    def sample(self, analysis: CellAnalysis, cell: Ints) -> tuple[Floats, Floats, Floats]:
        """Return the radiance (3, n) at random points of cells, and their X and Y in the cells."""
        x, y = self.rng.uniform(-1, 1, (2, cell.size))
        half, radiance = analysis.cells.width / 2, np.empty((3, cell.size))
        samples, order = Scattered.from_positions(
            analysis.cells.x[cell] + half * x, analysis.cells.y[cell] + half * y
        )
        radiance[:, order] = compute_radiance(analysis.faces.prepared, samples)
        self.count += cell.size
        return radiance, x, y

    def compare(
        self, enclosures: Enclosures, radiance: Floats, x: Floats, y: Floats, more: float = 0
    ) -> None:
        """Compare samples with enclosures, which may be exceeded by `more`."""
        powers = np.array([np.ones(x.size), x, y, x * x, x * y, y * y])
        value = (enclosures.coef[:UNKNOWN] * powers[:, None]).sum(axis=0)
        excess = np.abs(radiance - value) - enclosures.radius - more
        self.max_excess = excess.max(initial=self.max_excess)

    def check(self, analysis: CellAnalysis, result: CellEstimates) -> None:
        """Compare one sample of each cell with the enclosure of its region."""
        lines, regions, n = result.strips, result.regions, analysis.cells.x.size
        radiance, x, y = self.sample(analysis, np.arange(n))
        first_line = lines.cell.searchsorted(np.arange(n + 1))
        signs, allowed = np.zeros(n, dtype=int), np.zeros(n)
        for bit in range(int(np.diff(first_line).max(initial=0))):
            cell = np.flatnonzero(first_line[:-1] + bit < first_line[1:])
            line = first_line[cell] + bit
            z = lines.a[line] * x[cell] + lines.b[line] * y[cell] + lines.c[line]
            signs[cell] |= (z > 0) << bit
            allowed[cell] += (np.abs(z) <= lines.half_width[line]) * lines.jump[line]
        # Regions are sorted by cell and signs; very small ones may be missing.
        region = find_in_sorted(32 * regions.cell + regions.side_bits, 32 * np.arange(n) + signs)
        cell = np.flatnonzero(region >= 0)
        enclosures, more = result.radiance[region[cell]], result.sample_error[region[cell]] + allowed[cell]
        self.compare(enclosures, radiance[:, cell], x[cell], y[cell], more)
        self.max_excess = (radiance - result.max_radiance).max(initial=self.max_excess)
        # The error of a cell includes the worst case in its strips.
        strip_error = np.bincount(lines.cell, lines.area * lines.jump, n)
        max_error = np.maximum(result.mean, result.max_radiance - result.mean).max(axis=0)
        missing_error = np.fmin(strip_error, max_error) - result.error
        self.max_excess = missing_error.max(initial=self.max_excess)


def scenes(kinds: list[str], seeds: range, light_scale: float = 1.0) -> Iterator[Scene]:
    """Yield random scenes, with the positions of their lights multiplied by a factor."""
    for scene in (random_scene(kind, seed) for seed in seeds for kind in kinds):
        lights = [
            replace(light, position=tuple(np.multiply(light.position, light_scale)))
            for light in scene.lights
        ]
        yield replace(scene, lights=lights)


def check_points(monkeypatch: Patch, tested: Iterator[Scene], error: float = 1 / 32) -> int:
    """Certify scenes, except those that cannot be; return the number of points compared."""
    points = SampledPoints(monkeypatch)
    for scene in tested:
        try:
            certify(scene, error)
        except ValueError as refused:
            if not re.search("the eye is on a surface|a light is more than", str(refused)):
                raise
        assert points.max_excess <= 1e-9
    return points.count


@pytest.mark.parametrize("kind", HARD)
def test_points(kind: str, monkeypatch: Patch) -> None:
    assert check_points(monkeypatch, scenes([kind], range(6))) > 400


@pytest.mark.parametrize("light_scale", [1e4, 1e12])
def test_points_lit_by_distant_lights(light_scale: float, monkeypatch: Patch) -> None:
    tested = scenes(["scattered", "touching", "rooms"], range(3), light_scale)
    assert check_points(monkeypatch, tested) > 1000


def test_points_of_crowds(monkeypatch: Patch) -> None:
    pictures = (
        resize_picture(build_crowd(80), 16, 9),
        small_scene("sunflower", 6, 6),
        small_scene("many-objects", 16, 9),
    )
    assert check_points(monkeypatch, iter(pictures)) > 100_000


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_points_of_many_scenes(kind: str, monkeypatch: Patch) -> None:
    end = {"crowd": 16, "grazing": 26}.get(kind, 126)
    assert check_points(monkeypatch, scenes([kind], range(6, end))) > 10_000


def scaled(name: str, factor: float) -> Callable[..., Strips]:
    """Return a function that multiplies a field of strips by a factor."""
    return lambda strips, *_: strips._replace(**{name: getattr(strips, name) * factor})


def narrower(enclosures: Enclosures, *_: object) -> Enclosures:
    enclosures.coef[RADIUS] *= 0.7
    return enclosures


def with_narrower_cones(result: tuple[Enclosures, Floats], *_: object) -> tuple[Enclosures, Floats]:
    result[0].coef[CONSTANT] -= 1e-4 * np.abs(result[0].coef[CONSTANT])
    return result


def without_last_edges(_: object, self: CellAnalysis) -> None:
    del self._edges[-1]


def without_cone_planes(_: object, self: Faces, *__: object) -> None:
    self.shadow_volume[:, 5:] = 0


def without_third_occluders(triples: Ints, *_: object) -> Ints:
    return triples[:, np.arange(triples.shape[1]) % 3 > 0]


def lower(enclosures: Enclosures, *_: object) -> Enclosures:
    return Enclosures(enclosures.coef - 0.3 * np.abs(enclosures.coef[:1]))


BROKEN: dict[str, tuple[object, str, Callable[..., object]]] = {
    "narrow powers": (Enclosures, "power", narrower),
    "narrow products": (Enclosures, "__mul__", narrower),
    "narrow strips": (certificate, "enclose_in_strips", scaled("half_width", 0.5)),
    "small jumps": (certificate, "enclose_in_strips", scaled("jump", 0.7)),
    "narrow cones": (cell_analysis, "_enclose_cone", with_narrower_cones),
    "planes of shadows missing": (Faces, "_set_shadow_volumes", without_cone_planes),
    "no terminators": (CellAnalysis, "_find_terminators", without_last_edges),
    "no intersections": (CellAnalysis, "_find_intersections", without_last_edges),
    "occluders missing": (Faces, "find_occluders", without_third_occluders),
    "faces hidden too early": (Enclosures, "subtract_independent", lower),
}
"""Functions of the certificate, each with a change to its results that makes bounds unsound."""


@pytest.mark.parametrize("name", BROKEN)
def test_unsound_bounds_are_detected(name: str, monkeypatch: Patch) -> None:
    owner, function, change = BROKEN[name]
    real = getattr(owner, function)
    monkeypatch.setattr(owner, function, lambda *args: change(real(*args), *args))
    own = (small_scene(name) for name in ("room", "highlights", "touching", "sticks-perspective"))
    with pytest.raises((AssertionError, RuntimeError), match=r"contradicts|<= 1e-09"):
        check_points(monkeypatch, chain(own, scenes(HARD, range(40))), 1 / 128)


def test_a_region_is_doubtful_if_its_centroid_is_in_a_strip() -> None:
    # Strips around x = 0 and x = 0.02; the centroids are at -0.5, 0.01 and 0.51.
    lines = strips_of(np.array([1, 0, 0]), np.array([1, 0, -0.02]))
    lines = lines._replace(half_width=np.array([0.1, 0.001]), jump=np.array([3.0, 5.0]))
    doubt = certificate._bound_sample_errors(lines, divide_into_regions(lines, 1), 1)
    assert doubt.tolist() == [0, 3, 0]


def strips_of(*lines: Floats) -> Strips:
    """Make strips without width, around lines with coefficients (3,), in a single cell."""
    a, b, c = np.array([line / np.abs(line[:2]).sum() for line in lines]).T
    return Strips(np.zeros(a.size, dtype=np.intp), a, b, c, 0 * a, 0 * a)


def assert_means_are_certified(scene: Scene, samples: int) -> None:
    """Assert that the means of many samples agree with those that are certified."""
    certified, sampled = certify(scene, 1 / 256), render(scene, samples)
    assert certified.error.max() <= 1 / 256
    assert (certified.low <= certified.image).all()
    assert (certified.image <= certified.high).all()
    assert sampled.max() > 0.3
    assert np.abs(certified.image - sampled).max() < 0.01
    assert root_mean_square_error(certified.image, sampled) < 1e-3


@pytest.mark.parametrize("name", ["room", "highlights", "many-objects", "touching"])
def test_means(name: str) -> None:
    assert_means_are_certified(small_scene(name, 24, 14), 256)


@pytest.mark.parametrize("hard", hard_scenes("certificate"))
def test_means_of_hard_scenes(hard: HardScene) -> None:
    assert_means_are_certified(hard.scene, *hard.samples)


@np.errstate(all="ignore")
def test_the_rim_of_a_sheet_shows_its_face() -> None:
    """A ray through the rim hits a side of the sheet that has no area."""
    sheet = Box(min_pt=(-1, -1, -4), max_pt=(1, 1, -4))
    faces = Faces(scene_of(sheet, size=(8, 8), lights=(0, 0, 0)))
    _, sample, face = faces.trace_samples(np.array([4.0, 6.0, 2.0]), np.array([4.0, 4.0, 6.0]))
    assert sorted(sample) == [0, 1, 2]
    assert faces.may_be_visible[face].all()


@pytest.mark.slow
@np.errstate(all="ignore")
@pytest.mark.parametrize("name", ["four-spheres", "room", "highlights", "sticks-perspective"])
def test_means_where_thousands_of_samples_err(name: str) -> None:
    """Four million samples confirm the bounds in the pixels in which 65 x 65 samples err most."""
    scene = small_scene(name, 24, 14)
    certified, prepared_scene = certify(scene, 1 / 32768), Faces(scene).prepared
    sampled = render_supersampled(scene, 65)
    difference = np.abs(sampled - certified.image).max(axis=2)
    for row, column in np.argwhere(difference >= np.sort(difference, axis=None)[-4]):
        total, side = np.zeros(3), 2048
        for y in (np.arange(side) + 0.5) / side:
            x = column + (np.arange(side) + 0.5) / side
            samples, _ = Scattered.from_positions(x, np.full(side, row + y))
            total += compute_radiance(prepared_scene, samples).sum(axis=1)
        finer_difference = np.abs(total / side**2 - certified.image[row, column]).max()
        assert finer_difference <= certified.error[row, column] + 2e-5
        assert finer_difference < difference[row, column] / 5


def test_scenes_and_errors_that_cannot_be_certified() -> None:
    scene = scene_of(Sphere(center=(0, 0, -1), radius=1), size=(4, 4), lights=(1, 2, 3))
    distant = scene_of(Sphere(center=(0, 0, -5)), size=(4, 4), lights=(1e15, 0, 0))
    message = r"a light is more than 1e\+14 times as far away as an object is large; move it closer"
    with pytest.raises(ValueError, match=message):
        certify(distant, 0.1)
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
