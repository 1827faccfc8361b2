"""Pictures share what they would all paint the same."""

import functools

import pytest

from evo_cpg.view import frames, ground, preview
from evo_cpg.view.textures import floor_texture

# Of a still's sides; users have 3, which only makes edges smoother.
_OVERSAMPLING = 2.0


@pytest.fixture(autouse=True, scope="session")
def quick_pictures():
    """The floor's texture is made once for each look, and stills are painted less finely."""
    shared = functools.cache(floor_texture)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground, "floor_texture", shared)
        patch.setattr(frames, "_STILL_OVERSAMPLING", _OVERSAMPLING)
        patch.setattr(preview, "_OVERSAMPLING", 1.0)
        yield
