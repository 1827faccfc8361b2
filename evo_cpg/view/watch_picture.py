"""The picture that `evo-cpg watch` keeps: the newest champion, the fitness, and its way."""

import io
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from evo_cpg.files import in_one_piece
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.experiment import Experiment
from evo_cpg.view.film import side_by_side
from evo_cpg.view.panel import panel_of
from evo_cpg.view.plots import fitness_figure, path_figure

# Of the animal, pixels; the charts below are as wide together.
_SIZE = (1280, 560)


def watch_picture(
    experiment: Experiment,
    recording: Recording,
    history: Mapping[str, np.ndarray],
    title: str,
    path: Path,
) -> Path:
    """Draw it.

    Args:
        experiment: that the animal lives in.
        recording: its motion.
        history: columns of metrics.csv.
        title: of the animal.
        path: a .png file, which is replaced.

    Returns:
        The path.
    """
    charts = [_pixels(fitness_figure(history)), _pixels(path_figure(recording))]
    # As high as makes them as wide as the animal.
    height = round(_SIZE[0] / sum(chart.width / chart.height for chart in charts))
    sizes = [(round(chart.width * height / chart.height), height) for chart in charts]
    scaled = [chart.resize(size) for chart, size in zip(charts, sizes, strict=True)]
    with Image.new("RGB", (_SIZE[0], _SIZE[1] + height), "white") as sheet:
        with still(experiment, recording, _SIZE, title) as animal:
            sheet.paste(animal, (0, 0))
        left = 0
        for chart in scaled:
            sheet.paste(chart, (left, _SIZE[1]))
            left += chart.width
        with in_one_piece(path) as partial:
            sheet.save(partial)
    return path


def still(
    experiment: Experiment, recording: Recording, size: tuple[int, int], title: str
) -> Image.Image:
    """A picture of the animal in the middle of its motion.

    Args:
        experiment: that it lives in.
        recording: its motion.
        size: width and height, pixels.
        title: caption.
    """
    with tempfile.TemporaryDirectory() as place:
        panel = panel_of(experiment, recording, title)
        made = side_by_side([panel], Path(place) / "still.png", size=size)
        with Image.open(made) as picture:
            return picture.convert("RGB")


def _pixels(figure: Figure) -> Image.Image:
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=160)
    return Image.open(drawn).convert("RGB")
