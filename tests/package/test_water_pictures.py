"""The script that draws the pictures of the page on water."""

import importlib.util
import sys

import pytest

from tiny_run import REPOSITORY

SCRIPT = REPOSITORY / "docs" / "tools" / "water_pictures.py"
PAGE = REPOSITORY / "docs" / "models" / "fluid.md"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("water_pictures", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    path = list(sys.path)
    spec.loader.exec_module(module)
    sys.path[:] = path
    return module


def test_the_page_on_water_shows_every_picture(script):
    for name in script.PICTURES:
        assert f"../images/water_{name}.png" in PAGE.read_text()
        assert (script.IMAGES / f"water_{name}.png").is_file()


@pytest.mark.parametrize(
    "name",
    [
        "lift",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("friction", "form_drag", "shelter", "reactive_thrust")
        ),
    ],
)
def test_a_picture_of_water_is_drawn(script, name, tmp_path):
    script.main([name], tmp_path)
    drawn = tmp_path / f"water_{name}.png"
    assert drawn.stat().st_size > 10_000


def test_measured_lift_lies_beside_its_curve(script, x64):
    """Within 0.16, which is 20 % of the largest lift."""
    axes = script.lift().axes[0]
    curves, points = axes.lines[::2], axes.lines[1::2]
    for curve, measured in zip(curves, points, strict=True):
        found = [curve.get_ydata()[int(x)] for x in measured.get_xdata()]
        assert abs(found - measured.get_ydata()).max() < 0.16
