"""Pictures that processes share: any executor, its failures, and the command's own pool."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from probe import scene_of
from running import ROOT, SCENE, run, start_process, wait_until

from tracer import Camera, PointLight, Scene, Sphere, load_scene, render, save_scene
from tracer.command import cli
from tracer.picture import parallel
from tracer.picture import render as render_module
from tracer.picture.parallel import WorkerPool
from tracer.picture.render import RenderJob, render_tiles

SCENES = ROOT / "scenes"


def picture(width: int = 300, height: int = 200) -> Scene:
    """A sphere, in all of the picture but its corners."""
    camera = Camera(view_point=(0, 0, 4), proj_distance=4, view_width=2.2, view_height=2.2)
    lights = [PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 3))]
    return scene_of(Sphere(), camera=camera, size=(width, height), lights=lights)


class Counting(Executor):
    """Another executor that keeps its futures, and waits for the first of them.

    The first calls, or all, fail in a certain way.
    """

    def __init__(
        self, executor: Executor, fail: Callable[[], object] = len, failures: int = 0
    ) -> None:
        self.executor, self.futures = executor, list[Future[Any]]()
        self.fail, self.failures = fail, failures

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.futures) < self.failures:
            fn, args = self.fail, ()
        self.futures.append(self.executor.submit(fn, *args, **kwargs))
        self.futures[0].exception()
        return self.futures[-1]


def executor_of(kind: str, stack: ExitStack) -> Executor:
    if kind == "threads":
        return stack.enter_context(ThreadPoolExecutor(2))
    if kind == "loky":
        loky = pytest.importorskip("loky", reason="loky is not installed")
        pool = loky.ProcessPoolExecutor(2)
        stack.callback(pool.shutdown, kill_workers=True)
        return pool
    if kind == "dask":
        distributed = pytest.importorskip("distributed", reason="distributed is not installed")
        options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
        client = stack.enter_context(distributed.Client(**options))
        return stack.enter_context(client.get_executor())
    context = multiprocessing.get_context(kind)
    return stack.enter_context(ProcessPoolExecutor(2, context))


needs_two = pytest.mark.skipif(parallel.processors() < 2, reason="there is one processor")


@pytest.fixture
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pictures have many tiles, and share even the smallest ones."""
    monkeypatch.setattr(render_module, "MIN_SHARED_SECONDS", 0)
    for name in ("_MAX_TILE_SAMPLES", "_MAX_CLASSIFIED_TILE_SAMPLES"):
        monkeypatch.setattr(render_module, name, 1000)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks, and of what Dask imports
@pytest.mark.parametrize("kind", ["fork", "spawn", "forkserver", "threads", "loky", "dask"])
def test_any_executor_draws_the_same_picture(kind, small_tiles, capfd):
    with ExitStack() as stack:
        counting = Counting(executor_of(kind, stack))
        for scene, samples in ((picture(), 1), (picture(400, 3), 1), (picture(90, 60), 16)):
            alone = render(scene, samples)
            counting.futures.clear()
            assert np.array_equal(render(scene, samples, executor=counting), alone)
            assert counting.futures[0].exception() is None
            assert all(f.cancelled() or f.exception() is None for f in counting.futures)
    if kind != "dask":  # which logs what it likes
        assert capfd.readouterr() == ("", "")


def test_without_an_executor_nothing_is_started(small_tiles):
    before = threading.active_count()
    render(picture())
    assert threading.active_count() == before
    assert multiprocessing.active_children() == []


def run_out_of_memory() -> None:
    raise MemoryError


@pytest.mark.parametrize(
    ("fail", "times"),
    [
        (partial(os._exit, 1), 1),
        (run_out_of_memory, 1000),
        (lambda: None, 1000),  # cannot be pickled, as scenes with shaders of another type
    ],
)
def test_what_an_executor_fails_to_do_is_done_here(fail, times, small_tiles, capfd):
    scene = picture()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        failing = Counting(pool, fail, times)
        assert np.array_equal(render(scene, executor=failing), render(scene))
        assert failing.futures[0].exception() is not None
    assert capfd.readouterr() == ("", "")


class Waiting(Executor):
    """An executor whose results come when this process waits for them; counts unfinished calls."""

    def __init__(self) -> None:
        self.unfinished = list[tuple[Future[Any], Callable[[], Any]]]()
        self.max_unfinished = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        future.set_running_or_notify_cancel()
        self.unfinished.append((future, partial(fn, *args, **kwargs)))
        self.max_unfinished = max(self.max_unfinished, len(self.unfinished))
        return future

    def finish(self, *_: Any) -> bool:
        future, call = self.unfinished.pop(0)
        future.set_result(call())
        return True


@pytest.mark.parametrize("processors", [1, 2, 6, 100])
def test_an_executor_has_work_for_all_processors_and_no_more(processors, small_tiles, monkeypatch):
    for module in (parallel, render_module):
        monkeypatch.setattr(module, "processors", lambda: processors)
    waiting = Waiting()
    monkeypatch.setattr(parallel.Distribution, "_wait", waiting.finish)
    assert np.array_equal(render(picture(), executor=waiting), render(picture()))
    tiles = len(RenderJob(picture()).tiles(shared=True))
    share = tiles * processors // (processors + 1)
    assert waiting.max_unfinished == min(2 * processors, share)
    assert waiting.unfinished == []


