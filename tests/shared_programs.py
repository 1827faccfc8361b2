"""Programs of training that tests share: programs of equal parts are compiled once.

Training, resuming, replaying and refining each compile an experiment's programs. Tests do that
dozens of times with equal arguments. Here the five functions that make these programs cache their
results by the content of their arguments.

A test with `monkeypatch` gets its own programs, because its replacements may be part of them. So
does a test with `lowered`.
"""

import functools
import pickle
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import ClassVar

import jax
import pytest

from evo_cpg.native import engine
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.training import ascent, evaluate, train

# Fixtures of tests that get their own programs.
_OWN = {"monkeypatch", "lowered"}

# Number of latest programs that are kept. Each may hold hundreds of thousands of objects.
_KEPT = 16


def _trials(simulation, mesh, width=None, inputs=None, observers=JUDGE, ahead=None):
    # Inputs are arrays of several bodies, which a program of its own serves.
    return None if inputs is not None or ahead else (simulation, mesh, width, observers)


def _evolution(made):
    return (made._replace(generations=0, learning=None),)


def _evaluation(made, mesh, devices, recorder=None, ahead=False):
    return made._replace(generations=0, learning=None), mesh, devices, recorder, ahead


def _replay(made, devices, recorded=0, full=False):
    return made._replace(generations=0, learning=None), devices, recorded, full


def _ascent(made, mesh, steps, free=None):
    # Free numbers come with functions, whose content cannot be compared.
    return None if free else (made._replace(generations=0, learning=None, seed=0), mesh, steps)


_MAKERS: dict[Callable, Callable[..., tuple | None]] = {
    evaluate.compile_trials: _trials,
    evaluate.compile_evaluation: _evaluation,
    train.compile_evolution: _evolution,
    evaluate.compile_replay: _replay,
    ascent.compile_ascent: _ascent,
}


@pytest.fixture(autouse=True, scope="module")
def remember_programs() -> Iterator[None]:
    """Replace the makers in all modules of the package."""
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
    """Cache of programs, latest last, and whether it may be used."""

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
    """Return the key of a program's arguments, or None if they cannot be compared."""
    parts = _MAKERS[maker](*args, **options)
    if parts is None:
        return None
    made, *others = parts
    try:
        content = pickle.dumps(made)
    except (AttributeError, TypeError, pickle.PicklingError):
        return None
    return maker, content, *others, engine._chosen.get(None), jax.config.jax_enable_x64
