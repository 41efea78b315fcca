"""Optimizers for several parameters: SGD with momentum, and Adam.

``step()`` and ``zero_grad()`` are kernels on fixed memory and do not read values on the host. A
``nova.ScopedCapture`` can therefore record them. Each launch of the graph is then one step, with
the bits of ``step()``.
"""

from .._core.nova import SGD, Adam

__all__ = ["SGD", "Adam"]
