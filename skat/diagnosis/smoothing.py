r"""Positions that were smoothed forward and backward: by which filter, and what was read before.

A Butterworth filter :math:`H(z) = b(z) / a(z)` of order :math:`n` that was run forward and backward leaves
:math:`a(z) a(z^{-1})\, y = b(z) b(z^{-1})\, x` of readings :math:`x`. The left side has few taps, and the right side is
:math:`b_0^2 (1 + z)^n (1 + z^{-1})^n x` whatever the cutoff: means of readings over :math:`2n + 1` instants. Up to
half of the Nyquist frequency these are made readings again by taps that keep the noise of every second instant white.
Nothing is known where the filter began and ended.

The order shows in how fast noise falls off. Cutoff and size of the noise are one number there; but only with the right
cutoff do readings follow from the commands, so that the likelihood of the state space tells it, with the filter's
volume in it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy import signal

from skat.diagnosis.chains import Array
from skat.diagnosis.log import STRETCHES, Log
from skat.diagnosis.velocities import motions, power_by_frequency, states_in_time
from skat.simulators import Simulator

# Shares of the Nyquist frequency between which noise shows beside motion, and between which it falls off smoothly; of
# an episode with fewer instants neither is known.
MIDDLE, UPPER, FALLING, LONG_ENOUGH = (0.4, 0.6), (0.8, 0.95), (0.6, 0.85), 64
# Positions were smoothed if there is so many times more power between the first two than between the next.
SMOOTHED = 1e4
# Instants kept, taps to each side, and between which shares of the Nyquist frequency they end. Motion is where
# frequencies are low: there taps are so much more exact than elsewhere.
EVERY, TAPS, END, EXACT, LOW = 2, 8, (0.25, 0.75), 1e4, 0.1
# Cutoffs tried, as shares of the Nyquist frequency, and by which factors the best is moved then.
CUTOFFS = np.geomspace(0.04, 0.6, 9)
FACTORS = (1.18, 1.08, 1.04, 1.02, 1.01)
# It is told from stretches of so many rows, in so many turns with the causes at most.
STRETCH_ROWS, TURNS = 200, 4


@dataclass(frozen=True)
class Smoothing:
    """A Butterworth filter that was run forward and backward.

    `order`: of the filter; 0: there was none. `cutoff`: share of the Nyquist frequency. `channels`: positions that went
    through it.
    """

    order: int
    cutoff: float
    channels: tuple[str, ...]

    @property
    def reach(self) -> int:
        """Instants to each side that count."""
        return TAPS + self.order

    @property
    def taps(self) -> Array:
        """Weights of the instants around one, (2 reach + 1,), that make a reading of it."""
        taps = _binomial_undone(self.order)
        if self.order:
            b, a = self._filter()
            taps = np.convolve(np.convolve(a, a[::-1]) / (b[0] ** 2 * 4**self.order), taps)
        return taps

    @property
    def volume(self) -> float:
        """Log of what the filter makes of a unit of reading, mean over the frequencies that are kept."""
        if not self.order:
            return 0.0
        shares = (np.arange(500) + 0.5) / 500 / EVERY
        return float(np.mean(2 * np.log(np.abs(signal.freqz(*self._filter(), worN=np.pi * shares)[1]))))

    def hertz(self, simulator: Simulator) -> float:
        """Return the cutoff in Hz."""
        return self.cutoff / 2 / float(simulator.dt or np.nan)

    def sentence(self, simulator: Simulator) -> str:
        """Return what was undone, in words."""
        filtered = f"a Butterworth filter of order {self.order}, run forward and backward with a cutoff of"
        return f"{', '.join(self.channels)}: {filtered} {self.hertz(simulator):.3g} Hz"

    def _filter(self) -> tuple[Array, Array]:
        b, a = signal.butter(self.order, self.cutoff)
        return np.asarray(b), np.asarray(a)

    def undone(self, simulator: Simulator, log: Log) -> Log:
        """Return a log with what was read of every second instant, and NaN at the others and at the ends of episodes.

        `log`: rows of an episode follow each other.
        """
        names, n_states = simulator.state_names, len(simulator.state_names)
        columns = [names.index(name) for name in self.channels]
        X, y, taps = log.X.copy(), log.y.copy(), self.taps
        for episode in range(log.n_episodes):
            rows = np.flatnonzero(log.episodes == episode)
            states = np.concatenate([X[rows, :n_states], y[rows[-1:]]])
            read = np.full((len(states), len(columns)), np.nan)
            kept = np.arange(self.reach, len(states) - self.reach, EVERY)
            if len(kept):
                around = np.lib.stride_tricks.sliding_window_view(states[:, columns], len(taps), axis=0)
                read[kept] = around[kept - self.reach] @ taps
            X[rows[:, None], columns], y[rows[:, None], columns] = read[:-1], read[1:]
        return replace(log, X=X, y=y, simulator=simulator)


def smoothed_positions(simulator: Simulator, log: Log) -> Iterator[tuple[str, float, float]]:
    """Yield of each position how many times more power there is about half of the Nyquist frequency than towards it.

    And the order of a Butterworth filter, run forward and backward, behind which noise falls off as fast. Names first.
    """
    if not log.consecutive or not simulator.dt:
        return
    states, episodes, _ = states_in_time(simulator, log.X, log.y, log.episodes)
    for name, _ in motions(simulator):
        series = states[:, simulator.state_names.index(name)]
        pieces = [
            power_by_frequency(series[episodes == episode], LONG_ENOUGH) for episode in range(log.n_episodes)
        ]
        shares, powers = (np.concatenate(ones) for ones in zip(*pieces))
        middle, upper = (powers[(shares > low) & (shares < high)] for low, high in (MIDDLE, UPPER))
        if len(upper) and np.median(middle) > 0:
            falls = (shares > FALLING[0]) & (shares < FALLING[1]) & (powers > 0)
            slope = np.polyfit(np.log(np.tan(np.pi / 2 * shares[falls])), np.log(powers[falls]), 1)[0]
            yield name, float(np.median(middle) / max(np.median(upper), 1e-300)), float(-slope / 4)


def smoothing_of(
    simulator: Simulator,
    log: Log,
    likelihood: Callable[..., float],
    causes: Callable[[Log], Mapping[str, float]],
    progress: Callable[[str, int, int], None],
) -> Smoothing | None:
    """Return the filter that smoothed the positions which alone tell of their rates, or None.

    Cutoff and causes are told in turns, each with the other, until the cutoff stands still.

    `log`: as it was filtered. `likelihood`: ``likelihood(log, values=values)`` returns the log likelihood of what was
    read at values of effects. `causes`: ``causes(log)`` returns values of the effects that a log asks for. `progress`:
    ``progress(stage, done, total)``.
    """
    rates, outputs = dict(motions(simulator)), simulator.output_names
    found = {
        name: order
        for name, size, order in smoothed_positions(simulator, log)
        if size > SMOOTHED and np.isnan(log.y[:, outputs.index(rates[name])]).all()
    }
    if not found:
        return None
    order = float(np.median(list(found.values())))
    orders = tuple(sorted({max(1, int(np.floor(order))), max(1, int(np.ceil(order)))}))
    piece, values = log.stretches(STRETCHES, STRETCH_ROWS), dict[str, float]()
    smoothing: Smoothing | None = None
    for turn in range(TURNS):
        progress("smoothing", turn, TURNS)
        last, told = smoothing, partial(likelihood, values=values)
        smoothing = _likeliest(simulator, piece, tuple(found), orders, told, last)
        # Beyond the frequencies that are kept a cutoff is none that can be told.
        if not smoothing.order or smoothing.cutoff > 1 / EVERY:
            return None
        if smoothing == last:
            break
        values = dict(causes(smoothing.undone(simulator, piece)))
    return smoothing


def _likeliest(
    simulator: Simulator,
    log: Log,
    channels: tuple[str, ...],
    orders: tuple[int, ...],
    likelihood: Callable[[Log], float],
    near: Smoothing | None,
) -> Smoothing:
    """Return the filter with which a log is likeliest: of some orders and any cutoff, or none; or beside a near one."""
    known: dict[Smoothing, float] = {}
    columns = [simulator.state_names.index(name) for name in channels]

    def worth(smoothing: Smoothing) -> float:
        if smoothing not in known:
            read = smoothing.undone(simulator, log)
            count = int(np.isfinite(read.y[:, columns]).sum())
            known[smoothing] = likelihood(read) - count * smoothing.volume if count else -np.inf
        return known[smoothing]

    start = (
        [near]
        if near
        else [Smoothing(order, float(cutoff), channels) for order in orders for cutoff in CUTOFFS]
    )
    best = max(start, key=worth)
    for factor in FACTORS if near is None else FACTORS[2:]:
        for step in (factor, 1 / factor):
            while best.cutoff * step < 1 and worth(moved := replace(best, cutoff=best.cutoff * step)) > worth(
                best
            ):
                best = moved
    return best if near else max((best, Smoothing(0, 1.0, channels)), key=worth)


@lru_cache
def _binomial_undone(order: int) -> Array:
    """Return taps that make readings, up to half of the Nyquist frequency, of their binomial means."""
    shares = np.linspace(0, 1, 1601)
    angles = np.pi * shares
    low, high = END
    wanted = np.cos(np.pi / 2 * np.clip((shares - low) / (high - low), 0, 1))
    waves = np.column_stack([np.ones_like(angles), *(2 * np.cos(tap * angles) for tap in range(1, TAPS + 1))])
    weights = 1 + EXACT * np.exp(-((shares / LOW) ** 2))
    means = np.cos(angles / 2) ** (2 * order)
    half = np.linalg.lstsq(waves * (means * weights)[:, None], wanted * weights, rcond=None)[0]
    taps: Array = np.r_[half[:0:-1], half]
    taps.setflags(write=False)
    return taps
