"""Measured data from their public sources, and simulated measurements, each a `Bunch` of transitions."""

from skat.datasets.ball_drops import ball_drop_simulator, fetch_ball_drops
from skat.datasets.cube_tosses import cube_toss_simulator, fetch_cube_tosses
from skat.datasets.double_pendulum import fetch_double_pendulum
from skat.datasets.go2_air import fetch_go2_air
from skat.datasets.originals import data_home
from skat.datasets.pendulum import fetch_pendulum, pendulum_simulator
from skat.datasets.pucks import make_hidden_puck, make_real_puck
from skat.datasets.ricmonk import fetch_ricmonk
from skat.datasets.so101 import fetch_so101
from skat.datasets.ur10 import fetch_ur10
from skat.episodes import split_episodes

__all__ = [
    "ball_drop_simulator",
    "cube_toss_simulator",
    "data_home",
    "fetch_ball_drops",
    "fetch_cube_tosses",
    "fetch_double_pendulum",
    "fetch_go2_air",
    "fetch_pendulum",
    "fetch_ricmonk",
    "fetch_so101",
    "fetch_ur10",
    "make_hidden_puck",
    "make_real_puck",
    "pendulum_simulator",
    "split_episodes",
]
