"""Throughput of the simulators against bare ``mujoco.batch`` stepping of the same rows.

Run ``python benchmarks/simulators.py``. Each line shows the median over interleaved repetitions of both, and
the median of their ratio; the ratio must stay below 1.10.
"""

import argparse
import time

import joblib
import numpy as np
from mujoco.batch import Batch

from skat.simulators import MujocoSimulator, make_simulator


def random_rows(simulator: MujocoSimulator, n_rows: int) -> np.ndarray:
    """Return states of random episodes of 20 steps, with their random actions."""
    random = np.random.default_rng(0)
    model = simulator.compiled()
    n_episodes = n_rows // 20
    start = np.tile(np.r_[model.qpos0, np.zeros(model.nv)], (n_episodes, 1))
    actions = random.uniform(-1, 1, size=(n_episodes, 20, model.nu))
    states = simulator.rollout(start, actions, n_steps=20)
    return np.concatenate([states[:, :-1], actions], axis=2).reshape(n_episodes * 20, -1)


class Bare:
    """The fewest lines that step rows with ``mujoco.batch``."""

    def __init__(self, simulator: MujocoSimulator, candidates: list[dict[str, float]], n_rows: int):
        models = [simulator.compiled(values) for values in candidates]
        self.n_substeps = simulator.frame_skip
        self.batch = Batch(models[0], nsim=len(models) * n_rows, nthread=joblib.cpu_count())
        self.batch.set_models([model for model in models for _ in range(n_rows)])
        names = ("qpos", "qvel", "ctrl", "qacc_warmstart")
        self.qpos, self.qvel, self.ctrl, self.warm = (self.batch.bind(name) for name in names)

    def predict(self, rows: np.ndarray) -> np.ndarray:
        """Return the next states of all candidates' rows."""
        nq, nv = self.qpos.shape[1], self.qvel.shape[1]
        self.qpos[:], self.qvel[:], self.ctrl[:] = rows[:, :nq], rows[:, nq : nq + nv], rows[:, nq + nv :]
        self.warm[:] = 0
        self.batch.step(nstep=self.n_substeps)
        return np.hstack([self.qpos, self.qvel])


def compare(name: str, n_rows: int, n_candidates: int, repetitions: int) -> None:
    """Print the throughput of both, and their ratio."""
    simulator = make_simulator(name)
    rows = random_rows(simulator, n_rows)
    candidates = [{"mass[all]": 1 + 0.01 * index} for index in range(n_candidates)]
    bare, repeated = Bare(simulator, candidates, len(rows)), np.tile(rows, (n_candidates, 1))
    expected = bare.predict(repeated).reshape(n_candidates, len(rows), -1)
    difference = np.abs(simulator.predict_many(rows, candidates) - expected).max()
    seconds = np.empty((repetitions, 2))
    for repetition in range(repetitions):
        for column, run in enumerate(
            (lambda: bare.predict(repeated), lambda: simulator.predict_many(rows, candidates))
        ):
            start = time.perf_counter()
            run()
            seconds[repetition, column] = time.perf_counter() - start
    steps = len(repeated) * simulator.frame_skip
    rates = steps / np.median(seconds, axis=0)
    print(
        f"{name:12s} {n_candidates:3d} candidates x {len(rows)} rows: mujoco.batch {rates[0]:9,.0f} steps/s, "
        f"skat {rates[1]:9,.0f} steps/s, time ratio {np.median(seconds[:, 1] / seconds[:, 0]):.3f}, "
        f"largest difference {difference:.0e}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--repetitions", type=int, default=15)
    arguments = parser.parse_args()
    for name in ("hopper", "halfcheetah", "ant"):
        for n_candidates in (1, 10):
            compare(name, arguments.rows, n_candidates, arguments.repetitions)
    puck, strikes = make_simulator("puck"), np.random.default_rng(0).uniform(-1, 1, size=(500, 2))
    puck.predict(strikes[:10])
    start = time.perf_counter()
    puck.predict(strikes)
    print(f"puck         500 strikes until rest: {time.perf_counter() - start:.2f} s")


if __name__ == "__main__":
    main()
