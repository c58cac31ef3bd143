"""Mistakes in another tracer are found, and none is named that was not made."""

from __future__ import annotations

import random
import re
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import student
from PIL import Image

from reference.command import SCENES
from reference.handins.diagnosis import Solution
from reference.handins.drawing import draw
from reference.handins.formulas import parameters
from reference.handins.mistakes import RIGHT, mistakes_of
from reference.handins.reading import Codes, Picture, read_picture
from tracer import Scene, load_scene, render, to_codes

NAMES = ["four-spheres", "room", "highlights", "touching", "non-square-pixels", "two-boxes"]
NAMES += ["one-sphere", "sticks-perspective"]
SHIFTS = [kind for kind in student.MISTAKES if kind.startswith("shift")]


@cache
def scene(name: str) -> Scene:
    full = load_scene(SCENES / f"{name}.xml")
    wide = full.width != full.height
    return replace(full, width=240 if wide else 160, height=135 if wide else 160)


@cache
def diagnosis(name: str) -> Solution:
    return Solution(scene(name), f"{name}.xml")


def verdict(name: str, made: tuple[str, ...]) -> str | None:
    """How right the diagnosis is: it names what was made, or what draws the same; None: unseen."""
    codes = student.draw(scene(name), *made)
    if codes is None or (codes == diagnosis(name).codes).all() or not np.ptp(codes, (0, 1)).any():
        return None
    found = diagnosis(name).diagnose(Picture(codes)).kind
    causes = [cause.split("+") for cause in found.split("|")]
    if found == "unknown":
        return "vague"
    for cause in causes:
        drawn = draw(scene(name), *(kind for kind in cause if kind in mistakes_of(scene(name))))
        if {*made} == {*cause} or ((drawn != codes).any(axis=2).sum() <= 10 and {*made} > {*cause}):
            return "right"
    return "part" if any({*made} & {*cause} for cause in causes) else "wrong"


def verdicts(name: str, count: int, seed: int) -> Counter[str]:
    """So many pictures: a third with a shift and other single mistakes, the rest with pairs."""
    chance, found = random.Random(f"{name} {seed}"), Counter[str]()
    singles = [(kind,) for kind in chance.sample([*student.MISTAKES], len(student.MISTAKES))]
    shifts = [kinds for kinds in singles if kinds[0] in SHIFTS]
    for kinds in shifts:
        assert verdict(name, kinds) in ("right", None), kinds
    others = [kinds for kinds in singles if kinds not in shifts]
    while found.total() < count:
        half = others and found.total() < count // 2
        made = others.pop() if half else tuple(chance.sample([*student.MISTAKES], 2))
        if word := verdict(name, made):
            found[word] += 1
            if word in ("wrong", "vague"):
                print(name, made, word)
    return found


def test_the_student_draws_what_the_tracer_does() -> None:
    for name in NAMES:
        assert (student.draw(scene(name)) == to_codes(render(scene(name)))).all()
        assert (draw(scene(name)) == to_codes(render(scene(name)))).all()


def test_few_mistakes_are_found() -> None:
    found = verdicts("non-square-pixels", 20, 1)
    assert found["wrong"] == 0
    assert found["right"] + found["part"] >= 19


@pytest.mark.slow
def test_mistakes_are_found() -> None:
    """Two hundred pictures of eight scenes: 1 % are wrong at most, 94 % right or in part."""
    found = sum((verdicts(name, 25, 2) for name in NAMES), Counter[str]())
    print(found)
    assert found["wrong"] <= 2
    assert found["right"] + found["part"] >= 188


def test_every_mistake_of_the_table_can_be_drawn_and_most_show() -> None:
    """In formulas that exist, of values that exist."""
    table = mistakes_of(scene("room"))
    assert {name for one in table.values() for name in one.formulas} <= {*RIGHT}
    small = replace(scene("room"), width=40, height=30)
    for nothing in (replace(small, lights=[]), replace(small, surfaces=[])):
        for kind in mistakes_of(nothing):
            assert draw(nothing, kind).shape == (30, 40, 3), kind
    right = draw(small)
    shown = [kind for kind in table if (draw(small, kind) != right).any()]
    assert len(shown) > 0.8 * len(table) > 200
    assert all(text.endswith(".") for text, _ in table.values())
    known = {*RIGHT, *(name for f in RIGHT.values() for name in parameters(f))}
    used = {name for one in table.values() for f in one.formulas.values() for name in parameters(f)}
    assert used - known == {"handin", "phong"}


