"""The clock of a run: what its phases take, and where Ctrl-C ends a phase."""

import time

import pytest

from tso_cli.refinement.clock import Clock


def test_a_phase_that_comes_twice_counts_twice():
    clock = Clock()
    for _ in range(2):
        with clock.phase("prepare"):
            time.sleep(0.01)
    with clock.phase("optimise"):
        pass
    assert list(clock.seconds) == ["prepare", "optimise"]
    assert clock.seconds["prepare"] >= 0.02
    assert clock.seconds["optimise"] < 0.01


def test_an_attempt_returns_what_its_work_returns():
    clock = Clock()
    assert clock.attempt("cameras", lambda: "corrected", "given") == "corrected"
    assert not clock.interrupted
    assert list(clock.seconds) == ["cameras"]


def test_ctrl_c_during_an_attempt_leaves_out_that_and_every_later_one():
    def interrupted():
        raise KeyboardInterrupt

    clock, done = Clock(), []
    assert clock.attempt("cameras", interrupted, "given") == "given"
    assert clock.interrupted
    assert clock.attempt("check mistake", lambda: done.append(1), "none") == "none"
    assert done == []


def test_another_error_of_an_attempt_is_raised():
    with pytest.raises(ZeroDivisionError):
        Clock().attempt("cameras", lambda: 1 / 0, None)
