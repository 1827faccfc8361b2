"""Operations that only move numbers: NumPy performs them on arrays of nodes while tracing."""

import functools
import itertools
from collections.abc import Callable

import jax
import numpy as np

from evo_cpg.native.frontend.builder import Builder, elementwise
from evo_cpg.native.ir import Unsupported


def _broadcast_in_dim(builder, operands, params):
    (x, *_), shape = operands, params["shape"]
    placed = np.ones(len(shape), int)
    placed[list(params["broadcast_dimensions"])] = x.shape
    return [np.broadcast_to(x.reshape(placed), shape)]


def _slice(builder, operands, params):
    strides = params["strides"] or (1,) * operands[0].ndim
    window = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return [operands[0][tuple(slice(*each) for each in window)]]


def _dynamic_slice(builder, operands, params):
    x, *starts = operands
    sizes = params["slice_sizes"]
    first = [
        clamped(builder, start.item(), whole - size)
        for start, whole, size in zip(starts, x.shape, sizes, strict=True)
    ]
    return [_taken(builder, x, first, np.indices(sizes))]


def _dynamic_update_slice(builder, operands, params):
    """Replace the elements under the window by new elements."""
    x, update, *starts = operands
    first, reach = [], []
    for start, whole, size in zip(starts, x.shape, update.shape, strict=True):
        node = clamped(builder, start.item(), whole - size)
        first.append(node)
        reach.append(range(whole - size + 1) if node.value is None else [int(node.value)])
    result = x.copy()
    for begin in itertools.product(*reach):
        condition = builder.constant(True, bool)
        for node, b in zip(first, begin, strict=True):
            here = builder.apply("eq", node, builder.constant(b, node.dtype))
            condition = builder.apply("and", condition, here)
        window = tuple(slice(b, b + size) for b, size in zip(begin, update.shape, strict=True))
        result[window] = builder.apply_each("select", condition, update, result[window])
    return [result]


def _gather(builder, operands, params):
    """Gather elements at constant indices, with their places from JAX, or at computed indices.

    At computed indices, each row of indices takes a window. Offsets within the window are fixed.
    """
    (x, indices), fill = operands, params["fill_value"]
    dtype: np.dtype = next((node.dtype for node in x.flat), np.dtype(np.float32))
    if fill is None:
        # JAX's own value outside the array.
        fill = {"f": np.nan, "b": True}.get(dtype.kind)
    if fill is None:
        fill = np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max
    if all(node.value is not None for node in indices.flat):
        gather = functools.partial(jax.lax.gather_p.bind, **{**params, "fill_value": _OUTSIDE})
        places = _places(gather, x, indices)
        if (places == _OUTSIDE).any():
            x = np.append(x.reshape(-1), builder.constant(fill, dtype))
        return [x.reshape(-1)[places]]
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    if numbers.operand_batching_dims:
        raise Unsupported("no rule for a gather with batch dimensions at computed places")
    rows = indices.reshape(-1, indices.shape[-1]) if indices.ndim else indices.reshape(1, 1)
    kept = [size for i, size in enumerate(sizes) if i not in numbers.collapsed_slice_dims]
    results = []
    for row in rows:
        first = [builder.constant(0, np.int32)] * x.ndim
        valid = builder.constant(True, bool)
        for axis, node in zip(numbers.start_index_map, row, strict=True):
            first[axis] = clamped(builder, node, x.shape[axis] - sizes[axis])
            if "FILL" in str(params["mode"]):
                same = builder.apply("convert", first[axis], dtype=node.dtype)
                valid = builder.apply("and", valid, builder.apply("eq", same, node))
        taken = _taken(builder, x, first, np.indices(sizes)).reshape(kept)
        if valid.value is None or not valid.value:
            taken = builder.apply_each("select", valid, taken, builder.constant(fill, dtype))
        results.append(taken)
    batch = indices.shape[:-1]
    stacked = np.stack(results).reshape((*batch, *kept))
    # ``offset_dims`` places the axes of the windows. The axes of the indices go in between.
    return [np.moveaxis(stacked, range(len(batch), stacked.ndim), numbers.offset_dims)]


# Place of an element outside the array.
_OUTSIDE = -1


def _places(gather, x, indices):
    """Return the place of each element that JAX gathers at constant indices."""
    places = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    where = np.vectorize(lambda node: node.value, otypes=[np.int32])(indices)
    with jax.ensure_compile_time_eval():
        return np.asarray(gather(places, where))


