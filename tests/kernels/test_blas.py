"""BLAS on one thread while anything is refined, on its own threads after."""

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