def test_what_no_mistake_draws_is_described() -> None:
    """Half as bright in a rectangle: surfaces, the worst pixel, and the command, but no cause."""
    codes = diagnosis("room").codes.copy()
    codes[60:90, 100:140] //= 2
    kind, text = diagnosis("room").diagnose(Picture(codes))
    assert kind == "unknown"
    assert text.startswith("No mistake of the table draws this. ")
    number, on, of = re.search(
        r"(\d+) pixels differ: (\d+) of (\d+) on \w+ \d \(line", text
    ).groups()
    assert int(number) == (abs(codes.astype(int) - diagnosis("room").codes) > 1).any(axis=2).sum()
    assert int(on) <= int(of)
    x, y, here, right = re.search(r"is (\d+),(\d+): ([\d ]+) in place of ([\d ]+);", text).groups()
    for image, words in ((codes, here), (diagnosis("room").codes, right)):
        assert image[int(y), int(x)].tolist() == [*map(int, words.split())]
    assert f"tracer room.xml --pixel {x},{y} explains it" in text


def test_lights_that_are_lacking_are_named() -> None:
    right = diagnosis("room").codes
    codes = np.where(
        np.indices(right.shape)[1] < 120, student.draw(scene("room"), "light-first"), right
    )
    kind, text = diagnosis("room").diagnose(Picture(codes))
    assert kind == "unknown"
    assert re.search(r"It lacks light 1 \(line \d+\) at \d+", text)


def test_speckles_and_single_precision() -> None:
    """Points are rounded to float32: their own surfaces shadow them."""
    source = student.SOURCE.replace("if m != k:", "if True:")
    source = source.replace(
        "(other, p, way, 1e-7)", "(other, p.astype('f4').astype(float), way, 0)"
    )
    assert (
        diagnosis("room").diagnose(Picture(student.run(source, scene("room")))).kind
        == "shadow-speckles"
    )
    few = diagnosis("room").codes.copy()
    near = to_codes(render(scene("room"), offset=(0.04, 0.0)))
    differ = np.argwhere((abs(near.astype(int) - few) > 1).any(axis=2))[:9]
    few[tuple(differ.T)] = near[tuple(differ.T)]
    assert diagnosis("room").diagnose(Picture(few)).kind == "single-precision"


@pytest.mark.parametrize("made", ["shadow-none", "gamma-none", "missing-surface-1", "mirrored"])
def test_a_jpeg_hides_nothing(tmp_path: Path, made: str) -> None:
    for kinds in ((), (made,)):
        path = tmp_path / "a.jpg"
        Image.fromarray(student.draw(scene("four-spheres"), *kinds)).save(path, quality=85)
        kind = diagnosis("four-spheres").diagnose(read_picture(path)).kind
        assert (made if kinds else "format") in kind.split("|")


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda a: a.swapaxes(0, 1), "transposed"),
        (lambda a: np.rot90(a), "turned-90|turned-270"),
        (lambda a: 0 * a, "black"),
        (lambda a: 0 * a + 9, "flat"),
        (lambda a: a, "identical"),
        (lambda a: a + (np.indices(a.shape).sum(axis=0) == 90).astype(np.uint8), "rounding"),
        (lambda a: to_codes(render(replace(scene("room"), width=120, height=80))), "size"),
        (lambda a: 255 - a, "negative"),
    ],
)
def test_whole_pictures(change, kind: str) -> None:
    found = diagnosis("room").diagnose(
        Picture(np.ascontiguousarray(change(diagnosis("room").codes)))
    )
    assert found.kind in kind.split("|"), found.text


def pair(*kinds: str) -> tuple[Codes, Codes]:
    return student.draw(scene("four-spheres"), *kinds), diagnosis("four-spheres").codes


@pytest.mark.parametrize(
    "kinds",
    [
        "mirrored",
        "flipped",
        "gamma-none",
        "gamma-srgb",
        "gamma-twice",
        "channels-BGR",
        *SHIFTS,
        "pixel-upper-left",
        "size-minus-1",
        "background",
        "levels-truncated",
        "mirrored gamma-none",
    ],
)
def test_geometry_and_encoding_are_named_without_a_scene(kinds: str) -> None:
    found = compare_pictures(*pair(*kinds.split()))
    assert found.kind == kinds.replace(" ", "+"), found.text


@pytest.mark.parametrize("kind", ["shadow-none", "reflection", "missing-surface-1", "light-first"])
def test_shading_is_described_without_a_scene(kind: str) -> None:
    found = compare_pictures(*pair(kind))
    assert found.kind == "unknown"
    assert re.search(r"A is (brighter|darker).* in \d+\.\d% of what is shown", found.text)
