"""Many scenes in one command: which process renders which, the order of lines, and progress."""

import os
import random
import re
import resource
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from running import SCENE, needs_two, run, start_process, wait_until, workers_of

from tracer.command import batch, cli, progress
from tracer.command.batch import Batch, Job, Settings
from tracer.command.progress import Progress, track

SETTINGS = Settings(samples=1, size=None, file_format="png", quiet=True)


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Write forty scene files; the later the file, the smaller its picture."""
    paths = [tmp_path / f"{k:02}.xml" for k in range(40)]
    for k, path in enumerate(paths):
        path.write_text(SCENE.format(440 - 10 * k, 400))
    return paths


def codes(path: Path) -> tuple[tuple[int, int], bytes]:
    """Return the size and the codes of the picture of a scene."""
    with Image.open(f"{path}.png") as picture:
        return picture.size, picture.tobytes()


@pytest.mark.parametrize("processes", [1, 2])
def test_lines_and_errors_come_in_the_order_of_the_arguments(scenes, processes):
    for number in (3, 20, 38):
        scenes[number].write_text("<scene>")
    scenes[5].unlink()
    log = scenes[0].with_name("log")
    with log.open("w") as file:
        files = dict.fromkeys(("stdout", "stderr"), file)
        assert run(*scenes, "--processes", processes, **files)[0] == 1
    names = [
        re.match(rf"{scenes[0].parent}/(\d\d)", line)[1] for line in log.read_text().splitlines()
    ]
    assert names == sorted(names)
    assert {*names} == {path.stem for path in scenes}
    for path in scenes:
        assert Path(f"{path}.png").exists() != (path.stem in ("03", "05", "20", "38"))


def record_submissions(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record calls of `WorkerPool.submit`: return a list that receives the functions' names."""
    submitted, submit = [], batch.WorkerPool.submit

    def recording_submit(self: Any, function: Any, *arguments: Any) -> Any:
        submitted.append(function.func.__name__)
        return submit(self, function, *arguments)

    monkeypatch.setattr(batch.WorkerPool, "submit", recording_submit)
    return submitted


@pytest.mark.parametrize(
    ("count", "size", "expected"),
    [
        (1, (300, 200), set()),  # one small scene starts no process
        (3, (30, 20), set()),  # and neither do a few that take less time than starting it
        (1, (4000, 3000), {"render_encoded_tile"}),
        # Two whole scenes, and the third is shared.
        (3, (4000, 3000), {"render_encoded_tile", "_render_in_worker"}),
        (40, (400, 400), {"_render_in_worker"}),
    ],
)
def test_whole_scenes_are_distributed_and_large_ones_are_shared(
    count, size, expected, tmp_path, monkeypatch
):
    paths = [tmp_path / f"{k}.xml" for k in range(count)]
    for path in paths:
        path.write_text(SCENE.format(*size))
    submitted = record_submissions(monkeypatch)
    batch_of_two = Batch(SETTINGS, 2)
    assert batch_of_two.render([Job(str(path), f"{path}.png") for path in paths])
    batch_of_two.close()
    assert {*submitted} == expected
    assert len({codes(path) for path in paths}) == 1


def test_a_large_scene_among_many_is_shared(scenes, monkeypatch):
    monkeypatch.setattr(batch, "_MAX_UNSHARED_SECONDS", 0.05)
    scenes[30].write_text(SCENE.format(4000, 2000))
    submitted = record_submissions(monkeypatch)
    batch_of_two = Batch(SETTINGS, 2)
    assert batch_of_two.render([Job(str(path), f"{path}.png") for path in scenes])
    batch_of_two.close()
    assert {*submitted} == {"render_encoded_tile", "_render_in_worker"}
    assert codes(scenes[30])[0] == (4000, 2000)


def test_a_worker_writes_the_picture_of_a_small_scene(scenes):
    """Otherwise the main process would silently repeat the work of all workers."""
    path = scenes[0]
    report = batch._render_in_worker(SETTINGS, Job(str(path), f"{path}.png"))
    (width, height), _ = codes(path)
    assert report == batch.Report(pixel_count=width * height)


def test_one_process_if_the_user_wants_no_more(scenes, monkeypatch):
    submitted = record_submissions(monkeypatch)
    assert cli.main([*map(str, scenes), "--processes", "1", "--quiet"]) == 0
    assert submitted == []


def test_this_process_repeats_what_workers_cannot_do(scenes, monkeypatch):
    """Workers, which are forked, have no memory to read a scene."""
    parent, load = os.getpid(), batch.load_scene

    def load_in_parent(path: str) -> Any:
        if os.getpid() != parent:
            raise MemoryError
        return load(path)

    monkeypatch.setattr(batch, "load_scene", load_in_parent)
    submitted = record_submissions(monkeypatch)
    batch_of_two = Batch(SETTINGS, 2)
    assert batch_of_two.render([Job(str(path), f"{path}.png") for path in scenes])
    batch_of_two.close()
    assert submitted
    assert all(Path(f"{path}.png").exists() for path in scenes)


