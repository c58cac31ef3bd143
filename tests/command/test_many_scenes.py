"""Many scenes in one command: which process renders which, the order of lines, and progress."""

import os
import re
import resource
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from probe import record_calls
from running import SCENE, needs_two, run, write_ball

from tracer.command import batch, cli, progress
from tracer.command.batch import Job, Settings
from tracer.command.progress import Progress, track


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Write forty scene files; the later the file, the smaller its picture."""
    return [write_ball(tmp_path / f"{k:02}.xml", 440 - 10 * k, 400) for k in range(40)]


def read_codes(path: Path) -> tuple[tuple[int, int], bytes]:
    """Return the size and the 8-bit codes of the picture of a scene."""
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


@pytest.fixture(params=[True, False], ids=["processes", "threads"])
def submitted(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> list[type]:
    """Use two processes or threads on any machine; return the types of all items of workers.

    The list grows while commands run in this process.
    """
    monkeypatch.setattr(cli, "count_processors", lambda: 2)
    monkeypatch.setattr(batch, "has_gil", lambda: request.param)
    pool = batch.WorkerPool if request.param else batch.Threads
    return record_calls(monkeypatch, pool, "submit", lambda _pool, _function, item: type(item))


@pytest.mark.parametrize(
    ("count", "size", "expected"),
    [
        (1, (300, 200), set()),  # one small scene starts no process
        (3, (30, 20), set()),  # and neither do a few that take less time than starting it
        (1, (4000, 3000), {batch._Tile}),
        # Two whole scenes, and the third is shared.
        (3, (4000, 3000), {batch._Tile, Job}),
        (40, (400, 400), {Job}),
    ],
)
def test_whole_scenes_are_distributed_and_large_ones_are_shared(
    count, size, expected, tmp_path, submitted
):
    paths = [write_ball(tmp_path / f"{k}.xml", *size) for k in range(count)]
    assert cli.main([*map(str, paths), "--quiet"]) == 0
    assert {*submitted} == expected
    assert len({read_codes(path) for path in paths}) == 1


def test_a_large_scene_among_many_is_shared(scenes, submitted, monkeypatch):
    monkeypatch.setattr(batch, "_MIN_SHARED_SECONDS", 0.05)
    write_ball(scenes[30], 4000, 2000)
    assert cli.main([*map(str, scenes), "--quiet"]) == 0
    assert {*submitted} == {batch._Tile, Job}
    assert read_codes(scenes[30])[0] == (4000, 2000)


def test_a_worker_writes_the_picture_of_a_small_scene(scenes):
    """Otherwise the main process would silently repeat the work of all workers."""
    path = scenes[0]
    settings = Settings(samples=1, size=None, file_format="png", quiet=True)
    report = batch._process_in_worker(settings, Job(str(path), f"{path}.png", 1.0))
    (width, height), _ = read_codes(path)
    assert report == batch.Report(pixel_count=width * height)
    shared = Job(str(path), f"{path}.png", min_shared_seconds=0)
    assert batch._process_in_worker(settings, shared) is None


def test_one_process_if_the_user_wants_no_more(scenes, submitted):
    assert cli.main([*map(str, scenes), "--processes", "1", "--quiet"]) == 0
    assert submitted == []


def test_this_process_repeats_what_workers_cannot_do(scenes, submitted, monkeypatch):
    """Workers, which are forked or threads, have no memory to read a scene."""
    parent, load = os.getpid(), batch.load_scene

    def load_in_parent(path: str) -> Any:
        is_main_thread = threading.current_thread() is threading.main_thread()
        if os.getpid() != parent or not is_main_thread:
            raise MemoryError
        return load(path)

    monkeypatch.setattr(batch, "load_scene", load_in_parent)
    assert cli.main([*map(str, scenes), "--quiet"]) == 0
    assert submitted
    assert all(Path(f"{path}.png").exists() for path in scenes)


@needs_two
def test_standard_input_among_many_scenes(scenes):
    """Workers cannot read standard input."""
    arguments = [*scenes[:20], "-", *scenes[20:], "-o", "new/", "--processes", 2, "--quiet"]
    ended = run(*arguments, cwd=scenes[0].parent, input=SCENE.format(7, 5))
    assert ended == (0, "", "")
    assert read_codes(scenes[0].parent / "new" / "-")[0] == (7, 5)


@needs_two
@pytest.mark.parametrize("limit", range(5, 15))
def test_few_open_files_suffice(scenes, limit):
    """All pictures are written, even if only a part of the pool can be started."""
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))  # noqa: E731
    assert run(*scenes, "--quiet", "--processes", 2, preexec_fn=few) == (0, "", "")
    assert all(Path(f"{path}.png").exists() for path in scenes)


def test_memory_and_open_files_do_not_grow_with_the_number_of_scenes(tmp_path):
    """The memory of this process and its workers, after 20 scenes and after 400."""
    path = write_ball(tmp_path / "ball.xml", 40, 30)
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
            r"67%\|\S* *\| 2 of 3 pictures \[\d\d:\d\d, [\d:]+ left, [\d,]+ pixels\]", err
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
