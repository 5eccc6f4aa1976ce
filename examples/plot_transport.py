"""
Carry a simulation onto a measurement
=====================================

A simulated pendulum has too little damping and too little inertia. Rows are (angle, speed, torque, next
angle, next speed). Which transport carries the simulated rows to the measured ones?
"""

import matplotlib.pyplot as plt
import numpy as np

from skat import AffineTransport, ConditionalAffineTransport, IdentityTransport, ProcrustesAffineTransport

STEP_S = 0.05
NAMES = ["next angle (rad)", "next speed (rad/s)"]


def next_state(angle, speed, torque, damping, inertia):
    """Return the state one step later, by the semi-implicit Euler method."""
    acceleration = (torque - damping * speed - 9.81 * np.sin(angle)) / inertia
    speed = speed + STEP_S * acceleration
    return angle + STEP_S * speed, speed


def rows_of(inputs, rng, *, damping, inertia, noise):
    """Return rows of state, action and next state, for given states and actions."""
    after = np.column_stack(next_state(*inputs.T, damping, inertia))
    return np.column_stack([inputs, after + noise * rng.normal(size=after.shape)])


def inputs_of(rng, n_rows):
    """Return rows of state and action."""
    return rng.normal(size=(n_rows, 3)) * [0.4, 2.0, 1.0]


# %%
# Fit on rows that are not paired
# -------------------------------
# A robot does not repeat the simulation's states. `ConditionalAffineTransport` needs no pairs: it leaves
# state and action as they are and carries the next state given them. The sensor is simulated, too: without
# its noise the simulated angle would follow from the speed exactly, and no map could make the two vary apart.

rng = np.random.default_rng(0)
simulation = {"damping": 0.1, "inertia": 1.0, "noise": 0.01}
reality = {"damping": 1.5, "inertia": 1.3, "noise": 0.01}
simulated = rows_of(inputs_of(rng, 500), rng, **simulation)
measured = rows_of(inputs_of(rng, 300), rng, **reality)

transports = {
    "no transport": IdentityTransport(),
    "affine": AffineTransport(metric_scale="target"),
    "conditional": ConditionalAffineTransport(context=3),
}
for transport in transports.values():
    transport.fit(simulated, measured)

# %%
# Test on rows that are
# ---------------------
# To see the error row by row, both are started from the same new states.

inputs = inputs_of(rng, 500)
pair = [rows_of(inputs, rng, **world) for world in (simulation, reality)]
transports["Procrustes, on pairs"] = ProcrustesAffineTransport().fit(pair[0][:300], pair[1][:300])
test_simulated, test_measured = (rows[300:] for rows in pair)

errors = {}
for name, transport in transports.items():
    carried = transport.transform(test_simulated)
    errors[name] = np.sqrt(np.square(carried[:, 3:] - test_measured[:, 3:]).mean(axis=0))
    print(f"{name:>22}: {errors[name][0]:.4f} rad, {errors[name][1]:.4f} rad/s")

# %%
# The sensor's noise is 0.01 in each of the two. The conditional transport comes close to it without a single
# pair, while the plain map also moves the inputs, which are not what the simulation gets wrong.

figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
for axis, column, name in zip(axes, (3, 4), NAMES):
    for label, style in (("no transport", "."), ("conditional", "x")):
        carried = transports[label].transform(test_simulated)[:, column]
        axis.plot(test_measured[:, column], carried, style, ms=4, label=label)
    axis.axline((0, 0), slope=1, color="black", lw=0.8)
    axis.set(xlabel=f"measured {name}", ylabel=f"simulated {name}")
axes[0].legend()

# %%
# How many measured rows does it take?
# ------------------------------------
# Each point is the mean over ten sets of measured rows.

counts = [12, 20, 40, 80, 160, 300]
speeds = []
for count in counts:
    residuals = []
    for k in range(10):
        rng = np.random.default_rng([count, k])
        few = rows_of(inputs_of(rng, count), rng, **reality)
        transport = ConditionalAffineTransport(context=3).fit(simulated, few)
        residuals.append(transport.transform(test_simulated)[:, 4] - test_measured[:, 4])
    speeds.append(np.sqrt(np.mean(np.square(residuals))))

figure, axis = plt.subplots(figsize=(5, 3.5), layout="constrained")
axis.plot(counts, speeds, "o-", label="conditional")
axis.axhline(errors["no transport"][1], color="black", ls=":", label="no transport")
axis.set(xlabel="measured rows", ylabel="error of the next speed (rad/s)", ylim=(0, None))
axis.legend()
plt.show()