@needs_two
def test_standard_input_among_many_scenes(scenes):
    """Workers cannot read standard input."""
    arguments = [*scenes[:20], "-", *scenes[20:], "-o", "new/", "--processes", 2, "--quiet"]
    ended = run(*arguments, cwd=scenes[0].parent, input=SCENE.format(7, 5))
    assert ended == (0, "", "")
    assert codes(scenes[0].parent / "new" / "-")[0] == (7, 5)


@needs_two
@pytest.mark.parametrize(
    "moments", [3, pytest.param(40, marks=pytest.mark.slow)], ids=["some", "many"]
)
def test_a_worker_that_dies_at_any_moment_costs_no_picture(scenes, moments):
    assert run(*scenes, "--quiet", "--processes", 1)[0] == 0
    expected = {path: codes(path) for path in scenes}
    rng = random.Random(moments)
    for number in range(moments):
        for path in scenes:
            Path(f"{path}.png").unlink()
        with start_process(*scenes, "--processes", 2) as process:
            wait_until(lambda process=process: workers_of(process) or process.poll() is not None)
            time.sleep(0.3 * rng.random())
            kind = signal.SIGSTOP if number % 3 == 2 else signal.SIGKILL
            for worker in workers_of(process):
                with suppress(ProcessLookupError):
                    os.kill(worker, kind)
            out, err = process.communicate(timeout=60)
        assert (process.returncode, err, out.count("\n")) == (0, "", len(scenes))
        assert {path: codes(path) for path in scenes} == expected


@needs_two
@pytest.mark.parametrize("limit", range(5, 15))
def test_few_open_files_suffice(scenes, limit):
    """All pictures are written, even if only a part of the pool can be started."""
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))  # noqa: E731
    assert run(*scenes, "--quiet", "--processes", 2, preexec_fn=few) == (0, "", "")
    assert all(Path(f"{path}.png").exists() for path in scenes)


def test_memory_and_open_files_do_not_grow_with_the_number_of_scenes(tmp_path):
    """The memory of this process and its workers, after 20 scenes and after 400."""
    path = tmp_path / "ball.xml"
    path.write_text(SCENE.format(40, 30))
    script = f"""if True:
        import os, resource, sys
        from tracer.command.batch import Batch, Job, Settings
        batch = Batch(Settings(1, None, "png", True), 2)
        for count in (20, 400):
            assert batch.render([Job({str(path)!r}, {str(path)!r} + ".png")] * count)
            usage = resource.getrusage(resource.RUSAGE_SELF)
            print(usage.ru_maxrss, len(os.listdir("/proc/self/fd")))
        batch.close()
    """
    status, out, err = run(python=("-c", script))
    assert (status, err) == (0, "")
    (few_memory, few_files), (memory, files) = (map(int, line.split()) for line in out.splitlines())
    assert memory < few_memory + 8000  # KiB
    assert files <= few_files + 10


@pytest.mark.parametrize("bar", ["shown", "missing", "refused"])
def test_a_slow_command_shows_its_progress_or_does_without(bar, scenes, monkeypatch, capsys):
    """The clock makes the work slow; tqdm reads its settings when it is imported."""
    for module in [name for name in sys.modules if name.partition(".")[0] == "tqdm"]:
        monkeypatch.delitem(sys.modules, module)
    if bar == "missing":
        monkeypatch.setitem(sys.modules, "tqdm", None)
    if bar == "refused":
        monkeypatch.setenv("TQDM_MININTERVAL", "often")
    monkeypatch.setattr(progress, "perf_counter", iter(range(0, 1000, 10)).__next__)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert cli.main([*map(str, scenes[-3:]), "--processes", "1"]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 3
    if bar == "shown":
        assert re.search(
            r"67%\|\S* *\| 2 of 3 pictures \[\d\d:\d\d, [\d:]+ left, 0[.]052 million", err
        )
    else:
        assert err == ""


def test_a_bar_is_shown_once_the_work_has_taken_a_second(monkeypatch, capsys):
    monkeypatch.setattr(progress, "perf_counter", iter([0, 0.9, 1.1, 1.2]).__next__)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown = []
    with Progress(4, "parts") as bar:
        for done in (1, 2, 3):
            bar.update(done)
            shown.append("parts" in capsys.readouterr().err)
    assert shown[:2] == [False, True]


def test_items_are_tracked_without_change(capsys):
    assert [*track(iter("abc"), 3, "letters")] == ["a", "b", "c"]
    assert capsys.readouterr().err == ""
