"""Optimizers of several parameters: SGD with momentum, and Adam.

``step()`` and ``zero_grad()`` are kernels on fixed memory without a read on the host, so they may
stand in a ``nova.ScopedCapture``: each launch of the graph is a step, with the bits of ``step()``.
"""

from .._core.nova import SGD, Adam

__all__ = ["SGD", "Adam"]
