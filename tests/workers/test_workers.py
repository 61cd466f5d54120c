"""Work in other processes: a process that dies takes nothing with it, and outlives no parent."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from tso_cli.workers import Here, WorkerDied, WorkerPool, each
from tso_cli.workers.pool import receive, send

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def square(number):
    return number * number


def process(_=None):
    return os.getpid()


def sleep(seconds):
    time.sleep(seconds)
    return "slept"


def fail(number):
    raise ValueError(f"no {number}")


def unless_poison(number):
    """The square; number 3 kills its process, and 5 only while another file is not there."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def once_killed(marker):
    """Kills its process the first time."""
    if not Path(marker).exists():
        Path(marker).touch()
        os._exit(7)
    return "done"


def printing(_):
    print("noise")
    os.write(1, b"more noise\n")
    return "clean"


def leave(code):
    raise SystemExit(code)


def unpicklable(_):
    return lambda: None


@pytest.fixture
def pool():
    with WorkerPool(2) as pool:
        yield pool


def test_work_is_done_in_other_processes_which_are_used_again(pool):
    found = {pool.submit(process).result() for _ in range(6)}
    assert os.getpid() not in found
    assert len(found) <= 2
    assert list(pool.map(square, range(5))) == [0, 1, 4, 9, 16]


def test_an_exception_of_the_work_is_that_of_the_future(pool):
    with pytest.raises(ValueError, match="no 4"):
        pool.submit(fail, 4).result()
    assert pool.submit(square, 4).result() == 16


def test_what_the_work_prints_does_not_mix_with_its_results(pool):
    assert pool.submit(printing, 0).result() == "clean"


def test_a_result_that_cannot_be_sent_is_an_error(pool):
    with pytest.raises(RuntimeError, match="function cannot be sent back"):
        pool.submit(unpicklable, 0).result()
    assert pool.submit(square, 4).result() == 16


def test_only_the_work_of_a_killed_process_is_lost(pool):
    waiting = pool.submit(sleep, 0.5)
    with pytest.raises(WorkerDied, match="was killed by SIGKILL, perhaps for lack of memory"):
        pool.submit(unless_poison, 3).result()
    assert waiting.result() == "slept"
    with pytest.raises(WorkerDied, match="ended with exit code 7"):
        pool.submit(leave, 7).result()
    assert pool.submit(square, 4).result() == 16


@pytest.mark.parametrize("size", [10, 1 << 20])
def test_a_process_that_is_killed_while_it_has_nothing_to_do_is_a_death_too(size):
    """Not a broken pipe: its work is tried again, and is not taken for failed."""
    with WorkerPool(1) as pool:
        os.kill(pool.submit(process).result(), signal.SIGKILL)
        time.sleep(0.2)
        with pytest.raises(WorkerDied):
            pool.submit(len, bytes(size)).result()
        assert pool.submit(len, bytes(size)).result() == size


@pytest.mark.parametrize("kept", [3, 8, 12])
def test_a_message_that_was_cut_off_is_the_end_of_the_other_side(kept):
    stream = io.BytesIO()
    send(stream, b"a message")
    assert receive(io.BytesIO(stream.getvalue())) == b"a message"
    with pytest.raises(EOFError):
        receive(io.BytesIO(stream.getvalue()[:kept]))


def test_an_interrupt_reaches_the_work_and_not_the_process():
    with WorkerPool(1) as pool:
        before = pool.submit(process).result()
        waiting = pool.submit(sleep, 60.0)
        while not waiting.running():
            time.sleep(0.01)
        time.sleep(0.2)
        pool.interrupt()
        with pytest.raises(KeyboardInterrupt):
            waiting.result(timeout=20)
        assert pool.submit(process).result() == before


def test_a_pool_ends_at_once_if_it_is_not_to_wait():
    pool = WorkerPool(1)
    waiting, later = pool.submit(sleep, 60.0), pool.submit(square, 2)
    while not waiting.running():
        time.sleep(0.01)
    begun = time.monotonic()
    pool.shutdown(wait=False)
    assert time.monotonic() - begun < 10.0
    assert isinstance(waiting.exception(), WorkerDied)
    assert later.cancelled()


def test_a_process_that_starts_while_its_pool_ends_ends_too(monkeypatch):
    pool, starting, popen = WorkerPool(1), threading.Event(), subprocess.Popen

    def slow(*arguments, **options):
        starting.set()
        time.sleep(0.3)
        return popen(*arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", slow)
    waiting, begun = pool.submit(sleep, 60.0), time.monotonic()
    starting.wait()
    pool.shutdown(wait=False)
    assert time.monotonic() - begun < 10.0
    assert isinstance(waiting.exception(), WorkerDied)


@linux
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_processes_end_with_their_parent_however_it_dies(how, tmp_path):
    script = textwrap.dedent("""
        from tests.workers.test_workers import process, sleep
        from tso_cli.workers import WorkerPool
        pool = WorkerPool(2)
        print(*{pool.submit(process).result() for _ in range(8)}, flush=True)
        pool.submit(sleep, 600.0)
        pool.submit(sleep, 600.0).result()
    """)
    root = Path(__file__).parents[2]
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=root)
    children = [int(word) for word in parent.stdout.readline().split()]
    assert children
    parent.send_signal(how)
    parent.wait()
    parent.stdout.close()
    until = time.monotonic() + 20.0
    while any(Path(f"/proc/{child}").exists() for child in children):
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_pool_works_inside_a_process_that_is_itself_a_worker():
    with get_context("fork").Pool(1) as outer:
        assert outer.apply(squares_of_a_pool) == [0, 1, 4]


