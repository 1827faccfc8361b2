"""Programs of training that tests share: what is built anew from equal parts is compiled once.

Training, resuming, replaying and refining each compile an experiment's programs from the parts that
they are given. Tests do that dozens of times with the same parts. Here the four functions that
make these programs remember what they made, by the content of what they were given.

A test that replaces something by `monkeypatch` gets programs of its own, for what it replaced may
be part of them; so does one that watches what is `lowered`.
"""

import functools
import pickle
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import ClassVar

import jax
import pytest

from evo_cpg.fusion import engine
from evo_cpg.training import ascent, experiment, replay, running

# Fixtures of tests that get programs of their own.
_OWN = {"monkeypatch", "lowered"}

# The last so many are kept; each may hold hundreds of thousands of objects.
_KEPT = 16


def _trials(simulation, mesh, width=None, inputs=None):
    # Inputs are arrays of several bodies, which a program of its own serves.
    return None if inputs is not None else (simulation, mesh, width)


def _evolution(made):
    return (made._replace(generations=0, learning=None),)


def _replay(made, devices, recorded=0):
    return made._replace(generations=0, learning=None), devices, recorded


def _ascent(made, mesh, steps, free=None):
    # Numbers that are free come with functions, which nothing tells apart.
    return None if free else (made._replace(generations=0, learning=None, seed=0), mesh, steps)


_MAKERS: dict[Callable, Callable[..., tuple | None]] = {
    experiment.compile_trials: _trials,
    running.compile_evolution: _evolution,
    replay.compile_replay: _replay,
    ascent.compile_ascent: _ascent,
}


@pytest.fixture(autouse=True, scope="module")
def remember_programs() -> Iterator[None]:
    """Replace the makers wherever the package has them."""
    with pytest.MonkeyPatch.context() as patch:
        for maker in _MAKERS:
            for name, module in list(sys.modules.items()):
                if name.startswith("evo_cpg.") and vars(module).get(maker.__name__) is maker:
                    patch.setattr(module, maker.__name__, _remembering(maker))
        yield


@pytest.fixture(autouse=True)
def programs_of_its_own(request) -> Iterator[None]:
    _Kept.used = _OWN.isdisjoint(request.fixturenames)
    yield
    _Kept.used = True


class _Kept:
    """What was made, the latest last, and whether it may be used."""

    used = True
    programs: ClassVar[OrderedDict] = OrderedDict()


def _remembering(maker: Callable) -> Callable:
    @functools.wraps(maker)
    def make(*args, **options):
        key = _key(maker, *args, **options) if _Kept.used else None
        if key is None:
            return maker(*args, **options)
        if key not in _Kept.programs:
            _Kept.programs[key] = maker(*args, **options)
            if len(_Kept.programs) > _KEPT:
                _Kept.programs.popitem(last=False)
        _Kept.programs.move_to_end(key)
        return _Kept.programs[key]

    return make


def _key(maker: Callable, *args, **options) -> tuple | None:
    """What a program depends on; None where that cannot be told."""
    parts = _MAKERS[maker](*args, **options)
    if parts is None:
        return None
    made, *others = parts
    try:
        content = pickle.dumps(made)
    except (AttributeError, TypeError, pickle.PicklingError):
        return None
    return maker, content, *others, engine._chosen.get(None), jax.config.jax_enable_x64
