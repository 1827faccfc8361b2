"""Parameters of a simulation from a recorded motion, with the uncertainty of each.

Least squares (Levenberg-Marquardt, `optimistix`) on theta: logarithms of parameters that must be
positive, and values of all others:

    minimise  sum_i ((y_i - m_i(theta)) / sigma_i)^2.

Each kind of column (places, attitudes, joint angles) has a noise sigma, estimated from the
residuals of its n_q numbers. The estimate subtracts the degrees of freedom that the parameters use.
The fit is repeated with the new noise until the ratios between the sigmas converge (Foerstner, "Ein
Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten", Allgemeine
Vermessungs-Nachrichten 86, 1979).
With J the Jacobian of the weighted residuals, n numbers and k parameters,

    sigma_q^2 = sum_(i in q) r_i^2 / (n_q - sum_(i in q) h_i),      h = diag(J (J^T J)^-1 J^T),
    s^2 = |residuals|^2 / (n - k),      cov(theta) = s^2 (J^T J)^-1,

and a 95 % interval is theta +- t(0.975, nu) standard errors (Student). Intervals of logarithms
become factors. One kind has nu = n - k, and known noise has nu = infinity. With several kinds, the
variance of a parameter is a sum of v_q over the kinds (Satterthwaite, "An approximate distribution
of estimates of variance components", Biometrics Bulletin 2, 1946):

    nu = (sum_q v_q)^2 / sum_q (v_q^2 / (n_q - sum_(i in q) h_i)).

The intervals hold if the noise is normal and independent from number to number, the model is right,
and the model is linear within the errors.

The search has converged when the residuals have almost no component along J (Bates and Watts,
"A relative offset orthogonality convergence criterion for nonlinear least squares", Technometrics
23, 1981). The solver's own criterion is not used. Near the minimum, the sum of squares changes by
less than its rounding error. The solver rejects such steps and may not stop.

The model takes long to compile, so the program contains it once. Each evaluation also returns the
Jacobian, for both the solver's derivatives and the covariance.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Bool, Float, Int

# Relative change of the ratios of noises below which the fits end, and largest number of fits. Each
# fit uses the noise of the fit before it.
_STAYS, _ROUNDS = 0.01, 20

_TOLERANCE, _MOST_STEPS = 1e-6, 60

# Largest component of the residuals along J at the end, in units of their noise. It is the distance
# to the linear model's minimum in standard errors. At this distance, 94.5 % instead of 95 % of the
# intervals hold. The component may not reach 0 if the model has kinks (rectifiers, contact).
_OFFSET = 0.2

# Relative singular value below which directions are left out, because of rounding.
_FLAT = 1e-8

# Correlation of two parameters, and standard error of a logarithm, above which the data hardly
# determine them.
CORRELATED, VAGUE = 0.98, 0.5

CONFIDENCE = 0.95

# Least degrees of freedom of a kind's noise, so that the estimate stays finite.
_LEAST_FREEDOM = 1e-3


class Fit(NamedTuple):
    """Result of a fit.

    Attributes:
        values: values of the parameters.
        errors: standard errors of theta, so of logarithms for positive parameters.
        lower: lower end of each parameter's 95 % interval.
        upper: upper end of each parameter's 95 % interval.
        correlation: correlation of the parameters' errors.
        noise: standard deviation of the noise of each kind of column.
        freedom: degrees of freedom: measured numbers less parameters, n - k.
        found: whether the search converged.
        felt: whether any measured number depends on each parameter.
    """

    values: Float[Array, " k"]
    errors: Float[Array, " k"]
    lower: Float[Array, " k"]
    upper: Float[Array, " k"]
    correlation: Float[Array, "k k"]
    noise: Float[Array, " kinds"]
    freedom: Float[Array, ""]
    found: Bool[Array, ""]
    felt: Bool[Array, " k"]


def fit(
    model: Callable[[Float[Array, " k"]], Float[Array, "t c"]],
    data: Float[Array, "t c"],
    start: Float[Array, " k"],
    positive: Bool[np.ndarray, " k"],
    kinds: Int[np.ndarray, " c"],
    wrapped: Bool[np.ndarray, " c"],
    noise: Float[np.ndarray, " kinds"] | None = None,
) -> Fit:
    """Estimate parameters in pure JAX. `jax.vmap` fits many recordings at once.

    Args:
        model: function of the parameters that returns the expected recording.
        data: recording, NaN for missing numbers.
        start: initial values of the search.
        positive: which parameters are positive, and fitted by their logarithms.
        kinds: kind of each column. Columns of one kind have equal noise.
        wrapped: which columns are angles, whose whole turns do not count.
        noise: known noise of each kind, or None to estimate it.
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

    evaluate = _with_derivatives(gaps)

    def spread(gap: Array, taken: Array) -> Array:
        squares = (gap * gap).sum(0) @ members
        return jnp.sqrt(squares / jnp.maximum(counts - taken, _LEAST_FREEDOM))

    def decomposed(derivatives: Array, sigma: Array) -> tuple[Array, Array, Array]:
        """Return singular vectors and values of J, small for undetermined directions."""
        jacobian = derivatives / (members @ sigma)[None, :, None]
        jacobian = jacobian.reshape(-1, len(start))
        left, singular, right = jnp.linalg.svd(jacobian, full_matrices=False)
        return left, singular, right

    def taken_up(along: Array, singular: Array) -> Array:
        """Return the degrees of freedom of each kind's numbers that the parameters use."""
        along = jnp.where(singular > _FLAT * singular[0], along, 0.0)
        return (along * along).sum(1).reshape(data.shape).sum(0) @ members

    def weighted(theta: Array, sigma: Array) -> tuple[Array, tuple[Array, Array]]:
        gap, derivatives = evaluate(theta)
        return (gap / (members @ sigma)[None]).reshape(-1), (gap, derivatives)

    solver = optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)

    def once(carry: tuple) -> tuple:
        number, _, theta, sigma = carry[:4]
        solution = optimistix.least_squares(
            weighted, solver, theta, args=sigma, max_steps=_MOST_STEPS, has_aux=True, throw=False
        )
        gap, derivatives = solution.aux
        again = sigma
        if noise is None:
            along, singular, _ = decomposed(derivatives, sigma)
            again = spread(gap, taken_up(along, singular))
            again = jnp.maximum(again, jnp.finfo(data.dtype).tiny ** 0.25)
        # Only the ratios of the noises affect the estimate.
        ratios = again / sigma
        stays = (jnp.abs(ratios / ratios.max() - 1.0) < _STAYS).all()
        return number + 1, stays, solution.value, again, gap, derivatives

    theta = jnp.where(positive, jnp.log(jnp.where(positive, start, 1.0)), start)
    middle = (clean.sum(0) / jnp.maximum(known.sum(0), 1))[None]
    first = jnp.maximum(spread(jnp.where(known, data - middle, 0.0), jnp.zeros(())), 1e-12)
    sigma = first if noise is None else jnp.asarray(noise, data.dtype)
    derivatives = jnp.zeros((*data.shape, len(start)), data.dtype)
    begin = (jnp.zeros((), int), jnp.zeros((), bool), theta, sigma, clean, derivatives)
    _, _, theta, sigma, gap, derivatives = jax.lax.while_loop(
        lambda carry: (carry[0] < _ROUNDS) & ~carry[1], once, begin
    )
    residuals = (gap / (members @ sigma)[None]).reshape(-1)
    scale = 1.0 if noise is not None else (residuals * residuals).sum() / freedom
    # Singular values give an undetermined direction a large error instead of none.
    along, singular, turned = decomposed(derivatives, sigma)
    least = jnp.finfo(data.dtype).eps * singular[0] * len(start)
    rows = turned / jnp.maximum(singular, least)[:, None]
    covariance = scale * rows.T @ rows
    offset = jnp.where(singular > _FLAT * singular[0], along.T @ residuals, 0.0)
    step = rows.T @ offset
    near = (offset * offset).sum() <= _OFFSET**2 * scale
    # Data without noise have converged once the next step of theta is small enough.
    exact = (jnp.abs(step) <= _TOLERANCE * (1.0 + jnp.abs(theta))).all()
    errors = jnp.sqrt(jnp.diagonal(covariance))
    of_kinds = ((along @ rows) ** 2).reshape(*data.shape, -1).sum(0).T @ members
    left = jnp.maximum(counts - taken_up(along, singular), _LEAST_FREEDOM)
    unsure = 0.0 if noise is not None else (of_kinds**2 / left[None]).sum(1) / of_kinds.sum(1) ** 2
    reach = student_quantile(0.5 + CONFIDENCE / 2, unsure, data.size) * errors
    return Fit(
        to_values(theta),
        errors,
        to_values(theta - reach),
        to_values(theta + reach),
        covariance / (errors[:, None] * errors[None]),
        sigma,
        freedom,
        (near | exact) & jnp.isfinite(theta).all(),
        (derivatives != 0).any((0, 1)),
    )


