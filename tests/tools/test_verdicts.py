"""The grader says nothing false of mistakes that it does not know, and tells symptoms in words."""

from dataclasses import replace
from functools import partial
from io import BytesIO

import numpy as np
import pytest
import student
from PIL import Image
from test_handins import reference, scene

from reference import pictures
from reference.handins.diagnosis import Diagnosis, Reference
from reference.handins.search import Submission
from reference.handins.symptoms import (
    find_wrong_edge,
    is_explained_by_rounding,
    is_jpeg_of_reference,
)
from reference.pictures import Codes, Picture
from tracer import render, to_codes


def diagnose_changed(name: str, *changes: tuple[str, str]) -> Diagnosis:
    """Diagnose a picture of the student's tracer after changes of its source."""
    source = student.SOURCE
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    return reference(name).diagnose(Picture(student.render_with_source(source, scene(name))))


@pytest.mark.parametrize("name", ["two-boxes", "one-box"])
def test_speckles_on_boxes(name: str) -> None:
    """Double precision darkens some faces of a box at random, and others as a whole."""
    changes = ("if m != k", "if True"), ("way, 1e-7) < 1", "way, 0) < 1")
    assert diagnose_changed(name, *changes).kind == "shadow-speckles"


NO_FALSE_ALARM = [
    # Crescents are all that is left of the spheres.
    ("four-spheres", "image[mine] = color", "image[mine] = color * (dot(n, -ray) < 0.3)[:, None]"),
    # The shading is a little off: no rounding, and no gamma.
    ("four-spheres", "KS * shine", "KS * shine * (0.96 + 0.1 * nl)"),
    # Levels that are rounded up explain nearly all pixels, but few of them exactly.
    ("four-spheres", "KS * shine", "KS * shine * (1 + 0.06 * nl)"),
    ("four-spheres", "** EXPONENT", "** (EXPONENT + 0.5)"),
    ("two-boxes", "return codes", "return np.maximum(codes, 2) - np.uint8(2)"),
    # Shading in steps has few colours, but all of them are darker.
    ("two-boxes", "KD * np.maximum(nl, 0)", "KD * np.floor(4 * np.maximum(nl, 0)) / 4"),
]


@pytest.mark.parametrize(("name", "old", "new"), NO_FALSE_ALARM)
def test_an_unknown_mistake_gets_no_known_cause(name: str, old: str, new: str) -> None:
    diagnosis = diagnose_changed(name, (old, new))
    assert (diagnosis.kind, diagnosis.hint) == ("unknown", "")


@pytest.mark.parametrize(
    ("count", "kind", "hint"),
    [(5, "shadow-none-light-0", ""), (9, "unknown", "shadow-none-light-0"), (40, "unknown", "")],
)
def test_a_cause_explains_nearly_all_and_a_hint_most_of_the_wrong_pixels(
    count: int, kind: str, hint: str
) -> None:
    """The mistake shows in about 220 pixels; `count` more are wrong."""
    codes = student.render_mistakes(scene("two-boxes"), "shadow-none-light-0")
    codes[0, :count] ^= 64
    diagnosis = reference("two-boxes").diagnose(Picture(codes))
    assert (diagnosis.kind, diagnosis.hint) == (kind, hint)


def test_no_light_comes_before_other_causes_of_darkness() -> None:
    changes = (
        ("color = np.zeros(p.shape)", "color = 0.1 + 0 * p"),
        ("color += see *", "color += 0 *"),
    )
    diagnosis = diagnose_changed("one-box", *changes)
    assert diagnosis.kind.split("|")[0] == "light-none+ambient-grey"


def test_black_and_hidden_surfaces_are_told_as_such() -> None:
    """A cause of black pixels cannot be told, so that their surface is named first."""
    black = diagnose_changed("two-boxes", ("image[mine] = color", "image[mine] = color * (k != 1)"))
    assert black.first_cause_text.endswith(" is black.")
    assert "unknown" not in black.kind
    two = ("image[mine] = color", "image[mine] = color * (k not in (1, 2))")
    assert diagnose_changed("four-spheres", two).kind == "black-surfaces"
    hidden = diagnose_changed("two-boxes", ("new = t < best", "new = (t < best) & (k != 1)"))
    assert hidden.kind == "hidden-surface-1"


