"""Pictures of the laboratory: axes over decades, and phases that wrap around."""

import numpy as np

from evo_cpg.view.answer_plots import MeasurePanel, lab_figure


def test_numbers_on_axes_over_decades_are_plain():
    panel = MeasurePanel("cost of transport", [0.1, 2.0, 70.0], decades=True)
    figure = lab_figure(["size"], [[0.1], [1.0], [10.0]], [panel], "eel")
    figure.canvas.draw()
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    words = [tick.get_text() for tick in (*axes.get_xticklabels(), *axes.get_yticklabels())]
    assert {"0.1", "1", "10"} <= set(words)
    assert not any("$" in word for word in words)


def test_line_of_a_phase_breaks_where_it_wraps_around():
    panel = MeasurePanel("phase (cycles)", [0.3, 0.45, -0.45, -0.3], cycle=1.0)
    figure = lab_figure(["ratio"], [[1.0], [2.0], [3.0], [4.0]], [panel], "eel")
    (line,) = figure.axes[0].get_lines()
    np.testing.assert_equal(line.get_ydata(), [0.3, 0.45, np.nan, -0.45, -0.3])
