"""The pictures of a report: measured against simulated, before and after; each a self-contained SVG."""

import base64
import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from skat.diagnosis.open_loop import Episodes
from skat.plotting import CauseDisplay, TrajectoryDisplay
from skat.plotting.diagnosis import with_unit
from skat.plotting.style import AFTER, BEFORE, MEASURED

MOST_CHANNELS = 3
# Episodes and steps looked at to choose those that are drawn, and points of a scatter.
MOST_CANDIDATES, MOST_STEPS, MOST_POINTS = 12, 400, 600
MOST_ROWS = 5_000
FEW_POINTS = 200
N_BINS = 12
# Standard deviations of a chi-square beyond which an error's dependence on an input is worth a picture.
CLEAR_DEPENDENCE = 5.0

INK, GRID = "#24292f", "#d0d7de"
# Colour as drawn -> (name, on a light page, on a dark page).
THEME = {
    INK: ("ink", INK, "#d7dde4"),
    GRID: ("grid", GRID, "#3a424c"),
    MEASURED.lower(): ("measured", MEASURED, "#b4bcc6"),
    BEFORE.lower(): ("before", "#d98e04", "#f0ae2e"),
    AFTER.lower(): ("after", AFTER, "#56b1ec"),
}
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": GRID,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "skat",
}


@dataclass(frozen=True)
class Picture:
    """A picture with what it shows.

    Attributes
    ----------
    title, caption : str
    source : str
        An SVG as a data URI.
    """

    title: str
    caption: str
    source: str


def cause_picture(diagnosis):
    """Return the Picture of the named causes with their intervals, or None if there are none."""
    if not diagnosis.causes_:
        return None

    def draw(figure):
        neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}
        axes = figure.subplots()
        CauseDisplay.from_causes(diagnosis.causes_, neutral=neutral, ax=axes)
        axes.grid(False)

    return _picture(
        "Causes",
        "Estimates with 95 % intervals, each on a scale of its own from the model as given (neutral).",
        draw,
        height=0.9 + 0.45 * len(diagnosis.causes_),
    )


def log_pictures(diagnosis, log):
    """Return the Pictures of a log, measured against simulated, before and after.

    Parameters
    ----------
    diagnosis : SimulationDiagnosis
        Fitted.
    log : Log
        Rows to show: best those that were not fitted.
    """
    if tuple(diagnosis.hidden):
        try:
            picture = _open_loop(diagnosis, log)
        except RuntimeError:  # no initial state can be fitted to an episode that diverges
            return []
        return [] if picture is None else [picture]
    rows = _one_step(diagnosis, log)
    if rows is None:
        return []
    pictures = []
    if log.consecutive:
        if log.steps.max() > 0:
            pictures.append(_open_loop(diagnosis, log))
        pictures += [_structure(diagnosis, rows), _residuals_over_time(diagnosis, log, rows)]
    else:
        pictures += [_scatter(diagnosis, rows), _structure(diagnosis, rows)]
    return [picture for picture in pictures if picture is not None]


# -- one step ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _OneStep:
    """One-step predictions of the first rows of a log, without rows in which a simulation diverges.

    Attributes
    ----------
    log : Log
    rows : ndarray of int of shape (n_rows,)
        Which rows of the log.
    before, after : ndarray of shape (n_rows, n_outputs)
    residuals : tuple of two ndarray of shape (n_rows, n_channels)
        Measured minus predicted, before and after.
    noise : ndarray of shape (n_channels,)
        Standard deviation of what noise alone gives.
    """

    log: object
    rows: np.ndarray
    before: np.ndarray
    after: np.ndarray
    residuals: tuple
    noise: np.ndarray

    def worst(self, count):
        """Return the channels whose residual exceeds the noise most, before."""
        sizes = np.sqrt(np.mean(self.residuals[0] ** 2, axis=0)) / self.noise
        return np.argsort(-sizes)[:count]


def _one_step(diagnosis, log):
    simulator, extended = diagnosis.simulator, diagnosis.extended_simulator_
    rows = np.arange(min(len(log), MOST_ROWS))
    groups = log.groups[rows]
    X, y = log.X[rows], log.y[rows]
    before, after = (each.predict_many(X, [{}], groups=groups)[0] for each in (simulator, extended))
    there = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    if not there.any():
        return None
    residuals = tuple(simulator.residual(y[there], each[there]) for each in (before, after))
    noise = _noise_of_residuals(diagnosis, X[there], groups[there])
    return _OneStep(log, rows[there], before[there], after[there], residuals, noise)


