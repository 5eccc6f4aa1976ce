import dataclasses
import hashlib
import io
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from skat.diagnosis.report import Report
from skat.diagnosis.report.changes import mjcf_changes, model_changes
from skat.diagnosis.report.content import (
    Alternative,
    Change,
    Content,
    Episode,
    Left,
    Series,
    ShownCause,
    ShownLog,
    SourceFile,
    Verdict,
)
from skat.diagnosis.report.page import page
from skat.diagnosis.report.plots import SIZE, cause_line, points_of_each, signal_plots, spectrum_plot
from skat.diagnosis.report.provenance import provenance, source_file
from skat.diagnosis.report.stills import worst_moment
from skat.diagnosis.report.tables import guarded_size, is_guarded, probability_text
from skat.simulators import MujocoSimulator
from tests.diagnosis.pages import Page
from tests.diagnosis.synthetic import episode, full_content
from tests.machines import SERVO_ARM

ORDER = [
    "signals",
    "causes",
    "next",
    "errors",
    "left",
    "noise",
    "visible",
    "changes",
    "made",
]


def bare(name="nothing detected", **parts):
    return Content("A against B", Verdict(name, "Nothing detected", ("No effect is seen.",)), **parts)


def one_channel(measured, nominal, extended=None):
    time = np.arange(len(measured), dtype=float)
    (plot,) = signal_plots(Episode("1", time, (Series("q", "rad", measured, nominal, extended),)))
    return plot


def numbers_of(path):
    return np.array([[float(part) for part in pair] for pair in re.findall(r"([-\d.]+) ([-\d.]+)", path)])


# -- what the page says --------------------------------------------------------------------------------------


def test_sections_stand_in_the_order_in_which_they_matter():
    ids = Page(page(full_content())).ids
    assert [one for one in ids if one in ORDER] == ORDER


def test_the_page_shows_every_text_and_name_of_its_content():
    content = full_content()
    text = Page(page(content)).text

    def texts(part):
        if isinstance(part, str):
            yield part
        elif isinstance(part, tuple | list):
            for one in part:
                yield from texts(one)
        elif dataclasses.is_dataclass(part):
            for field in dataclasses.fields(part):
                yield from texts(getattr(part, field.name))

    shown = [one for one in texts(content) if one not in ("1", "map", "before", "after", "ambiguous")]
    # Alternative texts and roles of bars are attributes; a cause's sentence is the verdict's; the date is written out.
    hidden = {still.alt for still in content.stills} | {content.provenance.date}
    hidden |= {cause.sentence for cause in (*content.causes, *content.also_seen)}
    missing = [one for one in shown if one and one not in hidden and re.sub(r"\s+", " ", one) not in text]
    assert not missing


def test_what_is_not_known_leaves_no_trace():
    html = page(bare())
    parsed = Page(html)
    assert "No effect is seen." in parsed.text
    assert parsed.ids == []
    assert "table" not in parsed.tags
    assert not parsed.plots
    assert "None" not in parsed.text
    assert "nan" not in parsed.text


def test_links_of_the_page_lead_to_its_sections():
    parsed = Page(page(full_content()))
    targets = [source[1:] for source in parsed.sources if source.startswith("#")]
    assert set(targets) >= set(ORDER)
    assert set(targets) <= set(parsed.ids)
    assert len(parsed.ids) == len(set(parsed.ids))


def test_the_page_refers_to_nothing_outside_and_is_ascii():
    html = page(full_content(title="Ångström <arm> & more"))
    assert html.isascii()
    assert not re.search(r"https?://|@import|url\(", html)
    assert all(source.startswith(("#", "data:")) for source in Page(html).sources)
    assert "<title>&#197;ngstr&#246;m &lt;arm&gt; &amp; more: 2 causes named" in html


def test_the_same_content_gives_the_same_page():
    assert page(full_content()) == page(full_content())


def test_names_that_look_like_markup_stay_text():
    evil = '<img src=x onerror="alert(1)">'
    cause = dataclasses.replace(full_content().causes[0], name=evil, aliases=(Alternative((evil,)),))
    series = Series(evil, evil, np.arange(3.0), np.arange(3.0))
    log = ShownLog(evil, episodes=(Episode(evil, np.arange(3.0), (series,)),))
    html = page(
        full_content(title=evil, causes=(cause,), logs=(log,), changes=(Change(evil, evil, evil, evil),))
    )
    assert "<img src=x" not in html
    assert Page(html).text.count(evil) > 5


