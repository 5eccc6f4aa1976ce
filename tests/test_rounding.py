"""Numbers in text, in as many digits as their intervals deserve."""

import numpy as np
import pytest

from skat.rounding import amount, interval_text, size_text


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((0.5875, 0.6125), "0.5875 to 0.6125"),
        ((1.050032, 1.050058), "1.050032 to 1.050058"),
        ((-98765.4, 12.3), "-9.877e+04 to 12.3"),
        ((0.0, 0.0), "0 to 0"),
        ((2.0, np.inf), "2 to ∞"),
    ],
)
def test_interval_has_as_many_digits_as_tell_how_far_apart_its_ends_are(interval, text):
    assert interval_text(interval) == text


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [(1.050045, (1.050032, 1.050058), "1.050045"), (1.0502, (1.03, 1.07), "1.05"), (0.6, (0.6, 0.6), "0.6")],
)
def test_size_has_as_many_digits_as_its_interval(value, interval, text):
    assert size_text(value, interval) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.012345, "0.0123"),
        (999.4, "999"),
        (34321.0, "34\u202f300"),
        (2.5e6, "2\u202f500\u202f000"),
        (3e12, "3e+12"),
    ],
)
def test_amounts_are_written_as_in_a_sentence(value, text):
    assert amount(value) == text