def squares_of_a_pool():
    with WorkerPool(2) as pool:
        return list(pool.map(square, range(3)))


@pytest.mark.parametrize("make", [Here, lambda: ThreadPoolExecutor(2), lambda: WorkerPool(2)])
def test_each_job_ends_with_a_result_or_an_error_on_any_executor(make):
    with make() as executor:
        ended = {one.job: one for one in each(executor, square, iter(range(7)), 3)}
        assert {job: one.result for job, one in ended.items()} == {n: n * n for n in range(7)}
        (failed,) = each(executor, fail, [4], 3)
    assert str(failed.error) == "no 4"
    assert failed.result is None


def test_jobs_are_taken_only_a_few_ahead():
    taken = []

    def jobs():
        for number in range(100):
            taken.append(number)
            yield number

    with Here() as executor:
        running = each(executor, square, jobs(), 3)
        next(running)
        assert len(taken) <= 3


def test_a_job_that_kills_its_process_is_named_and_loses_no_other():
    with WorkerPool(2) as pool:
        ended = {one.job: one for one in each(pool, unless_poison, range(12), 4)}
    assert {n: one.result for n, one in ended.items() if n != 3} == {
        n: n * n for n in range(12) if n != 3
    }
    assert isinstance(ended[3].error, WorkerDied)
    assert ended[3].deaths == 3


def test_a_poisonous_job_waits_for_all_others_before_it_is_tried_alone():
    order = []
    with WorkerPool(2) as pool:
        for one in each(
            pool, unless_poison, range(12), 4, on_start=lambda job, n: order.append((job, n))
        ):
            del one
    assert order[-1] == (3, 2)
    assert [deaths for job, deaths in order if job == 3] == [0, 1, 2]


def test_a_job_whose_process_died_once_is_done_the_second_time(tmp_path):
    with WorkerPool(1) as pool:
        (ended,) = each(pool, once_killed, [tmp_path / "marker"], 2)
    assert ended.result == "done"
    assert ended.deaths == 1


def test_jobs_that_were_sent_together_are_tried_each_by_itself_after_a_death():
    with WorkerPool(2) as pool:
        found = each(pool, unless_poison, range(1, 40), 2, task_seconds=0.001)
        ended = {one.job: one for one in found}
    assert len(ended) == 39
    assert [job for job, one in ended.items() if one.error] == [3]


def test_an_executor_that_breaks_as_a_whole_loses_no_result_that_was_there():
    with ProcessPoolExecutor(2, get_context("fork")) as executor:
        ended = each(executor, unless_poison, [1, 2, 3, 4, 5, 6], 1)
        found = {one.job: one for one in ended}
    assert found[1].result == 1
    assert found[2].result == 4
    assert set(found) == {1, 2, 3, 4, 5, 6}
    assert all(isinstance(found[n].error, Exception) for n in (3, 4, 5, 6))


def holding(folder, number):
    """The square; number 3 kills its process once another job is at work too."""
    (folder / str(number)).touch()
    if number == 3:
        while len(list(folder.iterdir())) < 2:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


@pytest.mark.parametrize("window", [1, 4])
def test_in_place_of_an_executor_that_broke_another_goes_on(tmp_path, window):
    made = []

    def instead():
        made.append(WorkerPool(2))
        return made[-1]

    jobs = [2, 3, 4, 5, 6, 7, 8, 9]
    with ProcessPoolExecutor(2, get_context("fork")) as executor:
        work = partial(holding, tmp_path)
        found = {one.job: one for one in each(executor, work, jobs, window, instead=instead)}
    (pool,) = made
    pool.shutdown()
    assert {n: one.result for n, one in found.items()} == {
        n: None if n == 3 else n * n for n in jobs
    }
    assert {n: one.deaths for n, one in found.items()} == {n: 3 if n == 3 else 0 for n in jobs}
    assert found[3].failure.startswith("its process was killed by SIGKILL")


def test_a_job_that_is_done_last_stays_last_if_the_executor_breaks():
    with ProcessPoolExecutor(1, get_context("fork")) as executor, WorkerPool(1) as pool:
        (ended,) = each(executor, unless_poison, [], 2, last=[3], instead=lambda: pool)
    assert isinstance(ended.error, WorkerDied)
    assert ended.deaths == 3


def test_once_it_is_to_stop_no_job_begins():
    stopped = []
    with Here() as executor:
        for one in each(executor, square, range(9), 2, stopping=lambda: bool(stopped)):
            if one.job == 3:
                stopped.append(one.job)
            last = one.job
    assert last <= 5


def test_work_that_takes_too_long_ends_and_its_process_does_the_next_piece():
    with WorkerPool(1, seconds=5.0) as pool:
        late, next_piece = pool.submit(sleep, 60), pool.submit(square, 3)
        with pytest.raises(TimeoutError, match="took over 5 seconds"):
            late.result()
        assert next_piece.result() == 9
