"""Builder of the drag of water with a viscosity (`evo_cpg.physics.water.viscous_drag`).

The constants of a body come from its exposed surface and from the outline of its whole chain
(`evo_cpg.creature.slender`):

- R of creeping flow is that of an ellipsoid with the proportions of the outline.
- The coefficients of form drag give the outline its measured drag.
- The distance x of the boundary layer runs from the nose of the chain, or from its tail. Across the
  centreline, x is the path around the body. It is the distance of the mean coefficient over the
  body, a quarter of the length for a single body.

Resistance of an ellipsoid in creeping flow: with ``D^2 = (a^2 + l) (b^2 + l) (c^2 + l)``,
``chi = int_0^inf dl / D`` and ``alpha_i = int_0^inf dl / ((a_i^2 + l) D)``, force and torque of the
semi-axes a, b, c are (Oberbeck 1876, Jeffery 1922)

    F_i = -16 pi mu U_i / (chi + a_i^2 alpha_i),
    T_i = -16/3 pi mu w_i (a_j^2 + a_k^2) / (a_j^2 alpha_j + a_k^2 alpha_k).

A sphere has 6 pi mu a and 8 pi mu a^3.

Form drag along an axis of the shape is ``1/2 rho V^2 S C``, S being the area that meets the flow. C
depends on the depth l along the flow and on the profile across it, p >= q. A thin plate across the
flow has

    C_plate = 2 - 0.87 / (1 + ((p/q - 1) / 26)^1.3),

1.13 for a square, 2.0 for a long plate. Depth gives the flow time to follow the body:

    round:  C = C_plate / (1 + c (l/q)^1.1),
    box:    C = C_plate (1 - 0.27 e (1 - 1 / (1 + (0.55 l/q)^2))),  e = (2 - C_plate) / 0.87.

The constant c gives ``1.25 - 0.785 / (1 + (p/q - 1) / 6)`` at ``l = q``.

Cylinders with flat ends have their own values. Along the axis, x being ``l/q``,

    C = C_plate (1 - 0.28 x^3 / (0.5 + x^3)).

Across it they are round, with ``1.19 - 0.58 / (1 + e / (12 + 0.1 e))`` at ``l = q``,
``e = p/q - 1``.

So a sphere has 0.46, a long cylinder 1.25, a cube 1.06, a long bar 2.0, and a rod along the flow
0.83. The values are those of a laminar boundary layer, without friction. `docs/models/fluid.md`
compares them with measurements.
"""

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import decided
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Surface
from evo_cpg.creature.slender import ChainOutline, chain_outline, slender_chains
from evo_cpg.creature.surface import PointLayout
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.fluid import (
    PointPlaces,
    groups_of,
    merge_alike,
    outer_products,
    places_of,
    velocity_rows,
)
from evo_cpg.physics.water.viscous_drag import ViscousDrag, ViscousPatch, Wetted

# Reynolds number of the transition to turbulent friction. A single body has one Re_x for its whole
# length. The transition begins at its rear, where x is larger: the factor fits the mean friction of
# a plate with a transition at 5e5.
_TRANSITION, _ALONE = 5e5, 1.5

# Re_x below which the boundary layer fades out, because creeping flow has all the friction.
_CREEPING = 0.05

# Depth of the dip of round bodies' form drag.
_DIP = 0.3

# Sharpness above which form drag needs no points at the centre: the faces have all of it.
_SHARP = 0.99

# Resolution of the points that find silhouette and area of a body, and the largest frontal area of
# its few points over the silhouette. Those of half-balls have 1.09 at the default resolution.
_FINE, _MOST_FRONT = 8, 1.1

# Least length, so that a body without size has finite coefficients, m.
_TINY = 1e-9

# Corrections of the points' coefficients. Boxes need one.
_ROUNDS = 12

# Least coefficient, so that a body without area has finite coefficients.
_NO_DRAG = 1e-12


