"""Threads, which Python without a lock runs at the same time; with a lock, tests pretend."""

import multiprocessing
import os
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from probe import sphere_scene
from running import ROOT, run

from tracer import Scene, load_scene, render, to_png
from tracer.command import batch, cli
from tracer.picture import parallel, tiles
from tracer.picture.render_job import RenderJob
from tracer.world.prepared_scene import Lights, PreparedScene

SCENES = ROOT / "scenes"


@pytest.fixture(autouse=True)
def no_lock(monkeypatch: pytest.MonkeyPatch, small_tiles: None) -> None:
    """Use three threads, as Python without a lock does with three processors."""
    for module in (parallel, batch):
        monkeypatch.setattr(module, "has_gil", lambda: False)
    for module in (parallel, tiles, cli):
        monkeypatch.setattr(module, "count_processors", lambda: 3)


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> list[threading.Thread]:
    """Return all threads that are started from now on."""
    threads = list[threading.Thread]()
    start = threading.Thread.start

    def record_and_start(thread: threading.Thread) -> None:
        threads.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", record_and_start)
    return threads


@pytest.mark.parametrize("samples", [1, 4, 100])
@pytest.mark.parametrize("name", ["room", "two-boxes"])
def test_threads_render_the_same_picture(name, samples, workers):
    scene = replace(load_scene(SCENES / f"{name}.xml"), width=80, height=45)
    alone = render(scene, samples, threads=1)
    assert workers == []
    for threads in (None, 2, 5):
        assert np.array_equal(render(scene, samples, threads=threads), alone)
    assert to_png(scene, samples) == to_png(scene, samples, threads=1)
    assert len(workers) > 3
    assert not any(thread.is_alive() for thread in workers)


def make_shared_scenes() -> list[Scene]:
    """Make small scenes with light grids; the second has several batches of lights."""
    room = replace(load_scene(SCENES / "room.xml"), width=24, height=16)
    return [room, replace(room, lights=[*room.lights] * 5)]


@pytest.mark.parametrize(
    "count", [5, pytest.param(30, marks=pytest.mark.slow)], ids=["some", "many"]
)
@pytest.mark.parametrize("samples", [1, 4])
def test_many_threads_render_the_same_scene_at_once(samples, count):
    """Each round has a new scene, whose cached properties are computed in all threads."""
    thread_count = 8
    barrier = threading.Barrier(thread_count)
    for scene in make_shared_scenes():
        alone = render(scene, samples, threads=1)
        with ThreadPoolExecutor(thread_count) as pool:
            for _ in range(count):
                fresh = replace(scene)

                def render_at_once(scene: Scene = fresh) -> Any:
                    barrier.wait()
                    return render(scene, samples)

                futures = [pool.submit(render_at_once) for _ in range(thread_count)]
                assert all(np.array_equal(future.result(), alone) for future in futures)


@pytest.mark.parametrize("samples", [1, 4])
def test_many_threads_use_the_same_prepared_scene_at_once(samples):
    for scene in make_shared_scenes():
        rectangles = RenderJob(scene, samples).work.divide(parallel.Threads.sharing)
        alone = render(scene, samples, threads=1)
        with ThreadPoolExecutor(8) as pool:
            for _ in range(3):
                job = RenderJob(scene, samples)
                for k, radiance in enumerate(pool.map(job.render_tile, rectangles * 8)):
                    assert np.array_equal(radiance, alone[rectangles[k % len(rectangles)]])


class AnnouncingLock:
    """A lock that sets an event when a thread has to wait for it."""

    def __init__(self, event: threading.Event) -> None:
        self.event = event
        self.lock = threading.Lock()

    def __enter__(self) -> None:
        if not self.lock.acquire(blocking=False):
            self.event.set()
            self.lock.acquire()

    def __exit__(self, *_: object) -> None:
        self.lock.release()


def test_a_thread_waits_for_lights_that_another_one_prepares(monkeypatch):
    """The second thread needs them while the first prepares them, and does not do it again."""
    scene = PreparedScene(make_shared_scenes()[0])
    has_second_come = threading.Event()
    results = list[list[Lights]]()
    prepare_lights = PreparedScene.prepare_lights
    calls = list[slice]()

    def wait_for_second(self: PreparedScene, light_slice: slice) -> Lights:
        calls.append(light_slice)
        if len(calls) == 1:
            second.start()
        else:
            has_second_come.set()
        assert has_second_come.wait(60)
        return prepare_lights(self, light_slice)

    second = threading.Thread(target=lambda: results.append([*scene.iterate_light_batches()]))
    monkeypatch.setattr(PreparedScene, "prepare_lights", wait_for_second)
    monkeypatch.setattr(scene, "_lock", AnnouncingLock(has_second_come))
    results.append([*scene.iterate_light_batches()])
    second.join()
    assert len(calls) == 1
    assert results[0][0] is results[1][0]


