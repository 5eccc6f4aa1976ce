"""By how much predictions change with each effect: differences over steps that fit the noise, and secants."""

import numpy as np

# A derivative by an effect is a difference over a step that moves the predictions by about this much noise ...
STEP_IN_NOISE = 0.3
# ... sought from this share of the effect's range, and never beyond that one.
FIRST_STEP = 1e-4
LARGEST_STEP = 0.05
# In noise units.
LEAST_CHANGE = 1e-5
ROWS_FOR_STEPS = 40


class Slopes:
    """Slopes of predictions by effects, each over a step of its own, chosen when it is first asked for or by `choose`.

    Its methods take a function ``changes(candidates, rows)``, which returns by how much the predictions
    (n_candidates - 1, n_rows, n_channels) of the candidates after the first exceed the first's; ``rows`` are an index,
    all rows by default.

    Parameters
    ----------
    effects : iterable of Effect
        By which slopes may be asked for.

    Attributes
    ----------
    steps : dict of str to float
        The steps as they were last chosen.
    """

    def __init__(self, effects):
        self.effects = {effect.name: effect for effect in effects}
        self.steps = {}

    def derivatives(self, changes, values, names, *, n_rows, deviations):
        """Return the derivatives of the predictions at a model.

        Parameters
        ----------
        changes : callable
        values : dict of str to float
            The model.
        names : iterable of str
            The effects.
        n_rows : int
            Number of rows that `changes` knows.
        deviations : ndarray of shape (n_channels,)
            Standard deviations of what the predictions are compared with.

        Returns
        -------
        ndarray of shape (n_rows, n_channels, n_names)
        """
        names = list(names)
        if not names:
            return np.zeros((n_rows, len(deviations), 0))
        new = [name for name in names if name not in self.steps]
        if new:
            self.choose(changes, values, new, n_rows=n_rows, deviations=deviations)
        moves = [self._move(values, name, self.steps[name]) for name in names]
        moved = changes([values, *self._stepped(values, names, moves)])
        moved = np.nan_to_num(moved, nan=0.0, posinf=0.0, neginf=0.0)
        # What a step of an effect moves by less than this is rounding, not a derivative.
        felt = np.max(np.abs(moved / deviations), axis=(1, 2))
        moved[felt < LEAST_CHANGE] = 0.0
        return np.moveaxis(moved, 0, -1) / np.where(np.equal(moves, 0), np.inf, moves)

    def secants(self, changes, values, widths):
        """Return the slopes of secants about a model.

        Parameters
        ----------
        changes : callable
        values : dict of str to float
            The model.
        widths : dict of str to float
            How far each effect's secant reaches to both sides, as far as the effect's bounds allow.

        Returns
        -------
        ndarray of shape (n_rows, n_channels, n_effects)
        """
        ends = []
        for name, width in widths.items():
            at, (low, high) = self._at(values, name), self.effects[name].bounds
            ends += [max(at - width, low), min(at + width, high)]
        moved = changes(
            [values, *({**values, name: end} for name, end in zip(np.repeat(list(widths), 2), ends))]
        )
        moves = np.subtract(ends[1::2], ends[::2])[:, None, None]
        slopes = (moved[1::2] - moved[::2]) / np.where(moves == 0, np.inf, moves)
        return np.moveaxis(np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0), 0, -1)

    def choose(self, changes, values, names, *, n_rows, deviations):
        """Scale each effect's step until the predictions change by little against the noise but well above rounding.

        Parameters are those of `derivatives`.
        """
        rows = np.unique(np.linspace(0, n_rows - 1, ROWS_FOR_STEPS).astype(int))
        ranges = {name: np.ptp(self.effects[name].bounds) for name in names}
        steps = {name: FIRST_STEP * ranges[name] for name in names}
        open_names = list(names)
        for _ in range(4):
            moves = [self._move(values, name, steps[name]) for name in open_names]
            moved = changes([values, *self._stepped(values, open_names, moves)], rows) / deviations
            still_open = []
            for name, change in zip(open_names, moved):
                size = np.sqrt(np.nanmean(change**2)) if np.isfinite(change).any() else np.inf
                factor = np.clip(STEP_IN_NOISE / size, 1e-3, 1e3) if size > 0 else 1e3
                step = min(steps[name] * factor, LARGEST_STEP * ranges[name])
                if not 0.2 < step / steps[name] < 5:
                    still_open.append(name)
                steps[name] = step
            open_names = still_open
            if not open_names:
                break
        self.steps.update(steps)

    def _stepped(self, values, names, moves):
        return [{**values, name: self._at(values, name) + move} for name, move in zip(names, moves)]

    def _at(self, values, name):
        return values.get(name, self.effects[name].neutral)

    def _move(self, values, name, step):
        """Return the step, turned or shortened so that the effect stays within its bounds."""
        at, (low, high) = self._at(values, name), self.effects[name].bounds
        if at + step <= high:
            return step
        if at - step >= low:
            return -step
        return high - at if high - at >= at - low else low - at
