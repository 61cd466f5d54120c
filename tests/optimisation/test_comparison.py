"""Short optimisations whose final losses are compared."""

import pytest

from tests.scenes import problem_of
from tso_cli.cloud.smooth_field import SmoothField
from tso_cli.optimisation.comparison import final_losses


class _Interrupted(SmoothField):
    """A field that Ctrl-C interrupts when it is used for the time ``call``."""

    def __init__(self, points, call):
        super().__init__(points)
        self._left = call

    def spread(self, values):
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt
        return super().spread(values)


@pytest.mark.parametrize("call", [1, 6, 30])
def test_ctrl_c_during_a_comparison_ends_it(chair, call):
    """Before the first loss, in the first optimisation, and in the second."""
    problem = problem_of(chair.points[::3], chair.view)
    field = _Interrupted(problem.cloud.start, call)
    with pytest.raises(KeyboardInterrupt):
        final_losses((problem, problem), [1.0], field)


def test_problems_that_are_the_same_end_with_the_same_loss(chair):
    problem = problem_of(chair.points[::3], chair.view)
    one, other = final_losses((problem, problem), [1.0], SmoothField(problem.cloud.start))
    assert one == other > 0.0
