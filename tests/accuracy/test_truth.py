"""The true picture that errors are measured against: the same, in however many parts."""

import numpy as np
import pytest
from scene_files import small

from reference import command, truth
from reference.truth import Truth, supersampled
from tracer import render


def test_supersampling_in_parts_is_the_same(monkeypatch):
    scene, at = small("sticks-perspective", 16, 9), np.arange(-3, 4, 2) / 8
    by_hand = np.mean([render(scene, offset=(x, y)) for x in at for y in at], axis=0)
    for strip in (truth._STRIP, 4 * 4 * 16 * 2):
        monkeypatch.setattr(truth, "_STRIP", strip)
        # The same rays, but for the last bit, that decides no pixel here.
        np.testing.assert_allclose(supersampled(scene, 4), by_hand, rtol=0, atol=1e-12)


def test_truth_is_rows_of_the_whole_picture_and_kept(monkeypatch, tmp_path):
    scene = small("sticks-perspective", 16, 9)
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(truth, "_PIXELS", 16 * 9 // 4)
    kept = Truth.of(scene, 5)
    assert kept.radiance.shape == (2, 16, 3)
    whole = supersampled(scene, 5)
    assert kept.error(whole) < 1e-12
    assert kept.error(whole + 0.1) == pytest.approx(0.1)
    # For this scene and this code.
    monkeypatch.setattr(truth, "supersampled", None)
    assert np.array_equal(Truth.of(scene, 5).radiance, kept.radiance)
    for code, other in ((b"changed", scene), (truth._code(), small("room", 16, 9))):
        monkeypatch.setattr(truth, "_code", lambda code=code: code)
        with pytest.raises(TypeError):
            Truth.of(other, 5)
