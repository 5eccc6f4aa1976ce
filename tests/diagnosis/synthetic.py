"""A content with everything in it, made up: what the page is tried on."""

import io

import numpy as np

from skat.diagnosis.report.content import (
    Alternative,
    Change,
    ChannelError,
    ChannelNoise,
    Content,
    Episode,
    ForceNoise,
    Law,
    Left,
    MethodError,
    Provenance,
    Series,
    ShownCause,
    ShownLog,
    SourceFile,
    Spectrum,
    Still,
    Verdict,
    Visibility,
)


def picture(colour, size=(320, 240)):
    """Return a PNG of one colour."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", size, colour).save(buffer, format="png")
    return buffer.getvalue()


def series(name, unit, time, rng, *, error, noise):
    truth = np.sin(3 * time) + 0.3 * np.sin(11 * time)
    measured = truth + noise * rng.standard_normal(len(time))
    nominal = truth * (1 + error) + 0.2 * error * time
    nominal[:: len(time) // 4] = np.nan  # simulated anew four times
    return Series(name, unit, measured, nominal, truth + 0.01 * np.sin(5 * time))


def episode(label, n_times=800, n_channels=6, seed=0):
    rng, time = np.random.default_rng(seed), np.linspace(0, 4, n_times)
    joints = ["shoulder", "elbow", "wrist"]
    names = [(f"qpos.{one}", "rad") for one in joints] + [(f"qvel.{one}", "rad/s") for one in joints]
    channels = [
        series(name, unit, time, rng, error=0.35 / (k + 1), noise=0.01 * (k + 1))
        for k, (name, unit) in enumerate(names[:n_channels])
    ]
    return Episode(label, time, tuple(channels))


def left(name, word, seed):
    rng, frequency = np.random.default_rng(seed), np.linspace(0.25, 125, 400)
    density = 1e-4 / (1 + (frequency / 4) ** 2) + 2e-4 * np.exp(-((frequency - 22) ** 2) / 2)
    x = np.linspace(-1.5, 1.5, 12)
    mean = 0.2 * np.tanh(4 * x) + 0.01 * rng.standard_normal(12)
    law = Law(f"qvel.{name}", "rad/s", x, mean, mean - 0.03, mean + 0.03, before=0.9 * np.tanh(4 * x))
    return Left(
        name,
        "N m",
        rms=0.18,
        interval=(0.15, 0.21),
        scale=4.0,
        predictable=0.41,
        law=law,
        spectrum=Spectrum(frequency, density, word),
        sentence=f"0.18 N m are left at {name}; how fast it turns predicts 41 % of them.",
    )


def full_content(**changes):
    """Return a Content in which nothing is left out."""
    frequency = np.linspace(0.25, 125, 300)
    parts = {
        "title": "arm.xml against monday.csv",
        "verdict": Verdict(
            "ambiguous",
            "2 causes named, but the data allow other names",
            (
                "Dry friction of elbow is 0.6 N m more than the model's (95 %: 0.588 to 0.612).",
                "The time step is 0.25 times the model's (95 %: 0.25 to 0.255); the estimate is at the end of the "
                "range allowed, so something else may be behind it.",
                "These data cannot tell dry_friction[elbow] from damping[elbow].",
            ),
            probability=0.87,
            alternatives=(
                Alternative(("damping[elbow]", "timestep"), 0.09),
                Alternative(("timestep",), 0.001),
            ),
        ),
        "causes": (
            ShownCause(
                "dry_friction[elbow]",
                "N m",
                0.6,
                (0.588, 0.612),
                0.0,
                "Dry friction of elbow is 0.6 N m more than the model's.",
                probability=0.96,
                evidence="34 nats",
                aliases=(Alternative(("damping[elbow]",), 0.09),),
            ),
            ShownCause(
                "timestep",
                "1",
                0.25,
                (0.25, 0.2551),
                1.0,
                "The time step is 0.25.",
                0.999,
                "12 nats",
                (),
                True,
            ),
        ),
        "also_seen": (
            ShownCause(
                "armature[wrist]", "kg m2", 2.1e-5, (1e-5, 3.2e-5), 0.0, "Rotor inertia.", 0.99, "9 nats"
            ),
        ),
        "logs": (
            ShownLog(
                "Rows held out",
                horizon="0.4 s ahead",
                signal_horizon="simulated anew every second from what was measured",
                sentences=(
                    "With the causes built in, the squared error goes from 5.91 to 1.02 times what noise gives.",
                ),
                episodes=(episode("Episode 3, the worst"), episode("Episode 1, a typical one", seed=1)),
                errors=tuple(
                    ChannelError(
                        f"q{kind}.{name}", unit, 0.1 / (k + 1), 0.02 / (k + 1), 0.018 / (k + 1), gain, ends
                    )
                    for k, (kind, name, unit, gain, ends) in enumerate(
                        [
                            ("pos", "shoulder", "rad", 0.98, (0.95, 1.01)),
                            ("pos", "elbow", "rad", 0.96, (0.9, 1.02)),
                            ("vel", "shoulder", "rad/s", 0.4, (-3.0, 9.0)),
                            ("vel", "elbow", "rad/s", 0.9, (0.8, 0.95)),
                        ]
                    )
                ),
                comparison=(
                    MethodError("nominal simulation", 0.193, "before", 3.2, (3.0, 3.4)),
                    MethodError("AffineTransport", 0.11, "map", 1.8, (1.7, 1.9), 7000),
                    MethodError("CORAL", None, "map", None, None, 7000),
                    MethodError("extended simulation", 0.06, "after"),
                ),
                comparison_sentences=("No transport beats the extended simulation on data not used.",),
            ),
        ),
        "left": (
            left("elbow", "vibration at 22 Hz", 1),
            left("shoulder", "drift", 2),
            Left(
                "wrist",
                "N m",
                0.02,
                (0.0001, 0.4),
                1.0,
                None,
                None,
                Spectrum(frequency, 1e-6 + 0 * frequency, "white"),
            ),
        ),
        "left_sentences": ("Less than 5 % of what the motors do is left unexplained at any joint.",),
        "noise": (
            ChannelNoise("qpos.elbow", "rad", 3.83e-4, (3.8e-4, 3.86e-4), np.inf),
            ChannelNoise("qvel.elbow", "rad/s", 0.0102, (0.01, 0.0104), 5.0),
        ),
        "forces": (ForceNoise("elbow", "N m", 0.021, 0.05), ForceNoise("shoulder", "N m", 0.004, 0.0)),
        "visibility": tuple(
            Visibility(
                f"{family}[{joint}]",
                unit,
                0.01 * (k + 1) if k % 7 else np.inf,
                f"damping[{joint}]",
                0.2 + 0.05 * (k % 16),
                k == 1,
                "slower turns in both directions" if k % 5 == 0 else "",
            )
            for k, (family, unit, joint) in enumerate(
                (family, unit, joint)
                for family, unit in [
                    ("dry_friction", "N m"),
                    ("armature", "kg m2"),
                    ("gain", "1"),
                    ("bias", "rad"),
                ]
                for joint in ("shoulder", "elbow", "wrist", "gripper")
            )
        ),
        "next_steps": ("Turn the elbow slowly in both directions: it tells dry friction from damping.",),
        "changes": (
            Change('joint "elbow"', "frictionloss", None, "0.6"),
            Change("option", "timestep", "0.002", "0.0005"),
        ),
        "beside": ("delay[ctrl.elbow] = 0.004 s: send commands two steps later.",),
        "stills": (
            Still("As given", "An arm; the measured one, as a ghost, hangs lower.", picture((90, 90, 110))),
            Still("Extended", "An arm on its ghost.", picture((110, 90, 90))),
        ),
        "provenance": Provenance(
            date="2026-11-24T20:15:00+00:00",
            files=(
                SourceFile(
                    "model",
                    "arm.xml",
                    "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
                    2314,
                ),
                SourceFile(
                    "log",
                    "monday.csv",
                    "60303ae22b998861bce3b28f33eec1be758a213c86c93c076dbe9f558c11c752",
                    812345,
                ),
            ),
            command="skat diagnose arm.xml monday.csv --extended better.xml",
            versions=(("skat", "0.1.0"), ("mujoco", "4.0.0"), ("numpy", "2.3.1")),
            seed="0",
            settings=(("Rows fitted", "7000 in 7 episodes"), ("Chance of a false alarm", "at most 0.01")),
            warnings=("qvel.elbow is quantised to 0.01 rad/s.", "Gaps of 0.1 s: new episodes begin there."),
            notes=("The column q2 was taken for qpos.elbow.",),
        ),
    }
    return Content(**(parts | changes))
