"""Carry simulated samples onto measured ones, and find out what the simulation gets wrong."""

__version__ = "0.1.0"
