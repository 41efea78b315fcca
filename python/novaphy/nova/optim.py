"""Optimizers of several parameters: SGD with momentum, and Adam.

``step()`` and ``zero_grad()`` are kernels on fixed memory without a read on the host. A
``nova.ScopedCapture`` may therefore record them. Each launch of the graph is then a step, with the
bits of ``step()``.
"""

from .._core.nova import SGD, Adam

__all__ = ["SGD", "Adam"]
