"""Resistive-force model of a planar swimming chain in NumPy and SciPy, as an oracle.

Joint angles are prescribed, and the planar motion of the chain is unknown. P and L are momentum and
angular momentum of the whole chain about the world's origin. Newton's and Euler's equations are

    dP/dt = sum F,   dL/dt = sum r x F.

Momenta and angles give the head's velocity by a 3x3 solve. The force is the drag of points along
the middle line of every face: form drag by the normal velocity, friction by the tangential
velocity. The midpoint rule integrates it with many points per link.

The package shares no code with this model. It has other coordinates, another integrator, surface
points instead of lines, and motors instead of exact joint angles.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp


@dataclasses.dataclass(frozen=True)
class PlanarChain:
    """Chain of equal boxes in the plane, head first, in SI units.

    Attributes:
        links: number of boxes.
        length: length of a box along the chain.
        width: width of a box across the chain, in the plane.
        height: height of a box out of the plane.
        gap: distance between neighbours. Joints are in its middle.
        density: density of the boxes.
        water_density: density of the water.
        form_drag: C_d of a surface point.
        skin_drag: C_f of a surface point.
        sheltered: whether faces on both sides of a joint have no drag.
        points: number of points of the midpoint rule along a line.
    """

    links: int
    length: float
    width: float
    height: float
    gap: float
    density: float
    water_density: float
    form_drag: float
    skin_drag: float
    sheltered: bool = True
    points: int = 40

    def path(
        self, angles: Callable[[float], np.ndarray], rates: Callable[[float], np.ndarray], times
    ) -> np.ndarray:
        """Return head positions ``(times, 2)`` of a motion from rest, m.

        Args:
            angles: function of the time that returns joint angles, rad.
            rates: derivative of ``angles``, rad/s.
            times: increasing, from 0, s.
        """

        def derivative(time, y):
            velocity = self._head_velocity(y, angles(time), rates(time))
            return np.concatenate([velocity, self._force(y, velocity, angles(time), rates(time))])

        start = np.zeros(6)
        start[3:] = self._momentum(np.zeros(3), np.zeros(3), angles(0.0), rates(0.0))
        solution = solve_ivp(
            derivative, (times[0], times[-1]), start, "RK45", times, rtol=1e-6, atol=1e-8
        )
        return solution.y[:2].T

    def _links(self, pose, velocity, angles, rates):
        """Return centres, directions, velocities and turning rates of the links."""
        heading = pose[2] + np.concatenate([[0.0], np.cumsum(angles)])
        turning = velocity[2] + np.concatenate([[0.0], np.cumsum(rates)])
        along = np.stack([np.cos(heading), np.sin(heading)], 1)
        across = np.stack([-along[:, 1], along[:, 0]], 1)
        reach = (self.length + self.gap) / 2
        step = -reach * (along[:-1] + along[1:])
        speed = -reach * (across[:-1] * turning[:-1, None] + across[1:] * turning[1:, None])
        centre = pose[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(step, 0)])
        moving = velocity[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(speed, 0)])
        return centre, along, across, moving, turning

    def _momentum(self, pose, velocity, angles, rates):
        """Return momentum (x, y) and angular momentum about the origin."""
        mass = self.density * self.length * self.width * self.height
        inertia = mass / 12 * (self.length**2 + self.width**2)
        centre, _, _, moving, turning = self._links(pose, velocity, angles, rates)
        orbital = centre[:, 0] * moving[:, 1] - centre[:, 1] * moving[:, 0]
        spin = (mass * orbital + inertia * turning).sum()
        return np.array([*(mass * moving).sum(0), spin])

    def _head_velocity(self, y, angles, rates):
        """Return the velocity (x, y, turning) of the head for the momentum in the state."""
        own = self._momentum(y[:3], np.zeros(3), angles, rates)
        still = np.zeros_like(rates)
        columns = [self._momentum(y[:3], unit, angles, still) for unit in np.eye(3)]
        return np.linalg.solve(np.array(columns).T, y[3:] - own)

    def _force(self, y, velocity, angles, rates):
        """Return the drag of the whole chain: force (x, y) and moment about the origin."""
        centre, along, across, moving, turning = self._links(y[:3], velocity, angles, rates)
        middle = (np.arange(self.points) + 0.5) / self.points - 0.5
        half = 0.5 * self.water_density
        total = np.zeros(3)

        def add(links, x, y, area, normal):
            """Add the drag of points at (x, y) of links on faces normal to an axis."""
            x, y = np.broadcast_to(x, self.points), np.broadcast_to(y, self.points)
            v_x = (moving[links] * along[links]).sum(1)[:, None] - turning[links, None] * y
            v_y = (moving[links] * across[links]).sum(1)[:, None] + turning[links, None] * x
            c_x = self.form_drag if normal == "x" else self.skin_drag
            c_y = self.form_drag if normal == "y" else self.skin_drag
            # Friction depends on the tangential speed, form drag on the normal speed.
            tangential = np.hypot(v_x if normal != "x" else 0.0, v_y if normal != "y" else 0.0)
            f_x = -half * c_x * area * (np.abs(v_x) if normal == "x" else tangential) * v_x
            f_y = -half * c_y * area * (np.abs(v_y) if normal == "y" else tangential) * v_y
            force = f_x.sum(1)[:, None] * along[links] + f_y.sum(1)[:, None] * across[links]
            moment = (x * f_y - y * f_x).sum(1)
            orbital = centre[links, 0] * force[:, 1] - centre[links, 1] * force[:, 0]
            total[:] += [*force.sum(0), (moment + orbital).sum()]

        every = np.arange(self.links)
        x, y = middle * self.length, middle * self.width
        for side in (-0.5, 0.5):
            add(every, x, side * self.width, self.length * self.height / self.points, "y")
        add(every, x, 0.0, 2 * self.length * self.width / self.points, "z")
        caps = {0.5: every if not self.sheltered else every[:1]}
        caps[-0.5] = every if not self.sheltered else every[-1:]
        for end, links in caps.items():
            add(links, end * self.length, y, self.width * self.height / self.points, "x")
        return total
