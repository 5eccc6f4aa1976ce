"""Plots as geometry: paths in a square of 1000 by 1000 that the page stretches, and ticks in percent of it.

Lines keep their width and text stays text beside the square, whatever its shape: so a plot is redrawn for each width of
the page without a script.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from skat.diagnosis.report.content import Cloud, Episode, Law, Series, ShownCause, Spectrum

    Array = NDArray[np.float64]

SIZE = 1000.0
# Points of all lines of a page, and the fewest and most of one: a page stays below 2 MB.
ALL_POINTS, FEWEST_POINTS, MOST_POINTS = 60_000, 200, 2_000
# A simulation that runs away is drawn up to so many spreads beyond what was measured.
BEYOND = 1.0
# Exponents of ten between which ticks are written as they are.
PLAIN = (-3, 5)
# Decades of a logarithmic axis below its largest value.
MOST_DECADES = 6
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Axis:
    """One axis of a plot.

    `label`: with its unit, and the power of ten that ticks are multiplied by. `low`, `high`: ends, in what the ticks
    say; of a logarithmic axis the exponents of ten. `ticks`: place in percent from `low` on, and text.
    """

    label: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class Mark:
    """A path of a plot.

    `kind` in {"line", "dots", "band", "whisker"}. `role`: what it shows: "measured", "before", "after", "zero". `path`:
    of SVG.
    """

    kind: str
    role: str
    path: str


@dataclass(frozen=True)
class Plot:
    """A plot, ready to be shown.

    `summary`: for who does not see it. `marks`: from back to front. `grid`: path of SVG.
    """

    title: str
    summary: str
    x: Axis
    y: Axis
    marks: tuple[Mark, ...]
    grid: str


@dataclass(frozen=True)
class CauseLine:
    """A cause between the value that does nothing and the far end of its interval, in percent of the line's width."""

    neutral: float
    value: float
    low: float
    high: float


