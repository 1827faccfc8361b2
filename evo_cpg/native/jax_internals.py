"""All uses of JAX beyond its public interface, so that a new version breaks only this file."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.core
from jax.extend.core import ClosedJaxpr, Jaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from evo_cpg.native.frontend.threefry import threefry2x32
from evo_cpg.native.unsupported import Unsupported

Zero = ad.Zero
instantiate_zeros = ad.instantiate_zeros

Tracer = jax.core.Tracer

try:
    from jax.core import ShapedArray
except ImportError:
    from jax._src.core import ShapedArray

_RANDOM = {
    "random_bits", "random_fold_in", "random_seed", "random_split", "random_unwrap", "random_wrap",
    "threefry2x32",
}  # fmt: skip


def primitive(name: str) -> Primitive:
    """Return a new primitive with several results. `implement` adds its rules."""
    new = Primitive(name)
    new.multiple_results = True
    return new


def implement(
    primitive: Primitive,
    shapes: Callable[..., Sequence[Any]],
    evaluate: Callable[..., Sequence[jax.Array]],
    differentiate: Callable,
    batch: Callable,
    transpose: Callable | None = None,
) -> None:
    """Register the rules of a primitive with JAX.

    Args:
        primitive: the primitive.
        shapes: function from arguments and parameters to result shapes (`jax.ShapeDtypeStruct`).
        evaluate: definition in terms of other primitives.
        differentiate: rule of forward mode.
        batch: rule of `jax.vmap`.
        transpose: rule of reverse mode, if the primitive is linear.
    """
    primitive.def_abstract_eval(
        lambda *x, **params: [ShapedArray(s.shape, s.dtype) for s in shapes(*x, **params)]
    )
    primitive.def_impl(evaluate)
    mlir.register_lowering(primitive, mlir.lower_fun(evaluate, multiple_results=True))
    ad.primitive_jvps[primitive] = differentiate
    batching.primitive_batchers[primitive] = batch
    if transpose is not None:
        ad.primitive_transposes[primitive] = transpose


def no_tangent(x: jax.Array) -> Any:
    """Return the symbolic zero tangent of an array."""
    return Zero(jax.typeof(x).to_tangent_aval())


def is_random(name: str) -> bool:
    """Return whether a primitive makes random numbers or keys. Keys are traced as their words."""
    return name in _RANDOM


def random_program(equation: Any) -> ClosedJaxpr:
    """Return the program of a random-number primitive on the words of keys.

    Raises:
        Unsupported: the keys are not threefry keys, or this JAX version keeps them elsewhere.
    """
    name, params = equation.primitive.name, equation.params
    shapes = [_words(atom.aval) for atom in equation.invars]
    try:
        return jax.make_jaxpr(_random_function(name, params, equation))(*shapes)
    except (AttributeError, ImportError, TypeError) as error:
        raise Unsupported(f"no rule for {name} of JAX {jax.__version__}: {error}") from None


def _random_function(name: str, params: dict, equation: Any) -> Callable:
    if name in ("random_wrap", "random_unwrap"):
        return lambda x: x
    if name == "threefry2x32":
        return threefry2x32
    implementation = params.get("impl") or equation.invars[0].aval.dtype._impl
    if implementation.key_shape != (2,):
        raise Unsupported(f"no rule for random numbers of {implementation.name}")
    if name == "random_bits":
        one = functools.partial(
            implementation.random_bits, bit_width=params["bit_width"], shape=params["shape"]
        )
    elif name == "random_split":
        one = functools.partial(implementation.split, shape=params["shape"])
    else:
        one = {"random_fold_in": implementation.fold_in, "random_seed": implementation.seed}[name]
    for _ in equation.invars[0].aval.shape:
        one = jax.vmap(one)
    return one


def _words(aval: Any) -> jax.ShapeDtypeStruct:
    """Return the shape and type of an array as traced: a random key is two uint32 words."""
    if jax.numpy.issubdtype(aval.dtype, jax.dtypes.prng_key):
        return jax.ShapeDtypeStruct((*aval.shape, *aval.dtype._impl.key_shape), "uint32")
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype)


# Options that make XLA compile fast. They change with the version: jaxlib 0.11.2 lacks the last.
_QUICK: dict[str, Any] = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_experimental_ynn_fusion_type": "",
    "xla_cpu_use_fusion_emitters": False,
}


def quick_jit(function: Callable, **options: Any) -> Callable:
    """Return `jax.jit` of a function, with options that make XLA compile fast (`_QUICK`).

    Use it for a function that takes longer to compile than to run.
    """

    @functools.cache
    def jitted() -> Callable:
        return jax.jit(function, compiler_options=_quick_options(), **options)

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        return jitted()(*args)

    return call


@functools.cache
def _quick_options() -> dict[str, Any]:
    """Return the options of `_QUICK` that this XLA has. This call starts the back end."""
    if _has(_QUICK):
        return _QUICK
    return {name: value for name, value in _QUICK.items() if _has({name: value})}


def _has(options: dict[str, Any]) -> bool:
    try:
        jax.jit(lambda: 0, compiler_options=options).lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def opened(closed: ClosedJaxpr) -> Jaxpr:
    """Return a program whose constants are its first arguments.

    Since JAX 0.11 every program holds its constants. Cached programs must hold no traced constants.
    """
    jaxpr = closed.jaxpr
    return jaxpr.replace(constvars=(), invars=[*jaxpr.constvars, *jaxpr.invars])


def scan_counts(params: dict[str, Any]) -> tuple[int, int]:
    """Return the number of constants of a ``scan`` and the number of values that it carries."""
    if "ft_in" in params:  # since JAX 0.11
        constants, carried, _ = params["ft_in"].unpack()
        return len(constants), len(carried)
    return params["num_consts"], params["num_carry"]


def run(closed: ClosedJaxpr, arrays: Sequence[Any]) -> list[Any]:
    """Return the results of a program."""
    return list(jaxpr_as_fun(closed)(*arrays))
