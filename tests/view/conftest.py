"""Fixtures that make pictures faster."""

import functools

import pytest

from evo_cpg.view import film, ground, preview
from evo_cpg.view.offscreen import floor_texture

# Oversampling of a still. The default of 3 only makes edges smoother.
_OVERSAMPLING = 1.25


@pytest.fixture(autouse=True, scope="session")
def quick_pictures():
    """Make the floor's texture once for each look, and draw stills less finely."""
    shared = functools.cache(floor_texture)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground, "floor_texture", shared)
        patch.setattr(film, "_STILL_OVERSAMPLING", _OVERSAMPLING)
        patch.setattr(preview, "_OVERSAMPLING", 1.0)
        yield