def points_of_each(n_series: int) -> int:
    """Return how many points each of so many lines may have."""
    return int(np.clip(ALL_POINTS // max(n_series, 1), FEWEST_POINTS, MOST_POINTS))


def signal_plots(episode: Episode, most_points: int = MOST_POINTS) -> list[Plot]:
    """Return a Plot for each channel of an episode, all over the same time."""
    time = np.asarray(episode.time, dtype=float)
    return [_signal_plot(series, time, episode.time_label, most_points) for series in episode.channels]


def cloud_plot(cloud: Cloud) -> Plot:
    """Return measured against simulated, with the line on which a simulation is right."""
    versions = _versions(cloud)
    measured = np.asarray(cloud.measured, dtype=float)
    low, high = _ends(measured, [simulated for _, simulated in versions])
    across = _axis(f"simulated {_with_unit(cloud.name, cloud.unit)}", low, high)
    up = _axis(f"measured {_with_unit(cloud.name, cloud.unit)}", low, high)
    place_x, place_y = _placer(low, high), _placer(low, high, is_up=True)
    marks = [Mark("line", "zero", f"M0 {SIZE:g}L{SIZE:g} 0")]
    marks += [
        Mark("dots", role, _dots(place_x(simulated), place_y(measured))) for role, simulated in versions
    ]
    summary = (
        f"{cloud.name}: measured against simulated; where the simulation is right, points lie on the line."
    )
    return Plot(up.label, summary, across, up, tuple(marks), _grid(across, up))


def law_plot(law: Law, unit: str) -> Plot:
    """Return the means of what is left, binned by what it depends on."""
    x = np.asarray(law.x, dtype=float)
    parts = [np.asarray(one, dtype=float) for one in (law.mean, law.low, law.high)]
    before = None if law.before is None else np.asarray(law.before, dtype=float)
    everything = [*parts, np.zeros(1)] + ([] if before is None else [before])
    left, right = _padded(np.nanmin(x), np.nanmax(x), share=0.04)
    bottom, top = _padded(
        min(np.nanmin(one) for one in everything), max(np.nanmax(one) for one in everything), share=0.06
    )
    across = _axis(_with_unit(law.regressor, law.unit), left, right)
    up = _axis(_with_unit("what is left", unit), bottom, top)
    place_x, place_y = _placer(left, right), _placer(bottom, top, is_up=True)
    mean, low, high = parts
    marks = [Mark("line", "zero", _line(np.array([0.0, SIZE]), place_y(np.zeros(2))))]
    if before is not None:
        marks.append(Mark("line", "before", _line(place_x(x), place_y(before))))
    marks += [
        Mark("whisker", "after", _whiskers(place_x(x), place_y(low), place_y(high))),
        Mark("line", "after", _line(place_x(x), place_y(mean))),
        Mark("dots", "after", _dots(place_x(x), place_y(mean))),
    ]
    far = int(np.nanargmax(np.abs(mean)))
    summary = (
        f"What is left against {law.regressor}: it is furthest from zero, {mean[far]:.3g} {unit}, where "
        f"{law.regressor} is {x[far]:.3g} {law.unit}."
    )
    return Plot(up.label, summary, across, up, tuple(marks), _grid(across, up))


def spectrum_plot(spectrum: Spectrum, unit: str) -> Plot | None:
    """Return the power density on logarithmic axes; None where nothing of it is positive."""
    frequency, density = (np.asarray(one, dtype=float) for one in (spectrum.frequency, spectrum.density))
    there = (frequency > 0) & (density > 0) & np.isfinite(density)
    if there.sum() < 2:
        return None
    x, y = np.log10(frequency[there]), np.log10(density[there])
    bottom, top = _padded(max(y.min(), y.max() - MOST_DECADES), y.max(), share=0.05)
    across = _log_axis("frequency (Hz)", x.min(), x.max())
    up = _log_axis(f"density (({unit})² / Hz)", bottom, top)
    place_x, place_y = _placer(x.min(), x.max()), _placer(bottom, top, is_up=True)
    marks = (Mark("line", "after", _line(place_x(x), place_y(y))),)
    peak = frequency[there][np.argmax(density[there])]
    summary = f"Spectrum: {spectrum.word or 'no word for it'}; largest at {peak:.3g} Hz."
    return Plot(up.label, summary, across, up, marks, _grid(across, up))


def cause_line(cause: ShownCause) -> CauseLine | None:
    """Return the place of a cause between neutral and the far end of its interval; None where that has no end."""
    values = np.array([cause.neutral, cause.value, *cause.interval])
    if not np.isfinite(values).all() or np.ptp(values) == 0:
        return None
    low, high = _padded(values.min(), values.max(), share=0.06)
    return CauseLine(*(100 * (values - low) / (high - low)).tolist())


# -- parts ---------------------------------------------------------------------------------------------------


def _signal_plot(series: Series, time: Array, time_label: str, most_points: int) -> Plot:
    measured, versions = np.asarray(series.measured, dtype=float), _versions(series)
    low, high = _ends(measured, [simulated for _, simulated in versions])
    first, last = _padded(np.nanmin(time), np.nanmax(time), share=0.0)
    across = _axis(time_label, first, last, is_plain=True)
    up = _axis(_with_unit(series.name, series.unit), low, high)
    place_x, place_y = _placer(first, last), _placer(low, high, is_up=True)
    marks = []
    for role, values in [("measured", measured), *versions]:
        pieces = []
        for run in _runs(values):
            chosen = run[_telling(values[run], max(2, most_points * len(run) // max(len(values), 1)))]
            pieces.append(_line(place_x(time[chosen]), place_y(values[chosen])))
        marks.append(Mark("line", role, "".join(pieces)))
    summary = f"{series.name} over {time_label}, measured and simulated"
    if np.isfinite(measured).any():
        span = f"{np.nanmin(measured):.3g} to {np.nanmax(measured):.3g} {series.unit}".rstrip(" 1")
        summary += f"; measured from {span}"
    return Plot(up.label, f"{summary}.", across, up, tuple(marks), _grid(across, up))


def _versions(shown: Series | Cloud) -> list[tuple[str, Array]]:
    versions = [("before", np.asarray(shown.nominal, dtype=float))]
    if shown.extended is not None:
        versions.append(("after", np.asarray(shown.extended, dtype=float)))
    return versions


def _ends(measured: Array, simulated: Sequence[Array]) -> tuple[float, float]:
    """Return the ends of an axis that holds what was measured, and what was simulated unless it runs away."""
    finite = [one[np.isfinite(one)] for one in (measured, *simulated)]
    everything = np.concatenate(finite)
    if not len(everything):
        return 0.0, 1.0
    low, high = everything.min(), everything.max()
    span = np.ptp(finite[0]) if len(finite[0]) else 0.0
    if span > 0:
        low, high = max(low, finite[0].min() - BEYOND * span), min(high, finite[0].max() + BEYOND * span)
    return _padded(low, high, share=0.05)


def _padded(low: float, high: float, share: float) -> tuple[float, float]:
    """Return ends with a share of the span added to both, further apart than rounding."""
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        share, span = 1.0, max(abs(low), abs(high), 1.0) * 1e-3
    else:
        span = high - low
    return float(low - share * span), float(high + share * span)


def _axis(label: str, low: float, high: float, *, is_plain: bool = False) -> Axis:
    from matplotlib.ticker import MaxNLocator

    exponent = int(np.floor(np.log10(max(abs(low), abs(high), 1e-300))))
    if is_plain or PLAIN[0] <= exponent < PLAIN[1]:
        exponent = 0
    else:
        label = _with_power(label, exponent)
    low, high = low / 10.0**exponent, high / 10.0**exponent
    places = np.asarray(MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    places = places[(places >= low - 1e-9 * (high - low)) & (places <= high + 1e-9 * (high - low))]
    ticks = [(100 * (place - low) / (high - low), _tick(place, high - low)) for place in places]
    return Axis(label, low, high, tuple(ticks))


def _log_axis(label: str, low: float, high: float) -> Axis:
    """Return the axis with ticks at powers of ten, and at 2 and 5 times these where they are few."""
    steps = [1.0] if high - low > 2.5 else [1.0, 2.0, 5.0]
    places = []
    for exponent in range(int(np.floor(low)), int(np.ceil(high)) + 1):
        for step in steps:
            place = exponent + np.log10(step)
            if low - 1e-9 <= place <= high + 1e-9:
                text = f"{step * 10.0**exponent:g}"
                if not PLAIN[0] <= exponent < PLAIN[1]:
                    power = f"10{str(exponent).translate(SUPERSCRIPTS)}"
                    text = power if step == 1 else f"{step:g}·{power}"
                places.append((100 * (place - low) / (high - low), text))
    return Axis(label, low, high, tuple(places[:: max(1, len(places) // 6)]))


def _tick(value: float, span: float) -> str:
    decimals = max(0, int(np.ceil(-np.log10(span / 5))) + 1) if span > 0 else 3
    text = f"{value:.{min(decimals, 9)}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text.replace("-", "−")


def _with_unit(text: str, unit: str) -> str:
    return text if unit in ("", "1") else f"{text} ({unit})"


def _with_power(label: str, exponent: int) -> str:
    power = f"10{str(exponent).translate(SUPERSCRIPTS)}"
    head, bracket, unit = label.rpartition(" (")
    return f"{head} ({power} {unit}" if bracket else f"{label} ({power})"


def _placer(low: float, high: float, *, is_up: bool = False) -> Callable[[Array], Array]:
    """Return the function from values between low and high to places on the axis, from the top down where it is up."""

    def place(values: ArrayLike) -> Array:
        share = (np.asarray(values, dtype=float) - low) / (high - low)
        # Far away is far enough: no browser draws a billion.
        return SIZE * np.clip(1 - share if is_up else share, -9.0, 10.0)

    return place


def _runs(values: Array) -> list[NDArray[np.intp]]:
    """Return the indices of each run of finite values."""
    there = np.flatnonzero(np.isfinite(values))
    return np.split(there, np.flatnonzero(np.diff(there) > 1) + 1) if len(there) else []


def _telling(values: Array, most: int) -> NDArray[np.intp]:
    """Return the indices of at most so many points (but never fewer than two), with the extremes of each stretch."""
    if len(values) <= most:
        return np.arange(len(values))
    inner = max(1, (most - 2) // 2)
    edges = np.linspace(0, len(values), inner + 1).astype(int)
    chosen = {0, len(values) - 1}
    for start, end in pairwise(edges):
        if end > start:
            chosen |= {start + int(np.argmin(values[start:end])), start + int(np.argmax(values[start:end]))}
    return np.array(sorted(chosen))


def _grid(across: Axis, up: Axis) -> str:
    vertical = "".join(f"M{SIZE * place / 100:.1f} 0V{SIZE:g}" for place, _ in across.ticks)
    return vertical + "".join(f"M0 {SIZE * (1 - place / 100):.1f}H{SIZE:g}" for place, _ in up.ticks)


def _line(x: Array, y: Array) -> str:
    there = np.isfinite(x) & np.isfinite(y)
    points = [f"{one:.2f} {other:.1f}" for one, other in zip(x[there], y[there], strict=True)]
    if len(points) == 1:
        return f"M{points[0]}h0"
    return f"M{'L'.join(points)}" if points else ""


def _dots(x: Array, y: Array) -> str:
    there = np.isfinite(x) & np.isfinite(y)
    return "".join(f"M{one:.1f} {other:.1f}h0" for one, other in zip(x[there], y[there], strict=True))


def _whiskers(x: Array, low: Array, high: Array) -> str:
    there = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
    ends = zip(x[there], low[there], high[there], strict=True)
    return "".join(f"M{one:.1f} {start:.1f}V{end:.1f}" for one, start, end in ends)
