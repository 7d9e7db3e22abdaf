"""The compiled core of coopqp, ``coopqp.native._core``: steps, kinematics and distances."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from coopqp.errors import MissingCoreError, removed

try:
    _core: Any = import_module("coopqp.native._core")  # whose error says more than that of a name
except ImportError as error:
    raise MissingCoreError(str(error)) from error

_ONE = "there is no other than the compiled core, and coopqp --version names its version"
__getattr__ = removed(__name__, {"kernel_text": _ONE, "available_kernels": _ONE})
