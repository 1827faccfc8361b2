"""The exact flow of a Matsuoka network under a constant drive, one linear piece at a time.

The equations (`evo_cpg.control.matsuoka`) are linear as long as no neuron begins or ceases to fire.
The signs of all potentials form the *pattern*. For a given pattern a state s moves by

    ds/dt = A s + c,    s(t + h) = s(t) + E(h) (s(t), 1),

with E(h) from the matrix exponential. A step has no integration error, however stiff the network
is, and may last as long as the pattern. Steps are halved until a cubic (Hermite, through values and
derivatives at the ends) predicts the potentials in the middle. The cubic finds zero crossings of
potentials. A Taylor series, exact in this range, then locates the crossing.

The field is continuous where the pattern changes. So the derivative of the flow is the product of
the pieces' derivatives, without an extra term for the change of the pattern.

Units: time in units of ``T_r + T_a``, states in units of the largest drive. The equations are
homogeneous in both, so tolerances do not depend on the strength of the drive or the speed of the
network.

Only NumPy is used. Nothing has to compile, so this can be called before every run.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from evo_cpg.control.matsuoka import MatsuokaNetwork

# Shortest tabulated step times the largest rate of the network. Number of Taylor terms with which a
# step of this length is exact to rounding: 0.125^12 / 12! = 3e-20.
_SHORTEST, _TERMS = 0.125, 12

# Largest number of state variables (4 for each oscillator) of a network with tabulated steps. Every
# pattern needs a table, and tables of more than 25 oscillators are slow to build. Larger networks
# use Taylor series. Their longest step times the largest rate is the second number: 0.5^12 / 12! =
# 5e-13.
_TABULATED, _SERIES = 100, 0.5

# Largest relative error of the cubic in the middle of a step. The cubic is then accurate in the
# whole step, and shows every zero crossing except dips of this relative size.
_SMOOTH = 1e-4
# The next step is twice as long if the error is below this. Doubling a step multiplies the error by
# 16.
_LENGTHEN = _SMOOTH / 32

# Potentials below this, in units of the largest drive, are rounding errors without a sign.
_ZERO = 1e-14

# Places within a step at which the cubic is evaluated, and its weights there for the values and
# derivatives at the ends (Hermite).
_PLACES = np.arange(1, 9) / 8
_CUBIC = np.stack(
    [
        (1 + 2 * _PLACES) * (1 - _PLACES) ** 2,
        _PLACES**2 * (3 - 2 * _PLACES),
        _PLACES * (1 - _PLACES) ** 2,
        _PLACES**2 * (_PLACES - 1),
    ],
    axis=1,
)

# Largest element of a tabulated matrix. A step in which a mode grows more is never smooth enough.
_LARGEST_GROWTH = 1e6

# Largest derivative of a state that counts as at rest, in units of the flow. Also the largest
# growth rate of its modes.
_STILL = 1e-12

# Largest relative error of the sum of modes that represents a distance from an equilibrium.
_REBUILT = 1e-9

# The longest time that `Flow.leap` tries to add is two to this power, in units of the flow.
_LEAP = 50

# Number of time constants after which a mode has vanished: e^-50 = 2e-22.
_FADED = 50

# Bisections of an eighth of a step that bracket a crossing, and steps of Newton's method that then
# find it to rounding.
_HALVINGS, _REFINEMENTS = 8, 4

# Largest memory for the matrices of patterns, bytes.
_KEPT_BYTES = 2**28


class BudgetError(Exception):
    """Raised if the flow needs more steps than allowed."""


class Crossing(NamedTuple):
    """Start of a neuron's firing.

    Attributes:
        time: time since the start of the run, in the flow's units.
        neuron: number of the neuron, extensors first.
        state: state of the network at that time, in the flow's units.
    """

    time: float
    neuron: int
    state: Float[np.ndarray, " k"]


class Run(NamedTuple):
    """Result of a run.

    Attributes:
        state: final state.
        duration: duration of the run: as requested, or less if enough neurons have started to fire.
        tangent: derivative of the final state with respect to the initial one, or None unless
            requested.
        onsets: starts of firing, in order of time.
        lowest: smallest output of each oscillator, at the computed steps.
        highest: largest output of each oscillator, at the computed steps.
        most: largest sum of the firing rates of an oscillator's two neurons.
    """

    state: Float[np.ndarray, " k"]
    duration: float
    tangent: Float[np.ndarray, "k k"] | None
    onsets: list[Crossing]
    lowest: Float[np.ndarray, " o"]
    highest: Float[np.ndarray, " o"]
    most: Float[np.ndarray, " o"]


class Rest(NamedTuple):
    """An equilibrium, with its eigenvalues.

    Attributes:
        state: the equilibrium, in the flow's units.
        rates: eigenvalues of the network there, largest real part first, in the flow's units.
        firing: True for neurons that fire, extensors first.
    """

    state: Float[np.ndarray, " k"]
    rates: Complex[np.ndarray, " k"]
    firing: Bool[np.ndarray, " n"]


class _Piece(NamedTuple):
    """Linear flow for one pattern of signs.

    Attributes:
        generator: A, with the constant c in the last column.
        steps: E(h) minus the identity for each tabulated length h of a step, longest first. An
            entry is None if an element would exceed `_LARGEST_GROWTH`.
    """

    generator: np.ndarray
    steps: list[np.ndarray | None]


class _Modes(NamedTuple):
    """Modes that add up to a distance from an equilibrium: rates, and shapes of the states.

    ``shapes`` has the rows of ``shapes_of_all`` that belong to potentials.
    """

    rates: np.ndarray
    shapes: np.ndarray
    shapes_of_all: np.ndarray


class Flow:
    """A network under a constant drive.

    States are vectors: potentials of the extensors, of the flexors, then their adaptations.

    Args:
        network: connections and time constants.
        drive: tonic input and sensory feedback of each neuron, extensors first.
        adaptation_gain: b of each oscillator.

    Attributes:
        second: length of a second in units of the flow.
        ratio: T_r / T_a.
        scale: largest magnitude of the drive, the unit of states.
        steps_left: number of steps left before `BudgetError`.
    """

    def __init__(
        self,
        network: MatsuokaNetwork,
        drive: Float[np.ndarray, "2 o"],
        adaptation_gain: Float[np.ndarray, " o"],
    ):
        rise, adaptation = float(network.rise_time), float(network.adaptation_time)
        count = network.oscillator_count
        self.count, self.neurons, self.size = count, 2 * count, 4 * count
        unit = rise + adaptation
        self.second = 1.0 / unit
        self.ratio = rise / adaptation
        drive = np.asarray(drive, float)
        self.scale = float(np.abs(drive).max()) or 1.0
        self.steps_left = math.inf
        self._rise, self._adaptation = unit / rise, unit / adaptation
        self._drive = (drive / self.scale).ravel()
        self._gain = np.tile(np.asarray(adaptation_gain, float), 2)
        other, own = np.maximum(network.matrix, 0.0), np.maximum(-network.matrix, 0.0)
        self._inhibition = np.block([[own, other], [other, own]])
        rates = 1 + self._inhibition.sum(1) + self._gain + np.abs(self._drive)
        quickest = max(self._rise * rates.max(), 2 * self._adaptation)
        slowest = min(self._rise, self._adaptation)
        shortest, self._depth = _SHORTEST, 0
        if self.size <= _TABULATED:
            self._depth = max(3, math.ceil(math.log2(4 * quickest / slowest / _SHORTEST)))
        else:
            shortest = _SERIES
        self._lengths = shortest / quickest * 2.0 ** np.arange(self._depth, -1, -1)
        self._pieces: dict[bytes, _Piece] = {}

    def vector(self, potential: np.ndarray, adaptation: np.ndarray) -> Float[np.ndarray, " k"]:
        """Return a state in units of the flow.

        Args:
            potential: x of each neuron, extensors first, in the user's units.
            adaptation: z of each neuron, extensors first, in the user's units.
        """
        return np.concatenate([np.ravel(potential), np.ravel(adaptation)]) / self.scale

    def derivative(self, state: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the derivative of a state with respect to time."""
        generator = self._piece(self._pattern(state)).generator
        return generator[:-1, :-1] @ state + generator[:-1, -1]

    def run(
        self,
        state: Float[np.ndarray, " k"],
        duration: float,
        tangent: bool = False,
        most_onsets: float = math.inf,
    ) -> Run:
        """Follow the network for some time.

        Args:
            state: initial state.
            duration: duration in units of the flow.
            tangent: True to compute the derivative of the final state by the initial one.
            most_onsets: number of starts of firing after which the run ends early.

        Raises:
            BudgetError: the run needs more than `steps_left` steps.
        """
        n = self.neurons
        columns = np.zeros((self.size + 1, 1 + self.size * tangent))
        columns[:-1, 0], columns[-1, 0] = state, 1.0
        if tangent:
            columns[:-1, 1:] = np.eye(self.size)
        firing = self._pattern(state)
        piece = self._piece(firing)
        onsets: list[Crossing] = []
        lowest, highest = np.full(self.count, np.inf), np.full(self.count, -np.inf)
        most = np.zeros(self.count)
        time, level = 0.0, self._depth // 2
        while duration - time > 1e-15 * duration and len(onsets) < most_onsets:
            self.steps_left -= 1
            if self.steps_left < 0:
                raise BudgetError
            fired = np.maximum(columns[:n, 0], 0.0).reshape(2, -1)
            signal = fired[0] - fired[1]
            lowest, highest = np.minimum(lowest, signal), np.maximum(highest, signal)
            most = np.maximum(most, fired.sum(0))
            left = duration - time
            while level < self._depth - 1 and self._lengths[level] > left:
                level += 1
            length = min(float(self._lengths[level]), left)
            full_length = self._depth > 0 and length == self._lengths[level]
            if full_length:
                half = piece.steps[level + 1]
                if half is None:
                    level += 1
                    continue
                middle = columns + half @ columns
                end = middle + half @ middle
            else:
                terms = _terms(piece.generator, columns)
                middle, end = _sum(terms, length / 2), _sum(terms, length)
            x0, xm, x1 = columns[:n, 0], middle[:n, 0], end[:n, 0]
            v0 = length * (piece.generator[:n] @ columns[:, 0])
            v1 = length * (piece.generator[:n] @ end[:, 0])
            size = np.maximum(np.maximum(np.abs(x0), np.abs(x1)), np.abs(xm)) + _ZERO / _SMOOTH
            error = float((np.abs(xm - (x0 + x1) / 2 - (v0 - v1) / 8) / size).max())
            if full_length and error > _SMOOTH and level < self._depth - 1:
                level += 1
                continue
            seen = _CUBIC @ np.stack([x0, x1, v0, v1])
            wrong = np.where(firing, seen < -_ZERO, seen > _ZERO)
            if not wrong.any():
                columns, time = end, time + length
                if full_length and error < _LENGTHEN and level > 0:
                    level -= 1
                continue
            place = int(wrong.any(1).argmax())
            fraction, neuron = _first_root(x0, x1, v0, v1, np.flatnonzero(wrong[place]), place)
            columns, passed = self._onto_zero(piece, columns, fraction * length, neuron)
            time += passed
            columns[neuron, 0] = 0.0
            firing = firing.copy()
            firing[neuron] = not firing[neuron]
            piece = self._piece(firing)
            if firing[neuron]:
                onsets.append(Crossing(time, neuron, columns[:-1, 0].copy()))
        derivative = columns[:-1, 1:].copy() if tangent else None
        return Run(columns[:-1, 0].copy(), time, derivative, onsets, lowest, highest, most)

    @property
    def driven(self) -> bool:
        """True if any neuron has a positive drive. Otherwise all neurons soon cease to fire."""
        return bool((self._drive > 0).any())

    def stands_still(self, state: Float[np.ndarray, " k"]) -> bool:
        """Return whether a state changes by rounding only."""
        return bool(np.abs(self.derivative(state)).max() < _STILL)

    def rest(self, state: Float[np.ndarray, " k"]) -> Rest | None:
        """Return the equilibrium that a state certainly decays to, or None if this is not certain.

        The conditions are: state and equilibrium have one pattern, the equilibrium is stable, and
        no decaying mode of the distance can bring a potential across zero.
        """
        if self.stands_still(state):
            here = self._with_rates(state, self._pattern(state))
            # A potential of zero may be at the border of a pattern with growth.
            certain = here.rates[0].real < _STILL and self._margin(here).min() > _STILL**0.5
            return here if certain else None
        near = self.equilibrium(state)
        if near is None or not near.rates[0].real < 0:
            return None
        distance = state - near.state
        margin = self._margin(near)
        modes = self._modes(near, distance)
        if modes is not None and (np.abs(modes.shapes).sum(1) < margin).all():
            return near
        # Nearly parallel modes, as of oscillators with one-way coupling, decide nothing. Then the
        # norm of the flow bounds the growth of a distance.
        reach = self._growth(near) * np.abs(distance).max()
        return near if (reach < margin).all() else None

    def leap(self, state: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " k"], float]:
        """Follow growing oscillations about an unstable equilibrium while the pattern lasts.

        Near the onset of oscillation this may be millions of periods, without any steps.

        Returns:
            The later state, and the time until then. If nothing is certain, the initial state and
            0.
        """
        near = self.equilibrium(state)
        if near is None or not near.rates[0].real > 0:
            return state, 0.0
        modes, margin = self._modes(near, state - near.state), self._margin(near)
        if modes is None:
            return state, 0.0
        sizes = np.abs(modes.shapes)
        time = 0.0
        for length in 2.0 ** np.arange(_LEAP, 0, -1):
            with np.errstate(over="ignore", invalid="ignore"):
                reach = (sizes * np.exp(np.real(modes.rates) * (time + length))).sum(1)
            if (reach < margin).all():
                time += float(length)
        grown = np.real((modes.shapes_of_all * np.exp(modes.rates * time)).sum(1))
        return (near.state + grown, time) if time else (state, 0.0)

    def equilibrium(self, state: Float[np.ndarray, " k"]) -> Rest | None:
        """Return the equilibrium of the linear flow of this state's pattern.

        Return None if that equilibrium does not exist or has another pattern.
        """
        firing = self._pattern(state)
        generator = self._piece(firing).generator
        try:
            still = -np.linalg.solve(generator[:-1, :-1], generator[:-1, -1])
        except np.linalg.LinAlgError:
            return None
        free = self._drive > 0
        x = still[: self.neurons]
        if (np.where(firing, x, -x)[free] <= 0).any():
            return None
        return self._with_rates(still, firing)

    def _with_rates(self, state: np.ndarray, firing: np.ndarray) -> Rest:
        rates = np.linalg.eigvals(self._piece(firing).generator[:-1, :-1])
        return Rest(state, rates[np.argsort(-rates.real)].astype(complex), firing)

    def _margin(self, near: Rest) -> Float[np.ndarray, " n"]:
        """Return each potential's distance from zero, or infinity for neurons without a drive."""
        return np.where(self._drive > 0, np.abs(near.state[: self.neurons]), np.inf)

    def _modes(self, near: Rest, distance: np.ndarray) -> _Modes | None:
        """Split a distance from an equilibrium into modes. Return None if modes are too similar."""
        rates, vectors = np.linalg.eig(self._piece(near.firing).generator[:-1, :-1])
        try:
            shapes = vectors * np.linalg.solve(vectors, distance)
        except np.linalg.LinAlgError:
            return None
        rebuilt = np.abs(shapes.sum(1) - distance).max()
        if not rebuilt <= _REBUILT * np.abs(distance).max():
            return None
        return _Modes(rates, shapes[: self.neurons], shapes)

    def _growth(self, near: Rest) -> float:
        """Return a bound of the flow's norm: 4 times its maximum at powers of two of a step."""
        matrix = self._piece(near.firing).generator[:-1, :-1]
        step = _SHORTEST / np.abs(matrix).sum(1).max()
        onward = np.eye(len(matrix))
        term = np.eye(len(matrix))
        for k in range(1, _TERMS):
            term = term @ matrix * (step / k)
            onward = onward + term
        largest, time = 1.0, step
        while time * -near.rates[0].real < _FADED:
            largest = max(largest, np.abs(onward).sum(1).max())
            onward, time = onward @ onward, 2 * time
        return 4 * largest

    def _pattern(self, state: np.ndarray) -> Bool[np.ndarray, " n"]:
        """Return True for neurons that fire."""
        return state[: self.neurons] > 0

    def _piece(self, firing: np.ndarray) -> _Piece:
        key = firing.tobytes()
        piece = self._pieces.get(key)
        if piece is None:
            if (len(self._pieces) + 1) * (self._depth + 2) * 8 * (self.size + 1) ** 2 > _KEPT_BYTES:
                self._pieces.pop(next(iter(self._pieces)), None)
            piece = self._pieces[key] = self._make_piece(firing)
        return piece

    def _make_piece(self, firing: np.ndarray) -> _Piece:
        n, k = self.neurons, self.size
        generator = np.zeros((k + 1, k + 1))
        generator[:n, :n] = -self._rise * (np.eye(n) + self._inhibition * firing)
        generator[:n, n:k] = -self._rise * np.diag(self._gain)
        generator[:n, k] = self._rise * self._drive
        generator[n:k, :n] = self._adaptation * np.diag(firing.astype(float))
        generator[n:k, n:k] = -self._adaptation * np.eye(n)
        if not self._depth:
            return _Piece(generator, [None])
        # Store E(h) minus the identity. Adding the identity would round off the small changes of
        # slow modes.
        shortest = generator * self._lengths[-1]
        step = term = shortest
        for order in range(2, _TERMS):
            term = term @ shortest / order
            step = step + term
        steps: list[np.ndarray | None] = [step]
        for _ in range(self._depth):
            step = None if step is None else 2 * step + step @ step
            if step is not None and np.abs(step).max() > _LARGEST_GROWTH:
                step = None
            steps.append(step)
        return _Piece(generator, steps[::-1])

    def _onto_zero(
        self, piece: _Piece, columns: np.ndarray, about: float, neuron: int
    ) -> tuple[np.ndarray, float]:
        """Follow one piece until a neuron's potential is 0.

        Args:
            piece: piece that holds until then.
            columns: state and its derivatives with respect to the initial state.
            about: estimate of the time until the potential is 0.
            neuron: number of the neuron.

        Returns:
            New columns at that time, and the time until then in the flow's units.
        """
        left = about
        for step, length in zip(piece.steps, self._lengths, strict=True):
            if step is not None and left >= length:
                columns, left = columns + step @ columns, left - length
        if not self._depth:
            # The series is exact within a whole step.
            left = min(left, float(self._lengths[0]))
        # The Taylor series at this time is exact for the shortest step, forwards and backwards.
        terms = _terms(piece.generator, columns)
        series = [float(term[neuron, 0]) for term in terms]
        reach, moment = float(self._lengths[-1]), left
        for _ in range(_REFINEMENTS):
            value = derivative = 0.0
            for coefficient in reversed(series):
                derivative = derivative * moment + value
                value = value * moment + coefficient
            if derivative == 0:
                break
            moment = min(max(moment - value / derivative, -reach), 2 * reach)
        return _sum(terms, moment), about - left + moment


