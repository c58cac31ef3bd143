"""The command that certifies pictures: its output, its verdicts and its failures."""

import numpy as np
import pytest
from PIL import Image
from scene_files import small_scene

from reference.certify import count_wrong_codes, main
from reference.judges.certificate import Certificate, certify
from tracer import render, save_scene, to_codes

# Bounds on the radiance of two pixels: lower bounds, then upper bounds.
BOUNDS = (0.5, 0.2), (0.5003, 0.6)


@pytest.fixture
def room(tmp_path, monkeypatch):
    """The scene "room" with 32 x 18 pixels, as room.xml in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    save_scene(small_scene("room", 32, 18), path := tmp_path / "room.xml")
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[str]]:
    """Run the command; return its exit status and the lines that it prints."""
    status = main(arguments)
    return status, capsys.readouterr().out.splitlines()


@pytest.mark.usefixtures("room")
def test_a_picture_is_written_and_described(capsys):
    status, lines = run(capsys, "room.xml", "--error", "1/64")
    certificate = certify(small_scene("room", 32, 18), 1 / 64)
    assert status == 0
    within, certain, last = lines
    assert within.startswith("576 of 576 pixels are within 1/64; all are within 0.01")
    count = certificate.is_certain.sum()
    assert certain == f"8-bit codes are certain in {count} of 576 pixels, {count / 576:.2%}"
    assert last.startswith(f"room.xml.certified.png: {certificate.cell_count} cells in ")
    with Image.open("room.xml.certified.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), to_codes(certificate.image))


@pytest.mark.usefixtures("room")
def test_codes_that_are_certainly_wrong_are_counted(capsys):
    arguments = "room.xml", "-o", "out.png", "--error", "1/512", "--judge", "room.png"
    run(capsys, "room.xml", "-o", "room.png", "--error", "1/512")
    assert run(capsys, *arguments)[1][2] == "room.png: no code is certainly wrong"
    codes = np.array(Image.open("room.png"))
    right = int(codes[7, 5, 1])
    for wrong in (right - 60, right + 60):
        codes[7, 5, 1] = wrong
        Image.fromarray(codes).save("room.png")
        status, lines = run(capsys, *arguments)
        assert status == 1
        verdict = "room.png: 1 of 1728 codes are certainly wrong, by up to 60, at 5,7, where G is "
        assert lines[2] == f"{verdict}{wrong} and must be {right}"


@pytest.mark.usefixtures("room")
def test_pixels_that_exceed_the_permitted_error_are_counted(capsys, monkeypatch):
    # Both pixels have wide bounds, and the codes of the first are certain nevertheless.
    low, high = (np.array([[[first] * 3, [second] * 3]]) for first, second in BOUNDS)
    errors = list[float]()

    def certify(_scene: object, error: float, _progress: object) -> Certificate:
        errors.append(error)
        return Certificate(low, high, low, 7)

    monkeypatch.setattr("reference.certify.certify", certify)
    for options, error, count in (((), 1 / 128, 1), (("--error", "1/65536"), 1 / 65536, 2)):
        _, lines = run(capsys, "room.xml", *options)
        assert errors[-1] == error
        assert lines[1] == "8-bit codes are certain in 1 of 2 pixels, 50.00%"
        assert lines[2] == f"{count} pixels have larger error bounds, because edges touch there"


def test_codes_within_the_bounds_are_not_wrong():
    """A single sample per pixel has wrong codes at edges, many samples have few."""
    scene = small_scene("room", 32, 18)
    certificate = certify(scene, 1 / 1024)
    wrong = [count_wrong_codes(certificate, to_codes(render(scene, n)))[0] for n in (1, 1024)]
    assert wrong[1] < wrong[0] / 20
    for bound in (certificate.low, certificate.high):
        assert count_wrong_codes(certificate, to_codes(bound))[0] == 0