def test_a_page_of_a_large_robot_stays_below_two_megabytes():
    large = [episode(f"Episode {k}", n_times=20_000, seed=k) for k in range(3)]
    wide = [
        dataclasses.replace(
            one,
            channels=tuple(
                dataclasses.replace(channel, name=f"{channel.name}{k}")
                for k in range(4)
                for channel in one.channels
            ),
        )
        for one in large
    ]
    noise = np.random.default_rng(0).integers(0, 255, (360, 480, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).quantize(96).save(buffer, format="png")
    content = full_content()
    stills = tuple(dataclasses.replace(still, png=buffer.getvalue()) for still in content.stills)
    logs = (dataclasses.replace(content.logs[0], episodes=tuple(wide)),)
    assert len(page(full_content(logs=logs, stills=stills))) < 2e6


def test_a_fragment_has_no_script_and_no_ids_that_could_meet_another_one_s():
    parsed = Page(Report(full_content()).html())
    assert "script" not in parsed.tags
    assert not parsed.ids
    assert Page(Report(full_content())._repr_html_()).plots == []


def test_text_says_verdict_probability_sentences_and_gain():
    text = repr(Report(full_content()))
    assert text.startswith("Verdict: ambiguous (probability 87 %)\n")
    assert "Rows held out: With the causes built in" in text


def test_a_verdict_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="verdict must be one of nothing detected, named"):
        bare("perhaps")


def test_a_table_that_is_added_is_shown_and_counted_among_the_contents():
    report = Report(full_content())
    report.add_table(
        "All balls", pd.DataFrame({"error": [0.1, 0.2]}, index=pd.Index(["a", "b"], name="ball"))
    )
    report.describe(title="Balls")
    html = page(report.content)
    assert "All balls ball error a 0.1 b 0.2" in Page(html).text
    assert "#table-1" in Page(html).sources
    with pytest.raises(TypeError, match="it is a list"):
        report.add_table("No table", [1])


# -- numbers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "interval", "neutral", "text"),
    [
        (96.0, (49.5, 240.0), 0.0, "between 49.5 and 240"),
        (0.6, (0.588, 0.612), 0.0, "0.6"),
        (1.02, (0.9, 1.14), 1.0, "between 0.9 and 1.14"),
        (2.0, (1.9, 2.1), 1.0, "2"),
        (1.0, (-np.inf, np.inf), 0.0, "between -∞ and ∞"),
    ],
)
def test_a_size_whose_interval_is_wider_than_itself_is_not_said(value, interval, neutral, text):
    assert guarded_size(value, interval, neutral) == text
    assert is_guarded(value, interval, neutral) == text.startswith("between")


def test_under_unexplained_no_bare_number_stands_for_what_is_hardly_known():
    wild = ShownCause("dry_friction[elbow]", "N m", 96.3, (49.5, 240.0), 0.0, "Dry friction of elbow.")
    left = Left("elbow", "N m", 0.123, (0.001, 0.9))
    errors = dataclasses.replace(full_content().logs[0].errors[0], gain=1.153, interval=(-2.0, 8.0))
    log = ShownLog("Rows held out", errors=(errors,))
    content = Content("x", Verdict("unexplained", "Unexplained"), causes=(wild,), left=(left,), logs=(log,))
    text = Page(page(content)).text
    assert "between 49.5 and 240" in text
    assert "at most 0.9" in text
    assert "not known" in text
    assert "take their sizes as hints" in text
    for bare_number in ("96", "0.123", "115"):
        assert bare_number not in text


def test_a_probability_is_never_a_certainty():
    texts = [
        probability_text(one).replace("\N{NO-BREAK SPACE}", " ") for one in (1.0, 0.996, 0.87, 0.004, 0.0)
    ]
    assert texts == ["> 99 %", "> 99 %", "87 %", "< 1 %", "< 1 %"]


# -- plots ---------------------------------------------------------------------------------------------------


def test_a_line_goes_through_the_places_of_its_values():
    plot = one_channel(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.5, 0.0]))
    points = numbers_of(plot.marks[0].path)
    np.testing.assert_allclose(points[:, 0], [0, SIZE / 2, SIZE], atol=0.01)
    up = plot.y.low + (1 - points[:, 1] / SIZE) * (plot.y.high - plot.y.low)
    np.testing.assert_allclose(up, [0, 1, 0], atol=2e-4)


