"""Parameters of a simulation from a recorded motion, with the uncertainty of each.

Least squares (Levenberg-Marquardt, `optimistix`) on theta: the logarithms of parameters that must
be positive, and all others as they are:

    minimise  sum_i ((y_i - m_i(theta)) / sigma_i)^2.

The noise sigma of each kind of column (places, attitudes, joint angles) is estimated from its
residuals, and the fit repeated with it. With J the Jacobian of the weighted residuals at the end,
n numbers and k parameters,

    s^2 = |residuals|^2 / (n - k),      cov(theta) = s^2 (J^T J)^-1,

and a 95 % interval is theta +- t(0.975, n - k) standard errors (Student), for logarithms made into
factors. It holds where the noise is normal and independent from number to number, the model is
right, and the error so small that the model is linear within it.

The search has found its end where the residuals have next to nothing along J (Bates and Watts,
"A relative offset orthogonality convergence criterion for nonlinear least squares", Technometrics
23, 1981). What the solver says of itself is not asked: at the end the sum of squares changes less
than it is rounded, the solver turns such steps down, and so may not stop by itself.

The model is large to compile, so a program holds it once: each evaluation also gives the Jacobian,
which the solver's derivatives and the covariance share.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Bool, Float, Int

# Fits, each with the noise of the one before it.
_ROUNDS = 3

_TOLERANCE, _MOST_STEPS = 1e-6, 60

# Largest part of the residuals along J at the end, in units of their noise: standard errors to the
# minimum that J promises. A result so far off would be held by 94.5 % instead of 95 % of the
# intervals. Where the model has bends (rectifiers, contact) it need not come nearer to 0 at all.
_OFFSET = 0.2

# Directions that move the residuals by less than this share of the others are left out: only
# rounding decides about them.
_FLAT = 1e-8

# Beyond this correlation, or with a standard error of more than this factor or share, the data
# hardly tell parameters apart.
CORRELATED, VAGUE = 0.98, 0.5

CONFIDENCE = 0.95


class Fit(NamedTuple):
    """What the data say.

    Attributes:
        values: of the parameters.
        errors: standard errors of theta: of the logarithms where these are fitted.
        lower: end of the 95 % interval.
        upper: likewise.
        correlation: of the parameters' errors.
        noise: of each kind of column.
        freedom: n - k.
        found: whether the search converged.
    """

    values: Float[Array, " k"]
    errors: Float[Array, " k"]
    lower: Float[Array, " k"]
    upper: Float[Array, " k"]
    correlation: Float[Array, "k k"]
    noise: Float[Array, " kinds"]
    freedom: Float[Array, ""]
    found: Bool[Array, ""]


def fit(
    model: Callable[[Float[Array, " k"]], Float[Array, "t c"]],
    data: Float[Array, "t c"],
    start: Float[Array, " k"],
    positive: Bool[np.ndarray, " k"],
    kinds: Int[np.ndarray, " c"],
    wrapped: Bool[np.ndarray, " c"],
    noise: Float[np.ndarray, " kinds"] | None = None,
) -> Fit:
    """Estimate parameters; pure JAX, so many recordings can be fitted at once with `jax.vmap`.

    Args:
        model: what would be recorded, by the parameters.
        data: what was recorded; NaN where nothing was.
        start: values from which the search starts.
        positive: which parameters are positive, and fitted by their logarithms.
        kinds: of each column; those of a kind have the same noise.
        wrapped: columns that are angles, of which whole turns do not count.
        noise: of each kind, where it is known; estimated if None.
    """
    known = jnp.isfinite(data)
    clean = jnp.where(known, data, 0.0)
    members = jnp.asarray(kinds[:, None] == np.arange(kinds.max() + 1), data.dtype)
    counts = known.sum(0) @ members
    freedom = counts.sum() - len(start)

    def to_values(theta: Array) -> Array:
        return jnp.where(positive, jnp.exp(jnp.where(positive, theta, 0.0)), theta)

    def gaps(theta: Array) -> Array:
        gap = model(to_values(theta)) - clean
        turns = jnp.where(wrapped[None], jnp.round(gap / (2 * jnp.pi)), 0.0)
        return jnp.where(known, gap - 2 * jnp.pi * turns, 0.0)

    evaluate = _with_slopes(gaps)

    def spread(gap: Array) -> Array:
        squares = (gap * gap).sum(0) @ members
        share = jnp.maximum(counts * freedom / counts.sum(), 1.0)
        return jnp.sqrt(squares / share)

    def weighted(theta: Array, sigma: Array) -> tuple[Array, tuple[Array, Array]]:
        gap, slopes = evaluate(theta)
        return (gap / (members @ sigma)[None]).reshape(-1), (gap, slopes)

    solver = optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)

    def once(carry: tuple, _: None) -> tuple[tuple, None]:
        theta, sigma = carry[:2]
        solution = optimistix.least_squares(
            weighted, solver, theta, args=sigma, max_steps=_MOST_STEPS, has_aux=True, throw=False
        )
        gap, slopes = solution.aux
        again = jnp.maximum(spread(gap), jnp.finfo(data.dtype).tiny ** 0.25)
        sigma = again if noise is None else sigma
        return (solution.value, sigma, gap, slopes), None

    theta = jnp.where(positive, jnp.log(jnp.where(positive, start, 1.0)), start)
    middle = (clean.sum(0) / jnp.maximum(known.sum(0), 1))[None]
    first = jnp.maximum(spread(jnp.where(known, data - middle, 0.0)), 1e-12)
    sigma = first if noise is None else jnp.asarray(noise, data.dtype)
    # Where all noise is alike it does not move the estimate.
    rounds = _ROUNDS if noise is None and kinds.max() > 0 else 1
    begin = (theta, sigma, clean, jnp.zeros((*data.shape, len(start)), data.dtype))
    (theta, sigma, gap, slopes), _ = jax.lax.scan(once, begin, length=rounds)
    weights = 1.0 / (members @ sigma)[None]
    residuals = (gap * weights).reshape(-1)
    jacobian = (slopes * weights[..., None]).reshape(-1, len(start))
    scale = 1.0 if noise is not None else (residuals * residuals).sum() / freedom
    # By singular values, so that what the data do not tell has a large error and not none.
    along, singular, turned = jnp.linalg.svd(jacobian, full_matrices=False)
    least = jnp.finfo(data.dtype).eps * singular[0] * len(start)
    rows = turned / jnp.maximum(singular, least)[:, None]
    covariance = scale * rows.T @ rows
    offset = jnp.where(singular > _FLAT * singular[0], along.T @ residuals, 0.0)
    step = rows.T @ offset
    near = (offset * offset).sum() <= _OFFSET**2 * scale
    # Data without noise.
    exact = (jnp.abs(step) <= _TOLERANCE * (1.0 + jnp.abs(theta))).all()
    errors = jnp.sqrt(jnp.diagonal(covariance))
    quantiles = jnp.asarray(student_quantiles(0.5 + CONFIDENCE / 2, data.size), data.dtype)
    reach = quantiles[jnp.maximum(freedom, 0).astype(int)] * errors
    return Fit(
        to_values(theta),
        errors,
        to_values(theta - reach),
        to_values(theta + reach),
        covariance / (errors[:, None] * errors[None]),
        sigma,
        freedom,
        (near | exact) & jnp.isfinite(theta).all(),
    )


def _with_slopes(
    function: Callable[[Array], Array],
) -> Callable[[Array], tuple[Array, Array]]:
    """A function's values, and its derivatives on one more axis, as constants.

    The values are differentiable, by those derivatives and at no further cost.
    """

    @jax.custom_jvp
    def evaluate(theta: Array) -> tuple[Array, Array]:
        def along(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(function, (theta,), (direction,))

        every = jnp.eye(len(theta), dtype=theta.dtype)
        return jax.vmap(along, out_axes=(None, -1))(every)

    @evaluate.defjvp
    def derive(at: tuple[Array], tangents: tuple[Array]) -> tuple:
        value, slopes = evaluate(*at)
        return (value, slopes), (slopes @ tangents[0], jnp.zeros_like(slopes))

    return evaluate


def student_quantiles(probability: float, most: int) -> Float[np.ndarray, " freedoms"]:
    """Quantiles of Student's t with 0 (NaN), 1, ... degrees of freedom, to the most there may be.

    A table, because how much of a recording is missing may be known to the compiled program only.
    """
    from scipy.special import stdtrit

    return stdtrit(np.arange(most + 1), probability)


def doubts(keys: tuple[str, ...], positive: np.ndarray, result: Fit) -> list[str]:
    """What cannot be told from the data, in words."""
    words = []
    correlation = np.asarray(result.correlation)
    for i, key in enumerate(keys):
        if positive[i] and not float(result.errors[i]) < VAGUE:
            words.append(f"the data hardly determine {key}: its interval is wider than itself")
        elif not positive[i] and not float(result.lower[i] * result.upper[i]) > 0:
            words.append(f"the data cannot tell {key} from 0")
        words += [
            f"the data hardly tell {keys[j]} and {key} apart: their errors have a correlation of "
            f"{correlation[i, j]:+.3f}"
            for j in range(i)
            if not abs(correlation[i, j]) < CORRELATED
        ]
    if not bool(result.found):
        words.append("the search did not settle: try other starting values, KEY=VALUE")
    return words
