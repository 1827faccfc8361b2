"""From the configuration of the ground to the ground."""

from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.config.errors import ConfigError
from evo_cpg.config.schema.ground import (
    MOST_HEIGHTS,
    BlockConfig,
    BoulderConfig,
    GroundConfig,
    HillsConfig,
    PlaneConfig,
    ReliefConfig,
    ReliefFileConfig,
    ShoreConfig,
)
from evo_cpg.config.trust import named_file
from evo_cpg.config.wording import check_section
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.terrain import Block, Boulder, Obstacle, Part, Plane, Relief, Shore
from evo_cpg.spatial.numerics import xp
from evo_cpg.system import lend_matplotlib_a_folder

_FLOOR = ("world", "ground", "floor")
_ARRAYS, _TABLES, _IMAGES = (".npy",), (".csv", ".txt"), (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def build_ground(config: GroundConfig) -> Ground:
    """The ground that a configuration describes."""
    material = dict(config)
    del material["floor"], material["obstacles"]
    obstacles = tuple(_obstacle(obstacle) for obstacle in config.obstacles)
    return Ground(**material, floor=_floor(config.floor), obstacles=obstacles)


def _floor(config: PlaneConfig | ShoreConfig | HillsConfig | ReliefConfig) -> Part:
    if isinstance(config, PlaneConfig):
        slope, downhill = xp.deg2rad(config.slope_deg), xp.deg2rad(config.downhill_deg)
        level = xp.sin(slope)
        normal = (level * xp.cos(downhill), level * xp.sin(downhill), xp.cos(slope))
        return Plane(normal, config.height * normal[2])
    if isinstance(config, ShoreConfig):
        shore = dict(config)
        del shore["type"]
        return Shore(**shore)
    heights = _hills(config) if isinstance(config, HillsConfig) else np.array(config.heights)
    corner = None if isinstance(config, HillsConfig) else config.corner
    if corner is None:
        x, y = (-(count - 1) / 2 * config.spacing for count in heights.shape)
        corner = (x, y)
    return Relief(heights, corner, config.spacing)


def _obstacle(config: BoulderConfig | BlockConfig) -> Obstacle:
    if isinstance(config, BoulderConfig):
        return Boulder(config.centre, config.radius)
    x, y, z = config.size
    return Block(config.centre, (x / 2, y / 2, z / 2), xp.deg2rad(config.heading_deg))


def _hills(config: HillsConfig) -> np.ndarray:
    """Smoothed noise ``(n, n)``, 0 at the origin and nearly so around it, m."""
    count = round(config.size / config.spacing) + 1
    place = (np.arange(count) - (count - 1) / 2) * config.spacing
    noise = np.random.default_rng(config.seed).normal(size=(count, count))
    # A Gaussian in the frequencies; waves longer than `length` remain.
    wave = 2 * np.pi * np.fft.fftfreq(count, config.spacing)
    width = config.length / 4
    soft = np.exp(-0.5 * width**2 * (wave[:, None] ** 2 + wave[None] ** 2))
    heights = np.fft.ifft2(np.fft.fft2(noise) * soft).real
    heights = heights * (config.height / max(heights.std(), np.finfo(float).tiny))
    away = np.hypot(*np.meshgrid(place, place, indexing="ij"))
    return heights * (1 - np.exp(-0.5 * (away / max(config.clearing, config.spacing)) ** 2))


def read_heights(source: Path, given: dict[str, Any]) -> list[list[float]]:
    """Heights from an array (.npy), a table (.csv, .txt) or an image, m.

    Args:
        source: the configuration file, beside which the file is looked for.
        given: keys of `ReliefFileConfig`. The first axis of an array, and a line of a table, is x;
            an image is seen from above, its right edge straight ahead.

    Raises:
        ConfigError: a key is wrong, there is no such file, or it does not hold a grid of numbers.
    """
    checked = check_section(ReliefFileConfig, given, source, _FLOOR)
    file, where = checked.file, (*_FLOOR, "file")
    path = named_file(source, file, where, (*_ARRAYS, *_TABLES, *_IMAGES))
    suffix = path.suffix.lower()
    try:
        if suffix in _ARRAYS:
            # Mapped, so that a header that promises more than the file holds is found out.
            heights = np.load(path, mmap_mode="r", allow_pickle=False)
        elif suffix in _TABLES:
            heights = np.loadtxt(path, delimiter="," if suffix == ".csv" else None)
        else:
            heights = _image(path, checked.lowest, checked.highest)
        if heights.ndim == 2 and max(heights.shape) <= MOST_HEIGHTS:
            heights = np.asarray(heights, float)
    except Exception as error:
        # Whatever the readers raise is about the file.
        raise ConfigError(source, where, f"{file}: cannot be read ({error})") from None
    if heights.ndim != 2 or not np.isfinite(heights[:MOST_HEIGHTS, :MOST_HEIGHTS]).all():
        raise ConfigError(
            source, where, f"{file}: must hold a grid of finite numbers, not {heights.shape}"
        )
    if not all(2 <= count <= MOST_HEIGHTS for count in heights.shape):
        size = " x ".join(map(str, heights.shape))
        raise ConfigError(
            source, where, f"{file}: {size} heights; allowed: 2 to {MOST_HEIGHTS} each way"
        )
    return heights.tolist()


def _image(path: Path, lowest: float, highest: float) -> np.ndarray:
    lend_matplotlib_a_folder()
    from matplotlib.image import imread
    from PIL import Image

    with Image.open(path) as image:
        if max(image.size) > MOST_HEIGHTS:
            raise ValueError(f"{image.width} x {image.height} pixels, of {MOST_HEIGHTS} each way")
    pixels = np.asarray(imread(path))
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else 1
    grey = pixels if pixels.ndim == 2 else pixels[..., :3].mean(-1)
    # Rows go down in the picture, which is to the right on the ground.
    return lowest + (highest - lowest) / full * grey[::-1].T