def _noise_of_residuals(diagnosis, X, groups):
    """Return the deviations of one-step residuals that measurement noise alone gives, from one draw a row."""
    simulator, deviations = diagnosis.extended_simulator_, np.asarray(diagnosis.noise_, dtype=float)
    if not simulator.state_names:
        return deviations
    rng = np.random.default_rng(0)
    first, second = rng.standard_normal((2, len(X), len(deviations))) * deviations
    moved, still = simulator.predict_many(
        np.concatenate([simulator.displace(X, first), X]),
        [{}],
        groups=np.concatenate([groups, groups + groups.max() + 1]),
    )[0].reshape(2, len(X), -1)
    noise = simulator.residual(moved, still) + second
    return np.maximum(np.sqrt(np.nanmean(noise**2, axis=0)), 1e-300)


def _residuals_over_time(diagnosis, log, rows):
    shown = rows.rows[rows.rows < min(len(log), MOST_STEPS)]
    time, label = _time(diagnosis.simulator, shown)
    channels = rows.worst(MOST_CHANNELS)
    names, units = diagnosis.simulator.residual_names, diagnosis.simulator.units

    def draw(figure):
        panels = figure.subplots(len(channels), sharex=True, squeeze=False)[:, 0]
        for axes, channel in zip(panels, channels, strict=True):
            axes.axhspan(
                *(2 * rows.noise[channel] * np.array([-1, 1])), color=MEASURED, alpha=0.18, linewidth=0
            )
            for residuals, colour, name in _versions(diagnosis, rows.residuals):
                axes.plot(
                    time,
                    residuals[: len(shown), channel],
                    ".",
                    color=colour,
                    markersize=3.5,
                    alpha=0.8,
                    label=name,
                )
            for start in shown[(log.steps[shown] == 0) & (shown > 0)]:
                axes.axvline(_time(diagnosis.simulator, start)[0], color=GRID, linewidth=1)
            axes.set_ylabel(with_unit(names[channel], units.get(names[channel]), gap="\n"))
        panels[-1].set_xlabel(label)
        _legend(figure, panels[0])
        figure.align_ylabels()

    return _picture(
        "One step ahead: measured minus simulated",
        "The channels that exceed their noise most. The band is what noise alone gives (two standard "
        "deviations); vertical lines separate episodes.",
        draw,
        height=0.8 + 1.35 * len(channels),
    )


def _structure(diagnosis, rows):
    """Return the Picture of binned residuals against the input on which they depend most."""
    inputs = rows.log.X[rows.rows]
    found = []
    for coordinate in range(inputs.shape[1]):
        bins = _bins(inputs[:, coordinate])
        if bins.max() > 0:
            scores = _dependence(rows.residuals[0], bins)
            found += [(score, channel, coordinate) for channel, score in enumerate(scores)]
    pairs: dict[int, int] = {}
    for score, channel, coordinate in sorted(found, reverse=True):
        if score > CLEAR_DEPENDENCE and len(pairs) < MOST_CHANNELS:
            pairs.setdefault(channel, coordinate)
    if not pairs:
        return None
    names, units = diagnosis.simulator.residual_names, diagnosis.simulator.units

    def draw(figure):
        panels = figure.subplots(1, len(pairs), squeeze=False)[0]
        for axes, (channel, coordinate) in zip(panels, pairs.items(), strict=True):
            axes.axhline(0, color=MEASURED, linewidth=1)
            bins = _bins(inputs[:, coordinate])
            centres = _bin_means(inputs[:, [coordinate]], bins)[0][:, 0]
            for residuals, colour, name in _versions(diagnosis, rows.residuals):
                means, errors = _bin_means(residuals[:, [channel]], bins)
                axes.errorbar(
                    centres,
                    means[:, 0],
                    2 * errors[:, 0],
                    fmt="o-",
                    color=colour,
                    markersize=3.5,
                    linewidth=1,
                    elinewidth=1,
                    label=name,
                )
            across, up = diagnosis.simulator.input_names[coordinate], names[channel]
            axes.set_xlabel(with_unit(across, units.get(across)))
            axes.set_ylabel(with_unit(f"error of {up}", units.get(up), gap="\n"))
        _legend(figure, panels[0])

    return _picture(
        "One step ahead: what the error depends on",
        "Measured minus simulated, averaged over rows with similar input (bars: two standard errors), for "
        "the channels and inputs where the dependence is clearest. A right simulation stays at zero.",
        draw,
        height=2.7,
    )


