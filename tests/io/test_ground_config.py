"""Ground from YAML: building, and errors."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.image import imsave
from PIL import Image

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Relief, Shore
from tiny_run import REPOSITORY

HEXAPOD = REPOSITORY / "configs" / "hexapod.yaml"


def build(*ground: str):
    """Return the ground of a configuration with overrides."""
    config = load_config(HEXAPOD, [f"world.ground.{override}" for override in ground])
    return config.world.ground.build()


def floor(text: str):
    return build(f"floor={text}").floor


def test_a_plane_slopes_in_the_given_direction():
    plane = floor("{type: plane, slope_deg: 30, downhill_deg: 90, height: 1}")
    assert isinstance(plane, Plane)
    np.testing.assert_allclose(plane.normal, (0, 0.5, np.sqrt(0.75)), atol=1e-12)
    gap, _ = plane.distance(jnp.array([0.0, 0.0, 1.0]))
    assert float(gap) == pytest.approx(0, abs=1e-6)


def test_a_shore():
    shore = floor("{type: shore, axis: y, start: 1, stop: 3, start_height: 0.5, stop_height: -1}")
    assert shore == Shore("y", 1.0, 3.0, 0.5, -1.0)


def test_hills_have_their_height_and_a_clearing():
    hills = floor("{type: hills, height: 0.3, length: 2, size: 40, spacing: 0.5, clearing: 1}")
    assert isinstance(hills, Relief)
    assert hills.heights.shape == (81, 81) and hills.corner == (-20.0, -20.0)
    assert hills.heights.std() == pytest.approx(0.3, rel=0.05)
    assert abs(hills.heights[40, 40]) < 1e-12
    other = floor("{type: hills, seed: 1, height: 0.3, length: 2, size: 40, spacing: 0.5}")
    assert not np.allclose(hills.heights, other.heights)


def test_obstacles():
    ground = build(
        "obstacles=[{type: boulder, centre: [1, 2, 0], radius: 0.5}, "
        "{type: block, centre: [4, 0, 0], size: [2, 4, 1], heading_deg: 90}]"
    )
    boulder, block = ground.obstacles
    assert boulder == Boulder((1.0, 2.0, 0.0), 0.5)
    assert block == Block((4.0, 0.0, 0.0), (1.0, 2.0, 0.5), np.pi / 2)


@pytest.mark.parametrize("suffix", ["npy", "csv", "txt", "png", "tif"])
def test_saved_configuration_contains_the_heights_of_a_file(suffix, tmp_path):
    """Rows of arrays and tables run along x. An image is seen from above, with x to the right."""
    heights = np.array([[0.0, 0.2], [0.4, 0.6], [0.8, 1.0]])
    path = tmp_path / f"heights.{suffix}"
    if suffix == "npy":
        np.save(path, heights)
    elif suffix == "png":
        imsave(path, heights.T[::-1], cmap="gray", vmin=0, vmax=1)
    elif suffix == "tif":
        # Elevation maps mostly have 16 bits.
        Image.fromarray(np.uint16(heights.T[::-1] * 65535)).save(path)
    else:
        np.savetxt(path, heights, delimiter="," if suffix == "csv" else " ")
    limits = "lowest: 0, highest: 2, " if suffix in ("png", "tif") else ""
    override = f"world.ground.floor={{type: relief, {limits}spacing: 0.5, file: {path}}}"
    config = load_config(HEXAPOD, [override])
    path.unlink()
    (tmp_path / "config.yaml").write_text(dump_config(config))
    again = load_config(tmp_path / "config.yaml")
    assert again == config
    relief = again.world.ground.build().floor
    scale = 2 if suffix in ("png", "tif") else 1
    np.testing.assert_allclose(relief.heights, scale * heights, atol=0.01)
    assert (relief.corner, relief.spacing) == ((-0.5, -0.25), 0.5)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("bom.csv", b"\xef\xbb\xbf0,300\n-1,2.5\n"),
        ("spreadsheet.csv", b"0;300\r\n-1;2.5\r\n"),
        ("quoted.csv", b'"0","300"\n"-1","2.5"\n'),
        ("spaces.csv", b"0 300\n-1  2.5\n"),
        ("float.tif", np.float32),
        ("whole.tif", np.int32),
        ("whole.npy", np.int16),
    ],
)
def test_heights_in_metres_keep_their_values(tmp_path, name, text):
    heights = np.array([[0, 300], [-1, 2.5]])
    if isinstance(text, bytes):
        (tmp_path / name).write_bytes(text)
    elif name.endswith("npy"):
        np.save(tmp_path / name, heights.astype(text))
    else:
        Image.fromarray(heights.T[::-1].astype(text)).save(tmp_path / name)
    found = build(f"floor={{type: relief, file: {tmp_path / name}}}").floor.heights
    whole = isinstance(text, type) and issubclass(text, np.integer)
    np.testing.assert_array_equal(found, heights.astype(int) if whole else heights)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.npy", b"", r"floor.file: .*a.npy: "),
        ("a.npy", b"no array", "a.npy: "),
        ("a.npy", np.zeros((2, 2, 2)), "a.npy: "),
        ("a.npy", np.full((3, 3), np.nan), "a.npy: "),
        ("a.csv", b"0,5;1\n2;3\n", "decimal commas"),
        ("a.txt", b"0,5 1,5\n2 3\n", "decimal commas"),
        ("a.csv", b"0,1\n2,-9999\n", "-9999"),
        ("a.csv", b"0,1\n2,nan\n", "finite numbers"),
        ("a.csv", b"0,1\n2,\n", "cannot be read"),
        ("a.npy", np.array([[0, 1j], [1, 2]]), "complex128"),
        ("a.npy", np.full((300, 2), "x"), "<U1"),
        ("a.tif", np.float32([[0, -3.4028235e38], [1, 2]]), "missing"),
        ("a.png", np.uint8([[[255, 0, 0]] * 2] * 2), "coloured"),
        ("a.png", np.uint8([[[9, 9, 9, 0]] * 2] * 2), "transparent"),
        ("a.csv", b"0,1\n2,3\n", "metres"),
        ("a.tif", np.float32([[0, 1], [2, 3]]), "metres"),
    ],
)
def test_files_without_clear_heights_are_rejected(tmp_path, name, content, words):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif name.endswith("npy"):
        np.save(path, content)
    else:
        Image.fromarray(content).save(path)
    with pytest.raises(ConfigError, match=words):
        build(f"floor={{type: relief, highest: 2, file: {path}}}")


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "LA", "RGBA"])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_white_is_highest_in_every_kind_of_image(tmp_path, mode, suffix):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(np.uint8([[0, 255], [255, 0]])).convert(mode).save(path)
    found = build(f"floor={{type: relief, highest: 2, file: {path}}}").floor.heights
    np.testing.assert_array_equal(found, [[2, 0], [0, 2]])


def test_an_animal_stands_at_its_start():
    """It stands as high above a plateau as above level ground, with the given heading."""
    level = build_experiment(load_config(HEXAPOD), HEXAPOD).simulation.situations[0]
    height = level.start_position[2] + 0.8
    config = load_config(
        HEXAPOD,
        [
            "world.ground.floor={type: shore, start: 1, stop: 2, stop_height: 0.7}",
            "simulation.trials=[{start: [4, -1], start_heading_deg: 90}, {}]",
            "simulation.start_clearance=0.1",
        ],
    )
    # The second start is before the slope.
    situation, lower = build_experiment(config, HEXAPOD).simulation.situations
    assert lower.start_position[2] == pytest.approx(height - 0.7, abs=1e-4)
    assert situation.start_position == pytest.approx((4, -1, height), abs=1e-5)
    assert situation.start_heading == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("ground", "words"),
    [
        ("floor={type: shoer}", "'relief'"),
        ("floor={type: shore, start: 2, stop: 1, stop_height: 0}", "stop"),
        ("floor={type: shore, stop: 1, stop_hight: 0}", "'stop_height'"),
        ("floor={type: hills, size: 100, spacing: 0.1}", "256"),
        ("floor={type: relief, heights: [[0, 1], [0]]}", "equally long"),
        ("floor={type: relief, file: nowhere.npy}", "no such file"),
        ("floor={type: relief, file: heights.obj}", "'.obj'"),
        ("floor={type: relief, file: a.png, lowest: low}", "lowest: 'low'"),
        ("floor={type: shore, stop: 1, stop_height: 0, file: a.png}", "unknown key"),
        ("obstacles=[{type: blok, centre: [0, 0, 0]}]", "'boulder'"),
    ],
)
def test_invalid_ground_is_rejected(ground, words):
    with pytest.raises(ConfigError) as refused:
        build(ground)
    assert words in str(refused.value)
