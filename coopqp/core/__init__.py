"""The compiled core of coopqp, ``coopqp.core._core``: steps, kinematics and distances."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from coopqp.errors import MissingCoreError

try:
    _core: Any = import_module("coopqp.core._core")  # whose error says more than that of a name
except ImportError as error:
    raise MissingCoreError(str(error)) from error
