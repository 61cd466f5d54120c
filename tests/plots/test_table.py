"""Tables of text and numbers."""

from tso_cli.plots.table import text_table


def test_a_table_sets_text_to_the_left_and_numbers_to_the_right():
    table = text_table(
        ["name", "value", "count"], [["a", 1.5, 10], ["long name", None, 2], ["c", float("nan"), 3]]
    )
    assert table.splitlines() == [
        "name       value  count",
        "---------  -----  -----",
        "a          1.500     10",
        "long name      -      2",
        "c              -      3",
    ]


def test_a_small_number_in_a_table_does_not_look_like_zero():
    row = text_table(["a", "b", "c"], [[0.00001234, 0.0, -0.0005]]).splitlines()[-1]
    assert row.split() == ["1.23e-05", "0.000", "-0.0005"]


def test_a_rule_sets_off_the_mean():
    lines = text_table(["a"], [[1], [2], [3]], rule_before_last=True).splitlines()
    assert lines == ["a", "-", "1", "2", "-", "3"]