def make_viscous_drag(
    creature: Creature,
    tree: Tree,
    form: dict[str, Surface],
    skin: dict[str, Surface],
    viscosity: Number,
    form_drag: Number = 1.0,
    surfacing: bool = False,
    layout: PointLayout = "merged",
) -> ViscousDrag:
    """Return the law for a creature.

    Args:
        creature: the creature.
        tree: its tree.
        form: exposed points for form drag on each body by name, in the body's geometric frame.
        skin: exposed points for skin friction.
        viscosity: dynamic viscosity, Pa s.
        form_drag: factor of the form coefficients.
        surfacing: whether the water has a surface.
        layout: "merged" merges equal bodies and points.
    """
    wetted: list[Wetted] = [None] * tree.body_count  # pyright: ignore[reportAssignmentType]
    places: list[PointPlaces] = [None] * tree.body_count  # pyright: ignore[reportAssignmentType]
    runs_along = [xp.zeros(2)] * tree.body_count
    mass = tree.rigid_mass
    for chain in slender_chains(creature):
        if not creature.bodies[chain.bodies[0]].shape.exists:
            continue
        shape = chain_outline(creature, chain)
        names = [creature.bodies[body].name for body in chain.bodies]
        fine = creature.bodies[chain.bodies[0]].shape.surface(_FINE)
        points = _form_points(shape, [form[name] for name in names], fine)
        # The ellipsoid of creeping flow has the volume of the bodies. A body gets its part of the
        # force. A part of a straight chain that turns about its own centre has a torque that grows
        # with the cube of its length.
        half, lengths = shape.sizes / 2, shape.lengths
        scale = (shape.volume / (4 / 3 * np.pi * xp.prod(half))) ** (1 / 3)
        force, torque = ellipsoid_resistance(xp.maximum(half * scale, _TINY))
        part = (lengths / xp.maximum(lengths.sum(), _TINY))[:, None]
        about = xp.concatenate([part * torque[None, :1], part**3 * torque[None, 1:]], 1)
        creep = xp.concatenate([about, part * force[None]], 1)
        # Squared inverse distances from the nose and from the tail: the mean of x^-1/2 over a body
        # from x_0 to x_1 is 2 / (sqrt(x_0) + sqrt(x_1)).
        ends = xp.cumsum(lengths)
        total = xp.maximum(ends[-1], _TINY)
        starts, path, inverse = ends - lengths, _path(*shape.sizes) / total, []
        for near, far in ((starts, ends), (total - ends, total - starts)):
            roots = xp.sqrt(xp.maximum(near, 0.0)) + xp.sqrt(xp.maximum(far, _TINY))
            inverse.append(1 / (path * roots**2 / 4) ** 2)
        runs_here = xp.stack(inverse, -1)
        for i, name in enumerate(names):
            k = tree.names.index(name)
            surface, coefficients = points[i]
            placed = surface._replace(points=surface.points + tree.centre[None, :, k])
            places[k] = places_of(placed)
            area, own = coefficients * surface.areas, skin[name]
            if len(names) == 1:
                # The few points of a thin body have more area than many points.
                excess = fine.areas.sum() / xp.maximum(own.areas.sum(), _TINY**2)
                own = own._replace(areas=own.areas * xp.minimum(1.0, excess))
            wetted[k] = _wetted(shape, i, tree.centre[:, k], placed, area, own, creep[i], mass[k])
            runs_along[k] = runs_here[i]
    wet = [k for k, own in enumerate(wetted) if own is not None]
    keys = [(tuple(wetted[k]), tuple(places[k])) for k in wet]
    found = groups_of(keys, layout)
    groups = [tuple(wet[i] for i in bodies) for bodies in found]
    patches = []
    for bodies in groups:
        own = wetted[bodies[0]]
        if layout == "merged" and not surfacing:
            normal, area = merge_alike(own.normal, own.form)
            if len(own.dip) > 1:
                _, dip = merge_alike(own.normal, own.form * own.dip)
                own = own._replace(dip=dip / xp.maximum(area, _TINY**2))
            own = own._replace(normal=normal, form=area)
        forward, backward = xp.stack([runs_along[body] for body in bodies], -1)
        patches.append(
            ViscousPatch(
                bodies,
                own,
                outer_products(own.normal),
                forward,
                backward,
                places[bodies[0]] if surfacing else None,
            )
        )
    return ViscousDrag(viscosity, form_drag, tuple(patches))


