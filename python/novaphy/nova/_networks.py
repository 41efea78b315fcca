"""Log densities of Gaussian policies, and .npz files with parameters of networks."""

from __future__ import annotations

import json
import lzma
import os
import struct
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO

import numpy as np

from .._core.nova import Tensor, exp, float32, softplus, sum, tensor

_HALF_LOG_2_PI, _LOG_2 = 0.9189385332, 0.6931471806
_META = "meta"
# Names that parameters may not have: the entry for meta, and arguments of numpy.savez.
_RESERVED = (_META, "file", "path", "allow_pickle")
# The errors that NumPy and zipfile raise for damaged files.
_DAMAGED = (
    ValueError, AttributeError, TypeError, EOFError, OSError, KeyError, IndexError,
    NotImplementedError, RuntimeError, SyntaxError, OverflowError, MemoryError,
)  # fmt: skip


def gaussian_log_density(
    u: Tensor, mean: Tensor, log_std: Tensor, *, squashed: bool = True
) -> Tensor:
    """Return the log density of actions of a Gaussian policy, recorded on an active tape.

    Args:
        u: samples of the Gaussian before the tanh, {n, k}: n samples of k action components.
        mean: mean of the Gaussian, {n, k}.
        log_std: natural logarithm of the standard deviation, {n, k} or {k}.
        squashed: True: return the log density of the action tanh(u). Each column then has the term
            -log(1 - tanh(u)^2), computed without cancellation as -2 (log 2 - u - softplus(-2 u))
            (Haarnoja et al., "Soft actor-critic algorithms and applications", 2018, appendix C).
            False: return the log density of u.

    Returns:
        {n}: the log density of each sample, summed over its k components.

    Raises:
        ValueError: the shapes do not fit.
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
    """Write named float32 tensors to an ``.npz`` file, without pickle.

    Args:
        path: a name that ends in ``.npz``.
        parameters: finite float32 tensors by name. A name is any text except "meta", "file", "path"
            and "allow_pickle", without NUL and without the ending ".npy".
        meta: data that JSON can represent, such as the seed and the environment.

    Raises:
        TypeError: parameters or meta are not a mapping, a name is not a text, or a value is not a
            tensor.
        ValueError: a tensor contains NaN or infinity, a name is not allowed, JSON cannot represent
            meta (NaN and infinity included), or the path has another extension.
    """
    from ..io import save_npz

    arrays: dict[str, np.ndarray] = {}
    for name, value in _mapping(parameters, "parameters").items():
        if not isinstance(name, str):
            raise TypeError(f"parameters: expected names that are str, got {name!r}")
        if name in _RESERVED or name.endswith(".npy") or "\0" in name:
            raise ValueError(
                f"parameters: expected names other than {', '.join(map(repr, _RESERVED))}, "
                f"without NUL and not ending in '.npy', got {name!r}"
            )
        arrays[name] = _finite(_tensor(value, f"parameters[{name!r}]").numpy(), name)
    metadata = {} if meta is None else dict(_mapping(meta, _META))
    try:
        text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{_META}: expected what JSON can hold: {error}") from None
    save_npz(path, **arrays, **{_META: np.array(text)})


def load_parameters(
    path: str | os.PathLike[str], like: Mapping[str, Tensor] | None = None
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a file of `save_parameters`: tensors by name, and meta.

    Args:
        path: the file; pickled objects in the file are refused.
        like: float32 tensors with the expected names and shapes. Either all of them get the values
            of the file and are returned, or no tensor is changed. None: new tensors are returned.

    Returns:
        The tensors by name, and meta.

    Raises:
        FileNotFoundError: the file does not exist.
        TypeError: like contains values other than float32 tensors.
        ValueError: the file is not an archive or is damaged, contains pickled objects or NaN, or
            has missing names, unknown names or other shapes.
    """
    arrays, meta = _read(path)
    if like is None:
        return {name: tensor(value) for name, value in arrays.items()}, meta
    for name, target in _mapping(like, "like").items():
        if _tensor(target, f"like[{name!r}]").dtype != float32:
            raise TypeError(f"like[{name!r}]: expected a float32 tensor, got {target.dtype}")
    for what, names in (("misses", like.keys() - arrays.keys()), ("has", arrays.keys() - like)):
        if names:
            raise ValueError(
                f"{os.fspath(path)}: expected {_listed(like)}; it {what} {_listed(names)}"
            )
    for name, target in like.items():
        if arrays[name].shape != target.shape:
            raise ValueError(
                f"{os.fspath(path)}, {name}: expected {target.shape}, got {arrays[name].shape}"
            )
    for name, target in like.items():
        target.assign(arrays[name])
    return dict(like), meta


def _listed(names: Iterable[Any]) -> str:
    return ", ".join(sorted(map(str, names)))


def _mapping(value: Any, name: str) -> Mapping[Any, Any]:
    """Return the value if it is a mapping; TypeError otherwise."""
    if not isinstance(value, Mapping):
        raise TypeError(f"{name}: expected a mapping by name, got {type(value).__name__}")
    return value


def _tensor(value: Any, name: str) -> Tensor:
    """Return the value if it is a tensor; TypeError otherwise."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a nova.Tensor, got {type(value).__name__}")
    return value


def _read(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays of an archive by name, all float32 and finite, and the meta data."""
    where = os.fspath(path)
    with open(path, "rb") as file:  # an OSError here means a missing or unreadable file
        try:
            if file.read(2) != b"PK":
                raise ValueError("it does not begin as one")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            _check_count(file, len(arrays))
        except (*_DAMAGED, struct.error, zipfile.BadZipFile, zlib.error, lzma.LZMAError) as error:
            raise ValueError(
                f"{where}: expected an .npz file of arrays, undamaged and without pickled "
                f"objects: {error}"
            ) from None
    stored = arrays.pop(_META, None)
    try:
        meta = {} if stored is None else json.loads(str(stored))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where}, {_META}: expected JSON: {error}") from None
    if not isinstance(meta, dict):
        raise ValueError(f"{where}, {_META}: expected a JSON object, got {type(meta).__name__}")
    for name, value in arrays.items():
        if not isinstance(value, np.ndarray):  # A member of the archive that is no .npy file.
            raise ValueError(f"{where}, {name}: expected an array, got {type(value).__name__}")
        _finite(value, f"{where}, {name}")
    return arrays, meta


def _check_count(file: BinaryIO, found: int) -> None:
    """Check the number of members at the end of an archive, because damage may hide members."""
    file.seek(-22, os.SEEK_END)
    mark, count = struct.unpack("<4s6xH10x", file.read())
    if mark != b"PK\5\6" or count != found:
        raise ValueError(f"it has {found} members, and another number at its end")


def _finite(value: np.ndarray, name: str) -> np.ndarray:
    """Return the array if it is float32 and finite; ValueError otherwise."""
    if value.dtype != np.float32:
        raise ValueError(f"{name}: expected float32, got {value.dtype}")
    if not np.all(np.isfinite(value)):
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return value
