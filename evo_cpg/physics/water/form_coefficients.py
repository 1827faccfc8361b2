"""Form drag of a whole shape, and its distribution over points on the surface.

The force along an axis of the shape is ``1/2 rho V^2 S C``, S being the area that meets the flow. C
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

from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp

# Coefficients of the formulas above.
_LONG_PLATE, _PLATE_LOSS, _PLATE_RATIO, _PLATE_POWER = 2.0, 0.87, 26.0, 1.3
_LONG_CYLINDER, _END_LOSS, _END_RATIO = 1.25, 0.785, 6.0
_ROUND_POWER, _BOX_LOSS, _BOX_DEPTH = 1.1, 0.27, 0.55
_FLAT_LOSS, _FLAT_DEPTH = 0.28, 0.5
_FLAT_CYLINDER, _FLAT_END_LOSS, _FLAT_RATIO, _FLAT_SLOPE = 1.19, 0.58, 12.0, 0.1

# Corrections of the points' coefficients. Boxes need one.
_ROUNDS = 12

# Least coefficient and area, so that a body without area has finite coefficients.
_TINY = 1e-12


def form_drag_coefficients(
    sizes: Float[Numbers, " 3"],
    sharpness: Number,
    bluntness: Float[Numbers, " 3"] | None = None,
) -> Float[Numbers, " 3"]:
    """Return C for flow along each axis of a shape.

    Args:
        sizes: lengths of the shape along its axes, m.
        sharpness: 0 for round shapes, 1 for boxes. Values between mix the two coefficients.
        bluntness: fraction that consists of cylinders along each axis, or None without cylinders.
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


def point_coefficients(
    normals: Float[Numbers, "p 3"], areas: Float[Numbers, " p"], coefficients: Float[Numbers, " 3"]
) -> Float[Numbers, " p"]:
    """Return the coefficient k of each point, so that the points together have the form drag C.

    A point has the force ``-1/2 rho k A |v_n| v_n n``. The coefficient of a point with the normal n
    is ``1/k = sum_i n_i^2 / k_i``, so a point of a streamlined nose has the low drag of that
    direction. The three k_i are found by ``k_i <- k_i C_i S_i / sum_p k A |n_i|^3``.

    Args:
        normals: outward normals of the exposed points, along the axes of the shape.
        areas: areas of the points, m^2.
        coefficients: C of the shape along its axes.
    """
    squares = xp.square(normals)
    cubes = areas[:, None] * squares * xp.abs(normals)
    target = 0.5 * coefficients * (areas[:, None] * xp.abs(normals)).sum(0)
    own = xp.maximum(target, _TINY**2) / xp.maximum(cubes.sum(0), _TINY**2)
    for _ in range(_ROUNDS):
        force = cubes.T @ _mixed(squares, own)
        own = own * (target + _TINY**2) / (force + _TINY**2)
    return _mixed(squares, own)


def _mixed(squares: Numbers, own: Numbers) -> Numbers:
    return 1 / (squares @ (1 / xp.maximum(own, _TINY)))
