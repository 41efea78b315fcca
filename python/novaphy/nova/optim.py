"""Optimizers for several parameters: SGD with momentum, and Adam.

``step()`` and ``zero_grad()`` launch kernels on fixed memory and do not read values on the host.
Therefore ``nova.ScopedCapture`` can record them. Each launch of the recorded graph is then one
step, with the same bits as ``step()``.
"""

from .._core.nova import SGD, Adam

__all__ = ["SGD", "Adam"]
