"""All uses of JAX beyond its public interface, so that a new version breaks only this file."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.core
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir, partial_eval

from evo_cpg.native.ir import Unsupported

Zero = ad.Zero
instantiate_zeros = ad.instantiate_zeros

Tracer = jax.core.Tracer

try:
    from jax.core import ShapedArray
except ImportError:
    from jax._src.core import ShapedArray

RANDOM = {
    "random_bits", "random_fold_in", "random_seed", "random_split", "random_unwrap", "random_wrap",
    "threefry2x32",
}  # fmt: skip
"""Primitives that make random numbers or keys. Keys are traced as their words."""


def primitive(name: str) -> Primitive:
    """Return a new primitive with several results. `implement` adds its rules."""
    new = Primitive(name)
    new.multiple_results = True
    return new


def implement(
    primitive: Primitive,
    shapes: Callable[..., Sequence[Any]],
    evaluate: Callable[..., Sequence[jax.Array]],
    differentiate: Callable | None,
    batch: Callable,
    transpose: Callable | None = None,
) -> None:
    """Register the rules of a primitive with JAX.

    Args:
        primitive: the primitive.
        shapes: function from arguments and parameters to result shapes (`jax.ShapeDtypeStruct`).
        evaluate: definition in terms of other primitives.
        differentiate: rule of forward mode, or None to differentiate the definition.
        batch: rule of `jax.vmap`.
        transpose: rule of reverse mode, if the primitive is linear.
    """

    def of_definition(primals: Sequence[Any], tangents: Sequence[Any], **params: Any) -> tuple:
        given = [instantiate_zeros(tangent) for tangent in tangents]
        return jax.jvp(functools.partial(evaluate, **params), list(primals), given)

    primitive.def_abstract_eval(
        lambda *x, **params: [ShapedArray(s.shape, s.dtype) for s in shapes(*x, **params)]
    )
    primitive.def_impl(evaluate)
    mlir.register_lowering(primitive, mlir.lower_fun(evaluate, multiple_results=True))
    ad.primitive_jvps[primitive] = differentiate or of_definition
    batching.primitive_batchers[primitive] = batch
    if transpose is not None:
        ad.primitive_transposes[primitive] = transpose


def no_tangent(x: jax.Array) -> Any:
    """Return the symbolic zero tangent of an array."""
    return Zero(jax.typeof(x).to_tangent_aval())


def random_program(equation: Any) -> ClosedJaxpr:
    """Return the program of a random-number primitive (`RANDOM`) on the words of keys.

    Raises:
        Unsupported: if the keys are not threefry keys, or this JAX version keeps them elsewhere.
    """
    name, params = equation.primitive.name, equation.params
    shapes = []
    for aval in [atom.aval for atom in equation.invars]:
        # A random key is traced as two uint32 words.
        is_key = jax.numpy.issubdtype(aval.dtype, jax.dtypes.prng_key)
        own = aval.dtype._impl.key_shape if is_key else ()
        dtype = "uint32" if is_key else aval.dtype
        shapes.append(jax.ShapeDtypeStruct((*aval.shape, *own), dtype))
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


def threefry2x32(
    key_0: jax.Array, key_1: jax.Array, count_0: jax.Array, count_1: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return two random words (uint32) for each pair of counter words, as JAX does.

    The function is threefry-2x32 of Salmon et al. 2011 with 20 rounds. The words of a key encrypt
    the words of a counter by additions, rotations and exclusive ors. Every four rounds another pair
    of key words is added.
    """
    bits, rotations = 32, ((13, 15, 26, 6), (17, 29, 16, 24))
    keys = key_0, key_1, key_0 ^ key_1 ^ np.uint32(0x1BD11BDA)
    x, y = count_0 + key_0, count_1 + key_1
    for group in range(5):
        for turn in rotations[group % 2]:
            x = x + y
            y = jax.lax.shift_left(y, np.uint32(turn)) | jax.lax.shift_right_logical(
                y, np.uint32(bits - turn)
            )
            y = y ^ x
        x = x + keys[(group + 1) % 3]
        y = y + keys[(group + 2) % 3] + np.uint32(group + 1)
    return x, y


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
    jitted = None

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        nonlocal jitted
        jitted = jitted or jax.jit(function, compiler_options=_quick_options(), **options)
        return jitted(*args)

    return call


@functools.cache
def _quick_options() -> dict[str, Any]:
    """Return the options of `_QUICK` that this XLA has. This call starts the back end."""

    def has(options: dict[str, Any]) -> bool:
        try:
            jax.jit(lambda: 0, compiler_options=options).lower().compile()
        except jax.errors.JaxRuntimeError:
            return False
        return True

    if has(_QUICK):
        return _QUICK
    return {name: value for name, value in _QUICK.items() if has({name: value})}


def opened(closed: ClosedJaxpr) -> Jaxpr:
    """Return a program whose constants are its first arguments.

    Since JAX 0.11 every program holds its constants. Cached programs must hold no traced constants.
    """
    jaxpr = closed.jaxpr
    return jaxpr.replace(constvars=(), invars=[*jaxpr.constvars, *jaxpr.invars])


def alone(jaxpr: Jaxpr, equation: Any) -> tuple[list[Any], Callable]:
    """Return the variables that an equation of a program reads, and the equation as a function."""
    read = list(dict.fromkeys(atom for atom in equation.invars if not isinstance(atom, Literal)))
    own = jaxpr.replace(constvars=(), invars=read, outvars=equation.outvars, eqns=[equation])
    return read, jaxpr_as_fun(ClosedJaxpr(own, []))


def scope(equation: Any) -> str:
    """Return the names of `jax.named_scope` around an equation, with slashes between them."""
    return str(equation.source_info.name_stack)


def scan_counts(params: dict[str, Any]) -> tuple[int, int]:
    """Return the number of constants of a ``scan`` and the number of values that it carries."""
    if "ft_in" in params:  # since JAX 0.11
        constants, carried, _ = params["ft_in"].unpack()
        return len(constants), len(carried)
    return params["num_consts"], params["num_carry"]


def used_arguments(function: Callable, *arguments: Any) -> list[bool]:
    """Return whether a function's results depend on each array of its arguments.

    Only the arguments' shapes and types matter.
    """
    traced = jax.make_jaxpr(function)(*arguments).jaxpr
    return partial_eval.dce_jaxpr(traced, [True] * len(traced.outvars))[1]
