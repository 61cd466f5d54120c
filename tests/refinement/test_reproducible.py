"""The same cloud comes out on other machines."""

import os
import subprocess
import sys

import numpy as np

from tests.scenes import example
from tso_cli import refine

REFINED = """
import sys
from tests.scenes import example
from tso_cli import refine
scene = example("car")
sys.stdout.buffer.write(refine(scene.points, scene.view).points.tobytes())
"""
OLD = {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512_SKX"}
"""A processor of 2004, with other sums in matrix products and without wide registers."""


def test_other_processors_round_differently_and_give_the_same_cloud():
    scene = example("car")
    environment = os.environ | OLD | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", REFINED],
        env=environment,
        capture_output=True,
        check=True,
    )
    elsewhere = np.frombuffer(run.stdout).reshape(-1, 3)
    np.testing.assert_allclose(elsewhere, refine(scene.points, scene.view).points, atol=1e-8)