def returned(
    onsets: Sequence[Crossing], near: float
) -> tuple[Float[np.ndarray, " k"], float] | None:
    """Return the state at the last start of firing, and the time since an earlier, similar start.

    The earlier start is the latest one at which the same neuron began to fire and the state was
    nearly equal. On a periodic orbit this time is the period. Return None without such a start.

    Args:
        onsets: starts of firing of one run.
        near: largest difference of two states that count as equal, as a fraction of the states'
            range.
    """
    if not onsets:
        return None
    last = onsets[-1]
    # Only the later half measures the swing, without the initial transient.
    recent = np.array([onset.state for onset in onsets[len(onsets) // 2 :]])
    swing = float(np.ptp(recent, axis=0).max())
    for before in reversed(onsets[:-1]):
        apart = np.abs(last.state - before.state).max()
        if before.neuron == last.neuron and apart <= near * swing:
            return last.state, last.time - before.time
    return None


def _terms(generator: np.ndarray, columns: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of the Taylor series of columns in time."""
    terms = [columns]
    for order in range(1, _TERMS):
        terms.append(generator @ terms[-1] / order)
    return terms


def _sum(terms: Sequence[np.ndarray], duration: float) -> np.ndarray:
    """Evaluate a Taylor series at a duration that is short against all rates."""
    total = terms[-1]
    for term in reversed(terms[:-1]):
        total = total * duration + term
    return total


def _first_root(
    x0: np.ndarray, x1: np.ndarray, v0: np.ndarray, v1: np.ndarray, neurons: np.ndarray, place: int
) -> tuple[float, int]:
    """Return the fraction of a step at which the first cubic crosses zero, and its neuron."""
    low = np.full(len(neurons), _PLACES[place - 1] if place else 0.0)
    high = np.full(len(neurons), _PLACES[place])
    a, b, c = x0[neurons], v0[neurons], 3 * (x1 - x0)[neurons] - (2 * v0 + v1)[neurons]
    d = 2 * (x0 - x1)[neurons] + (v0 + v1)[neurons]

    def cubic(t: np.ndarray) -> np.ndarray:
        return a + t * (b + t * (c + t * d))

    after = np.sign(cubic(high))
    # Accurate enough for Newton's method, which follows.
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        beyond = np.sign(cubic(middle)) == after
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    first = int(high.argmin())
    return float(low[first]), int(neurons[first])
