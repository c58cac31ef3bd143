"""The grader says nothing false of mistakes that it does not know, and tells symptoms in words."""

from dataclasses import replace

import pytest
import student
from test_handins import scene

from reference.handins.diagnosis import Diagnosis, Reference
from reference.pictures import Picture


def diagnose_changed(name: str, *changes: tuple[str, str]) -> Diagnosis:
    """Diagnose a small picture of the student's tracer after changes of its source."""
    small = replace(scene(name), width=scene(name).width // 2, height=scene(name).height // 2)
    source = student.SOURCE
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    codes = student.render_with_source(source, small)
    return Reference(small, f"{name}.xml").diagnose(Picture(codes))


@pytest.mark.parametrize("name", ["two-boxes", "one-box"])
def test_speckles_on_boxes(name: str) -> None:
    """Double precision darkens some faces of a box at random, and others as a whole."""
    changes = ("if m != k", "if True"), ("way, 1e-7) < 1", "way, 0) < 1")
    assert diagnose_changed(name, *changes).kind == "shadow-speckles"


NO_FALSE_ALARM = [
    # Two surfaces are black; crescents are all that is left of the spheres.
    ("four-spheres", "image[mine] = color", "image[mine] = color * (k not in (1, 2))"),
    ("four-spheres", "image[mine] = color", "image[mine] = color * (dot(n, -ray) < 0.3)[:, None]"),
    # The shading is a little off: no rounding, and no gamma.
    ("highlights", "KS * shine", "1.05 * KS * shine"),
    ("highlights", "** EXPONENT", "** (EXPONENT + 0.5)"),
    ("two-boxes", "return codes", "return np.maximum(codes, 2) - np.uint8(2)"),
]


@pytest.mark.parametrize(("name", "old", "new"), NO_FALSE_ALARM)
def test_an_unknown_mistake_gets_no_known_cause(name: str, old: str, new: str) -> None:
    diagnosis = diagnose_changed(name, (old, new))
    assert (diagnosis.kind, diagnosis.hint) == ("unknown", "")


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
    hidden = diagnose_changed("two-boxes", ("new = t < best", "new = (t < best) & (k != 1)"))
    assert hidden.kind == "hidden-surface-1"


def test_outward_normals_do_not_change_the_diagnosis() -> None:
    """A tracer whose normals are never turned is right, but shows the far sides in another way."""
    changes = ("np.where(near > least, near, far)", "far"), ("-n, n)", "n, n)")
    assert "root-far-all" in diagnose_changed("non-square-pixels", *changes).kind.split("|")


def test_highlights_without_a_test_of_nl() -> None:
    """No shadows, and exponent 1: highlights show on the dark sides, unlike in a right picture."""
    changes = ("np.where(nl > 0, KS * shine, 0)", "KS * shine"), ("if m != k", "if False")
    diagnosis = diagnose_changed("four-spheres", *changes, ("EXPONENT", "1"))
    assert diagnosis.kind == "shadow-none+exponent-1"
