"""What the tests of the prior's training share: the shipped meshes, and scenes of them."""

import pytest

from tso_cli.io.shipped import examples_folder
from tso_cli.train.prior.bank import build_bank
from tso_cli.train.prior.shapes import read_shapes


@pytest.fixture(scope="package")
def shapes():
    return read_shapes(examples_folder() / "meshes")


@pytest.fixture(scope="package")
def bank(shapes):
    pytest.importorskip("open3d")  # draws depth maps
    return build_bank(shapes, 60, seed=0)
