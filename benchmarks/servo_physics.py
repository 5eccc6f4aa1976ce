"""How much slower rows are whose friction and torque are renewed in each time step, against the same rows without.

    python benchmarks/servo_physics.py

Prints, for each robot and family, candidates of one kind in one call over plain candidates in the same call size, both
timed in turn in one process, best of several.
"""

import time

import numpy as np

from skat.simulators import Simulator, make_simulator

ROWS, CANDIDATES, ROUNDS = 400, 16, 7
KINDS = {
    "mass": "mass",  # the plain batch: models of their own
    "stribeck": "stribeck",
    "load_friction": "load_friction",
    "torque_speed": "torque_speed",
    "dead_zone": "dead_zone",
    "lag_torque, carried along": "lag_torque",
    "backlash, carried along": "backlash",
}


def candidates_of(simulator: Simulator, family: str) -> list[dict[str, float]]:
    """Return candidates with one effect of a family each, at different values."""
    effects = [one for one in simulator.effects(also="all") if one.family == family and one.target != "all"]
    found = []
    for index in range(CANDIDATES):
        effect = effects[index % len(effects)]
        value = effect.neutral + min(0.1 * effect.typical, effect.bounds[1] - effect.neutral)
        found.append({effect.name: value * (1 + 0.01 * index)})
    return found


def main() -> None:
    """Print the table."""
    print(f"{'robot':12}{'family':28}{'rows/s':>10}{'of plain':>10}")
    for name in ("so101", "go2_air"):
        simulator = make_simulator(name)
        n_states = len(simulator.state_names)
        random = np.random.default_rng(0)
        rows = np.zeros((ROWS, len(simulator.input_names)))
        rows[:, : n_states // 2] = random.normal(scale=0.1, size=(ROWS, n_states // 2))
        rows[:, n_states:] = rows[:, : n_states // 2]
        groups = np.repeat(np.arange(20), ROWS // 20)
        best = dict.fromkeys(KINDS, np.inf)
        for _ in range(ROUNDS):
            for kind, family in KINDS.items():
                candidates = candidates_of(simulator, family)
                start = time.perf_counter()
                simulator.predict_many(rows, candidates, groups=groups)
                best[kind] = min(best[kind], time.perf_counter() - start)
        for kind, seconds in best.items():
            print(f"{name:12}{kind:28}{ROWS * CANDIDATES / seconds:10.0f}{best['mass'] / seconds:10.2f}")


if __name__ == "__main__":
    main()
