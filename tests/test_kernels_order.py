"""The order in which statements are printed."""

import pytest

from jaxblur.kernels.cpp.order import by_reads, names_of

FIRST = [
    ("const Ints v1 = read(t, x);", ["v1"], True),
    ("const Ints v2 = read(t, v1);", ["v2"], True),
    ("const Floats v3 = read(c, v2);", ["v3"], True),
]
SECOND = [
    ("const Ints v11 = read(t, y);", ["v11"], True),
    ("const Ints v12 = v11 + wide(1);", ["v12"], False),
    ("const Ints v13 = read(t, v12);", ["v13"], True),
    ("const Floats v14 = read(c, v13);", ["v14"], True),
]


def texts(*statements):
    return [text for text, _, _ in statements]


def test_chains_of_reads_lie_side_by_side():
    expected = [FIRST[0], SECOND[0], FIRST[1], *SECOND[1:3], FIRST[2], SECOND[3]]
    assert by_reads(FIRST + SECOND) == texts(*expected)


def test_reads_that_need_no_other_stay_where_they_are():
    statements = [FIRST[0], FIRST[1], SECOND[0], SECOND[1]]
    assert by_reads(statements) == texts(*statements)


def test_nothing_passes_a_statement_that_keeps_its_place():
    jump = ("if (!any(v3 > v1)) continue;", None, False)
    assert by_reads([*FIRST, jump, *SECOND]) == texts(*FIRST, jump, *SECOND)


@pytest.mark.parametrize(
    ("statement", "names"),
    [
        ("const Floats v12 = (v3 + v4);", ["v12"]),
        ("sums[3] += v12;", []),
        ("Floats v12 = wide(0.0f);", None),
        ("v12 = v13;", None),
        ("results[0] = v12;", None),
        ("if (!any(v12)) continue;", None),
    ],
)
def test_what_a_statement_defines(statement, names):
    assert names_of(statement) == names
