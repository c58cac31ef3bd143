"""Worker processes: results, errors, deaths, limits, and what is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from math import inf
from mmap import mmap
from pathlib import Path

import numpy as np
import pytest
from parts import PARTS, SIZE, dying, failing, refusing, signing
from running import run

from tracer import Camera, Lambertian, PointLight, Scene, Sphere, render
from tracer.picture import bands, parallel
from tracer.picture.parallel import Done, Job, Work, forked, helped

ME = os.getpid()

Start = Callable[[int, int, int, Job, Work], Done]


@pytest.fixture(autouse=True)
def no_workers() -> Iterator[None]:
    """No test finds workers of another."""
    parallel._helpers.stop()
    yield
    parallel._helpers.stop()
    assert not children()


def children() -> list[int]:
    """Child processes of this one, ended ones included."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            found += [int(stat.parent.name)] if int(fields[1]) == os.getpid() else []
    return found


staying = partial(helped, load=inf)


def signed(start: Start, others: int = 1, parts: int = 40, job: Job = signing) -> list[int]:
    """Do a job; return which process did each of its parts."""
    signers = np.zeros(PARTS, np.int64)
    own = mmap(-1, SIZE)
    for number, memory in start(parts, others, SIZE, job, signing(own)):
        assert signers[number] == 0
        signers[number] = np.frombuffer(memory or own, np.int64, PARTS)[number]
    assert signers[:parts].all()
    return signers[:parts].tolist()


def signed_by_all(others: int = 1) -> set[int]:
    """Repeat a job until all workers that stay take part; return the processes."""
    for _ in range(100):
        found = set(signed(staying, others))
        if len(found) > others:
            return found
    pytest.fail("no worker took part")


both = pytest.mark.parametrize("start", [forked, staying])


@pytest.mark.parametrize("others", [0, 1, 2, 20])
def test_forks_share_the_parts(others):
    assert min(others, 2) < len(set(signed(forked, others))) <= others + 1
    assert not children()


def test_no_part_is_taken_twice():
    done = forked(100_000, 1, 8, lambda _memory: abs, abs)
    assert sorted(number for number, _ in done) == list(range(100_000))


@pytest.mark.parametrize("others", [1, 2])
def test_workers_stay_for_the_next_job(others):
    first = signed_by_all(others)
    assert ME in first
    for _ in range(4):
        assert set(signed(staying, others)) <= first
    assert sorted(children()) == sorted(first - {ME})


def test_nobody_waits_for_a_worker_to_start_but_it_may_join():
    assert set(signed(staying, parts=2)) == {ME}
    parallel._helpers.stop()
    assert len(set(signed(staying, parts=400))) == 2


def test_no_forks_beside_another_thread():
    """It may hold a lock, which nobody would release in a copy."""
    ends = threading.Event()
    (thread := threading.Thread(target=ends.wait)).start()
    assert set(signed(forked)) == {ME}
    ends.set()
    thread.join()


def test_one_job_at_a_time_has_workers():
    job = staying(8, 1, SIZE, signing, signing(mmap(-1, SIZE)))
    next(job)
    assert len(children()) == 1
    assert set(signed(staying, parts=8)) == {ME}
    assert len(list(job)) == 7


@both
def test_an_error_is_raised_here(start):
    with pytest.raises(MemoryError, match="too little"):
        list(start(40, 1, SIZE, failing, failing(mmap(-1, SIZE))))
    assert not children()


def test_what_only_workers_cannot_do_is_done_here():
    before = signed_by_all()
    for job in (failing, refusing):
        assert set(signed(staying, job=job)) == {ME}
    assert signed_by_all() == before


