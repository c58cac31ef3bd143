"""Pictures that processes share: any executor, its failures, and the command's own pool."""

import multiprocessing
import os
import resource
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from probe import scene_of
from running import SCENE, run, started, wait_until

from tracer import Camera, PointLight, Scene, Sphere, render
from tracer.picture import parallel
from tracer.picture import render as render_module
from tracer.picture.render import render_tiles


def picture(width: int = 300, height: int = 200) -> Scene:
    """A sphere, in all of the picture but its corners."""
    camera = Camera(view_point=(0, 0, 4), proj_distance=4, view_width=2.2, view_height=2.2)
    lights = [PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 3))]
    return scene_of(Sphere(), camera=camera, size=(width, height), lights=lights)


class Counting(Executor):
    """Another executor that keeps its futures; the first of them, or all, fail in a certain way."""

    def __init__(
        self, executor: Executor, fail: Callable[[], object] = len, failures: int = 0
    ) -> None:
        self.executor, self.futures = executor, list[Future[Any]]()
        self.fail, self.failures = fail, failures

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.futures) < self.failures:
            fn, args = self.fail, ()
        self.futures.append(self.executor.submit(fn, *args, **kwargs))
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
    """Pictures have many tiles."""
    monkeypatch.setattr(render_module, "_MAX_TILE_SAMPLES", 1000)
    monkeypatch.setattr(render_module, "_MIN_TILE_SAMPLES", 1000)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks, and of what Dask imports
@pytest.mark.parametrize("kind", ["fork", "spawn", "forkserver", "threads", "loky", "dask"])
def test_any_executor_draws_the_same_picture(kind, small_tiles, capfd):
    with ExitStack() as stack:
        counting = Counting(executor_of(kind, stack))
        for scene, samples in ((picture(), 1), (picture(400, 3), 1), (picture(90, 60), 16)):
            alone = render(scene, samples)
            counting.futures.clear()
            assert np.array_equal(render(scene, samples, executor=counting), alone)
            assert counting.futures
            assert all(future.exception() is None for future in counting.futures)
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


class Late(Executor):
    """An executor of which each result is late; counts how many are out at a time."""

    out = most = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.out += 1
        self.most = max(self.most, self.out)
        future = Future[Any]()

        def result(_timeout: float | None = None) -> Any:
            self.out -= 1
            return fn(*args, **kwargs)

        future.result = result  # type: ignore[method-assign]
        return future


@pytest.mark.parametrize("processors", [1, 2, 6])
def test_an_executor_has_work_for_all_processors_and_no_more(processors, small_tiles, monkeypatch):
    for module in (parallel, render_module):
        monkeypatch.setattr(module, "processors", lambda: processors)
    late = Late()
    assert np.array_equal(render(picture(), executor=late), render(picture()))
    assert (late.most, late.out) == (2 * processors, 0)


@pytest.mark.parametrize("processors", [2, 16])
def test_all_processors_have_tiles(processors, monkeypatch):
    monkeypatch.setattr(render_module, "processors", lambda: processors)
    monkeypatch.setattr(render_module, "_MIN_TILE_SAMPLES", 1000)
    monkeypatch.setattr(render_module, "worker_pool", lambda *_: None)
    assert len(tiles_of(picture(), processes=processors)) >= 4 * processors


def test_a_program_with_threads_is_not_forked(monkeypatch):
    """Another thread may hold a lock, which stays locked in the fork."""
    wait = threading.Event()
    thread = threading.Thread(target=wait.wait)
    thread.start()
    try:
        pool: Any = parallel.worker_pool(1, len, ())
        assert pool._mp_context.get_start_method() == "spawn"
        pool.shutdown()
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


def tiles_of(scene: Scene, **options: Any) -> list[bytes]:
    return [tile.data.data for tile in render_tiles(scene, **options)]


@pytest.mark.parametrize("samples", [1, 16])
def test_the_pool_of_the_command_draws_the_same(samples, small_tiles, monkeypatch):
    monkeypatch.setattr(render_module, "processors", lambda: 3)
    pool = Mock(wraps=parallel.worker_pool)
    monkeypatch.setattr(render_module, "worker_pool", pool)
    drawn = [tiles_of(picture(), samples=samples, processes=n) for n in (1, 2, 3, 9)]
    assert [call.args[0] for call in pool.call_args_list] == [0, 1, 2, 2]
    # With one process tiles are larger: only those that several share can be compared so.
    assert drawn[1] == drawn[2] == drawn[3]
    assert len(drawn[1]) > 3


def test_a_small_picture_starts_no_process(monkeypatch):
    monkeypatch.setattr(render_module, "processors", lambda: 2)
    pools: list[int] = []
    monkeypatch.setattr(render_module, "worker_pool", lambda count, *_: pools.append(count))
    for size in ((320, 180), (3000, 2000)):
        tiles_of(picture(*size))
    assert pools == [0, 1]


def test_leaving_early_ends_the_pool(small_tiles, monkeypatch):
    monkeypatch.setattr(render_module, "processors", lambda: 2)
    with closing(render_tiles(picture(), processes=2)) as tiles:
        next(tiles)
    wait_until(lambda: not multiprocessing.active_children())


@needs_two
@pytest.mark.parametrize("limit", range(5, 15))
def test_few_files(limit, tmp_path):
    """What starts a pool, or a part of one, may lack files for the rest."""
    path = tmp_path / "ball.xml"
    path.write_text(SCENE.format(300, 200))
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))  # noqa: E731
    assert run(path, "--quiet", "--processes", 2, preexec_fn=few) == (0, "", "")


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
    with started(large, "--quiet", "--processes", 2) as process:
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
    with started(large, "--quiet", "--processes", 2) as process:
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
