"""Numbers in text, in as many digits as their intervals deserve."""

import numpy as np

LEAST_DIGITS, MOST_DIGITS = 4, 9


def number(value: float, digits: int = LEAST_DIGITS) -> str:
    """Return a number in so many digits."""
    if np.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.{digits}g}"


def amount(value: float) -> str:
    """Return a number for a sentence, in three digits, as people write it up to a thousand million.

    Examples
    --------
    >>> amount(34321.0), amount(0.0123)
    ('34\u202f300', '0.0123')
    """
    text = number(value, 3)
    if "e+0" not in text:
        return text
    return f"{float(text):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def size_text(value: float, interval: tuple[float, float]) -> str:
    """Return a value in as many digits as its interval (low, high) has."""
    return number(value, _digits(interval))


def interval_text(interval: tuple[float, float]) -> str:
    """Return the ends of an interval (low, high) in words, in as many digits as tell how far apart they are."""
    digits = _digits(interval)
    return f"{number(interval[0], digits)} to {number(interval[1], digits)}"


def _digits(interval: tuple[float, float]) -> int:
    low, high = interval
    width, size = high - low, max(abs(low), abs(high))
    if not 0 < width < np.inf:
        return LEAST_DIGITS
    return int(np.clip(np.ceil(np.log10(size / width)) + 2, LEAST_DIGITS, MOST_DIGITS))