@pytest.mark.parametrize(("others", "first"), [(1, 0), (1, 20), (3, 8)])
@both
def test_what_a_killed_worker_had_taken_is_done_here(start, others, first, tmp_path):
    before = signed_by_all(others) if start is staying else {ME}
    for _ in range(100):  # a worker that has not yet said that it is idle is not asked
        assert ME in signed(start, others, job=partial(dying, first, tmp_path / "died"))
        if (tmp_path / "died").exists():
            break
    assert (tmp_path / "died").exists()
    if start is staying:  # another takes its place
        assert len(signed_by_all(others) & before) == others


def test_the_number_of_a_dead_worker_may_be_given_to_another_process():
    (worker,) = signed_by_all() - {ME}
    os.kill(worker, signal.SIGKILL)
    others = signed_by_all()
    assert worker not in others
    (worker,) = others - {ME}
    os.kill(worker, signal.SIGKILL)
    os.waitpid(worker, 0)
    for _ in range(100):
        try:  # the system gives out numbers in turn: the next is this one
            Path("/proc/sys/kernel/ns_last_pid").write_text(str(worker - 1))
        except OSError:
            pytest.skip("only root may choose the number of a process")
        with subprocess.Popen(["sleep", "60"]) as other:
            if other.pid == worker:
                parallel._helpers.stop()
                time.sleep(0.05)
            lives = other.poll() is None
            other.kill()
        if other.pid == worker:
            assert lives
            return
    pytest.skip("the number was always taken")


@both
def test_leaving_early_ends_workers(start):
    before = signed_by_all() if start is staying else set()
    with closing(start(40, 1, SIZE, signing, signing(mmap(-1, SIZE)))) as done:
        next(done)
    assert not children()
    if start is staying:
        assert signed_by_all() & before == {ME}


@pytest.mark.parametrize("count", range(14))
@both
def test_workers_for_whom_there_are_files(start, count, files_left):
    with files_left(count):
        assert ME in signed(start, 2, parts=8)
        parallel._helpers.stop()
    assert not children()


@pytest.mark.parametrize(
    ("lacking", "start"), [("fork", forked), ("memfd_create", forked), ("memfd_create", staying)]
)
def test_nothing_to_share_or_no_more_processes(lacking, start, monkeypatch):
    def none(*_: object) -> int:
        raise OSError("no more of these")

    assert {memory for _, memory in start(8, 1, 1 << 60, signing, lambda _: None)} == {None}
    parallel._helpers.stop()
    monkeypatch.setattr(os, lacking, none)
    assert set(signed(start)) == {ME}


@pytest.mark.parametrize("name", ["python3", "a-program-of-its-own"])
def test_a_worker_that_cannot_start(name, tmp_path, monkeypatch):
    program = tmp_path / name
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/started\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    assert set(signed(staying, parts=100)) == {ME}
    assert (tmp_path / "started").exists() == (name == "python3")
    assert not children()


def test_a_worker_has_the_same_tracer_and_is_isolated(tmp_path, monkeypatch):
    """As a program may be that was started by python -I."""
    (tmp_path / "tracer.py").write_text("raise ImportError('another one')\n")
    (tmp_path / "sitecustomize.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), tmp_path, *sys.path])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert len(signed_by_all()) == 2
    assert not (tmp_path / "run").exists()


def test_a_fork_has_workers_of_its_own():
    before = signed_by_all()
    reading, writing = os.pipe()
    if not (child := os.fork()):
        os.write(writing, " ".join(map(str, signed_by_all())).encode())
        os._exit(0)
    os.waitpid(child, 0)
    theirs = {int(part) for part in os.read(reading, 100).split()}
    assert (len(theirs), theirs & before) == (2, set())
    assert signed_by_all() == before


@pytest.mark.parametrize("killed", [False, True])
def test_workers_end_with_their_process(killed):
    code = f"""if True:
        import os, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        import test_processes
        print(*test_processes.signed_by_all() - {{os.getpid()}}, flush=True)
        if {killed}: os.kill(os.getpid(), signal.SIGKILL)
    """
    _, out, err = run(python=("-W", "error", "-c", code))
    assert not err
    deadline = time.monotonic() + 10
    while Path(f"/proc/{int(out)}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def picture(width: int, height: int) -> Scene:
    """A sphere, in all of the picture but its corners."""
    return Scene(
        camera=Camera(view_point=(0, 0, 4), proj_distance=4, view_width=2.2, view_height=2.2),
        width=width,
        height=height,
        lights=(PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 3))),
        surfaces=(Sphere(),),
    )


