"""Resistive-force swimming of a planar chain, from scratch in NumPy and SciPy: an oracle.

Joint angles are prescribed, the plane motion of the chain is unknown. Newton and Euler for the
whole chain, with P and L its momentum and its angular momentum about the world's origin:

    dP/dt = sum F,   dL/dt = sum r x F.

Momenta and angles give the head's velocity by a 3x3 solve. The force is the drag of points along
the middle line of every face, form drag on the normal velocity and friction on the tangential,
integrated by the midpoint rule with many points to a link.

Besides `solve_ivp` nothing is shared with the package: other coordinates, another integrator,
lines instead of surface points, and joint angles that are exact instead of motors.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp


@dataclasses.dataclass(frozen=True)
class PlanarChain:
    """A chain of equal boxes in the plane, head first, in SI units.

    Attributes:
        links: how many.
        length: of a box along the chain.
        width: of a box across, in the plane.
        height: of a box out of the plane.
        gap: between neighbours; joints are in the middle of it.
        density: of the boxes.
        water_density: of the water.
        form_drag: C_d of a surface point.
        skin_drag: C_f of a surface point.
        sheltered: whether faces that look at each other across a joint feel no water.
        points: of the midpoint rule along a line.
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
        """Head position ``(times, 2)`` from rest, m.

        Args:
            angles: joint angles at a time, rad.
            rates: their derivative, rad/s.
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
        """Centres, directions, velocities and turning rates of the links."""
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
        """Momentum (x, y) and angular momentum about the origin."""
        mass = self.density * self.length * self.width * self.height
        inertia = mass / 12 * (self.length**2 + self.width**2)
        centre, _, _, moving, turning = self._links(pose, velocity, angles, rates)
        orbital = centre[:, 0] * moving[:, 1] - centre[:, 1] * moving[:, 0]
        spin = (mass * orbital + inertia * turning).sum()
        return np.array([*(mass * moving).sum(0), spin])

    def _head_velocity(self, y, angles, rates):
        """Velocity (x, y, turning) of the head with the momentum in the state."""
        own = self._momentum(y[:3], np.zeros(3), angles, rates)
        still = np.zeros_like(rates)
        columns = [self._momentum(y[:3], unit, angles, still) for unit in np.eye(3)]
        return np.linalg.solve(np.array(columns).T, y[3:] - own)

    def _force(self, y, velocity, angles, rates):
        """Drag of the whole chain: force (x, y) and moment about the origin."""
        centre, along, across, moving, turning = self._links(y[:3], velocity, angles, rates)
        middle = (np.arange(self.points) + 0.5) / self.points - 0.5
        half = 0.5 * self.water_density
        total = np.zeros(3)

        def add(links, x, y, area, normal):
            """Drag of points at (x, y) of some links whose faces look along the given axis."""
            x, y = np.broadcast_to(x, self.points), np.broadcast_to(y, self.points)
            v_x = (moving[links] * along[links]).sum(1)[:, None] - turning[links, None] * y
            v_y = (moving[links] * across[links]).sum(1)[:, None] + turning[links, None] * x
            c_x = self.form_drag if normal == "x" else self.skin_drag
            c_y = self.form_drag if normal == "y" else self.skin_drag
            # Friction goes with the tangential speed, form drag with the normal one.
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