def _bins(values):
    edges = np.unique(np.quantile(values, np.linspace(0, 1, N_BINS + 1)[1:-1]))
    return np.unique(np.searchsorted(edges, values, side="left"), return_inverse=True)[1]


def _bin_means(columns, bins):
    """Return means and their standard errors, (n_bins, n_columns)."""
    counts = np.bincount(bins)[:, None]
    means = np.stack([np.bincount(bins, column) for column in columns.T], axis=1) / counts
    squares = np.stack([np.bincount(bins, column) for column in ((columns - means[bins]) ** 2).T], axis=1)
    return means, np.sqrt(squares / counts / np.maximum(counts - 1, 1))


def _dependence(residuals, bins):
    """Return for each channel how far the bins' means are from zero, in standard errors."""
    means, errors = _bin_means(residuals, bins)
    count = bins.max() + 1
    safe = np.where(errors > 0, errors, np.inf)
    return (np.sum(np.minimum((means / safe) ** 2, 1e6), axis=0) - count) / np.sqrt(2 * count)


def _scatter(diagnosis, rows):
    """Return the Picture of measured against simulated outputs, or changes of state."""
    simulator = diagnosis.simulator
    outputs = list(simulator.output_names)
    state = bool(simulator.state_names)
    plain = [name for name in simulator.residual_names if name in outputs]
    channels = [
        outputs.index(simulator.residual_names[k])
        for k in rows.worst(len(simulator.residual_names))
        if simulator.residual_names[k] in plain
    ]
    channels = channels[:MOST_CHANNELS]
    if not channels:
        return None
    picked = np.unique(np.linspace(0, len(rows.rows) - 1, min(len(rows.rows), MOST_POINTS)).astype(int))
    reference = rows.log.X[rows.rows] if state else np.zeros((len(rows.rows), len(outputs)))
    measured = rows.log.y[rows.rows]
    word, size = "change of " if state else "", 8 if len(picked) < FEW_POINTS else 4

    def draw(figure):
        panels = figure.subplots(1, len(channels), squeeze=False)[0]
        for axes, channel in zip(panels, channels, strict=True):
            across = (measured - reference[:, : len(outputs)])[picked, channel]
            for predicted, colour, name in _versions(diagnosis, (rows.before, rows.after)):
                simulated = (predicted - reference[:, : len(outputs)])[picked, channel]
                axes.plot(simulated, across, ".", color=colour, markersize=size, alpha=0.65, label=name)
            axes.axline((across[0], across[0]), slope=1, color=MEASURED, linewidth=1)
            shown = with_unit(word + outputs[channel], simulator.units.get(outputs[channel]))
            axes.set(xlabel=f"simulated {shown}", ylabel=f"measured {shown}")
        _legend(figure, panels[0])

    return _picture(
        "Measured against simulated",
        "A point for each row; on the line the simulation is right.",
        draw,
        height=3.0,
    )


# -- open loop -----------------------------------------------------------------------------------------------


