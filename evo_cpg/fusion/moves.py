"""Operations that only move numbers about: NumPy does them on arrays of nodes while tracing."""

from collections.abc import Callable

import jax
import numpy as np

from evo_cpg.fusion.graph import Graph


def _broadcast_in_dim(graph, operands, params):
    (x, *_), shape = operands, params["shape"]
    placed = np.ones(len(shape), int)
    placed[list(params["broadcast_dimensions"])] = x.shape
    return [np.broadcast_to(x.reshape(placed), shape)]


def _slice(graph, operands, params):
    strides = params["strides"] or (1,) * operands[0].ndim
    window = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return [operands[0][tuple(slice(*each) for each in window)]]


def _dynamic_slice(graph, operands, params):
    x, *starts = operands
    begin = _clamped_starts(x.shape, starts, params["slice_sizes"])
    sizes = params["slice_sizes"]
    return [x[tuple(slice(b, b + size) for b, size in zip(begin, sizes, strict=True))]]


def _dynamic_update_slice(graph, operands, params):
    x, update, *starts = operands
    begin = _clamped_starts(x.shape, starts, update.shape)
    result = x.copy()
    result[tuple(slice(b, b + size) for b, size in zip(begin, update.shape, strict=True))] = update
    return [result]


def _clamped_starts(shape, starts, sizes) -> list[int]:
    begin = []
    for start, size, whole in zip(starts, sizes, shape, strict=True):
        if start.item().value is None:
            raise NotImplementedError("a slice at a computed place cannot be fused")
        begin.append(int(np.clip(start.item().value, 0, whole - size)))
    return begin


def _gather(graph, operands, params):
    """Taken at constant indices; where each element comes from is asked of JAX itself."""
    x, indices = operands
    if any(node.value is None for node in indices.flat):
        raise NotImplementedError("a gather at computed places cannot be fused")
    where = np.vectorize(lambda node: node.value, otypes=[np.int32])(indices)
    with jax.ensure_compile_time_eval():
        places = jax.lax.gather_p.bind(
            np.arange(x.size, dtype=np.int32).reshape(x.shape), where, **params
        )
    return [x.reshape(-1)[np.asarray(places)]]


def _split(graph, operands, params):
    cuts = np.cumsum(params["sizes"])[:-1]
    return np.split(operands[0], cuts, params["axis"])


def _unstack(graph, operands, params):
    (x,), axis = operands, params["axis"]
    return [part.squeeze(axis) for part in np.split(x, x.shape[axis], axis)]


def _pad(graph, operands, params):
    """Between and around the elements, or less than nothing around: that cuts."""
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


def _scatter(graph, operands, params, combine=lambda old, new: new):
    """Put at constant places; where each element goes is asked of JAX itself, as a gather."""
    x, indices, updates = operands
    if any(node.value is None for node in indices.flat):
        raise NotImplementedError("a scatter to computed places cannot be fused")
    where = np.vectorize(lambda node: node.value, otypes=[np.int32])(indices)
    numbers = params["dimension_numbers"]
    alone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = iter([updates.shape[i] for i in numbers.update_window_dims])
    outside = -1
    with jax.ensure_compile_time_eval():
        places = jax.lax.gather(
            np.arange(x.size, dtype=np.int32).reshape(x.shape),
            where,
            jax.lax.GatherDimensionNumbers(
                offset_dims=numbers.update_window_dims,
                collapsed_slice_dims=numbers.inserted_window_dims,
                start_index_map=numbers.scatter_dims_to_operand_dims,
                operand_batching_dims=numbers.operand_batching_dims,
                start_indices_batching_dims=numbers.scatter_indices_batching_dims,
            ),
            tuple(1 if i in alone else next(window) for i in range(x.ndim)),
            mode=params["mode"],
            fill_value=outside,
        )
    result = x.copy().reshape(-1)
    for node, place in zip(updates.flat, np.asarray(places).flat, strict=True):
        if place != outside:
            result[place] = combine(result[place], node)
    return [result.reshape(x.shape)]


def _same(graph, operands, params):
    return operands


def _scatter_add(graph, operands, params):
    return _scatter(graph, operands, params, graph.add)


# By the name of JAX's primitive, from its operands and parameters to its results.
MOVES: dict[str, Callable[[Graph, list[np.ndarray], dict], list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda graph, xs, params: [np.concatenate(xs, params["dimension"])],
    "copy": _same,
    "copy_p": _same,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "expand_dims": lambda graph, xs, params: [np.expand_dims(xs[0], params["dimensions"])],
    "gather": _gather,
    "gathered": _same,
    "pad": _pad,
    "reshape": lambda graph, xs, params: [xs[0].reshape(params["new_sizes"])],
    "rev": lambda graph, xs, params: [np.flip(xs[0], params["dimensions"])],
    "scatter": _scatter,
    "scatter-add": _scatter_add,
    "scatter_add": _scatter_add,
    "slice": _slice,
    "split": _split,
    "squeeze": lambda graph, xs, params: [xs[0].squeeze(params["dimensions"])],
    "stack": lambda graph, xs, params: [np.stack(xs, params["axis"])],
    "stop_gradient": _same,
    "transpose": lambda graph, xs, params: [xs[0].transpose(params["permutation"])],
    "unstack": _unstack,
}
