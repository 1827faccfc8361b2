"""The brain that fits any body: places of axes, strokes towards the light, and symmetry."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain
from evo_cpg.control.body_brain import (
    CHARACTER,
    WEIGHTS,
    BodyBrainSettings,
    build_body_brain,
    newborn_weights,
)
from evo_cpg.control.controller import Observation
from evo_cpg.control.couplings import UnfitError
from evo_cpg.control.places import PLACE, directions, places
from evo_cpg.creature.creature import Muscle
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.jax_internals import quick_jit

STEP = 1 / 60
SETTINGS = BodyBrainSettings()


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def commands(controller, bearing, seconds=4.0, changes=None, speed=1.0):
    """Return rates and angles ``(step, d)`` of joints that follow the commands exactly.

    The bearing ``(3, b)`` is constant, and joints stop at their limits.
    """
    tree, count = controller.tree, controller.tree.dof_count
    genes = np.full((len(CHARACTER), count), 0.5) + (0 if changes is None else changes)
    none = jnp.zeros(0)

    @quick_jit
    def run(genes, bearing):
        decoded, state = controller.decode(genes.ravel()), controller.initial_state((), float)

        def advance(carry, _):
            state, angle = carry
            seen = Observation(none, none, none, none, angle, 0 * angle, none, bearing=bearing)
            state, command = controller.act(decoded, state, seen)
            moved = angle + speed * STEP * command.target_rate
            angle = jnp.clip(moved, tree.lower, tree.upper)
            return (state, angle), (command.target_rate, angle, command.activation)

        start = state, jnp.zeros(count)
        return jax.lax.scan(advance, start, length=round(seconds / STEP))[1]

    return jax.tree.map(np.asarray, run(jnp.asarray(genes), jnp.asarray(bearing, float)))


def brain(tree, **settings):
    return build_body_brain(tree, dataclasses.replace(SETTINGS, **settings), STEP)


def chain(axes="z", **options):
    return build_tree(box_chain(3, axes, **options))


def lit(tree, direction):
    """Return the bearing of a light in one direction from all bodies."""
    return np.tile(np.array(direction, float)[:, None], (1, tree.body_count))


def test_places_are_those_of_a_chain_of_boxes():
    """Compare numbers of the tip of a chain with its geometry, worked out by hand."""
    tree = chain()
    found = dict(zip(PLACE, np.asarray(places(tree)), strict=True))
    own = directions(tree)
    part, volume = tree.volume[2], tree.volume
    size = volume.sum() ** (1 / 3)
    reach = np.linalg.norm(tree.com[:, 2])
    assert found["reach"][1] == pytest.approx(2 * reach / size - 1, abs=1e-5)
    assert found["depth"].tolist() == pytest.approx([-0.5, 0.0])
    assert found["limb"][0] == pytest.approx(2 * volume[1:].sum() / volume.sum() - 0.5)
    assert found["limb"][1] == pytest.approx(2 * part / volume.sum() - 0.5)
    assert found["straight"][1] == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(found["sweep"], 1.0, atol=1e-4)
    np.testing.assert_allclose(own.sweep[:, 1], np.cross([0, 0, 1], own.along[:, 1]), atol=1e-4)


def test_places_do_not_depend_on_scale():
    """A chain of twice the size has the same place but for its size and its motors."""
    small, large = (
        np.asarray(places(chain(size=tuple(k * np.array([0.2, 0.1, 0.1])), gap=0.02 * k)))
        for k in (1, 2)
    )
    same = [i for i, name in enumerate(PLACE) if name not in ("size", "servo")]
    np.testing.assert_allclose(small[same], large[same], atol=1e-4)
    grown = (large - small)[PLACE.index("size")]
    np.testing.assert_allclose(grown, 3 * np.log(2), atol=1e-4)


def test_places_beyond_the_training_count_as_its_edge(monkeypatch):
    found = []
    for factor in (1e3, 1e6):
        beyond = functools.partial(lambda factor, tree: factor * (places(tree) + 0.01), factor)
        monkeypatch.setattr("evo_cpg.control.body_brain.places", beyond)
        found.append(commands(brain(chain()), lit(chain(), (0.6, 0.8, 0.0)))[0])
    np.testing.assert_array_equal(*found)


def test_parts_move_faster_away_from_the_light():
    """An untrained brain pushes water away from the light, and returns slowly."""
    tree = chain()
    for side in (1, -1):
        rate, *_ = commands(brain(tree, brain="untrained"), side * lit(tree, (0, 1, 0)))
        towards = side * np.asarray(directions(tree).sweep)[1] * rate
        away, back = -towards[towards < 0].mean(), towards[towards > 0].mean()
        assert away > 1.5 * back


@pytest.mark.slow
def test_parts_sense_the_light_below_an_eye():
    """With an eye on the middle, both joints sense the light, and with one on the tip, one does."""
    tree, bearing = chain(), lit(chain(), (0.6, 0.8, 0.0))
    seeing, dark = commands(brain(tree), bearing)[0], commands(brain(tree), 0 * bearing)[0]
    for eye, blind in ((tree.names[0], []), (tree.names[1], []), (tree.names[2], [0])):
        found = commands(brain(tree, eyes=(eye,)), bearing)[0]
        for axis in range(tree.dof_count):
            expected = dark if axis in blind else seeing
            same = np.abs(found[:, axis] - expected[:, axis]).max() < 1e-9
            # Oscillators are coupled, so what a blind axis commands changes the seeing one.
            assert same if not blind or axis in blind else not same


def test_an_eye_on_no_body_is_refused():
    with pytest.raises(UnfitError, match="unknown body 'hed'"):
        brain(chain(), eyes=("hed",))


@pytest.mark.slow
def test_an_axis_turned_round_commands_the_opposite():
    """A chain about -z moves as the chain about z does, with all angles negative."""
    tree = chain()
    opposite = dataclasses.replace(tree, joint_axes=-tree.joint_axes)
    bearing = lit(tree, (0.6, 0.64, 0.48))
    controllers = (brain(each) for each in (tree, opposite))
    # The oscillators start on one side, so the start is exchanged, too.
    half = np.zeros((len(CHARACTER), tree.dof_count))
    half[[*CHARACTER].index("start")] = 0.3
    first = commands(next(controllers), bearing, changes=half)[0]
    start = build_body_brain(tree, SETTINGS, STEP).decode(jnp.asarray(0.5 + half).ravel())
    assert np.ptp(np.asarray(start.rhythm.start), axis=0).min() > 1e-3
    second = commands(_exchanged(next(controllers)), bearing, changes=half)[0]
    np.testing.assert_allclose(second, -first, atol=1e-9)
    assert np.abs(first).max() > 1.0


def _exchanged(controller):
    """Return a controller whose oscillators start on the other side."""

    class Exchanged(type(controller)):
        def decode(self, genes):
            found = super().decode(genes)
            rhythm = found.rhythm._replace(start=found.rhythm.start[::-1])
            return found._replace(rhythm=rhythm)

    fields = {x.name: getattr(controller, x.name) for x in dataclasses.fields(controller)}
    return Exchanged(**fields)


def test_a_blind_brain_ignores_the_light():
    tree = chain()
    blind = dataclasses.replace(brain(tree), sight=0.0)
    one, other = (commands(blind, lit(tree, x))[0] for x in ((0, 1, 0), (0, -1, 0)))
    np.testing.assert_array_equal(one, other)
    seeing = [commands(brain(tree), lit(tree, x))[0] for x in ((0, 1, 0), (0, -1, 0))]
    assert np.abs(seeing[0] - seeing[1]).max() > 1.0


def test_genes_change_one_axis_alone():
    """The second gene of the amplitude changes the second joint only."""
    tree = chain()
    changes = np.zeros((len(CHARACTER), tree.dof_count))
    changes[[*CHARACTER].index("amplitude"), 1] = -0.4
    one = commands(brain(tree), lit(tree, (0, 1, 0)))[1]
    other = commands(brain(tree), lit(tree, (0, 1, 0)), changes=changes)[1]
    np.testing.assert_array_equal(one[:, 0], other[:, 0])
    assert np.abs(other[:, 1] - one[:, 1]).max() > 0.1


def test_muscles_pull_to_the_side_of_the_rate():
    tree = chain(motor=Muscle(area=1e-4, arm=0.01, fibre_length=0.05))
    rate, _, active = commands(brain(tree), lit(tree, (0, 1, 0)))
    np.testing.assert_allclose(active[:, 0] - active[:, 1], rate / SETTINGS.max_rate, atol=1e-12)
    assert (active >= 0).all() and active.max() > 0.3


def test_the_shipped_brain_fits_and_beats_none():
    """Its weights have the right number, and no axis keeps its untrained character."""
    weights = newborn_weights()
    assert weights.shape == (sum(WEIGHTS),) and np.isfinite(weights).all()
    tree, bearing = chain(), lit(chain(), (0, 1, 0))
    trained, untrained = (
        commands(brain(tree, brain=b), bearing)[0] for b in ("newborn", "untrained")
    )
    assert np.abs(trained - untrained).max() > 0.5


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"time_scale": 0.0}, "time_scale must be positive, got 0.0"),
        ({"max_rate": float("nan")}, "max_rate must be positive, got nan"),
        ({"spread": 1.5}, "spread must be from 0 to 1, got 1.5"),
    ],
)
def test_wrong_settings_are_named(settings, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(SETTINGS, **settings)
