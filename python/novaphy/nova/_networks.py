"""Densities of policies, and parameters in files."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._core.nova import Tensor, exp, softplus, sum, tensor

_HALF_LOG_2_PI, _LOG_2 = 0.9189385332, 0.6931471806
_META = "meta"


def gaussian_log_density(
    u: Tensor, mean: Tensor, log_std: Tensor, *, squashed: bool = True
) -> Tensor:
    """Log density of actions of a Gaussian policy, recorded on an active tape.

    Args:
        u: what was drawn, {n, k}; before the tanh.
        mean: of the Gaussian, {n, k}.
        log_std: logarithm of its standard deviation, {n, k} or {k}.
        squashed: the action is tanh(u): its density, so with -log(1 - tanh(u)^2) of every column,
            as 2 (log 2 - u - softplus(-2 u)) without cancellation (Haarnoja et al., "Soft
            actor-critic algorithms and applications", 2018, appendix C). False: that of u.

    Returns:
        {n}, the sum over columns.

    Raises:
        ValueError: another shape.
    """
    if u.ndim != 2 or mean.shape != u.shape:
        raise ValueError(f"mean: expected the shape of u, {{n, k}}, got {mean.shape} and {u.shape}")
    if log_std.shape not in (u.shape, u.shape[1:]):
        raise ValueError(f"log_std: expected {u.shape} or {u.shape[1:]}, got {log_std.shape}")
    z = (u - mean) * exp(-log_std)
    terms = -0.5 * z * z - log_std - _HALF_LOG_2_PI
    if squashed:
        terms = terms - 2.0 * (_LOG_2 - u - softplus(-2.0 * u))
    return sum(terms, axis=1)


def save_parameters(
    path: str | os.PathLike[str],
    parameters: Mapping[str, Tensor],
    meta: Mapping[str, Any] | None = None,
) -> None:
    """Write tensors by name into an ``.npz`` file, float32, without pickle.

    Args:
        path: a name that ends in ``.npz``.
        parameters: finite float32 tensors.
        meta: what JSON can hold: seed, environment, ...

    Raises:
        ValueError: a tensor that holds NaN or infinity, a name that is "meta", another ending.
    """
    from ..io import save_npz

    arrays: dict[str, np.ndarray] = {}
    for name, value in parameters.items():
        if name == _META:
            raise ValueError(f"parameters: expected names other than {_META!r}")
        arrays[name] = _finite(value.numpy(), name)
    save_npz(path, **arrays, **{_META: np.array(json.dumps(dict(meta or {}), sort_keys=True))})


def load_parameters(
    path: str | os.PathLike[str], like: Mapping[str, Tensor] | None = None
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_parameters` wrote: tensors by name, and meta.

    Args:
        path: the file; pickled objects in it are refused.
        like: these names and shapes are expected, no others; the values are written into these
            tensors, all of them or none, which are what is returned.

    Raises:
        ValueError: no such archive, pickled objects, missing or unknown names, another shape, NaN.
    """
    arrays = _read(path)
    try:
        meta = json.loads(str(arrays.pop(_META))) if _META in arrays else {}
    except json.JSONDecodeError as error:
        raise ValueError(f"{os.fspath(path)}, {_META}: expected JSON: {error}") from None
    for name, value in arrays.items():
        _finite(value, f"{os.fspath(path)}, {name}")
    if like is None:
        return {name: tensor(value) for name, value in arrays.items()}, meta
    for what, names in (("misses", like.keys() - arrays.keys()), ("has", arrays.keys() - like)):
        if names:
            raise ValueError(
                f"{os.fspath(path)}: expected {', '.join(sorted(like))}; it {what} "
                f"{', '.join(sorted(names))}"
            )
    for name, target in like.items():
        if arrays[name].shape != target.shape:
            raise ValueError(
                f"{os.fspath(path)}, {name}: expected {target.shape}, got {arrays[name].shape}"
            )
    for name, target in like.items():
        target.assign(arrays[name])
    return dict(like), meta


def _read(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Arrays of an archive by name, none of them pickled."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, AttributeError, TypeError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(
            f"{os.fspath(path)}: expected an .npz file of arrays, without pickled objects: {error}"
        ) from None


def _finite(value: np.ndarray, name: str) -> np.ndarray:
    """The array, when it is float32 and finite."""
    if value.dtype != np.float32:
        raise ValueError(f"{name}: expected float32, got {value.dtype}")
    if not np.all(np.isfinite(value)):
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return value