def test_ticks_say_where_they_stand():
    plot = one_channel(np.linspace(-3.2, 7.9, 50), np.zeros(50))
    for axis in (plot.x, plot.y):
        assert 3 <= len(axis.ticks) <= 7
        for place, text in axis.ticks:
            said = float(text.replace("−", "-"))
            assert axis.low + place / 100 * (axis.high - axis.low) == pytest.approx(said, abs=1e-9)


def test_tiny_and_huge_values_are_told_in_powers_of_ten():
    tiny = one_channel(2e-7 * np.sin(np.arange(50)), np.zeros(50))
    assert tiny.y.label == "q (10⁻⁷ rad)"
    assert all(len(text) <= 5 for _, text in tiny.y.ticks)
    huge = one_channel(3e8 * np.sin(np.arange(50)), np.zeros(50))
    assert huge.y.label == "q (10⁸ rad)"


def test_a_constant_channel_and_one_that_was_never_simulated_are_drawn():
    plot = one_channel(np.full(9, 3.0), np.full(9, np.nan))
    assert plot.y.low < 3 < plot.y.high
    assert plot.marks[1].path == ""


def test_lines_break_where_values_are_missing_and_lone_values_are_dots():
    gappy = np.array([0, 1, np.nan, 5, np.nan, 2, 3], dtype=float)
    plot = one_channel(np.arange(7.0), gappy)
    assert plot.marks[1].path.count("M") == 3
    assert "h0" in plot.marks[1].path


def test_a_simulation_that_runs_away_does_not_hide_what_was_measured():
    plot = one_channel(np.sin(np.arange(60)), np.exp(np.arange(60.0)))
    assert plot.y.high < 4
    assert np.abs(numbers_of(plot.marks[1].path)).max() <= 10 * SIZE


@pytest.mark.parametrize("n_times", [50, 5_000, 100_000])
def test_a_long_line_keeps_its_extremes_and_its_ends(n_times):
    values = np.random.default_rng(0).standard_normal(n_times)
    (plot,) = signal_plots(
        Episode("1", np.arange(n_times, dtype=float), (Series("q", "1", values, values),)), 500
    )
    points = numbers_of(plot.marks[0].path)
    assert len(points) <= 500
    up = plot.y.low + (1 - points[:, 1] / SIZE) * (plot.y.high - plot.y.low)
    tolerance = 2e-4 * (plot.y.high - plot.y.low)
    np.testing.assert_allclose([up.max(), up.min()], [values.max(), values.min()], atol=tolerance)
    np.testing.assert_allclose(up[[0, -1]], values[[0, -1]], atol=tolerance)


def test_all_lines_together_have_a_bounded_number_of_points():
    for n_series in (1, 10, 100, 300):
        assert n_series * points_of_each(n_series) <= 60_000


def test_a_spectrum_without_power_is_not_drawn():
    content = full_content().left[0].spectrum
    assert spectrum_plot(dataclasses.replace(content, density=np.zeros_like(content.density)), "N m") is None


def test_a_cause_s_line_has_its_interval_where_the_numbers_put_it():
    cause = ShownCause("x", "1", 2.0, (1.5, 3.0), 1.0, "")
    line = cause_line(cause)
    assert (line.value - line.neutral) / (line.high - line.neutral) == pytest.approx(0.5)
    assert (line.low - line.neutral) / (line.high - line.neutral) == pytest.approx(0.25)
    assert cause_line(dataclasses.replace(cause, interval=(-np.inf, np.inf))) is None


# -- changes of the model ------------------------------------------------------------------------------------


def test_changes_are_those_that_were_made():
    before = (
        '<mujoco><option timestep="0.002"/><worldbody><body name="a"><joint name="j" damping="1"/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    after = (
        '<mujoco><option timestep="0.001"/><worldbody><body name="a"><joint name="j" damping="1" armature="0.1"/>'
        '<joint name="j.play" range="0 1"/><geom size="0.10000000000000001"/></body></worldbody></mujoco>'
    )
    assert set(mjcf_changes(before, after)) == {
        Change("option", "timestep", "0.002", "0.001"),
        Change('joint "j"', "armature", None, "0.1"),
        Change('joint "j.play"', "", None, 'name="j.play" range="0 1"'),
        # What rounds to the same is told with all digits.
        Change('geom of body "a"', "size", "0.1", "0.10000000000000001"),
    }
    assert mjcf_changes(before, before) == ()


