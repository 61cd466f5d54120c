"""Names of variants."""

from tso_cli.datasets.variants import shape_type


def test_variants_of_one_aeroplane_are_one_type():
    assert shape_type("fg_767_763") == shape_type("fg_767_767") != shape_type("fg_777_77F")
    assert shape_type("qreal_Cop") != shape_type("qreal_Cop_SUV")