def test_no_cause_of_a_nearly_black_picture_is_told() -> None:
    codes = np.zeros_like(reference("two-boxes").codes)
    codes[::7, ::7] = reference("two-boxes").codes[::7, ::7]
    diagnosis = reference("two-boxes").diagnose(Picture(codes))
    assert (diagnosis.kind, diagnosis.hint) == ("unknown", "")


def test_outward_normals_do_not_change_the_diagnosis() -> None:
    """A tracer whose normals are never turned is right, but shows the far sides in another way."""
    changes = ("np.where(near > least, near, far)", "far"), ("-n, n)", "n, n)")
    assert "root-far-all" in diagnose_changed("non-square-pixels", *changes).kind.split("|")


def test_highlights_without_a_test_of_nl() -> None:
    """No shadows, and exponent 1: highlights show on the dark sides, unlike in a right picture."""
    changes = ("np.where(nl > 0, KS * shine, 0)", "KS * shine"), ("if m != k", "if False")
    diagnosis = diagnose_changed("four-spheres", *changes, ("EXPONENT", "1"))
    assert diagnosis.kind == "shadow-none+exponent-1"


def test_exceptions_that_fill_a_square_refute_a_cause() -> None:
    """Small highlights are left of those of a squared exponent: it is false that there are none."""
    changes = ("EXPONENT", "sh.exponent**2"), ("return codes", "return codes[::-1, ::-1]")
    diagnosis = diagnose_changed("four-spheres", *changes)
    assert (diagnosis.kind, diagnosis.hint) == ("unknown", "turned-180")


@pytest.mark.parametrize(("count", "may_be_right"), [(20, True), (100, False)])
def test_a_pair_leaves_few_of_the_pixels_that_each_mistake_explains(
    count: int, may_be_right: bool
) -> None:
    """Highlights show in about 1,500 pixels, a mirrored picture in ten times as many."""
    codes = student.render_mistakes(scene("four-spheres"), "mirrored", "specular-none")
    codes[0, :count] ^= 64
    kinds = reference("four-spheres").diagnose(Picture(codes)).kind.split("|")
    assert kinds[0] == ("mirrored+specular-none" if may_be_right else "unknown")


def test_each_mistake_of_a_pair_explains_what_the_other_does_not() -> None:
    """Missing rows, not a mirrored picture, explain most of a picture with a light elsewhere."""
    light = "np.array(light.position)"
    changes = (light, f"{light} * (-1, 1, 1)"), ("return codes", "codes[1::2] = 0; return codes")
    diagnosis = diagnose_changed("non-square-pixels", *changes)
    assert (diagnosis.kind, diagnosis.hint) == ("unknown", "")


PAIRS = [
    # What is missing is no reason to doubt the camera, although few surfaces are left.
    ("non-square-pixels", "mirrored", "missing-sphere"),
    ("two-boxes", "viewDir-length", "missing-surface-1"),
    # Both change what is written.
    ("four-spheres", "channels-BGR", "rows-even-only"),
]


@pytest.mark.parametrize("mistakes", PAIRS)
def test_pairs_are_known(mistakes: tuple[str, ...]) -> None:
    name, *pair = mistakes
    codes = student.render_mistakes(scene(name), *pair)
    assert "+".join(pair) in reference(name).diagnose(Picture(codes)).kind.split("|")


FITTED = [
    ("four-spheres", "EXPONENT", "23", "The exponent is about 23 for all."),
    (
        "four-spheres",
        "color = np.zeros(p.shape)",
        "color = 0.07 + 0 * p",
        "An ambient term of about 0.0",
    ),
    (
        "two-boxes",
        "color += see *",
        "color += np.where(see, 1, 0.3) *",
        "have about 0.3 of the light",
    ),
    ("two-boxes", "** (1 / 2.2)", "** 1 / 2.2", "and levels are multiplied by about 0.45"),
    ("two-boxes", "return codes", "return codes // 24 * 24", "Levels are multiples of 24."),
    ("four-spheres", "part = KD *", "part = 0.4 * KD *", "diffuse term is multiplied by about 0.4"),
    ("four-spheres", "KS * shine", "1.05 * KS * shine", "Highlights are multiplied by about 1.05."),
]


@pytest.mark.parametrize(("name", "old", "new", "text"), FITTED)
def test_numbers_are_estimated(name: str, old: str, new: str, text: str) -> None:
    assert text in str(diagnose_changed(name, (old, new)))


