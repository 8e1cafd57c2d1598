import math

import pytest

from benchmarks.report import NONE, markdown_table, number, ratio, times


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (185_856, "185,856"),
        (0, "0"),
        (0.0, "0"),
        (1234.5, "1,234"),
        (31.06, "31.1"),
        (9.996, "10.0"),
        (0.99999, "1.00"),
        (0.0123456, "0.0123"),
        (-4.321, "-4.32"),
        (None, NONE),
        (math.inf, NONE),
        (math.nan, NONE),
    ],
)
def test_numbers_have_three_significant_digits_and_whole_ones_all(value, shown):
    assert number(value) == shown


def test_ratios_are_missing_where_a_side_is_missing():
    assert ratio(None, 2.0) is None
    assert ratio(3.0, None) is None
    assert ratio(3.0, 0.0) is None
    assert times(ratio(9.0, 2.0)) == "4.5 x"
    assert times(ratio(250.0, 2.0)) == "125 x"
    assert times(None) == NONE


def test_a_table_escapes_what_would_end_a_cell():
    assert markdown_table(["a", "b"], [["x|y", "1\n2"]]) == "| a | b |\n| --- | ---: |\n| x\\|y | 1 2 |"


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="1 cells under 2 titles"):
        markdown_table(["a", "b"], [["1"]])
