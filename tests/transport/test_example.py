"""The example runs, and shows what its text says."""

import runpy
from pathlib import Path

from matplotlib import pyplot

EXAMPLE = Path(__file__).parents[2] / "examples" / "plot_transport.py"


def test_example_shows_that_the_conditional_transport_comes_close_to_the_noise(monkeypatch, capsys):
    monkeypatch.setattr(pyplot, "show", lambda: None)
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    pyplot.close("all")
    speed = {}
    for line in capsys.readouterr().out.splitlines():
        name, values = line.split(":")
        speed[name.strip()] = float(values.split()[2])
    assert 0.01 < speed["conditional"] < 0.016
    assert 0.01 < speed["Procrustes, on pairs"] < 0.016
    assert speed["affine"] > 0.05
    assert speed["no transport"] > 0.05
