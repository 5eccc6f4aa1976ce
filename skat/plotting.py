"""Figures in scikit-learn's manner: a Display holds what it shows, and ``plot`` draws it.

Colours mean the same everywhere: grey is the measurement (target), orange the simulation (source), blue the
simulation after transport or diagnosis. They are of Okabe and Ito's palette, which colour-blind readers can
tell apart.
"""

import numpy as np

from skat.gaussian import row_moments

__all__ = [
    "CauseDisplay",
    "DomainMatrixDisplay",
    "LearningCurveDisplay",
    "TrajectoryDisplay",
    "TransportDisplay",
]

MEASURED, BEFORE, AFTER = "#555555", "#E69F00", "#0072B2"
METHODS = (AFTER, "#D55E00", "#009E73", "#CC79A7", BEFORE, "#56B4E9", "#000000")
MARKERS = "osD^vPX"


class TransportDisplay:
    """Clouds of source, transported and target rows in two coordinates.

    Use `from_estimator` or `from_predictions`.

    Parameters
    ----------
    source, transported, target : ndarray of shape (n_rows, 2)
        Coordinates of the rows; `source` and `transported` have as many.
    labels : tuple of two str
        Names of the coordinates.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> from sklearn.preprocessing import FunctionTransformer
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.normal(size=(2, 50, 3))
    >>> display = TransportDisplay.from_estimator(FunctionTransformer(), X, y)
    >>> display.ax_.get_xlabel()
    'principal coordinate 1'
    """

    def __init__(self, *, source, transported, target, labels):
        self.source = source
        self.transported = transported
        self.target = target
        self.labels = labels

    @classmethod
    def from_estimator(
        cls, estimator, X, y, *, features="principal", feature_names=None, n_points=1000, n_arrows=0, ax=None
    ):
        """Draw a fitted transport at work.

        Parameters
        ----------
        estimator : fitted transport or pipeline that ends in one
            Anything with ``transform``.
        X : array-like of shape (n_source, n_features)
            Source rows.
        y : array-like of shape (n_target, n_features)
            Target rows.
        features : "principal" or pair of int or str, default="principal"
            Two columns, by number or name; or the first two principal axes of the target.
        feature_names : sequence of str, default=None
            Names of the columns; those of a data frame by default.
        n_points : int, default=1000
            Largest number of rows drawn of each cloud, evenly picked.
        n_arrows : int, default=0
            Number of arrows from source rows to where they are carried.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        TransportDisplay

        Raises
        ------
        TypeError
            If the estimator cannot transform.
        ValueError
            If the columns differ or a feature is unknown.
        """
        if not hasattr(estimator, "transform"):
            raise TypeError(
                "a transport is drawn by what estimator.transform(X) returns, but "
                f"{type(estimator).__name__} cannot transform. Give a transport or a pipeline."
            )
        options = {"features": features, "feature_names": feature_names, "n_points": n_points}
        return cls.from_predictions(X, estimator.transform(X), y, n_arrows=n_arrows, ax=ax, **options)

    @classmethod
    def from_predictions(
        cls,
        X,
        X_transported,
        y,
        *,
        features="principal",
        feature_names=None,
        n_points=1000,
        n_arrows=0,
        ax=None,
    ):
        """Draw rows that were carried before.

        Parameters
        ----------
        X, X_transported : array-like of shape (n_source, n_features)
            Source rows, before and after.
        y : array-like of shape (n_target, n_features)
            Target rows.
        features, feature_names, n_points, n_arrows, ax
            As for `from_estimator`.

        Returns
        -------
        TransportDisplay

        Raises
        ------
        ValueError
            If shapes do not fit or a feature is unknown.
        """
        names = _feature_names(X, feature_names)
        X, X_transported, y = _rows(X, "X"), _rows(X_transported, "X_transported"), _rows(y, "y")
        if X.shape != X_transported.shape or X.shape[1] != y.shape[1]:
            raise ValueError(
                "X and X_transported must have one shape and y the same columns; "
                f"their shapes are {X.shape}, {X_transported.shape} and {y.shape}."
            )
        if isinstance(features, str) and features == "principal":
            axes, labels = _principal_axes(y)
        else:
            columns = [_column(feature, names, X.shape[1]) for feature in features]
            if len(columns) != 2:
                raise ValueError(
                    f"features must be two columns, or 'principal'; {features!r} names {len(columns)}."
                )
            axes, labels = np.eye(X.shape[1])[columns], tuple(names[k] for k in columns)
        drawn, target = _evenly(len(X), n_points), _evenly(len(y), n_points)
        display = cls(
            source=X[drawn] @ axes.T,
            transported=X_transported[drawn] @ axes.T,
            target=y[target] @ axes.T,
            labels=labels,
        )
        return display.plot(ax=ax, n_arrows=n_arrows)

    def plot(self, ax=None, *, n_arrows=0):
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        n_arrows : int, default=0
            Number of arrows from source rows to where they are carried.

        Returns
        -------
        TransportDisplay
        """
        self.ax_, self.figure_ = _axes(ax, size=(5.2, 4.2))
        clouds = (
            ("target", self.target, MEASURED, "o", 16),
            ("source", self.source, BEFORE, "^", 14),
            ("source, transported", self.transported, AFTER, "o", 9),
        )
        for name, rows, colour, marker, size in clouds:
            opacity = float(np.clip(150 / len(rows), 0.25, 0.9))
            self.ax_.scatter(
                *rows.T, s=size, color=colour, marker=marker, alpha=opacity, linewidths=0, label=name
            )
        for k in _evenly(len(self.source), n_arrows) if n_arrows else ():
            arrow = {"arrowstyle": "->", "color": AFTER, "alpha": 0.7}
            self.ax_.annotate("", self.transported[k], self.source[k], arrowprops=arrow)
        self.ax_.set(xlabel=self.labels[0], ylabel=self.labels[1])
        legend = self.ax_.legend(loc="best", frameon=False)
        for handle in legend.legend_handles:
            handle.set_alpha(1.0)
            handle.set_sizes([30])
        _trim(self.ax_)
        return self


class DomainMatrixDisplay:
    """A number for each pair of a source and a target domain, as a heat map.

    Use `from_frame`.

    Parameters
    ----------
    values : ndarray of shape (n_sources, n_targets)
        NaN where a pair is missing; such cells stay empty.
    sources, targets : sequence of str
        Names of rows and columns.
    label : str
        What the numbers are.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.
    im_ : matplotlib AxesImage
        The cells.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame(
    ...     {"source": ["light", "heavy"], "target": ["heavy", "light"], "value": [0.3, 0.5]}
    ... )
    >>> DomainMatrixDisplay.from_frame(frame).values
    array([[nan, 0.3],
           [0.5, nan]])
    """

    def __init__(self, *, values, sources, targets, label):
        self.values = values
        self.sources = sources
        self.targets = targets
        self.label = label

    @classmethod
    def from_frame(
        cls, frame, *, value="value", source="source", target="target", label=None, ax=None, **options
    ):
        """Draw a data frame with a row for each pair.

        Parameters
        ----------
        frame : pandas.DataFrame
            Columns `source`, `target` and `value`; domains are shown in the order in which they first appear
            as sources, so that a domain has the same place in rows and columns.
        value, source, target : str
            Names of the columns.
        label : str, default=None
            What the numbers are; the name of their column by default.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        **options
            For `plot`.

        Returns
        -------
        DomainMatrixDisplay

        Raises
        ------
        ValueError
            If a column is missing or a pair appears more than once.
        """
        _check_columns(frame, (value, source, target))
        twice = frame.duplicated([source, target])
        if twice.any():
            pair = frame[twice].iloc[0]
            raise ValueError(
                f"each pair of domains can have one value; {pair[source]} to {pair[target]} has several. "
                "Select one method or average first."
            )
        sources = list(dict.fromkeys(frame[source]))
        targets = [name for name in sources if name in set(frame[target])]
        targets += [name for name in dict.fromkeys(frame[target]) if name not in set(sources)]
        values = np.full((len(sources), len(targets)), np.nan)
        for row, column, number in zip(frame[source], frame[target], frame[value]):
            values[sources.index(row), targets.index(column)] = number
        display = cls(values=values, sources=sources, targets=targets, label=label or value)
        return display.plot(ax=ax, **options)

    def plot(self, ax=None, *, limits=None, cmap="viridis_r", number_format=".2f", colorbar=True):
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        limits : pair of float, default=None
            Numbers at the ends of the colour scale, to make figures comparable; those of the data by default.
        cmap : str or matplotlib Colormap, default="viridis_r"
            Colour scale; by default large numbers are dark.
        number_format : str, default=".2f"
            How to write the numbers; empty for none.
        colorbar : bool, default=True
            Whether to draw the scale.

        Returns
        -------
        DomainMatrixDisplay
        """
        n_rows, n_columns = self.values.shape
        self.ax_, self.figure_ = _axes(ax, size=(2.6 + 0.62 * n_columns, 1.5 + 0.5 * n_rows))
        low, high = limits or (np.nanmin(self.values), np.nanmax(self.values))
        self.im_ = self.ax_.imshow(self.values, cmap=cmap, vmin=low, vmax=high, aspect="auto")
        self.ax_.set_xticks(range(n_columns), self.targets, rotation=35, ha="right", rotation_mode="anchor")
        self.ax_.set_yticks(range(n_rows), self.sources)
        self.ax_.set(xlabel="target", ylabel="source")
        self.ax_.tick_params(length=0)
        self.ax_.spines[:].set_visible(False)
        self.ax_.set_xticks(np.arange(n_columns - 1) + 0.5, minor=True)
        self.ax_.set_yticks(np.arange(n_rows - 1) + 0.5, minor=True)
        self.ax_.grid(which="minor", color="white", linewidth=1.5)
        self.ax_.tick_params(which="minor", length=0)
        if number_format:
            for (row, column), number in np.ndenumerate(self.values):
                if np.isfinite(number):
                    self._write(row, column, format(number, number_format))
        if colorbar:
            bar = self.figure_.colorbar(self.im_, ax=self.ax_, label=self.label)
            bar.outline.set_visible(False)
        else:
            self.ax_.set_title(self.label)
        return self

    def _write(self, row, column, text):
        red, green, blue, _ = self.im_.cmap(self.im_.norm(self.values[row, column]))
        is_dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        self.ax_.text(
            column, row, text, ha="center", va="center", color="white" if is_dark else "black", fontsize=9
        )


