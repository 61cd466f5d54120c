"""BLAS on one thread while anything is refined, on its own threads after."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

from threadpoolctl import threadpool_info, threadpool_limits

from tso_cli.kernels.blas import one_thread


def _threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_the_last_of_interleaved_users_gives_the_threads_back():
    with threadpool_limits(2, "blas"):
        before = _threads()
        first, second = ExitStack(), ExitStack()
        first.enter_context(one_thread())
        second.enter_context(one_thread())
        first.close()
        assert _threads() == {1}
        second.close()
        assert _threads() == before


def test_a_limit_holds_in_any_thread_after_another_had_one():
    """Else the last bits of a result would depend on the thread that made it."""

    def inside() -> set[int]:
        with one_thread():
            return _threads()

    # Not inside `threadpool_limits`, whose thread would stay in control.
    before = _threads()
    with ThreadPoolExecutor(1) as pool:
        seen = [inside(), pool.submit(inside).result(), inside()]
    assert seen == [{1}] * 3
    assert _threads() == before