def _with_derivatives(
    function: Callable[[Array], Array],
) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function of theta for values, and derivatives on an additional last axis.

    The values are differentiable with these derivatives, without further evaluations. The
    derivatives are constants.
    """

    @jax.custom_jvp
    def evaluate(theta: Array) -> tuple[Array, Array]:
        def along(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(function, (theta,), (direction,))

        every = jnp.eye(len(theta), dtype=theta.dtype)
        return jax.vmap(along, out_axes=(None, -1))(every)

    @evaluate.defjvp
    def derive(at: tuple[Array], tangents: tuple[Array]) -> tuple:
        value, derivatives = evaluate(*at)
        return (value, derivatives), (derivatives @ tangents[0], jnp.zeros_like(derivatives))

    return evaluate


def student_quantile(
    probability: float, unsure: Float[Array, "*k"] | float, most: int
) -> Float[Array, "*k"]:
    """Return quantiles of Student's t, infinite below one degree of freedom.

    Quantiles between whole degrees of freedom are linear in their inverse.

    Args:
        probability: probability of a smaller value.
        unsure: one over the degrees of freedom, or 0 for the normal distribution.
        most: largest finite number of degrees of freedom.
    """
    from scipy.special import ndtri, stdtrit

    freedoms = np.arange(most, 0, -1)
    known = np.append(ndtri(probability), stdtrit(freedoms, probability))
    found = jnp.interp(unsure, np.append(0.0, 1.0 / freedoms), known)
    return jnp.where(jnp.asarray(unsure) > 1.0 + 1e-6, jnp.inf, found)


def fit_warnings(keys: tuple[str, ...], positive: np.ndarray, result: Fit) -> list[str]:
    """Return warnings about parameters that the data do not determine."""
    words = []
    correlation = np.asarray(result.correlation)
    for i, key in enumerate(keys):
        if positive[i] and not float(result.errors[i]) < VAGUE:
            words.append(f"the data hardly determine {key}: the interval is wider than the value")
        elif not positive[i] and not float(result.lower[i] * result.upper[i]) > 0:
            words.append(f"the data do not distinguish {key} from 0")
        words += [
            f"the data hardly distinguish {keys[j]} from {key}: the correlation of their errors is "
            f"{correlation[i, j]:+.3f}"
            for j in range(i)
            if not abs(correlation[i, j]) < CORRELATED
        ]
    if not bool(result.found):
        words.append("the search did not converge. Try other initial values, KEY=VALUE")
    return words