@pytest.mark.parametrize("processors", [2, 16])
@pytest.mark.parametrize(
    ("name", "size", "samples"),
    [
        ("one-sphere", (4000, 3000), 1),
        ("room", (1920, 1080), 16),
        ("room", (320, 180), 40_000),
        ("many-objects", (320, 180), 20_000),
        ("room", (40, 30), 999_999_999),
    ],
)
def test_all_processors_have_tiles(processors, name, size, samples, monkeypatch):
    monkeypatch.setattr(render_module, "processors", lambda: processors)
    width, height = size
    scene = replace(load_scene(SCENES / f"{name}.xml"), width=width, height=height)
    for shared in (False, True):
        job = RenderJob(scene, samples)
        tiles = job.tiles(shared=shared)
        assert len(tiles) >= min(job.seconds / 0.25, width * height)
        assert len(tiles) >= min(4 * processors, job.seconds / 0.05) or not shared
        counts = np.zeros((height, width), dtype=int)
        for tile in tiles:
            counts[tile] += 1
        assert (counts == 1).all()


def test_a_worker_remembers_the_jobs_of_several_pictures():
    """Each of four pictures that are rendered in turns is prepared once."""
    jobs = [RenderJob(picture(), samples) for samples in (1, 4, 9, 16)]
    first, second = ([pickle.loads(pickle.dumps(job)) for job in jobs] for _ in range(2))
    assert [*map(id, first)] == [*map(id, second)]
    assert not {*map(id, first)} & {*map(id, jobs)}


@pytest.mark.parametrize("samples", [1, 4, 30])
def test_the_picture_is_the_same_however_it_is_divided(samples, monkeypatch):
    scene = replace(load_scene(SCENES / "room.xml"), width=16, height=9)
    images = []
    for seconds in (1e-9, 1e-4, 1):  # tiles of a pixel, of a row or two, and of the whole picture
        monkeypatch.setattr(render_module, "_MAX_TILE_SECONDS", seconds)
        images.append(render(scene, samples))
    assert len(RenderJob(scene, samples).tiles(shared=False)) == 1
    assert np.array_equal(images[0], images[2])
    assert np.array_equal(images[1], images[2])


def test_a_program_with_threads_is_not_forked(monkeypatch):
    """Another thread may hold a lock, which stays locked in the fork."""
    wait = threading.Event()
    thread = threading.Thread(target=wait.wait)
    thread.start()
    try:
        executor: Any = WorkerPool(1)._started()
        assert executor._mp_context.get_start_method() == "spawn"
    finally:
        wait.set()
        thread.join()


def test_an_executor_that_is_shut_down():
    pool = ThreadPoolExecutor(1)
    pool.shutdown()
    assert np.array_equal(render(picture(), executor=pool), render(picture()))


def test_an_error_here_is_raised_here(small_tiles, monkeypatch):
    monkeypatch.setattr(render_module, "radiance_at", lambda *_, **__: run_out_of_memory())
    with ThreadPoolExecutor(1) as pool, pytest.raises(MemoryError):
        render(picture(), executor=pool)


def tiles_of(scene: Scene, samples: int, workers: int) -> list[bytes]:
    with closing(WorkerPool(workers)) as pool:
        return [tile.data.data for tile in render_tiles(RenderJob(scene, samples), pool)]


@pytest.mark.parametrize("samples", [1, 16])
def test_the_pool_of_the_command_draws_the_same(samples, small_tiles):
    drawn = [tiles_of(picture(), samples, workers) for workers in (0, 1, 2, 8)]
    # With one process tiles are larger: only those that several share can be compared so.
    assert drawn[1] == drawn[2] == drawn[3]
    assert len(drawn[1]) > 3


@pytest.mark.parametrize(("size", "starts"), [((320, 180), 0), ((3000, 2000), 1)])
def test_a_small_picture_starts_no_process(size, starts, monkeypatch, tmp_path):
    monkeypatch.setattr(cli, "processors", lambda: 2)
    start = Mock(side_effect=OSError)
    monkeypatch.setattr(WorkerPool, "_started", start)
    save_scene(picture(*size), tmp_path / "scene.xml")
    assert cli.main([str(tmp_path / "scene.xml"), "--quiet"]) == 0
    assert start.call_count == starts


def test_leaving_early_ends_the_pool(small_tiles, monkeypatch):
    with closing(WorkerPool(1)) as pool:
        next(render_tiles(RenderJob(picture()), pool))
    wait_until(lambda: not multiprocessing.active_children())


@pytest.fixture
def large(tmp_path: Path) -> Path:
    """A scene that takes some seconds."""
    path = tmp_path / "large.xml"
    path.write_text(SCENE.format(6000, 5000))
    return path


def workers_of(process: subprocess.Popen[str]) -> Iterator[int]:
    """Wait for the workers of a command; yield their numbers."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    wait_until(lambda: bool(children.read_text()))
    yield from map(int, children.read_text().split())


@needs_two
def test_a_killed_worker_costs_time_not_the_picture(large, tmp_path):
    other = tmp_path / "other.png"
    assert run(large, "-o", other, "--quiet", "--processes", 1)[0] == 0
    with start_process(large, "--quiet", "--processes", 2) as process:
        for worker in workers_of(process):
            os.kill(worker, signal.SIGKILL)
        assert process.communicate(timeout=120) == ("", "")
    assert process.returncode == 0
    Image.MAX_IMAGE_PIXELS = None
    with Image.open(f"{large}.png") as a, Image.open(other) as b:
        assert a.size == b.size
        assert a.tobytes() == b.tobytes()


@needs_two
def test_workers_end_with_a_command_that_is_killed(large, tmp_path):
    with start_process(large, "--quiet", "--processes", 2) as process:
        workers = list(workers_of(process))
        process.kill()
        assert process.communicate(timeout=60) == ("", "")
    wait_until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))
    assert [path.name for path in tmp_path.iterdir()] == ["large.xml"]


def test_processors_are_those_that_may_be_used():
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(usable)})
    try:
        assert parallel.processors() == 1
    finally:
        os.sched_setaffinity(0, usable)
    assert parallel.processors() == len(usable)
