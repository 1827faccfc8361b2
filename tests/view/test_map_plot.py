"""Maps of behaviour, drawn."""

import matplotlib.image
import numpy as np
import pytest

from evo_cpg.evolution.map_elites import Axis
from evo_cpg.files import OutputError
from evo_cpg.view.map_plot import plot_map

AXES = (
    Axis("speed", 0.0, 1.0, 6),
    Axis("cost_of_transport", 0.0, 50.0, 5),
    Axis("duty_factor", 0.0, 1.0, 4),
    Axis("turning", -1.0, 1.0, 3),
)


def fitness(axes, filled=0.5):
    rng = np.random.default_rng(0)
    values = rng.random([axis.cells for axis in axes])
    return np.where(rng.random(values.shape) < filled, values, np.nan)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("filled", [0.0, 0.5, 1.0])
def test_maps_of_any_number_of_axes(count, filled, tmp_path):
    axes = AXES[:count]
    path = plot_map(axes, fitness(axes, filled), tmp_path / "map.png", "caf\u00e9 run")
    picture = matplotlib.image.imread(path)[..., :3]
    assert min(picture.shape[:2]) > 300
    # The colours of fitness where there are elites, greys elsewhere; a bar of colours is beside all
    # but the first.
    shown = picture if count == 1 else picture[:, : int(0.8 * picture.shape[1])]
    colourful = (np.ptp(shown, axis=-1) > 0.25).mean()
    assert colourful > 0.02 if filled else colourful < 0.001


def test_the_best_cell_has_the_brightest_colour(tmp_path):
    values = np.full((6, 5), np.nan)
    values[1, 3], values[4, 0] = 1.0, 2.0
    path = plot_map(AXES[:2], values, tmp_path / "map.png", "two")
    picture = matplotlib.image.imread(path)[..., :3]
    panel = picture[:, : int(picture.shape[1] * 0.8)]
    yellow = np.argwhere(np.abs(panel - [0.993, 0.906, 0.144]).max(-1) < 0.03)
    purple = np.argwhere(np.abs(panel - [0.267, 0.005, 0.329]).max(-1) < 0.03)
    # Rows of a picture run downwards: the best is on the right, below.
    assert yellow[:, 1].mean() > purple[:, 1].mean()
    assert yellow[:, 0].mean() > purple[:, 0].mean()


def test_a_film_is_no_map(tmp_path):
    with pytest.raises(OutputError):
        plot_map(AXES[:2], fitness(AXES[:2]), tmp_path / "map.mp4", "no")