class LearningCurveDisplay:
    """Error against the number of samples, for several methods, with bands of two standard deviations.

    Use `from_frame`.

    Parameters
    ----------
    curves : dict of str to ndarray of shape (n_sizes, 3)
        For each method, in columns: the number of samples, the mean and the standard deviation (NaN for no
        band).
    labels : tuple of two str
        Names of the axes.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame(
    ...     {"n_samples": [10, 10, 20, 20], "method": "affine", "error": [4.0, 2.0, 1.0, 1.0]}
    ... )
    >>> LearningCurveDisplay.from_frame(frame).curves["affine"]
    array([[10., 3., 1.],
           [20., 1., 0.]])
    """

    def __init__(self, *, curves, labels):
        self.curves = curves
        self.labels = labels

    @classmethod
    def from_frame(
        cls, frame, *, size="n_samples", method="method", value="error", deviation=None, ax=None, **options
    ):
        """Draw a tidy data frame.

        Parameters
        ----------
        frame : pandas.DataFrame
            A row for each size, method and repetition; or for each size and method, with a column
            `deviation`.
        size, method, value : str
            Names of the columns of the number of samples, the method and the error.
        deviation : str, default=None
            Column of standard deviations of already averaged values; by default they are taken over
            repetitions.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        **options
            For `plot`.

        Returns
        -------
        LearningCurveDisplay

        Raises
        ------
        ValueError
            If a column is missing; or with `deviation`, if a size appears twice for a method.
        """
        _check_columns(frame, (size, method, value) + ((deviation,) if deviation else ()))
        curves = {}
        for name, rows in frame.groupby(method, sort=False):
            by_size = rows.groupby(size)
            if deviation is None:
                spread = by_size[value].std(ddof=0).where(by_size[value].count() > 1)
            elif rows[size].duplicated().any():
                raise ValueError(
                    f"with a column of deviations each size appears once a method; {name} has "
                    f"{len(rows)} rows for {rows[size].nunique()} sizes. "
                    "Select or average first, or leave out deviation."
                )
            else:
                spread = by_size[deviation].mean()
            curves[str(name)] = np.column_stack([spread.index, by_size[value].mean(), spread]).astype(float)
        return cls(curves=curves, labels=(size, value)).plot(ax=ax, **options)

    def plot(self, ax=None, *, log_size=True, log_value=False, baseline=None):
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        log_size, log_value : bool
            Whether the axes are logarithmic. Bands are cut at zero, or at the lowest mean on a logarithmic
            axis.
        baseline : float, default=None
            A number to compare with, such as the error without transport, as a dashed line.

        Returns
        -------
        LearningCurveDisplay
        """
        self.ax_, self.figure_ = _axes(ax, size=(5.6, 3.8))
        floor = 0.5 * min(curve[:, 1].min() for curve in self.curves.values()) if log_value else -np.inf
        for k, (name, (sizes, means, deviations)) in enumerate((n, c.T) for n, c in self.curves.items()):
            style = {"color": METHODS[k % len(METHODS)]}
            self.ax_.plot(sizes, means, marker=MARKERS[k % len(MARKERS)], markersize=4, label=name, **style)
            low = np.maximum(means - 2 * deviations, floor)
            self.ax_.fill_between(sizes, low, means + 2 * deviations, alpha=0.16, linewidth=0, **style)
        if baseline is not None:
            self.ax_.axhline(baseline, color=MEASURED, linestyle="--", linewidth=1, label="without transport")
        if log_size:
            self.ax_.set_xscale("log")
            sizes = sorted({size for curve in self.curves.values() for size in curve[:, 0]})
            if len(sizes) <= 8:
                self.ax_.set_xticks(sizes, [f"{size:g}" for size in sizes])
                self.ax_.set_xticks([], minor=True)
        if log_value:
            self.ax_.set_yscale("log")
        elif min((c[:, 1] - 2 * np.nan_to_num(c[:, 2])).min() for c in self.curves.values()) >= 0:
            self.ax_.set_ylim(bottom=0)
        self.ax_.set(xlabel=self.labels[0], ylabel=self.labels[1])
        self.ax_.legend(frameon=False, title="mean, band of 2 standard deviations", title_fontsize="small")
        _trim(self.ax_)
        return self


class TrajectoryDisplay:
    """A measured trajectory against the simulation before and after, over time.

    Use `from_estimator` or `from_predictions`.

    Parameters
    ----------
    time : ndarray of shape (n_times,)
        In s.
    measured, before, after : ndarray of shape (n_times, n_channels)
        `after` may be None.
    names : sequence of str
        Names of the channels.

    Attributes
    ----------
    ax_ : ndarray of matplotlib Axes of shape (n_channels,)
        One for each channel, from top to bottom.
    figure_ : matplotlib Figure
        The figure around them.

    Examples
    --------
    >>> time = np.linspace(0, 1, 50)
    >>> fall = np.column_stack([1 - 4.9 * time**2, -9.8 * time])
    >>> display = TrajectoryDisplay.from_predictions(time, fall, 1.1 * fall, names=["height", "velocity"])
    >>> [ax.get_ylabel() for ax in display.ax_]
    ['height', 'velocity']
    """

    def __init__(self, *, time, measured, before, after, names):
        self.time = time
        self.measured = measured
        self.before = before
        self.after = after
        self.names = names

    @classmethod
    def from_estimator(cls, diagnosis, X, y, *, channels=None, ax=None):
        """Draw one episode, simulated open loop from its first measured state.

        Parameters
        ----------
        diagnosis : fitted SimulationDiagnosis
            Anything with ``simulator`` and ``extended_simulator_``.
        X : array-like of shape (n_rows, n_inputs)
            The episode's rows: state, then other inputs.
        y : array-like of shape (n_rows, n_states)
            Its next states.
        channels : sequence of str, default=None
            Which states to show; all by default.
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If the simulation has no state, or a channel is unknown.
        """
        simulator = diagnosis.simulator
        names = tuple(simulator.state_names)
        if not names:
            raise ValueError(
                "a trajectory needs a simulation with a state; this one maps inputs to outputs in one step. "
                "Compare its outputs by TransportDisplay instead."
            )
        X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
        states, inputs = X[:, : len(names)], X[np.newaxis, :, len(names) :]
        measured = np.vstack([states[:1], y])
        before, after = (
            each.rollout(states[:1], inputs, n_steps=len(X))[0]
            for each in (simulator, diagnosis.extended_simulator_)
        )
        time = simulator.dt * np.arange(len(measured))
        return cls.from_predictions(time, measured, before, after, names=names, channels=channels, ax=ax)

    @classmethod
    def from_predictions(cls, time, measured, before, after=None, *, names, channels=None, ax=None):
        """Draw trajectories computed before.

        Parameters
        ----------
        time : array-like of shape (n_times,)
            In s.
        measured, before : array-like of shape (n_times, n_channels)
            The measurement and the simulation as given; rows may be NaN where there is none.
        after : array-like of shape (n_times, n_channels), default=None
            The simulation after transport or diagnosis.
        names : sequence of str
            Names of the channels.
        channels : sequence of str, default=None
            Which of them to show; all by default.
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If shapes do not fit or a channel is unknown.
        """
        time, names = np.asarray(time, dtype=float), list(names)
        rows = {"measured": measured, "before": before, "after": after}
        rows = {name: np.asarray(part, dtype=float) for name, part in rows.items() if part is not None}
        for name, part in rows.items():
            if part.shape != (len(time), len(names)):
                raise ValueError(
                    f"{name} must have a row per time and a column per name, "
                    f"shape ({len(time)}, {len(names)}); its shape is {part.shape}."
                )
        columns = [
            _column(channel, names, len(names)) for channel in (names if channels is None else channels)
        ]
        measured, before, after = (
            rows[name][:, columns] if name in rows else None for name in ("measured", "before", "after")
        )
        shown = [names[k] for k in columns]
        return cls(time=time, measured=measured, before=before, after=after, names=shown).plot(ax=ax)

    def plot(self, ax=None):
        """Draw.

        Parameters
        ----------
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If there are fewer or more Axes than channels.
        """
        from matplotlib import pyplot

        n_channels = len(self.names)
        if ax is None:
            size = (6.4, 0.9 + 1.45 * n_channels)
            _, ax = pyplot.subplots(
                n_channels, squeeze=False, sharex=True, figsize=size, layout="constrained"
            )
        self.ax_ = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        if len(self.ax_) != n_channels:
            raise ValueError(
                f"each of the {n_channels} channels needs its own Axes; there are {len(self.ax_)}."
            )
        self.figure_ = self.ax_[0].figure
        for k, (axes, name) in enumerate(zip(self.ax_, self.names)):
            axes.plot(
                self.time, self.measured[:, k], color=MEASURED, linewidth=2.5, alpha=0.7, label="measured"
            )
            axes.plot(self.time, self.before[:, k], color=BEFORE, linestyle="--", label="simulated, before")
            if self.after is not None:
                axes.plot(self.time, self.after[:, k], color=AFTER, linewidth=1.2, label="simulated, after")
            axes.set_ylabel(name)
            _trim(axes)
        self.figure_.align_ylabels(list(self.ax_))
        self.ax_[-1].set_xlabel("time (s)")
        self.ax_[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
        return self


class CauseDisplay:
    """Named causes and their intervals, each relative to the value at which it would do nothing.

    Causes have different units, so each has a scale of its own: the neutral value is at the line in the
    middle, and the end of the interval that is furthest from it at one edge. Numbers and units stand beside
    them. Use `from_estimator` or `from_causes`.

    Parameters
    ----------
    names, units : sequence of str
        Of the causes.
    values, neutrals : ndarray of shape (n_causes,)
        Estimates, and the values that leave the simulation as it is.
    intervals : ndarray of shape (n_causes, 2)
        Lower and upper ends.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> display = CauseDisplay(
    ...     names=["mass[torso]"], units=["1"], values=[1.08], neutrals=[1.0], intervals=[(1.05, 1.11)]
    ... )
    >>> [text.get_text() for text in display.plot().ax_.get_yticklabels()]
    ['mass[torso]']
    """

    def __init__(self, *, names, units, values, neutrals, intervals):
        self.names = names
        self.units = units
        self.values = values
        self.neutrals = neutrals
        self.intervals = intervals

    @classmethod
    def from_estimator(cls, diagnosis, *, ax=None):
        """Draw what a diagnosis has named.

        Parameters
        ----------
        diagnosis : fitted SimulationDiagnosis
            Anything with ``causes_`` and a ``simulator`` that knows its ``effects()``.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay
        """
        neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects()}
        return cls.from_causes(diagnosis.causes_, neutral=neutral, ax=ax)

    @classmethod
    def from_causes(cls, causes, *, neutral, ax=None):
        """Draw causes.

        Parameters
        ----------
        causes : sequence of Cause
            Anything with ``name``, ``value``, ``interval`` and ``unit``.
        neutral : dict of str to float
            For each name the value that leaves the simulation as it is.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay

        Raises
        ------
        ValueError
            If a cause has no neutral value.
        """
        missing = [cause.name for cause in causes if cause.name not in neutral]
        if missing:
            raise ValueError(f"neutral has no value for {missing}; it has values for {sorted(neutral)}.")
        display = cls(
            names=[cause.name for cause in causes],
            units=[cause.unit for cause in causes],
            values=[cause.value for cause in causes],
            neutrals=[neutral[cause.name] for cause in causes],
            intervals=[cause.interval for cause in causes],
        )
        return display.plot(ax=ax)

    def plot(self, ax=None):
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay
        """
        n_causes = len(self.names)
        self.ax_, self.figure_ = _axes(ax, size=(6.8, 0.9 + 0.5 * max(n_causes, 1)))
        values, neutrals = np.asarray(self.values, dtype=float), np.asarray(self.neutrals, dtype=float)
        ends = np.asarray(self.intervals, dtype=float).reshape(n_causes, 2)
        away = np.abs(np.column_stack([values, ends]) - neutrals[:, np.newaxis]).max(axis=1, initial=0)
        scale = np.where(away > 0, away, 1.0)
        rows = np.arange(n_causes)
        low, middle, high = ((each - neutrals) / scale for each in (ends[:, 0], values, ends[:, 1]))
        self.ax_.axvline(0, color=MEASURED, linewidth=1)
        self.ax_.hlines(
            rows, np.minimum(0, middle), np.maximum(0, middle), color=AFTER, alpha=0.3, linewidth=1.5
        )
        self.ax_.hlines(rows, low, high, color=AFTER, linewidth=5, alpha=0.45)
        self.ax_.plot(middle, rows, "o", color=AFTER, markersize=7)
        for row, (first, last) in enumerate(ends):
            unit = "" if self.units[row] in ("", "1") else f" {self.units[row]}"
            text = f"{values[row]:.3g}{unit}  ({first:.3g} to {last:.3g}; neutral {neutrals[row]:.3g})"
            self.ax_.text(1.12, row, text, va="center", fontsize=9)
        if not n_causes:
            self.ax_.text(0.05, 0, "nothing named", va="center")
        self.ax_.set_yticks(rows, self.names)
        self.ax_.set(xlim=(-1.08, 1.08), ylim=(max(n_causes, 1) - 0.5, -0.5))
        self.ax_.set_xticks([0], ["neutral"])
        self.ax_.tick_params(length=0)
        _trim(self.ax_)
        self.ax_.spines["bottom"].set_visible(False)
        self.ax_.spines["left"].set_visible(False)
        return self


