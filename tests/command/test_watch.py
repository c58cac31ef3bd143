"""The option --watch: scenes are rendered again whenever they are saved."""

import os
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from running import start_process, write_ball

from tracer.command import cli, watch
from tracer.command.batch import Job


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Write the file of a scene with 40 x 30 pixels into an empty folder, and return its path."""
    return write_ball(tmp_path / "ball.xml", 40, 30)


@pytest.fixture(autouse=True)
def _limit_time() -> Iterator[None]:
    """Make a test fail that waits for ever, so that the others still run."""

    def fail(_number: int, _frame: object) -> None:
        pytest.fail("waited for a minute")

    old_handler = signal.signal(signal.SIGALRM, fail)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, old_handler)


def test_watch(scene):
    """Files are saved, are wrong, are corrected, are replaced, are removed."""
    missing = scene.with_name("missing.xml")
    other = write_ball(scene.with_name("other.xml"), 3, 3)
    with start_process(scene, other, missing, "--watch") as process:
        out, err = process.stdout, process.stderr
        assert err.readline() == "watching 3 scenes; press Ctrl-C to end\n"
        assert err.readline().startswith(f"{missing}: cannot be read: ")
        assert "ball.xml.png: 40 x 30" in out.readline()
        assert "other.xml.png: 3 x 3" in out.readline()
        write_ball(other, 5, 5)
        assert "other.xml.png: 5 x 5" in out.readline()
        scene.write_text("<scene>")
        assert "ball.xml:1: " in err.readline()
        write_ball(scene.with_name("new"), 8, 6).replace(scene)
        assert "ball.xml.png: 8 x 6" in out.readline()
        other.unlink()
        line = err.readline()
        while "other.xml: cannot be read" not in line:
            assert "ball.xml:" in line  # more errors of the version that was wrong
            line = err.readline()
        process.send_signal(signal.SIGINT)
        assert (process.wait(), out.read(), err.read()) == (130, "", "")


def test_watch_waits_until_a_file_is_complete(scene, monkeypatch):
    """An editor may write a file in pieces, each after a check of the file."""
    old, rendered = scene.read_text(), []
    new = old + "\n"
    steps = [partial(scene.write_text, text) for text in (new[:20], new[:40], new)]
    following = iter([*steps, dict, dict, sys.exit])
    monkeypatch.setattr(cli, "sleep", lambda _seconds: next(following)())
    read_all = lambda _, jobs: rendered.extend(Path(job.scene_path).read_text() for job in jobs)  # noqa: E731
    monkeypatch.setattr(cli.Batch, "render", read_all)
    with pytest.raises(SystemExit):
        cli.main([str(scene), "--watch"])
    assert rendered == [old, new]


def test_watch_sees_a_save_that_changes_only_the_content(scene, monkeypatch):
    """Two saves within the resolution of file times leave the same time, and maybe length.

    The last save is much later, and changes the time.
    """
    lights = "3 4 5", "5 4 3", "4 4 4", "3 3 3"
    texts = [scene.read_text().replace("3 4 5", light) for light in lights]
    old_time, rendered = scene.stat().st_mtime_ns, []

    def save(text: str, seconds: int = 0) -> None:
        scene.write_text(text)
        time = old_time + seconds * 10**9
        os.utime(scene, ns=(time, time))

    times = iter([0, 0.1, 0.2, 0.3, 2.0, 2.1, 20.0, 20.1, 40.0, 40.1, 60.0, 60.1])
    steps = [dict, partial(save, texts[1]), dict, partial(save, texts[2]), dict, dict]
    later_steps = [partial(save, texts[3], 20), dict, scene.unlink, sys.exit]
    following = iter([*steps, *later_steps])
    monkeypatch.setattr(watch, "monotonic", lambda: next(times))
    monkeypatch.setattr(cli, "sleep", lambda _seconds: next(following)())

    def read_or_skip(_batch: object, jobs: list[Job]) -> None:
        rendered.extend(Path(job.scene_path).read_text() for job in jobs)

    monkeypatch.setattr(cli.Batch, "render", read_or_skip)
    with pytest.raises(SystemExit):
        cli.main([str(scene), "--watch"])
    assert rendered == texts