FREQUENT = [
    (
        "four-spheres",
        "n = (p - CENTER) / RADIUS",
        "n = (eye - CENTER) / RADIUS + 0 * p",
        "normal-eye-sphere",
    ),
    (
        "four-spheres",
        "n = (p - CENTER) / RADIUS",
        "n = norm(eye - CENTER) + 0 * p",
        "normal-eye-sphere-unit",
    ),
    ("two-boxes", "else box_normal(s, p)", "else norm(p)", "normal-origin-box"),
    (
        "two-boxes",
        "normals[distance.argmin(-1)]",
        "np.eye(3)[abs(p - (lo + hi) / 2).argmax(-1)]",
        "normal-cube-box",
    ),
    (
        "two-boxes",
        "ray, sh = d[mine], s.shader",
        "ray, sh = d[mine], surfaces[k - 1].shader",
        "shader-previous",
    ),
    (
        "four-spheres",
        "list(scene.lights)",
        "[*scene.lights][:1] * len(scene.lights)",
        "light-first-all",
    ),
]


@pytest.mark.parametrize(("name", "old", "new", "kind"), FREQUENT)
def test_frequent_mistakes_are_known(name: str, old: str, new: str, kind: str) -> None:
    assert kind in diagnose_changed(name, (old, new)).kind.split("|")


def blacken_tiles(codes: Codes) -> Codes:
    codes[16:32, 32:48] = codes[32:48, 48:64] = 0
    return codes


def blacken(codes: Codes, rows: int | slice) -> Codes:
    codes[rows] = 0
    return codes


def end_within_row(codes: Codes) -> Codes:
    codes[40, 99:] = codes[41:] = 0
    return codes


# For each kind: how a right picture is changed, and what the grader says.
SYMPTOMS = {
    "unrendered": (
        lambda a: np.vstack([a[:41], 0 * a[41:]]),
        "except that it is black from row 41 on.",
    ),
    "ended within a row": (end_within_row, "except that it is black from row 40 on."),
    "one row": (partial(blacken, rows=np.s_[40]), "except that row 40 is black."),
    "every third row": (
        partial(blacken, rows=np.s_[1::3]),
        "except that 28 rows are black, the first of them row 22.",
    ),
    "tiles": (blacken_tiles, "except that 2 tiles of 16 x 16 pixels are black."),
    "scaled": (
        lambda a: np.asarray(Image.fromarray(a).resize((90, 90))),
        "It is the right picture, scaled.",
    ),
    "palette": (
        lambda a: np.asarray(Image.fromarray(a).quantize(200).convert("RGB")),
        "in few colours",
    ),
}


@pytest.mark.parametrize("kind", SYMPTOMS)
def test_symptoms_are_told(kind: str) -> None:
    change, text = SYMPTOMS[kind]
    diagnosis = reference("highlights").diagnose(
        Picture(change(reference("highlights").codes.copy()))
    )
    assert text in str(diagnosis)


def test_antialiased_pictures_are_told() -> None:
    codes = to_codes(render(scene("one-box"), samples=64))
    assert reference("one-box").diagnose(Picture(codes)).kind == "smoothed"


@np.errstate(all="ignore")
def test_rounding_does_not_explain_a_difference_of_several_levels() -> None:
    renderer = Reference(replace(scene("room"), width=10, height=10))._get_renderer(10, 10)
    codes = renderer.reference_codes.copy()
    codes[:, 55] ^= 4
    assert not is_explained_by_rounding(Submission(codes, renderer))


def test_an_edge_is_wrong_only_if_nothing_else_is() -> None:
    is_wrong = np.zeros((9, 9), dtype=np.bool_)
    assert find_wrong_edge(is_wrong) == ""
    is_wrong[2:4, -1] = True
    assert find_wrong_edge(is_wrong) == "last column"
    is_wrong[5, 5] = True
    assert find_wrong_edge(is_wrong) == ""


def test_jpeg_compression_does_not_explain_a_single_wrong_pixel() -> None:
    gray = np.full((16, 16, 3), 128, np.uint8)  # JPEG compression does not change it
    codes = gray.copy()
    codes[5, 5] = 255
    assert not is_jpeg_of_reference(codes, gray)


def test_a_jpeg_encoder_compresses_bands_like_the_whole_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    codes = reference("room").codes
    Image.fromarray(codes).save(file := BytesIO(), "JPEG", quality=70, subsampling=2)
    image = Image.open(file)
    monkeypatch.setattr(pictures, "_PIXELS_PER_BAND", 1)
    assert np.array_equal(pictures._make_jpeg_encoder(image)(codes), np.asarray(image))