@pytest.mark.parametrize("size", [(150, 100), (400, 1), (1, 400)])
@pytest.mark.parametrize("samples", [1, 4])
def test_pictures_are_the_same_whoever_renders_them(samples, size, monkeypatch):
    monkeypatch.setattr(bands, "processors", lambda: 3)
    scene = picture(*size)
    alone = render(scene, samples, processes=1)
    signed_by_all(2)
    for samples_in_a_tile in (bands._TILE_SAMPLES, 1000, 90):
        monkeypatch.setattr(bands, "_TILE_SAMPLES", samples_in_a_tile)
        monkeypatch.setattr(bands, "_LEAST_SAMPLES", samples_in_a_tile)
        monkeypatch.setattr(bands, "_LEAST_PIXELS", 10)
        for processes in (1, 2, 3):
            assert np.array_equal(render(scene, samples, processes=processes), alone)


def test_memory_of_a_large_picture_is_given_back(monkeypatch):
    monkeypatch.setattr(parallel, "_KEPT", 1 << 20)
    signed_by_all()
    scene = picture(1000, 1000)
    alone = render(scene, processes=1)
    for _ in range(2):
        assert np.array_equal(render(scene, processes=2), alone)
        used = os.fstat(parallel._helpers.file).st_blocks * 512
        assert used <= 1 << 20


def test_pictures_in_threads():
    scenes = [picture(200 + k, 100) for k in range(4)]
    alone = [render(scene, processes=1) for scene in scenes]
    signed_by_all()
    with ThreadPoolExecutor(4) as pool:
        images = list(pool.map(partial(render, processes=2), scenes * 10))
    assert all(map(np.array_equal, images, alone * 10))


def test_no_more_processes_than_are_asked_for_or_than_there_are_processors(monkeypatch):
    for processors, processes, others in ((3, 1, 0), (3, 2, 1), (3, 6, 2)):
        monkeypatch.setattr(bands, "processors", lambda processors=processors: processors)
        render(picture(200, 300), processes=processes)
        assert len(children()) == others
        parallel._helpers.stop()
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(usable)})
    assert parallel.processors() == 1
    os.sched_setaffinity(0, usable)


@pytest.mark.skipif(parallel.processors() < 2, reason="there is one processor")
@pytest.mark.parametrize(
    ("size", "times", "others"),
    [
        ((640, 360), 3, 0),  # it would slow these, and not be ready in time
        pytest.param((2000, 1500), 1, 1, marks=pytest.mark.slow),
        pytest.param((700, 500), 200, 1, marks=pytest.mark.slow),
    ],
)
def test_large_or_many_pictures_start_a_worker(size, times, others):
    for _ in range(times):
        render(picture(*size))
    assert len(children()) == others


@pytest.mark.parametrize("place", ["__main__", "nowhere"])
def test_a_scene_of_which_a_worker_does_not_know_all(place, monkeypatch):
    class Red(Lambertian):
        """It can be pickled only if it is found where it says to be."""

    Red.__module__, Red.__qualname__ = place, "Red"
    monkeypatch.setattr(sys.modules["__main__"], "Red", Red, raising=False)
    before = signed_by_all()
    scene = replace(picture(300, 200), surfaces=(Sphere(shader=Red(diffuse=(1, 0, 0))),))
    alone = render(scene, processes=1)
    for _ in range(3):
        assert np.array_equal(render(scene, processes=2), alone)
    assert signed_by_all() == before
