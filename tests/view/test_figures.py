"""Figures: axes, labels and curves before saving, and the ink in the saved file."""

import numpy as np
import pytest
import synthetic

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.sensitivity import Sensitivity
from evo_cpg.analysis.verdict import Check
from evo_cpg.evolution.strategy import Axis
from evo_cpg.files import OutputError
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.conditions import Probe
from evo_cpg.view import plots
from evo_cpg.view.answer_plots import (
    MeasurePanel,
    audit_figure,
    lab_figure,
    probe_figure,
    sensitivity_figure,
)
from evo_cpg.view.figure import new_figure, save_figure
from evo_cpg.view.plots import _crests, fitness_figure, joint_signals_figure, path_figure
from evo_cpg.view.search_plots import Curves, generations_figure, map_figure, sweep_figure
from pictures import ink


@pytest.fixture(scope="module")
def recording():
    return synthetic.swim(12)


def rows_of(axes):
    """Names of the rows of axes."""
    return [label.get_text() for label in axes.get_yticklabels()]


def legend_of(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_saved_figure_has_ink_and_the_size_of_its_frame(tmp_path):
    figure = new_figure(4, 3, "a $x$ \u982d")
    assert figure.get_suptitle() == "a $x$ <982D>"
    figure.subplots().plot([0, 1], [0, 1])
    path = save_figure(figure, tmp_path / "x.png")
    assert synthetic.read(path).shape == (480, 640, 3)
    assert 0.01 < ink(path) < 0.1
    for name in ("x.txt", "x.mp4"):
        with pytest.raises(OutputError, match=r"Use \.png, \.svg or \.pdf"):
            save_figure(figure, tmp_path / name)


def test_the_crests_give_frequency_and_lag(recording):
    angle = np.degrees(recording.joint_angle[:, 2::3])
    frequency, lag, crests = _crests(recording.time, angle)
    assert frequency == pytest.approx(synthetic.FREQUENCY, rel=0.01)
    assert np.allclose(lag, synthetic.LAG, atol=0.02)
    # sin(2 pi f t - LAG i) has its crests at (1/4 + LAG i / 2 pi + k) / f, with i from 1.
    joints = np.arange(1, 10)
    beats = np.array(crests) * synthetic.FREQUENCY - 0.25 - synthetic.LAG * joints / (2 * np.pi)
    near = (np.array(crests) > 1) & (np.array(crests) < 11)
    assert np.abs(beats - np.rint(beats))[near].max() < 0.03


def test_slides_are_drawn_in_metres():
    recording = synthetic.swim(4)
    names = tuple(name.replace(".x", ".slide_x") for name in recording.dof_names)
    recording = recording._replace(dof_names=names)
    figure = joint_signals_figure(recording, "slide_x")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert "displacement (m)" in labels and figure.get_suptitle().startswith(
        "joint signals along x"
    )
    angle = next(axes for axes in joint_signals_figure(recording).axes if axes.get_ylabel())
    assert angle.get_ylabel() == "joint angle (deg)"


@pytest.mark.parametrize("drift", [np.zeros_like, np.square, np.exp, lambda t: np.sin(2.7 * t)])
@pytest.mark.parametrize(("count", "span"), [(181, 3.0), (2, 1.0), (30, 0.15)])
def test_rest_drift_and_short_signals_have_no_crests(drift, count, span):
    """A short signal has too few instants, or too little time, for two periods."""
    time = np.linspace(0, span, count)
    assert _crests(time, drift(3 * time / span)[:, None] * [1.0, 0.5]) is None


def test_crests_are_found_on_a_drift():
    time = np.linspace(0, 3, 181)
    angle = 30 * time[:, None] + np.sin(2 * np.pi * 1.4 * time[:, None] - [0.0, 0.6])
    frequency, lag, _ = _crests(time, angle)
    assert frequency == pytest.approx(1.4, rel=0.02)
    assert lag == pytest.approx(0.6, abs=0.05)


def test_joint_signals_follow_chains(recording, monkeypatch):
    """Rows have names, crests are joined within a chain, and the first chain gives the lag."""
    joined = []
    original = plots._join_crests

    def join(figure, panels, crest_times, time, angle):
        joined.append(len(panels))
        original(figure, panels, crest_times, time, angle)

    monkeypatch.setattr(plots, "_join_crests", join)
    about_z = [i for i, name in enumerate(recording.dof_names) if name.endswith(".z")]
    first, second = about_z[:3:-1], about_z[:3]
    others = [i for i, name in enumerate(recording.dof_names) if name.endswith(".y")]
    figure = joint_signals_figure(recording, "z", chains=[others, first, second], title="mine")
    # Names are above the rows and hide no curve.
    shown = [title for axes in figure.axes if (title := axes.get_title(loc="left"))]
    assert not any(axes.texts for axes in figure.axes)
    rows = [*first, *second, about_z[3]]
    assert shown == [recording.dof_names[row].rpartition(".")[0] for row in rows]
    assert joined == [len(first), len(second), 1]
    title = figure.get_suptitle()
    assert title.startswith("mine: joint signals about z\n")
    # Backwards along the body the lag has the other sign.
    lag = -np.degrees(synthetic.LAG)
    assert f" {lag:.0f} deg of lag per joint from {shown[0]} to {shown[len(first) - 1]}" in title
    words = {axes.get_ylabel() for axes in figure.axes} - {""}
    assert words == {"joint angle (deg)", "CPG output (no unit)"}


def test_joint_signals_do_not_depend_on_the_signs_of_axes():
    """With ``signs``, a motion with mirrored axes has the lag of the original motion."""
    motion = synthetic.swim(12)
    signs = np.where(np.arange(len(motion.dof_names)) % 4 < 2, 1.0, -1.0)
    mirrored = motion._replace(joint_angle=motion.joint_angle * signs)
    plain = joint_signals_figure(motion, "z").get_suptitle()
    assert joint_signals_figure(mirrored, "z", signs=signs).get_suptitle() == plain
    assert joint_signals_figure(mirrored, "z").get_suptitle() != plain


@pytest.mark.parametrize("still", [False, True])
def test_joint_signals_show_the_given_window(recording, still):
    motion = recording._replace(joint_angle=0 * recording.joint_angle) if still else recording
    figure = joint_signals_figure(motion, "x", window=(2.0, 6.0))
    lines = [axes.get_lines()[-1] for axes in figure.axes]
    assert len(lines) == 18
    time, angle = lines[0].get_data()
    assert (time[0], time[-1]) == pytest.approx((2.0, 6.0))
    assert (np.abs(angle).max() == 0) == still
    assert ("Hz" in figure.get_suptitle()) != still


def test_joint_signals_that_cannot_be_drawn_are_refused(recording):
    stiff = recording._replace(dof_names=())
    for motion, given, words in (
        (recording, {"axis": "w"}, r"'w'\. Allowed: x, y, z"),
        (recording, {"window": (50, 60)}, "from 50 s to 60 s holds 0"),
        (stiff, {}, "no joints"),
    ):
        with pytest.raises(ValueError, match=words):
            joint_signals_figure(motion, **given)


def test_a_path_is_that_of_the_root_in_any_order_of_bodies(recording):
    """A file may list the tail first."""
    bodies = recording.position.shape[1]
    tail_first = recording._replace(position=recording.position[:, ::-1])
    first, last = (
        figure.axes[0].collections[0].get_segments()
        for figure in (path_figure(recording, 0), path_figure(tail_first, bodies - 1))
    )
    np.testing.assert_array_equal(first, last)
    np.testing.assert_array_equal(first[0][0], recording.position[0, 0, :2])


@pytest.mark.parametrize(("goal", "origin"), [(np.nan, "start"), (3.0, "light")])
def test_a_path_names_its_dots_and_the_origin_of_the_distance(recording, goal, origin):
    above, later, _ = path_figure(synthetic.with_light(recording, np.full(3, goal)), 0).axes
    assert origin in later.get_ylabel() and origin in legend_of(above)[-1]
    every = (recording.time[-1] - recording.time[0]) / 6
    assert f"{every:.3g} s" in legend_of(above)[0]
    assert later.lines[0].get_ydata().max() == pytest.approx(recording.distance.max())


def test_fitness_of_several_runs_is_their_median():
    """Each run is a thin line. Values that are not finite are left out. Diverged ones add up."""
    generation, run = np.tile(np.arange(4), 3), np.repeat(np.arange(3), 4)
    best = 10.0 * run + generation
    mean = np.where((run == 2) | (generation == 0), -np.inf, best - 1)
    history = {"generation": generation, "run": run, "best": best, "mean": mean, "diverged": run}
    top, bottom = fitness_figure(history).axes
    *each, median, middling = top.get_lines()
    assert [line.get_ydata().tolist() for line in each] == [[0, 1, 2, 3], [10, 11, 12, 13],
                                                            [20, 21, 22, 23]]  # fmt: skip
    assert median.get_ydata().tolist() == [10, 11, 12, 13]
    assert middling.get_xydata().tolist() == [[1, 5], [2, 6], [3, 7]]
    assert top.get_legend().get_title().get_text().startswith("3 runs")
    assert [bar.get_height() for bar in bottom.patches] == [3, 3, 3, 3]


def test_fitness_needs_its_columns():
    empty = {key: np.zeros(0) for key in ("generation", "best", "mean", "diverged")}
    part = {key: np.zeros(3) for key in ("generation", "best", "diverged")}
    for history, words in ((part, "no column 'mean'"), (empty, "no rows yet")):
        with pytest.raises(ValueError, match=words):
            fitness_figure(history)


def test_generations_have_a_line_and_a_band_for_each_setting():
    bests = {"a": np.outer(np.arange(5.0), [1, 2, 9]), "b": np.full((5, 1), np.nan)}
    axes = generations_figure(bests, "best (m)", single_runs=True).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("generation", "best (m)")
    median = next(line for line in axes.get_lines() if line.get_label() == "a")
    assert median.get_ydata().tolist() == [0, 2, 4, 6, 8]
    assert len(axes.collections) == 1
    equal = generations_figure({"a": bests["a"]}, "best (m)").axes[0]
    for shown, words in ((axes, "1 to 3 runs"), (equal, "3 runs")):
        assert words in shown.get_legend().get_title().get_text()


@pytest.mark.parametrize("count", [2, 9])
def test_a_sweep_shows_each_setting_in_its_colour(count):
    """Settings without a champion keep their row."""
    best = np.array([[1.0, 2.0], [3.0, 6.0], [np.nan, 7.0]])
    tried = np.array([10, 20])
    names = [f"{i}" * 40 for i in range(count)]
    curves = [Curves(name, tried, best, np.array([2.0, 6.0, np.nan])) for name in names]
    curves[0] = curves[0]._replace(final=np.full(3, np.nan))
    left, right = sweep_figure(curves, "mine").axes
    assert [line.get_ydata().tolist() for line in left.get_lines()] == count * [[2.0, 6.0]]
    assert len({line.get_color() for line in left.get_lines()}) == count
    head = "1" * 33 + "..."
    assert rows_of(right)[:2] == ["0" * 33 + "...  (n = 0)", f"{head}  (n = 2)"]
    _, median = right.get_lines()[:2]
    assert median.get_xdata().tolist() == [4.0, 4.0]


def test_sensitivities_are_bars_and_unconfirmed_ones_are_grey():
    """A bar is the elasticity, or the simulated change if the derivative is not confirmed.

    A parameter that is 0 has no bar.
    """
    rows = [
        Sensitivity("up", 2.0, 0.5, 0.02, 0.04, 1.0),
        Sensitivity("down", 2.0, -0.5, -0.02, 0.04, 1.0),
        Sensitivity("doubtful", 2.0, 9.0, 0.02, 0.04, 1.0),
        Sensitivity("nothing", 0.0, 1.0, 0.01, 0.01, 1.0),
    ]
    axes = sensitivity_figure(rows, "speed", "mine").axes[0]
    assert rows_of(axes) == ["up = 2", "down = 2", "doubtful = 2"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([1.0, -1.0, 1.0])
    assert axes.get_xlabel().startswith("change of the speed (%)")


STEPS = 240


def a_ledger() -> Ledger:
    shape = {name: (STEPS,) for name in Ledger._fields} | {"impulse": (3, STEPS)}
    return Ledger(**{name: np.full(shape[name], 0.01) for name in Ledger._fields})


def test_an_audit_has_a_panel_of_paths_only_with_mujoco():
    kept = [Check("half_step", "way kept at half the step", 0.97, 0.9, True, "%")]
    path = np.zeros((3, STEPS))
    for paths, panels in (({"evo_cpg": path, "MuJoCo": path + 1}, 3), ({}, 2)):
        figure = audit_figure(a_ledger(), 1 / 240, kept, paths, "animal: audit")
        assert len(figure.axes) == panels
        fractions = figure.axes[-1]
        assert rows_of(fractions) == ["way kept at half the step"]
        assert fractions.patches[0].get_width() == pytest.approx(97)


AXES = (
    Axis("speed", 0.0, 1.0, 6),
    Axis("cost_of_transport", 0.0, 50.0, 5),
    Axis("duty_factor", 0.0, 1.0, 4),
    Axis("turning", -1.0, 1.0, 3),
)


@pytest.mark.parametrize("filled", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("count", "panels"), [(1, 1), (2, 1), (3, 4), (4, 4)])
def test_maps_of_one_to_four_axes_are_drawn(count, panels, filled):
    """Each cell shows its elite, or the best elite along a fourth axis. Empty cells are blank."""
    rng = np.random.default_rng(0)
    values = rng.random([axis.cells for axis in AXES[:count]])
    values = np.where(rng.random(values.shape) < filled, values, np.nan)
    figure = map_figure(AXES[:count], values, "caf\u00e9 run")
    share = np.isfinite(values).mean()
    assert figure.get_suptitle() == f"caf\u00e9 run: {share:.0%} of {values.size} cells filled"
    if count == 1:
        heights = [bar.get_height() for bar in figure.axes[0].patches]
        assert heights == pytest.approx(np.nan_to_num(values))
        return
    shown = [axes.collections[0].get_array() for axes in figure.axes[:panels]]
    assert len(figure.axes) == panels + 1
    best = values if count < 4 else np.where(np.isfinite(values), values, -np.inf).max(3)
    best = best.reshape(6, 5, panels)
    for i, cells in enumerate(shown):
        want = np.ma.masked_invalid(best[..., i].T)
        assert (np.ma.getmaskarray(cells) == np.ma.getmaskarray(want)).all()
        assert np.ma.allclose(cells, want)


def test_the_best_cell_has_a_star():
    values = np.full((6, 5), np.nan)
    values[1, 3], values[4, 0] = 1.0, 2.0
    (star,) = map_figure(AXES[:2], values, "two").axes[0].get_lines()
    assert star.get_xydata().tolist() == [[4.5 / 6, 5.0]]


def test_a_probe_fills_the_lights_that_were_reached():
    """Each path has the colour of its light, and each light has a label with its bearing."""
    lights = [(3.0, 1.0, 0.0), (3.0, -1.0, 0.0)]
    situations = tuple(Situation((0.0, 0.0, 0.0), 0.0, light=light) for light in lights)
    paths = np.linspace(0, 1, 5)[None, :, None] * np.array([lights[0], (0.5, 0.0, 0.0)])[:, None]
    start = np.full(2, np.sqrt(10))
    left = np.array([0.0, 0.8])
    probe = Probe(situations, start, left, 0 * left, np.ones(2, bool), paths)
    axes = probe_figure(probe, 0.2, "mine").axes[0]
    stars = [line for line in axes.get_lines() if line.get_marker() == "*"]
    assert stars[1].get_markerfacecolor() == "white"
    assert tuple(stars[0].get_markerfacecolor()) == tuple(stars[0].get_markeredgecolor())
    assert [text.get_text() for text in axes.texts] == ["+18\u00b0", "\u221218\u00b0"]
    assert [round(patch.radius, 3) for patch in axes.patches] == [0.632, 0.632]


def test_line_of_a_phase_breaks_where_it_wraps_around():
    panel = MeasurePanel("phase (cycles)", [0.3, 0.45, -0.45, -0.3], cycle=1.0)
    figure = lab_figure(["ratio"], [[1.0], [2.0], [3.0], [4.0]], [panel], "eel")
    (line,) = figure.axes[0].get_lines()
    np.testing.assert_equal(line.get_ydata(), [0.3, 0.45, np.nan, -0.45, -0.3])