def _taken(builder, x, first, window):
    """Return elements of an array in a window whose first element is at a computed place.

    Args:
        builder: maker of the nodes.
        x: the array.
        first: index of the window's first element along each axis, within the array.
        window: ``(axes, ...)``, indices within the window.
    """
    if not window[0].size:
        return np.empty(window[0].shape, object)
    if all(node.value is not None for node in first):
        begin = [int(node.value) for node in first]
        return np.asarray(x[tuple(b + w for b, w in zip(begin, window, strict=True))], object)
    strides = [int(np.prod(x.shape[i + 1 :], dtype=int)) for i in range(x.ndim)]
    start = builder.constant(0, np.int32)
    for node, stride in zip(first, strides, strict=True):
        narrow = builder.apply("convert", node, dtype=np.int32)
        step = builder.apply("mul", narrow, builder.constant(stride, np.int32))
        start = builder.apply("add", start, step)
    offsets = sum(w * stride for w, stride in zip(window, strides, strict=True))
    table = builder.table(list(x.flat))
    places = elementwise(lambda offset: builder.constant(offset, np.int32), offsets)
    places = builder.apply_each("add", start, places)
    return elementwise(functools.partial(builder.lookup, table), places)


def clamped(builder, place, most):
    """Return an index clamped to ``[0, most]``, int32."""
    if place.dtype.kind == "u":
        place = builder.apply("min", place, builder.constant(most, place.dtype))
    else:
        low, high = (builder.constant(value, place.dtype) for value in (0, most))
        place = builder.apply("min", builder.apply("max", place, low), high)
    return builder.apply("convert", place, dtype=np.int32)


def _pad(builder, operands, params):
    """Pad between and around the elements. Negative padding removes elements at the ends."""
    x, value = operands
    shape, inside, kept = [], [], []
    for count, (low, high, inner) in zip(x.shape, params["padding_config"], strict=True):
        start, width = max(low, 0), (count - 1) * (inner + 1) + 1 if count else 0
        shape.append(start + width + max(high, 0))
        inside.append(slice(start, start + width, inner + 1))
        kept.append(slice(max(-low, 0), shape[-1] - max(-high, 0)))
    result = np.full(shape, value.item())
    result[tuple(inside)] = x
    return [result[tuple(kept)]]


def _scatter(builder, operands, params, adds=False):
    """Put or add elements at constant places. A gather by JAX finds the places."""
    x, indices, updates = operands
    numbers = params["dimension_numbers"]
    alone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = iter([updates.shape[i] for i in numbers.update_window_dims])
    gather = functools.partial(
        jax.lax.gather,
        dimension_numbers=jax.lax.GatherDimensionNumbers(
            offset_dims=numbers.update_window_dims,
            collapsed_slice_dims=numbers.inserted_window_dims,
            start_index_map=numbers.scatter_dims_to_operand_dims,
            operand_batching_dims=numbers.operand_batching_dims,
            start_indices_batching_dims=numbers.scatter_indices_batching_dims,
        ),
        slice_sizes=tuple(1 if i in alone else next(window) for i in range(x.ndim)),
        mode=params["mode"],
        fill_value=_OUTSIDE,
    )
    result = x.copy().reshape(-1)
    for node, place in zip(updates.flat, _places(gather, x, indices).flat, strict=True):
        if place != _OUTSIDE:
            result[place] = builder.apply("add", result[place], node) if adds else node
    return [result.reshape(x.shape)]


# JAX's names of the primitive that adds to some places of an array.
SCATTER_ADD = ("scatter-add", "scatter_add")


# Rules by the name of JAX's primitive, from its operands and parameters to its results.
MOVES: dict[str, Callable[[Builder, list[np.ndarray], dict], list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda builder, xs, params: [np.concatenate(xs, params["dimension"])],
    **dict.fromkeys(
        ("copy", "copy_p", "optimization_barrier", "reshard", "stop_gradient"),
        lambda builder, xs, params: xs,
    ),
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "expand_dims": lambda builder, xs, params: [np.expand_dims(xs[0], params["dimensions"])],
    "gather": _gather,
    "pad": _pad,
    "reshape": lambda builder, xs, params: [
        # JAX may transpose the axes before.
        xs[0].transpose(params["dimensions"] or range(xs[0].ndim)).reshape(params["new_sizes"])
    ],
    "rev": lambda builder, xs, params: [np.flip(xs[0], params["dimensions"])],
    "scatter": _scatter,
    **dict.fromkeys(SCATTER_ADD, functools.partial(_scatter, adds=True)),
    "slice": _slice,
    "split": lambda builder, xs, params: np.split(
        xs[0], np.cumsum(params["sizes"])[:-1], params["axis"]
    ),
    "squeeze": lambda builder, xs, params: [xs[0].squeeze(params["dimensions"])],
    "stack": lambda builder, xs, params: [np.stack(xs, params["axis"])],
    "transpose": lambda builder, xs, params: [xs[0].transpose(params["permutation"])],
    "unstack": lambda builder, xs, params: [
        np.asarray(x, object) for x in np.moveaxis(xs[0], params["axis"], 0)
    ],
}