def test_a_model_s_changes_and_what_mjcf_cannot_express_are_those_of_its_effects():
    arm = MujocoSimulator(SERVO_ARM, frame_skip=5)
    joint = arm.state_names[0].removeprefix("qpos.")
    better = arm.extended({f"dry_friction[{joint}]": 0.25, "wind[x]": 0.5})
    changes, beside = model_changes(arm, better)
    assert changes == (Change(f'joint "{joint}"', "frictionloss", changes[0].before, changes[0].after),)
    compiled = better.compiled()
    assert float(changes[0].after) == pytest.approx(
        compiled.dof_frictionloss[
            compiled.jnt_dofadr[mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_JOINT, joint)]
        ]
    )
    assert len(beside) == 1
    assert beside[0].startswith("wind[x]: ")
    assert model_changes(object(), object()) == ((), ())


# -- how it was made -----------------------------------------------------------------------------------------


def test_files_are_told_with_the_hash_that_other_tools_give(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"time,qpos.a\n0,1\n" * 100)
    program = "import hashlib, sys; print(hashlib.sha256(open(sys.argv[1], 'rb').read()).hexdigest())"
    expected = subprocess.run(
        [sys.executable, "-c", program, path], capture_output=True, text=True, check=True
    )
    assert source_file("log", path) == SourceFile("log", str(path), expected.stdout.strip(), 1600)
    assert source_file("log", tmp_path / "gone.csv").sha256 == ""


def test_a_folder_s_hash_changes_with_any_file_in_it(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    first = source_file("log", tmp_path)
    listing = "".join(f"{hashlib.sha256(name.encode()).hexdigest()}  {name}\n" for name in ("a", "b"))
    assert first.sha256 == hashlib.sha256(listing.encode()).hexdigest()
    assert first.path.endswith("(2 files)")
    (tmp_path / "b").write_text("c")
    assert source_file("log", tmp_path).sha256 != first.sha256


def test_provenance_has_versions_date_and_each_warning_once():
    made = provenance(
        command="skat diagnose", seed=3, settings={"Rate": "100 Hz", "No": None}, warnings=["w", "w"]
    )
    assert dict(made.versions)["mujoco"] == mujoco.__version__
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d", made.date)
    assert (made.seed, made.settings, made.warnings) == ("3", (("Rate", "100 Hz"),), ("w",))


# -- stills --------------------------------------------------------------------------------------------------


def arm_episode(simulator, n_times=5):
    names = simulator.state_names
    time = np.arange(n_times, dtype=float)
    still = np.zeros(n_times)
    moved = np.array([0.0, 0.1, 0.4, 0.2, 0.1])
    channels = tuple(
        Series(name, "rad", still, moved if k == 0 else still, still) for k, name in enumerate(names)
    )
    return Episode("Episode 2, the worst", time, channels)


def test_without_opengl_the_page_says_so_in_place_of_pictures(monkeypatch):
    from skat.replay import NoOpenGL

    def refuse(*_, **__):
        raise NoOpenGL("MuJoCo found no OpenGL to draw with. Install one.")

    monkeypatch.setattr("skat.replay.frames", refuse)
    simulator = MujocoSimulator(SERVO_ARM)
    stills, note = worst_moment(simulator, arm_episode(simulator))
    assert stills == ()
    assert "Install one." in note
    assert note in Page(page(full_content(stills=(), stills_note=note))).text


def test_the_worst_moment_is_the_one_that_is_drawn(monkeypatch):
    drawn = {}

    def draw(simulator, poses, ghosts, *, size):
        drawn.update(poses=np.array(poses), ghosts=np.array(ghosts))
        return [np.zeros((size[1], size[0], 3), dtype=np.uint8) for _ in poses]

    monkeypatch.setattr("skat.replay.frames", draw)
    simulator = MujocoSimulator(SERVO_ARM)
    stills, note = worst_moment(simulator, arm_episode(simulator))
    assert note == ""
    assert drawn["poses"][:, 0].tolist() == [0.4, 0.0]
    assert not drawn["ghosts"].any()
    assert "2 s into episode 2, the worst" in stills[0].title
    assert all(still.png.startswith(b"\x89PNG") for still in stills)


def test_resources_of_the_page_are_ascii_so_that_none_is_escaped_within_it():
    folder = Path(sys.modules[page.__module__].__file__).parent
    for name in ("page.css", "page.js"):
        assert (folder / name).read_bytes().isascii()