def test_pictures_in_other_threads_and_processes_use_one_thread_each(workers):
    scenes = [sphere_scene()] * 6
    with ThreadPoolExecutor(2) as pool:
        assert len({*pool.map(to_png, scenes)}) == 1
        assert len(workers) == 2
        assert pool.submit(render, scenes[0], threads=2).result().any()
        assert len(workers) == 3
    workers.clear()
    if "fork" in multiprocessing.get_all_start_methods():
        context = multiprocessing.get_context("fork")
        counts = context.SimpleQueue()
        process = context.Process(target=lambda: counts.put(parallel.choose_thread_count(None)))
        process.start()
        assert counts.get() == 1
        process.join()
    assert parallel.choose_thread_count(None) == 3


def test_with_a_lock_or_an_executor_there_is_one_thread(monkeypatch, workers):
    with ThreadPoolExecutor(1) as pool:
        render(sphere_scene(), executor=pool, threads=3)
        assert len(workers) == 1
    monkeypatch.setattr(parallel, "has_gil", lambda: True)
    render(sphere_scene(), threads=3)
    assert len(workers) == 1


@pytest.mark.parametrize(
    ("threads", "error", "message"),
    [(0, ValueError, "threads must be at least 1, not 0"), (1.5, TypeError, "integer")],
)
def test_invalid_numbers_of_threads(threads, error, message):
    for call in (render, to_png):
        with pytest.raises(error, match=message):
            call(sphere_scene(), threads=threads)


def test_a_small_picture_starts_no_thread(monkeypatch, workers):
    monkeypatch.undo()
    monkeypatch.setattr(parallel, "has_gil", lambda: False)
    started = []
    monkeypatch.setattr(threading.Thread, "start", lambda thread: started.append(thread))
    render(sphere_scene(40, 30))
    assert started == []


@pytest.fixture
def failing_tile(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Return a function that makes all tiles of the lower half of a picture raise an error."""
    compute = RenderJob.render_tile

    def fail_with(error: BaseException) -> None:
        def render_tile(job: Any, rectangle: Any, **options: Any) -> Any:
            if rectangle[0].start > 100:
                raise error
            return compute(job, rectangle, **options)

        monkeypatch.setattr(RenderJob, "render_tile", render_tile)

    return fail_with


@pytest.mark.parametrize("error", [MemoryError(), KeyboardInterrupt(), ValueError("a bug")])
def test_an_error_is_raised_and_no_thread_is_left(error, failing_tile, workers):
    failing_tile(error)
    with pytest.raises(type(error)):
        render(sphere_scene())
    assert workers
    assert not any(thread.is_alive() for thread in workers)


def test_an_error_in_a_thread_alone_costs_no_tile(monkeypatch):
    """For example, memory may suffice for one tile at a time."""
    compute = RenderJob.render_tile

    def render_tile(job: Any, rectangle: Any, **options: Any) -> Any:
        if threading.current_thread() is not threading.main_thread():
            raise MemoryError
        return compute(job, rectangle, **options)

    alone = render(sphere_scene(), threads=1)
    monkeypatch.setattr(RenderJob, "render_tile", render_tile)
    assert np.array_equal(render(sphere_scene()), alone)


def test_without_another_thread_the_main_thread_renders_all(monkeypatch):
    def fail(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    alone = render(sphere_scene(), threads=1)
    monkeypatch.setattr(threading.Thread, "start", fail)
    assert np.array_equal(render(sphere_scene()), alone)


def test_warnings_are_those_of_one_thread():
    black = replace(sphere_scene(), lights=[])
    given = {}
    for threads in (1, 3):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            render(black, threads=threads)
        given[threads] = [(str(each.message), each.filename) for each in caught]
    assert given[1] == given[3]
    assert {filename for _, filename in given[3]} == {__file__}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_fork_after_a_render_is_safe():
    # Other tests may have left threads of their own.
    old_count = threading.active_count()
    render(sphere_scene())
    assert threading.active_count() <= old_count
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(render, (sphere_scene(),)).any()


def test_nothing_is_started_by_an_import():
    script = "import tracer, threading; tracer.render; print(threading.active_count())"
    assert run(python=("-c", script)) == (0, "1\n", "")
