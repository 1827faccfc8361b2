"""Contacts between bodies of one creature in a step: the common interface, and the choice of one.

Few pairs are written out (`evo_cpg.physics.few_pairs`), many are looped over
(`evo_cpg.physics.many_pairs`). `evo_cpg.physics.pairs` has the contact model.
"""

from typing import Any, Protocol

from jaxtyping import Array, Bool, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.few_pairs import FewPairContacts
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.many_pairs import ManyPairContacts
from evo_cpg.physics.pairs import Pairs


class PairForces(Protocol):
    """Forces of all pairs at joint accelerations, and their derivative."""

    @property
    def force(self) -> Float[Array, "p *n"]:
        """Force of every point, N."""
        ...

    @property
    def load(self) -> Float[Array, "*n"]:
        """Sum of all forces, N."""
        ...

    @property
    def torque(self) -> Float[Array, "d *n"]:
        """Joint torques of the forces, ``J^T f``, N m."""
        ...

    def power(self, change: Float[Array, "k *n"]) -> Float[Array, "*n"]:
        """Return the power of the forces for a result of `PairContacts.change`, W."""
        ...

    def newton(self) -> tuple[Float[Array, "d *n"], Float[Array, "d d *n"]]:
        """Return the linearised torques at zero joint acceleration, and ``h J^T K J``."""
        ...


class PairContacts(Protocol):
    """Nearest points of all pairs, with what stays the same throughout a step.

    Attributes:
        bias: velocity-product bias: what determines the acceleration of the points along their
            normals at constant joint rates. It belongs to joint rates between the start and the
            end of the step. Few pairs store that acceleration, ``(p, *n)``, m/s^2; many pairs store
            the joint accelerations that lead to those rates, ``(d, *n)``, rad/s^2.
    """

    @property
    def bias(self) -> Float[Array, "k *n"]:
        """See the class."""
        ...

    def with_bias(self, bias: Float[Array, "k *n"]) -> Any:
        """Return the contacts with another velocity-product bias."""
        ...

    def bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "k *n"]:
        """Return the velocity-product bias at the joint rates after the step."""
        ...

    def change(self, turn: Float[Array, "d *n"]) -> Float[Array, "k *n"]:
        """Return the change of velocities that `PairForces.power` takes, for accelerations."""
        ...

    def at(self, qdd: Float[Array, "d *n"]) -> Any:
        """Return the `PairForces` at joint accelerations."""
        ...

    def touches(self, qdd: Float[Array, "d *n"]) -> Bool[Array, "*n"]:
        """Return where any pair pushes at joint accelerations."""
        ...

    def drifts(self, qdd: Float[Array, "d *n"], bias: Float[Array, "k *n"]) -> Bool[Array, "*n"]:
        """Return where another bias would move a touching pair by more than `LARGEST_DRIFT`."""
        ...

    def parting(self, rates: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return the speeds at which points part at joint rates, ``J rates``, m/s."""
        ...


def find_pair_contacts(
    tree: Tree, pairs: Pairs, kin: Kinematics, qd: Float[Array, "d *n"], h: float
) -> PairContacts:
    """Find the nearest points of all pairs, and the velocity at which each is to part.

    Args:
        tree: the creature.
        pairs: of the creature.
        kin: kinematics at the start of the step.
        qd: joint rates there, rad/s.
        h: s.
    """
    find = ManyPairContacts if pairs.looped else FewPairContacts.find
    return find(tree, pairs, kin, qd, h)