def _form_points(
    shape: ChainOutline, surfaces: list[Surface], fine: Surface
) -> list[tuple[Surface, Numbers]]:
    """Return the points of form drag of each body of a chain, and their coefficients k.

    A point has the force ``-1/2 rho k A |v_n| v_n n``. The coefficients give the chain the drag C
    of its outline. Where the points of a round body are too few for that, such as at the edge of a
    thin disc, points at the body's centre add the rest.

    ``fine`` are many points of the first body: a thin ellipsoid's few points have up to six times
    its area, and a single body meets hardly more flow than its silhouette.
    """
    normals = [surface.normals @ turn for surface, turn in zip(surfaces, shape.axes, strict=True)]
    every, areas = xp.concatenate(normals), xp.concatenate([s.areas for s in surfaces])
    coefficients = form_drag_coefficients(shape.sizes, shape.sharpness, shape.bluntness)
    fronts = xp.stack([0.5 * s.areas @ xp.abs(n) for s, n in zip(surfaces, normals, strict=True)])
    total = fronts.sum(0)
    if len(surfaces) == 1:
        silhouette = 0.5 * fine.areas @ xp.abs(fine.normals @ shape.axes[0])
        coefficients = coefficients * xp.minimum(
            1.0, _MOST_FRONT * silhouette / xp.maximum(total, _TINY**2)
        )
    # With 1/k = sum_i n_i^2 / k_i, a point of a streamlined nose has the low drag of its direction.
    # The three k_i are found by k_i <- k_i C_i S_i / sum_p k A |n_i|^3.
    squares = xp.square(every)
    cubes = areas[:, None] * squares * xp.abs(every)
    target = 0.5 * coefficients * (areas[:, None] * xp.abs(every)).sum(0)
    of_axes = xp.maximum(target, _NO_DRAG**2) / xp.maximum(cubes.sum(0), _NO_DRAG**2)
    for _ in range(_ROUNDS):
        force = cubes.T @ (1 / (squares @ (1 / xp.maximum(of_axes, _NO_DRAG))))
        of_axes = of_axes * (target + _NO_DRAG**2) / (force + _NO_DRAG**2)
    k = 1 / (squares @ (1 / xp.maximum(of_axes, _NO_DRAG)))
    splits = np.cumsum([len(s.areas) for s in surfaces])[:-1].tolist()
    own = xp.split(k, splits)
    if decided(lambda: shape.sharpness > _SHARP):
        return list(zip(surfaces, own, strict=True))
    given = (k * areas) @ xp.abs(every) ** 3
    missing = xp.maximum(coefficients - given / xp.maximum(total, _TINY**2), 0.0)
    found = []
    for i, surface in enumerate(surfaces):
        centre = Surface(np.zeros((3, 3)), shape.axes[i].T, fronts[i])
        both = (xp.concatenate(columns) for columns in zip(surface, centre, strict=True))
        found.append((Surface(*both), xp.concatenate([own[i], missing])))
    return found


def _path(depth: Number, one: Number, other: Number) -> Number:
    """Return the length of the way of the water around a body of a depth along the flow, m."""
    narrow = xp.minimum(one, other)
    return (depth**4 + narrow**4) ** 0.25


def _wetted(
    shape: ChainOutline,
    i: int,
    middle: Float[Numbers, " 3"],
    placed: Surface,
    form: Float[Numbers, " p"],
    skin: Surface,
    creep: Float[Numbers, " 6"],
    mass: Number,
) -> Wetted:
    """Return the constants of a body of a chain in its working frame."""
    turn, half = shape.axes[i], xp.maximum(shape.halves[i], _TINY)
    along = xp.concatenate([xp.cross(middle[None], turn.T), turn.T], 1)
    motion = xp.concatenate([along, xp.concatenate([turn.T, np.zeros((3, 3))], 1)])
    normal, _, _ = velocity_rows(placed)
    _, first, second = velocity_rows(skin._replace(points=skin.points + middle))
    friction = (first.T * skin.areas) @ first + (second.T * skin.areas) @ second
    axes = xp.concatenate([motion[3:], motion[:3]])
    # The path of the water across the centreline is that around the body. A chain that is shorter
    # than wide has the path of its length.
    sizes = xp.array([shape.sizes[0], 2 * half[1], 2 * half[2]])
    runs = [_path(sizes[j], sizes[j - 1], sizes[j - 2]) / 4 for j in range(3)]
    inverse = xp.array([1 / run**2 for run in runs])
    # Mean squares of the positions in a box of the body's sizes.
    square = xp.square(half)
    spread = square / 3
    turning = xp.array([[0.0 if j == k else spread[3 - j - k] for k in range(3)] for j in range(3)])
    # The inertia of an ellipsoid of these sizes.
    inertia = xp.concatenate([0.2 * mass * (square.sum() - square), xp.stack([mass] * 3)])
    dip = xp.array([_DIP * (1 - shape.sharpness)])
    if shape.blunt[i]:
        # The flow leaves flat ends at their edge, at any speed.
        dip = dip * (1 - xp.square(placed.normals[:, 0]))
    return Wetted(
        normal=normal,
        form=form,
        motion=motion,
        speed=xp.concatenate([np.ones(3), turning.sum(0)])[None],
        rate=xp.concatenate([inverse * np.array([0.0, 1.0, 1.0]), inverse @ turning])[None],
        friction=friction,
        creep=(axes.T * creep) @ axes,
        decay=xp.array([xp.max(creep / xp.maximum(inertia, _TINY**5))]),
        fade=xp.array([_CREEPING * xp.sqrt(inverse[1] * inverse[2])]),
        transition=xp.array([_TRANSITION if len(shape.axes) > 1 else _TRANSITION / _ALONE]),
        diameter=xp.array([2 * xp.sqrt(half[1] * half[2])]),
        dip=dip,
    )


