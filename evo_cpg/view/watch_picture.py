"""The picture that `evo-cpg watch` keeps: the newest champion, the fitness and the path."""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from evo_cpg.simulation.recording import Recording
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.view.film import picture
from evo_cpg.view.frames import Film
from evo_cpg.view.output import save_picture
from evo_cpg.view.plots import fitness_figure, path_figure
from evo_cpg.view.scene import panel_of

# Size of the animal's picture, pixels. The charts below are together as wide.
_SIZE = (1280, 560)


def watch_picture(
    experiment: ExperimentParts,
    recording: Recording,
    history: Mapping[str, np.ndarray],
    title: str,
    path: Path,
) -> Path:
    """Draw the picture of the newest champion.

    Args:
        experiment: experiment of the champion.
        recording: motion of the champion.
        history: columns of metrics.csv.
        title: title of the animal.
        path: a .png file, which is replaced.

    Returns:
        The path.
    """
    charts = [
        _pixels(fitness_figure(history)),
        _pixels(path_figure(recording, experiment.creature.root_index)),
    ]
    # Height at which the charts are together as wide as the animal's picture.
    height = round(_SIZE[0] / sum(chart.width / chart.height for chart in charts))
    sizes = [(round(chart.width * height / chart.height), height) for chart in charts]
    scaled = [chart.resize(size) for chart, size in zip(charts, sizes, strict=True)]
    sheet = Image.new("RGB", (_SIZE[0], _SIZE[1] + height), "white")
    sheet.paste(picture([panel_of(experiment, recording, title)], Film(_SIZE)), (0, 0))
    left = 0
    for chart in scaled:
        sheet.paste(chart, (left, _SIZE[1]))
        left += chart.width
    save_picture(sheet, path)
    return path


def _pixels(figure: Figure) -> Image.Image:
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=160)
    return Image.open(drawn).convert("RGB")
