"""Scene files that tests write: the one-sphere scene, small, and another that is too bright."""

from __future__ import annotations

from pathlib import Path

__all__ = ["ONE_SPHERE", "overflowing", "small_one"]

ONE_SPHERE = Path(__file__).resolve().parent.parent / "scenes" / "one-sphere.xml"


def small_one(folder: Path, size: str) -> Path:
    """A scene in a folder, of so small a size (two numbers) that it is soon rendered."""
    scene = folder / "small.xml"
    text = ONE_SPHERE.read_text(encoding="utf-8")
    scene.write_text(text.replace("300 300", size), encoding="utf-8")
    return scene


def overflowing(scene: Path) -> Path:
    """A scene like another, whose radiance is more than float32 holds."""
    light = "<light><position>3 5 4</position></light>"
    text = scene.read_text(encoding="utf-8").replace(".25 .5 .85", "3e38 0 0")
    bright = scene.with_name("bright.xml")
    bright.write_text(text.replace("<image>", 3 * light + "<image>"), encoding="utf-8")
    return bright
