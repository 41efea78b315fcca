"""`novaphy check FILE.py:FUNCTION`: the certificate of the gradient of a function in a file."""

from __future__ import annotations

import argparse
import importlib.util
import sys
import traceback
from pathlib import Path
from typing import Any

import novaphy

TRUSTED, DOUBTFUL, FAILED = 0, 1, 2  # exit codes


def is_function(word: str) -> bool:
    """Return whether a word is FILE.py:FUNCTION, and not the name of a demo."""
    return ".py:" in word or word.endswith(".py")


def _load(path: Path) -> Any:
    if not path.is_file():
        raise ValueError(f"check: expected a file, got {path}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"check: expected a Python file, got {path}")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.resolve().parent))  # so that the file can import its neighbors
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def _find(module: Any, word: str, path: Path) -> Any:
    if not hasattr(module, word):
        raise ValueError(f"check: expected {word!r} in {path}, which has no such name")
    return getattr(module, word)


def _save(certificate: Any, f: Any, theta: Any, sigma: Any, path: str) -> None:
    """Write the picture of a certificate. A page also shows the adjoint record, if there is one."""
    from .diff import _certificate_view, _parameters

    of = _parameters.Losses(f, _parameters.Parameters("check", theta, sigma))
    record = of.record() if path.lower().endswith(".html") else None
    _certificate_view.save(certificate, path, record)
    for found in [] if record is None else record.suspects:
        print(f"step {found['step']}: {found['cause']}, H drifts by {found['drift']:.0%}")


def _certify(word: str, options: list[str]) -> int:
    file, _, name = word.rpartition(":") if ".py:" in word else (word, "", "")
    if not name:
        raise ValueError(f"check: expected FILE.py:FUNCTION, got {word}")
    parser = argparse.ArgumentParser(prog="novaphy check FILE.py:FUNCTION", allow_abbrev=False)
    parser.add_argument("--worlds", type=int, default=64, help="samples (default 64)")
    parser.add_argument("--seed", type=int, default=0, help="of samples and directions")
    parser.add_argument("--record", metavar="FILE", help="write the picture: .html, .png")
    args = parser.parse_args(options)
    from . import diff

    path = Path(file)
    module = _load(path)
    f, theta, sigma = (_find(module, key, path) for key in (name, "theta0", "sigma"))
    certificate = diff.certify(f, theta, sigma, worlds=args.worlds, seed=args.seed)
    certificate.print()
    if args.record:
        _save(certificate, f, theta, sigma, args.record)
    return TRUSTED if certificate.verdict == "of the motion" else DOUBTFUL


def check_function(word: str, options: list[str]) -> int:
    """Print the certificate of FILE.py:FUNCTION and return the exit code.

    The code is 0 for the verdict "of the motion", 1 for another verdict, and 2 for an error.
    """
    try:
        return _certify(word, options)
    except (ValueError, OSError, ImportError, NotImplementedError, novaphy.Error) as error:
        print(f"error: {error}", file=sys.stderr)
    except Exception:  # any error of the user's file
        traceback.print_exc()
    return FAILED