# Points of the quadrature: the error is below 1e-6 for axes of 1 to 100.
_NODES = 60


def ellipsoid_resistance(
    axes: Float[Numbers, " 3"],
) -> tuple[Float[Numbers, " 3"], Float[Numbers, " 3"]]:
    """Return force over viscosity and velocity (m), torque over viscosity and rate (m^3)."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # l = s^2 (x / (1 - x))^2 maps (0, 1) to (0, infinity) and leaves a smooth integrand.
    x = (nodes + 1) / 2
    scale = axes.min() * axes.max()
    squares = xp.square(axes)
    shifted = squares[:, None] + (scale * (x / (1 - x)) ** 2)[None]
    integrand = weights / 2 * scale * 2 * x / (1 - x) ** 3 / xp.sqrt(shifted.prod(0))
    chi = integrand.sum()
    part = squares * (integrand / shifted).sum(-1)
    force = 16 * np.pi / (chi + part)
    order, other = np.array([1, 2, 0]), np.array([2, 0, 1])
    torque = 16 / 3 * np.pi * (squares[order] + squares[other]) / (part[order] + part[other])
    return force, torque


# Coefficients of the formulas above.
_LONG_PLATE, _PLATE_LOSS, _PLATE_RATIO, _PLATE_POWER = 2.0, 0.87, 26.0, 1.3
_LONG_CYLINDER, _END_LOSS, _END_RATIO = 1.25, 0.785, 6.0
_ROUND_POWER, _BOX_LOSS, _BOX_DEPTH = 1.1, 0.27, 0.55
_FLAT_LOSS, _FLAT_DEPTH = 0.28, 0.5
_FLAT_CYLINDER, _FLAT_END_LOSS, _FLAT_RATIO, _FLAT_SLOPE = 1.19, 0.58, 12.0, 0.1


def form_drag_coefficients(
    sizes: Float[Numbers, " 3"], sharpness: Number, bluntness: Float[Numbers, " 3"] | None = None
) -> Float[Numbers, " 3"]:
    """Return C for flow along each axis of a shape.

    The sharpness is 0 for round shapes and 1 for boxes. The bluntness is the fraction that consists
    of cylinders along each axis.
    """
    found = []
    for axis in range(3):
        one, other = (sizes[i] for i in range(3) if i != axis)
        broad, narrow = xp.maximum(one, other), xp.minimum(one, other)
        excess, depth = broad / narrow - 1, sizes[axis] / narrow
        loss = 1 / (1 + (excess / _PLATE_RATIO) ** _PLATE_POWER)
        plate = _LONG_PLATE - _PLATE_LOSS * loss
        cylinder = _LONG_CYLINDER - _END_LOSS / (1 + excess / _END_RATIO)
        rounded = plate / (1 + (plate / cylinder - 1) * depth**_ROUND_POWER)
        box = plate * (1 - _BOX_LOSS * loss * (1 - 1 / (1 + (_BOX_DEPTH * depth) ** 2)))
        if bluntness is not None:
            total, cube = bluntness.sum(), depth**3
            ends = plate * (1 - _FLAT_LOSS * cube / (_FLAT_DEPTH + cube))
            slope = excess / (_FLAT_RATIO + _FLAT_SLOPE * excess)
            cylinder = _FLAT_CYLINDER - _FLAT_END_LOSS / (1 + slope)
            side = plate / (1 + (plate / cylinder - 1) * depth**_ROUND_POWER)
            flat = bluntness[axis] * ends + (total - bluntness[axis]) * side
            rounded = (1 - total) * rounded + flat
        found.append((1 - sharpness) * rounded + sharpness * box)
    return xp.array(found)
