"""Least squares with confidence intervals: parameters of a model from a recorded motion.

The parameters theta minimise the sum of squared residuals ``r = model(theta) - data``, by the
Levenberg-Marquardt method (`scipy.optimize.least_squares`, MINPACK). Positive parameters enter as
logarithms, because they then stay positive and their intervals become factors. All columns have
the same noise, which is estimated from the residuals. With J the Jacobian of n residuals with
respect to k parameters,

    s^2 = |r|^2 / (n - k),      cov(theta) = s^2 (J^T J)^-1,

and a 95 % interval is theta +- t(0.975, n - k) standard errors (Student). The intervals hold if the
noise is normal and independent from number to number, the model is right, and the model is linear
within the errors.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# Most evaluations of the model, and relative change of parameters or squares that ends the search.
_MOST_STEPS, _TOLERANCE = 100, 1e-9

# Correlation of two parameters, and standard error of a logarithm, above which the data hardly
# determine them.
_CORRELATED, _VAGUE = 0.98, 0.5


class Fit(NamedTuple):
    """Result of a fit.

    Attributes:
        values: values of the parameters.
        errors: standard errors, for positive parameters of their logarithms.
        lower: lower end of each parameter's 95 % interval.
        upper: upper end of each parameter's 95 % interval.
        correlation: correlation of the parameters' errors.
        noise: standard deviation of the noise, in the units of the columns.
        freedom: degrees of freedom: measured numbers less parameters, n - k.
        found: whether the search converged.
        model: values of the model at the result.
    """

    values: Float[np.ndarray, " k"]
    errors: Float[np.ndarray, " k"]
    lower: Float[np.ndarray, " k"]
    upper: Float[np.ndarray, " k"]
    correlation: Float[np.ndarray, "k k"]
    noise: float
    freedom: int
    found: bool
    model: Float[np.ndarray, "t c"]

    def warnings(self, names: Sequence[str], positive: Bool[np.ndarray, " k"]) -> list[str]:
        """Return warnings about parameters that the data do not determine."""
        words = []
        for i, name in enumerate(names):
            if positive[i] and not self.errors[i] < _VAGUE:
                words.append(
                    f"the data hardly determine {name}: the interval is wider than the value"
                )
            elif not positive[i] and not self.lower[i] * self.upper[i] > 0:
                words.append(f"the data do not distinguish {name} from 0")
            words += [
                f"the data hardly distinguish {names[j]} from {name}: the correlation of their "
                f"errors is {self.correlation[i, j]:+.3f}"
                for j in range(i)
                if not abs(self.correlation[i, j]) < _CORRELATED
            ]
        if not self.found:
            words.append("the search did not converge. Try other initial values, KEY=VALUE")
        return words


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    data: Float[np.ndarray, "t c"],
    start: Float[np.ndarray, " k"],
    positive: Bool[np.ndarray, " k"],
    wrapped: Bool[np.ndarray, " c"],
) -> Fit:
    """Estimate parameters.

    Args:
        evaluate: function of the parameters that returns the expected recording ``(t, c)`` and its
            derivatives ``(t, c, k)``.
        data: recording, NaN for missing numbers.
        start: initial values of the search.
        positive: which parameters are positive, and fitted by their logarithms.
        wrapped: which columns are angles, whose whole turns do not count.

    Raises:
        FloatingPointError: the model is not finite at some values.
    """
    from scipy.optimize import least_squares
    from scipy.stats import t as student

    known = np.isfinite(data)
    latest: dict[bytes, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def values_of(theta: np.ndarray) -> np.ndarray:
        return np.where(positive, np.exp(np.where(positive, theta, 0.0)), theta)

    def at(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # SciPy asks for residuals and Jacobian apart, and a program computes both.
        if theta.tobytes() not in latest:
            values = values_of(theta)
            model, derivatives = map(np.asarray, evaluate(values))
            gap = (model - data)[known]
            turns = np.broadcast_to(wrapped, data.shape)[known] * np.round(gap / (2 * np.pi))
            jacobian = derivatives[known] * np.where(positive, values, 1.0)
            if not (np.isfinite(gap).all() and np.isfinite(jacobian).all()):
                raise FloatingPointError
            latest.clear()
            latest[theta.tobytes()] = gap - 2 * np.pi * turns, jacobian, model
        return latest[theta.tobytes()]

    options: dict[str, Any] = {"jac": lambda theta: at(theta)[1], "method": "lm"}
    options |= {"x_scale": "jac", "max_nfev": _MOST_STEPS}
    options |= dict.fromkeys(("ftol", "xtol", "gtol"), _TOLERANCE)
    begin = np.where(positive, np.log(np.where(positive, start, 1.0)), start)
    found = least_squares(lambda theta: at(theta)[0], begin, **options)
    theta, (residuals, jacobian, model) = found.x, at(found.x)
    freedom = len(residuals) - len(start)
    noise = float(np.sqrt(residuals @ residuals / freedom))
    # Singular values give an undetermined direction a large error instead of none.
    _, singular, turned = np.linalg.svd(jacobian, full_matrices=False)
    least = np.finfo(float).eps * singular[0] * len(start)
    rows = turned / np.maximum(singular, least)[:, None]
    covariance = noise**2 * rows.T @ rows
    errors = np.sqrt(np.diagonal(covariance))
    reach = student.ppf(0.975, freedom) * errors
    with np.errstate(over="ignore"):
        lower, upper = values_of(theta - reach), values_of(theta + reach)
    correlation = covariance / np.maximum(np.outer(errors, errors), np.finfo(float).tiny)
    values = values_of(theta)
    return Fit(
        values, errors, lower, upper, correlation, noise, freedom, bool(found.success), model
    )