def _axes(ax, size):
    """Return Axes and their figure, new ones of a size in inches where there are none."""
    from matplotlib import pyplot

    if ax is None:
        _, ax = pyplot.subplots(figsize=size, layout="constrained")
    return ax, ax.figure


def _trim(ax):
    ax.spines[["top", "right"]].set_visible(False)


def _rows(rows, name):
    rows = np.asarray(rows, dtype=float)
    if rows.ndim != 2 or len(rows) == 0:
        raise ValueError(f"{name} must be a 2-D array of at least one row; its shape is {rows.shape}.")
    return rows


def _feature_names(X, feature_names):
    if feature_names is not None:
        return list(feature_names)
    if hasattr(X, "columns"):
        return [str(name) for name in X.columns]
    return [f"feature {k}" for k in range(np.shape(X)[-1])]


def _column(feature, names, n_columns):
    if isinstance(feature, str):
        if feature not in names:
            raise ValueError(f"there is no column {feature!r}; there are {names}.")
        return names.index(feature)
    if not -n_columns <= feature < n_columns:
        raise ValueError(f"there is no column {feature}; there are {n_columns}.")
    return int(feature) % n_columns


def _principal_axes(rows):
    """Return two axes, in rows, and their labels."""
    if rows.shape[1] < 2:
        raise ValueError(f"a plane needs two columns; there is {rows.shape[1]}.")
    _, vectors = np.linalg.eigh(row_moments(rows).covariance)
    axes = vectors[:, [-1, -2]].T
    # An axis has no direction: its largest entry is made positive, so that figures are reproducible.
    largest = axes[[0, 1], np.abs(axes).argmax(axis=1)]
    return axes * np.sign(largest)[:, np.newaxis], ("principal coordinate 1", "principal coordinate 2")


def _evenly(n_rows, n_points):
    return np.unique(np.linspace(0, n_rows - 1, min(n_points, n_rows)).astype(int))


def _check_columns(frame, names):
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise ValueError(f"the data frame has no column {missing[0]!r}; it has {list(frame.columns)}.")
