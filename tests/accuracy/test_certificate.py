"""The certificate is sound: nowhere in a cell is radiance what the cell rules out.

Single samples at random points tell, for what a cell says of its points is strict.  What it says of
means is held against millions of samples.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from probe import scene_of
from random_scenes import KINDS, random_scene
from scene_files import small

from reference import command
from reference.judges import cells, certificate, forms
from reference.judges import true_picture as truth
from reference.judges.arrays import Floats, Ints, places
from reference.judges.cells import CellForms, Shades
from reference.judges.certificate import Enclosure, certify
from reference.judges.faces import Faces
from reference.judges.forms import Form, R, Z
from reference.judges.true_picture import supersampled, true_picture
from reference.measured.workloads import crowd, resized
from tracer import Camera, Scene, Sphere, render
from tracer.trace.radiance import radiance_at
from tracer.trace.samples import Scattered

HARD = [kind for kind in KINDS if kind != "crowd"]

Patch = pytest.MonkeyPatch


class Points:
    """Holds every enclosure against single samples, at four random points of each cell.

    `worst`: the most that radiance was farther from the form of its region than the form's radius,
    the region's doubt, and what may change in strips that hold the point; `count`: of points.
    """

    def __init__(self, monkeypatch: Patch) -> None:
        self.worst, self.count, self.rng = -np.inf, 0, np.random.default_rng(0)
        settle, enclose = CellForms.settle, certificate.enclose

        def settled(forms: CellForms, *args: object) -> Shades:
            shades, cells = settle(forms, *args), forms.cells
            alone = np.bincount(cells.cell, minlength=cells.x.size)[cells.cell] == 1
            at = np.flatnonzero(alone & cells.covers & cells.done.all(axis=1))
            for _ in range(4):
                self.held(cells.known[at], *self.sampled(forms, cells.cell[at]))
            return shades

        def enclosed(forms: CellForms, *args: object) -> Enclosure:
            result = enclose(forms, *args)
            for _ in range(4):
                self.check(forms, result)
            return result

        monkeypatch.setattr(CellForms, "settle", settled)
        monkeypatch.setattr(certificate, "enclose", enclosed)

    def sampled(self, forms: CellForms, cell: Ints) -> tuple[Floats, Floats, Floats]:
        """Radiance at random points of cells, and their coordinates there."""
        x, y = self.rng.uniform(-1, 1, (2, cell.size))
        half, radiance = forms.cells.size / 2, np.empty((3, cell.size))
        across, down = forms.cells.x[cell], forms.cells.y[cell]
        samples, order = Scattered.of(across + half * x, down + half * y)
        radiance[:, order] = radiance_at(forms.faces.prepared, samples)
        self.count += cell.size
        return radiance, x, y

    def held(self, form: Form, radiance: Floats, x: Floats, y: Floats, more: float = 0) -> None:
        powers = np.array([np.ones(x.size), x, y, x * x, x * y, y * y])
        value = (form.m[:Z] * powers[:, None]).sum(axis=0)
        excess = np.abs(radiance - value) - form.radius - more
        self.worst = excess.max(initial=self.worst)

    def check(self, forms: CellForms, result: Enclosure) -> None:
        lines, regions, n = result.lines, result.regions, forms.cells.x.size
        radiance, x, y = self.sampled(forms, np.arange(n))
        first = lines.cell.searchsorted(np.arange(n + 1))
        signs, allowed = np.zeros(n, dtype=int), result.loose.copy()
        for bit in range(int(np.diff(first).max(initial=0))):
            at = np.flatnonzero(first[:-1] + bit < first[1:])
            line = first[at] + bit
            z = lines.a[line] * x[at] + lines.b[line] * y[at] + lines.c[line]
            signs[at] |= (z > 0) << bit
            allowed[at] += (np.abs(z) <= lines.half[line]) * lines.jump[line]
        # Regions are sorted by cell and signs; very small ones may be missing.
        place = places(32 * regions.cell + regions.signs, 32 * np.arange(n) + signs)
        at = np.flatnonzero(place >= 0)
        form, more = result.radiance[place[at]], result.doubt[place[at]] + allowed[at]
        self.held(form, radiance[:, at], x[at], y[at], more)
        self.worst = (radiance - result.most).max(initial=self.worst)


def scenes(kinds: list[str], seeds: range, far: float = 1.0) -> Iterator[Scene]:
    """Random scenes, with their lights so many times as far away."""
    for scene in (random_scene(kind, seed) for seed in seeds for kind in kinds):
        lights = [replace(m, position=tuple(np.multiply(m.position, far))) for m in scene.lights]
        yield replace(scene, lights=lights)


def sound(monkeypatch: Patch, some: Iterator[Scene], error: float = 1 / 32) -> int:
    """Certify scenes, but those with the eye on a surface; the number of points that were held."""
    points = Points(monkeypatch)
    for scene in some:
        try:
            certify(scene, error)
        except ValueError as refused:
            if not re.search("the eye is on a surface|a light is more than", str(refused)):
                raise
        assert points.worst <= 1e-9
    return points.count


@pytest.mark.parametrize("kind", HARD)
def test_points(kind: str, monkeypatch: Patch) -> None:
    assert sound(monkeypatch, scenes([kind], range(6))) > 400


@pytest.mark.parametrize("far", [1e4, 1e12])
def test_points_under_distant_suns(far: float, monkeypatch: Patch) -> None:
    some = scenes(["scattered", "touching", "rooms"], range(3), far)
    assert sound(monkeypatch, some) > 1000


def test_points_of_crowds(monkeypatch: Patch) -> None:
    pictures = resized(crowd(200), 32, 18), small("sunflower", 16, 16), small("many-objects")
    assert sound(monkeypatch, iter(pictures)) > 50_000


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_points_of_many_scenes(kind: str, monkeypatch: Patch) -> None:
    last = {"crowd": 16, "grazing": 26}.get(kind, 126)
    assert sound(monkeypatch, scenes([kind], range(6, last))) > 10_000


def narrower(form: Form, *_: object) -> Form:
    form.m[R] *= 0.7
    return form


def with_less_in_cones(made: tuple[Form, Floats], *_: object) -> tuple[Form, Floats]:
    made[0].m[forms.C] -= 1e-4 * np.abs(made[0].m[forms.C])
    return made


def without_last_edges(made: object, self: CellForms) -> object:
    del self.edges[-1]
    return made


FAULTS: dict[str, tuple[object, str, Callable[..., object]]] = {
    "narrow powers": (Form, "power", narrower),
    "narrow products": (Form, "__mul__", narrower),
    "narrow strips": (certificate, "strips", lambda s, *_: s._replace(half=s.half * 0.5)),
    "small changes": (certificate, "strips", lambda s, *_: s._replace(jump=s.jump * 0.7)),
    "cones too narrow": (cells, "_cone", with_less_in_cones),
    "planes of shadows missing": (
        Faces,
        "_add_shadows",
        lambda _, self, *__: self.shadow[:, 5:].fill(0),
    ),
    "no terminators": (CellForms, "_find_terminators", without_last_edges),
    "no intersections": (CellForms, "_find_intersections", without_last_edges),
    "rows missing": (Faces, "blockers", lambda rows, *_: rows[:, np.arange(rows.shape[1]) % 3 > 0]),
    "hidden too soon": (cells, "difference", lambda f, *_: Form(f.m - 0.3 * np.abs(f.m[:1]))),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_found(fault: str, monkeypatch: Patch) -> None:
    owner, function, change = FAULTS[fault]
    real = getattr(owner, function)
    monkeypatch.setattr(owner, function, lambda *args: change(real(*args), *args))
    named = (small(name) for name in ("room", "highlights", "touching", "sticks-perspective"))
    with pytest.raises((AssertionError, RuntimeError), match=r"contradicts|<= 1e-09"):
        sound(monkeypatch, chain(named, scenes(HARD, range(40))), 1 / 128)


def test_means_of_cells_that_edges_do_not_divide(monkeypatch: Patch) -> None:
    side, held, enclose = 32, [], certificate.enclose
    y, x = ((m.ravel() + 0.5) / side * 2 - 1 for m in np.indices((side, side)))

    def checked(forms: CellForms, *args: object) -> Enclosure:
        result, half = enclose(forms, *args), forms.cells.size / 2
        for cell in np.flatnonzero(result.loose)[:20]:
            across, down = forms.cells.x[cell], forms.cells.y[cell]
            samples, _ = Scattered.of(across + half * x, down + half * y)
            mean = radiance_at(forms.faces.prepared, samples).mean(axis=1)
            held.append(np.abs(mean - result.mean[:, cell]).max() - result.error[cell])
        return result

    monkeypatch.setattr(certificate, "enclose", checked)
    monkeypatch.setattr(certificate, "_MOST_LINES", 0)
    for name in ("room", "sticks-perspective", "touching"):
        certify(small(name), 1 / 4)
    assert len(held) > 100
    assert max(held) <= 1 / side


@pytest.mark.parametrize("name", ["room", "highlights", "many-objects", "touching"])
def test_means(name: str) -> None:
    made, near = certify(small(name), 1 / 256), render(small(name), 256)
    assert made.error.max() <= 1 / 256
    assert (made.low <= made.image).all()
    assert (made.image <= made.high).all()
    assert np.abs(made.image - near).max() < 0.01
    assert np.sqrt(np.mean((made.image - near) ** 2)) < 6e-4


@pytest.mark.slow
@np.errstate(all="ignore")
@pytest.mark.parametrize("name", ["four-spheres", "room", "highlights", "sticks-perspective"])
def test_means_where_thousands_of_samples_err(name: str) -> None:
    """Of four pixels where 65 x 65 samples are farthest off, four million agree."""
    scene = small(name, 32, 18)
    made, prepared = certify(scene, 1 / 32768), Faces(scene).prepared
    many = supersampled(scene, 65)
    off = np.abs(many - made.image).max(axis=2)
    for row, column in np.argwhere(off >= np.sort(off, axis=None)[-4]):
        total, side = np.zeros(3), 2048
        for y in (np.arange(side) + 0.5) / side:
            x = column + (np.arange(side) + 0.5) / side
            samples, _ = Scattered.of(x, np.full(side, row + y))
            total += radiance_at(prepared, samples).sum(axis=1)
        far = np.abs(total / side**2 - made.image[row, column]).max()
        assert far <= made.error[row, column] + 2e-5
        assert far < off[row, column] / 5


def test_codes() -> None:
    scene = small("room")
    early, late = certify(scene, 1 / 8192, codes=True), certify(scene, 1 / 65536)
    assert early.cells < late.cells
    assert early.certain.mean() > 0.9
    both = early.certain & late.certain
    np.testing.assert_array_equal(early.codes[both], late.codes[both])


def test_what_cannot_be_certified() -> None:
    scene = scene_of(Sphere(center=(0, 0, -1), radius=1), size=(4, 4), lights=(1, 2, 3))
    far = scene_of(Sphere(center=(0, 0, -5)), size=(4, 4), lights=(1e15, 0, 0))
    with pytest.raises(ValueError, match=r"a light is more than 1e\+14 times as far as an object"):
        certify(far, 0.1)
    with pytest.raises(ValueError, match="the eye is on a surface; move it off"):
        certify(replace(scene, camera=Camera(view_point=(0, 0, 0))), 1 / 32)
    for error in (0, -1, np.nan):
        with pytest.raises(ValueError, match="the error must be more than 0, not"):
            certify(scene, error)


def test_supersampling_in_parts_is_the_same(monkeypatch: Patch) -> None:
    scene, at = small("sticks-perspective", 16, 9), np.arange(-3, 4, 2) / 8
    by_hand = np.mean([render(scene, offset=(x, y)) for x in at for y in at], axis=0)
    for strip in (truth._STRIP, 4 * 4 * 16 * 2):
        monkeypatch.setattr(truth, "_STRIP", strip)
        # The same rays, but for the last bit, that decides no pixel here.
        np.testing.assert_allclose(supersampled(scene, 4), by_hand, rtol=0, atol=1e-12)


def test_true_pictures_are_kept(monkeypatch: Patch, tmp_path: Path) -> None:
    scene = small("sticks-perspective", 16, 9)
    monkeypatch.setattr(command, "BUILD", tmp_path)
    made = true_picture(scene, 1 / 64)
    # For this scene, this error and this code.
    monkeypatch.setattr(truth, "certify", None)
    kept = true_picture(scene, 1 / 64)
    for name in ("low", "high", "image", "cells"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(made, name))
    for code, *other in (
        (b"changed", scene, 1 / 64),
        (truth._code(), small("room", 16, 9), 1 / 64),
    ):
        monkeypatch.setattr(truth, "_code", lambda code=code: code)
        with pytest.raises(TypeError):
            true_picture(*other)