def _open_loop(diagnosis, log):
    """Return the Picture of episodes simulated from their first state on."""
    short = log.rows(_within(log))
    simulator = diagnosis.simulator
    paths, initial_is_fitted = [], bool(tuple(diagnosis.hidden))
    for each in (simulator, diagnosis.extended_simulator_):
        episodes = Episodes(each, short, tuple(diagnosis.hidden))
        initial = episodes.fit_initial_states({}, diagnosis.noise_) if initial_is_fitted else episodes.initial
        paths.append(each.rollout_many(initial, episodes.inputs, [{}], n_steps=episodes.n_steps)[0])
    names = list(simulator.output_names)
    there = [
        k
        for k, name in enumerate(names)
        if name in simulator.residual_names and name not in tuple(diagnosis.hidden)
    ]
    measured = np.full_like(paths[0], np.nan)
    measured[:, 0] = short.X[short.steps == 0][:, : len(names)]
    measured[short.episodes, short.steps + 1] = short.y
    spread = np.nanstd(measured.reshape(-1, len(names)), axis=0)
    errors = np.abs(measured - paths[0]) / np.where(spread > 0, spread, 1.0)
    errors = np.where(np.isnan(paths[0]) & ~np.isnan(measured), 1.0, np.nan_to_num(errors))[:, :, there]
    if not there:
        return None
    channels = [there[k] for k in np.argsort(-np.mean(errors**2, axis=(0, 1)))[:MOST_CHANNELS]]
    lengths = np.sum(~np.isnan(measured[..., there[0]]), axis=1)
    chosen = typical_and_worst(np.sum(errors**2, axis=(1, 2)), lengths)

    def draw(figure):
        panels = figure.subplots(len(channels), len(chosen), squeeze=False, sharex="col")
        for column, episode in enumerate(chosen):
            lasts = np.flatnonzero(~np.isnan(measured[episode, :, there[0]]))[-1] + 1
            time, label = _time(simulator, np.arange(lasts))
            parts = [part[episode, :lasts][:, channels] for part in (measured, *paths)]
            display = TrajectoryDisplay.from_predictions(
                time,
                *parts[: 3 if diagnosis.causes_ else 2],
                names=[names[k] for k in channels],
                units=simulator.units,
                ax=panels[:, column],
            )
            for axes in display.ax_:
                axes.grid(True)
                if column:
                    axes.set_ylabel("")
            display.ax_[0].get_legend().remove()
            display.ax_[-1].set_xlabel(label)
            if len(chosen) > 1:
                display.ax_[0].set_title("typical episode" if column == 0 else "worst episode", loc="left")
        figure.align_ylabels()
        _legend(figure, panels[0, 0])

    start = (
        "the initial state that fits each simulation best"
        if initial_is_fitted
        else "the first measured state"
    )
    cut = f" The first {MOST_STEPS} steps." if (np.bincount(log.episodes) > MOST_STEPS).any() else ""
    return _picture(
        "In open loop: measured and simulated",
        f"Whole episodes simulated from {start}, the channels with the largest error.{cut}",
        draw,
        height=1.0 + 1.45 * len(channels),
    )


def typical_and_worst(errors, lengths):
    """Return the episodes of the median and of the largest error per row, given each one's sum and number of rows."""
    order = np.argsort(errors / lengths)
    return list(dict.fromkeys([int(order[len(order) // 2]), int(order[-1])]))


def _within(log):
    return (log.episodes < MOST_CANDIDATES) & (log.steps < MOST_STEPS)


# -- drawing -------------------------------------------------------------------------------------------------


def _versions(diagnosis, pair):
    """Return (values, colour, label) of the simulation before and, if there is one, after."""
    before, after = pair
    if not diagnosis.causes_:
        return [(before, BEFORE, "simulated")]
    return [(before, BEFORE, "simulated, before"), (after, AFTER, "simulated, after")]


def _time(simulator, steps):
    return (steps, "step") if simulator.dt is None else (simulator.dt * steps, "time (s)")


def _legend(figure, axes):
    """Put the legend of some Axes above the whole figure."""
    legend = figure.legend(
        *axes.get_legend_handles_labels(), loc="outside upper left", ncols=3, handlelength=1.4
    )
    for handle in legend.legend_handles:
        handle.set_alpha(1.0)


def _picture(title, caption, draw, *, height, width=8.4):
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    data = base64.b64encode(_themed(buffer.getvalue()).encode()).decode()
    return Picture(title, caption, f"data:image/svg+xml;base64,{data}")


def _themed(svg):
    """Return the SVG with colours that follow the page's: light or dark."""
    light = ";".join(f"--{name}:{colour}" for name, colour, _ in THEME.values())
    dark = ";".join(f"--{name}:{colour}" for name, _, colour in THEME.values())
    for colour, (name, _, _) in THEME.items():
        svg = svg.replace(colour, f"var(--{name})")
    style = (
        f"<style>svg{{{light}}}@media (prefers-color-scheme: dark){{svg{{{dark}}}}}"
        "text{font-family:system-ui,-apple-system,'Segoe UI',Helvetica,Arial,sans-serif!important}</style>"
    )
    head, mark, rest = svg.partition("<defs>")
    return f"{head}{style}{mark}{rest}"
