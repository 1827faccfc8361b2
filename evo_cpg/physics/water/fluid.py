"""Drag: form drag and skin friction at points on the surface of the bodies.

Iwadate 2010, eqs. 7 and 8. Each surface point has an outward normal n, two tangents and an area A.
Its velocity relative to the water has the parts v_n n and v_t:

    f = -1/2 rho C_d A |v_n| v_n n - 1/2 rho C_f A |v_t| v_t.

These are the paper's "inertial" and "frictional" resistance. Windward *and* lee faces count. So the
frontal drag coefficient of a box is 2 C_d, and the coefficient of a sphere is C_d.

Differs from eq. 8 as printed, which defines neither the direction of v nor the part of each
resistance. ``law="isotropic"`` keeps the literal reading, -1/2 rho (C_d + C_f) A |v| v, which gives
undulation no forward thrust.

The force over a step is ``-c |v_0| v_1``, with the velocities at the start and the end. Under drag
alone this is the exact solution of ``v' = -c |v| v`` for any step. Elsewhere it is of second order
(Kahan 1993). The derivative ``2 c |v|`` would make it first order.

The rows w of the matrix W are the point Jacobians: point velocities are ``W V``. The decrease of
the wrench per change of V is ``D = sum_p c_p |v_p| w_p w_p^T``, and the wrench is ``-D V``. For
known bodies D is a product of constant outer products with the coefficients. These small matrix
products serve the whole population.

If the water has a surface, each point's force and derivative are scaled by the fraction of its
patch under water.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import Condition, all_hold, chosen
from evo_cpg.creature.algebra.linear import matvec, matvec_t
from evo_cpg.creature.algebra.numerics import (
    MixedArray,
    Number,
    Numbers,
    is_traced,
    smooth_step,
    xp,
)
from evo_cpg.creature.shapes import Surface
from evo_cpg.creature.surface import PointLayout
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, WrenchPart

# Decimals to which equal numbers are rounded, and tolerance for numbers to stay equal (m, m^2).
_DECIMALS, _SAME = 9, 1e-9

# Largest component of a normal along the axis from which tangents are made. A normal's least
# component is at most 0.58.
_ACROSS = 0.9

# Height over which a level patch gets wet, as a fraction of its size, so that forces do not jump.
_LEAST_SLOPE = 0.1


class PointPlaces(NamedTuple):
    """Places of the points of a patch, for their depth.

    Attributes:
        points: positions in the body's working frame, m.
        normals: outward unit normals.
        extents: half the edge of a square of a point's area, m.
    """

    points: np.ndarray
    normals: np.ndarray
    extents: np.ndarray


def wet_fraction(places: PointPlaces | None, pose: Float[Array, "4 k *n"]) -> Float[Array, "p kn"]:
    """Return the fraction under water of the patch around each point, a cubic in its depth.

    Raises:
        ValueError: if the patches were made for water without a surface.
    """
    if places is None:
        raise ValueError("patches know no depth; make them with make_patches(..., surfacing=True)")
    flat = pose.reshape(4, -1)
    up, height = flat[:3], flat[3:]
    points, normals, extents = (jnp.asarray(column, flat.dtype) for column in places)
    steepness = normals @ up
    spread = extents[:, None] * jnp.sqrt(1.0 - (1.0 - _LEAST_SLOPE**2) * steepness * steepness)
    # Points with the same normal and area share the quotient.
    return smooth_step(0.5 - (height + points @ up) * (0.5 / spread))


def groups_of(
    surfaces: Sequence[tuple[tuple[Numbers, ...], ...]], layout: PointLayout
) -> list[tuple[int, ...]]:
    """Return the bodies grouped by their arrays: points of surfaces, or other constants.

    The layout "merged" groups equal bodies. Any other layout keeps each body alone.
    """
    if layout != "merged":
        return [(i,) for i in range(len(surfaces))]

    def alike() -> list[tuple[int, ...]]:
        groups: dict[bytes, list[int]] = {}
        for i, own in enumerate(surfaces):
            columns = (column for surface in own for column in surface)
            key = b"|".join(np.round(column, _DECIMALS).tobytes() for column in columns)
            groups.setdefault(key, []).append(i)
        return [tuple(bodies) for bodies in groups.values()]

    def still(groups: list[tuple[int, ...]]) -> Condition:
        return all_hold(
            (xp.abs(one - same) <= _SAME).all()
            for first, *others in groups
            for other in others
            for own, theirs in zip(surfaces[first], surfaces[other], strict=True)
            for one, same in zip(own, theirs, strict=True)
        )

    return chosen(alike, still)


def places_of(surface: Surface) -> PointPlaces:
    """Return the places of surface points."""
    # Points without area have no force, so any extent serves.
    areas = xp.where(surface.areas > 0, surface.areas, 1.0)
    return PointPlaces(surface.points, surface.normals, xp.sqrt(areas) / 2)


def velocity_rows(surface: Surface) -> list[Numbers]:
    """Return rows ``(points, 6)`` for the normal and two tangential velocities of a twist."""
    points, normals, _ = surface

    def still(axes: np.ndarray) -> Condition:
        """Return whether no axis is nearly along its normal, so that the axes give tangents."""
        return (xp.abs(normals[np.arange(len(axes)), axes]) < _ACROSS).all()

    across = xp.cross(normals, np.eye(3)[chosen(lambda: np.abs(normals).argmin(-1), still)])
    first = across / xp.linalg.norm(across, axis=-1, keepdims=True)
    second = xp.cross(normals, first)
    return [
        xp.concatenate([xp.cross(points, direction), direction], -1)
        for direction in (normals, first, second)
    ]


def merge_alike(
    rows: Numbers, areas: Numbers, layout: PointLayout = "merged"
) -> tuple[Numbers, Numbers]:
    """Return one row for all rows that are equal up to their sign, with summed areas.

    Points on opposite faces of a box move alike whatever its size. Layouts other than "merged"
    merge only such points: their normals are axes of the body.
    """

    def choose() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a sign for each row, the first row of each kind, and the members of each kind."""
        rounded = np.round(rows, _DECIMALS) + 0.0
        if layout != "merged":
            # A number of its own keeps any other point apart.
            along_axis = (np.abs(rows[:, 3:]) == 1).any(1)
            alone = np.where(along_axis, 0, 1 + np.arange(len(rows)))
            rounded = np.column_stack([rounded, alone])
        leading = np.take_along_axis(rounded, (rounded != 0).argmax(1)[:, None], 1)
        signs = np.where(leading < 0, -1.0, 1.0)
        _, first, inverse = np.unique(
            rounded * signs + 0.0, axis=0, return_index=True, return_inverse=True
        )
        # Keep the order of the points: the order of the rows would change with a body's size.
        order = np.argsort(first)
        return signs, first[order], (inverse.ravel() == order[:, None]).astype(float)

    def still(merged: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Condition:
        signs, kept, members = merged
        signed = rows * signs
        return (xp.abs(signed - signed[kept[members.argmax(0)]]) <= _SAME).all()

    signs, kept, members = chosen(choose, still)
    return (rows * signs)[kept], members @ areas


def outer_products(rows: Numbers) -> Numbers:
    """Return the (angular, mixed, linear) blocks of ``w w^T`` of each row, ``(27, points)``."""
    outer = xp.einsum("pi,pj->ijp", rows, rows)
    return xp.stack([outer[:3, :3], outer[:3, 3:], outer[3:, 3:]]).reshape(27, -1)


def sum_of_outer_products(
    rows: Sequence[Numbers], factor: Numbers, weight: Float[Array, "p m"]
) -> Float[Array, "27 m"]:
    """Return the blocks of ``sum factor weight w w^T`` over points.

    Args:
        rows: one or several rows w of each point, ``(p, 6)`` each. Outer products of traced rows
            are made in each step, because reading them from memory would take more time.
        factor: constant factor of each point, ``(p,)``.
        weight: factor of each point and body.
    """
    if not is_traced(rows, factor):
        outer = sum(map(outer_products, rows))
        return jnp.asarray(outer * factor[None], weight.dtype) @ weight
    weight = jnp.asarray(factor, weight.dtype)[:, None] * weight
    total = jnp.zeros((6, 6, weight.shape[1]), weight.dtype)
    for own in rows:
        w = jnp.asarray(own, weight.dtype).T[..., None]
        total = total + (w[:, None] * (weight[None] * w)[None]).sum(2)
    return jnp.stack([total[:3, :3], total[:3, 3:], total[3:, 3:]]).reshape(27, -1)


SPEED_FLOOR = 1e-12
"""Squared speed (m^2/s^2) added under the root so that its gradient exists at rest."""

DragLaw = Literal["normal", "isotropic"]


class Patch(NamedTuple):
    """Surface points of bodies that have the same surface in their working frames.

    Form drag and skin friction have separate points. Points of form drag with equal normal
    velocities, up to the sign, feel equal wrenches and are merged. A box keeps only half of its
    points, because points on opposite faces move alike. At the water's surface opposite points do
    not get wet alike, so all are kept.

    Attributes:
        bodies: indices in the tree, in increasing order.
        normal: rows for the normal velocity, ``(form points, 6)``.
        normal_area: area of each form point, m^2.
        tangential: rows for the two tangential velocities, ``(2, skin points, 6)``.
        tangential_area: area of each skin point, m^2.
        normal_places: places of the form points, or None for water without a surface.
        tangential_places: places of the skin points, or None for water without a surface.
    """

    bodies: tuple[int, ...]
    normal: np.ndarray
    normal_area: np.ndarray
    tangential: np.ndarray
    tangential_area: np.ndarray
    normal_places: PointPlaces | None = None
    tangential_places: PointPlaces | None = None


class DragOnPatches(ForceLaw):
    """Drag whose `parts` is one part, with a D that includes the change over a step."""

    of_water: ClassVar[bool] = True

    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the drag wrench on every body (`ForceLaw.wrench`)."""
        return self.parts(bodies)[0].wrench

    def averaged(self, start: Bodies, moving: Bodies) -> None:
        """Return None: D already includes the change over a step (`ForceLaw.averaged`)."""
        del start, moving


class Drag(DragOnPatches):
    """Form drag and skin friction.

    Attributes:
        form_drag: C_d.
        skin_drag: C_f.
        patches: the surface points that meet the water.
        law: drag against the normal and tangential velocities, or against the whole velocity.
    """

    form_drag: Number
    skin_drag: Number
    patches: tuple[Patch, ...] = ()
    law: DragLaw = eqx.field(static=True, default="normal")

    def parts(self, bodies: Bodies) -> tuple[WrenchPart]:
        """Return the drag wrench with the D of the module docstring (`ForceLaw.parts`)."""
        assert bodies.water is not None
        density = bodies.water.density
        wrench, derivative = drag(self, density, bodies.relative, bodies.pose)
        return (WrenchPart(wrench, bodies.h * derivative),)

    def scaled(self, factor: float) -> "Drag":
        """Return drag with both coefficients multiplied by a factor."""
        return dataclasses.replace(
            self, form_drag=self.form_drag * factor, skin_drag=self.skin_drag * factor
        )


def make_patches(
    tree: Tree,
    form: dict[str, Surface],
    skin: dict[str, Surface],
    law: DragLaw = "normal",
    surfacing: bool = False,
    layout: PointLayout = "merged",
) -> tuple[Patch, ...]:
    """Group bodies with equal surfaces and prepare their constant matrices.

    Args:
        tree: the creature.
        form: points for form drag on each body by name, in the body's geometric frame.
        skin: points for skin friction. The isotropic law uses the form points for both.
        law: drag law (`Drag`).
        surfacing: whether the water has a surface.
        layout: "merged" merges equal bodies, and all points that move alike in this creature. Other
            layouts merge only points that move alike in all creatures of their plan.
    """
    if law == "isotropic":
        skin = form
    placed = [
        (
            form[name]._replace(points=form[name].points + tree.centre[None, :, i]),
            skin[name]._replace(points=skin[name].points + tree.centre[None, :, i]),
        )
        for i, name in enumerate(tree.names)
    ]
    patches = []
    for bodies in groups_of(placed, layout):
        of_form, of_skin = placed[bodies[0]]
        if not len(of_form.areas):
            if not len(of_skin.areas):
                continue
            # A point without area, because native code needs one.
            first = Surface(*(x[:1] for x in of_skin))
            of_form = first._replace(areas=0.0 * first.areas)
        normal, area = velocity_rows(of_form)[0], of_form.areas
        if law == "normal" and not surfacing:
            normal, area = merge_alike(normal, area, layout)
        _, first, second = velocity_rows(of_skin)
        patches.append(
            Patch(
                bodies,
                normal,
                area,
                xp.stack([first, second]),
                of_skin.areas,
                places_of(of_form) if surfacing else None,
                places_of(of_skin) if surfacing else None,
            )
        )
    return tuple(patches)


def drag(
    law: Drag,
    density: Number,
    velocity: Float[Array, "6 b *n"],
    pose: Float[Array, "4 b *n"] | None = None,
) -> tuple[Float[Array, "6 b *n"], Float[Array, "3 3 3 b *n"]]:
    """Return the drag wrench on every body and D, in body axes.

    The velocities are relative to the water: angular, then linear.

    Returns:
        The wrench (moment, force) and the blocks (angular-angular, angular-linear,
        linear-linear) of D.
    """
    inputs = [x for x in (velocity, pose) if x is not None]
    return over_patches(law.patches, inputs, functools.partial(_patch_drag, law, density))


def over_patches(
    patches: Sequence[Any], inputs: list[Array], evaluate: Callable
) -> tuple[Float[Array, "6 b *n"], Float[Array, "3 3 3 b *n"]]:
    """Return wrench and D of all bodies from those of some patches, and 0 for other bodies.

    Args:
        patches: patches with `bodies` in increasing order.
        inputs: quantities of all bodies ``(k, b, *n)``, the velocity first.
        evaluate: function that returns wrench and D of a run of consecutive bodies, from its patch,
            its slice of all bodies, and its inputs.
    """
    velocity = inputs[0]
    pieces = []
    for patch in patches:
        splits = np.flatnonzero(np.diff(patch.bodies) != 1) + 1
        for run in np.split(np.array(patch.bodies), splits):
            own = slice(int(run[0]), int(run[-1]) + 1)
            pieces.append((own.start, *evaluate(patch, own, *(x[:, own] for x in inputs))))
    wet = {body for patch in patches for body in patch.bodies}
    batch, dtype = velocity.shape[2:], velocity.dtype
    none = jnp.zeros((6, 1, *batch), dtype), jnp.zeros((3, 3, 3, 1, *batch), dtype)
    pieces += [(body, *none) for body in range(velocity.shape[1]) if body not in wet]
    _, wrenches, derivatives = zip(*sorted(pieces, key=lambda piece: piece[0]), strict=True)
    return jnp.concatenate(wrenches, 1), jnp.concatenate(derivatives, 3)


def _patch_drag(
    law: Drag,
    density: Number,
    patch: Patch,
    run: slice,
    velocity: Float[Array, "6 k *n"],
    pose: Float[Array, "4 k *n"] | None = None,
) -> tuple[Float[Array, "6 k *n"], Float[Array, "3 3 3 k *n"]]:
    """Return the wrench and D of some bodies of a patch.

    Constant factors are multiplied into the constant matrices, so a point takes few operations.
    """
    del run
    flat = velocity.reshape(6, -1)

    def product(constant: np.ndarray | Array | MixedArray, x: Array) -> Array:
        return jnp.asarray(constant, flat.dtype) @ x

    pressure = 0.5 * density
    skin_points = len(patch.tangential_area)
    tangential_rows = patch.tangential.reshape(2 * skin_points, 6)
    normal = product(patch.normal, flat)
    # A part whose skin points are all inside other parts has none, so no size can be -1.
    first, second = product(tangential_rows, flat).reshape(2, skin_points, flat.shape[1])
    along = jnp.sqrt(first * first + second * second + SPEED_FLOOR)
    normal_factor = pressure * law.form_drag * patch.normal_area
    tangential_factor = pressure * law.skin_drag * patch.tangential_area
    if law.law == "normal":
        speed = jnp.abs(normal)
    else:
        speed = jnp.sqrt(normal * normal + along * along)
        normal_factor = tangential_factor = normal_factor + pressure * law.skin_drag * (
            patch.normal_area
        )
        along = speed
    if pose is not None:
        speed = speed * wet_fraction(patch.normal_places, pose)
        along = along * wet_fraction(patch.tangential_places, pose)
    derivative = sum_of_outer_products([patch.normal], normal_factor, speed)
    derivative = derivative + sum_of_outer_products([*patch.tangential], tangential_factor, along)
    angular, mixed, linear = derivative.reshape(3, 3, 3, flat.shape[1])
    moment = matvec(angular, flat[:3]) + matvec(mixed, flat[3:])
    force = matvec_t(mixed, flat[:3]) + matvec(linear, flat[3:])
    wrench = -jnp.concatenate([moment, force])
    return wrench.reshape(velocity.shape), derivative.reshape(3, 3, 3, *velocity.shape[1:])
