"""What an engine's processes do besides the work."""

import time

import pytest

from tso_cli.batch.engines import engine


def profiles_kept():
    from distributed import get_worker

    time.sleep(1.5)  # the usual cycle of a profile is one second
    return len(get_worker().profile_history)


@pytest.mark.slow
def test_workers_of_dask_keep_no_profile_so_that_their_memory_does_not_grow():
    pytest.importorskip("distributed")
    with engine("dask", 1, None) as used:
        assert [used.executor.submit(profiles_kept).result() for _ in range(2)] == [0, 0]
