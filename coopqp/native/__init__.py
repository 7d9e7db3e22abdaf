"""The compiled parts of coopqp: whether this installation has them, and why not."""

from __future__ import annotations

import functools
import warnings
from importlib import import_module
from types import ModuleType

from coopqp.errors import KernelWarning

#: The module of steps, kinematics and distances. Without it their definitions in NumPy take its place.
MODULE = "coopqp.native._core"
_REMEDY = (
    "Install a C++ compiler, then: COOPQP_REQUIRE_KERNEL=1 pip install --force-reinstall --no-binary coopqp coopqp"
)


@functools.cache
def _loaded() -> tuple[ModuleType | None, str]:
    """The module, or None and the reason."""
    try:
        return import_module(MODULE), ""
    except ModuleNotFoundError:
        return None, "it was not built: there was no C++ compiler, or it failed"
    except ImportError as error:
        return None, f"it cannot be loaded ({error})"


def compiled() -> ModuleType | None:
    """The compiled module; None where it is missing."""
    return _loaded()[0]


def available_kernels() -> tuple[str, ...]:
    """Names of what computes steps, kinematics and distances in this installation, the fastest first.

    Returns:
        ``("compiled", "plain")``, or ``("plain",)`` where the module was not built or cannot be loaded.
    """
    return ("compiled", "plain") if compiled() is not None else ("plain",)


def kernel_text() -> str:
    """The kernel that computes by default, and why it is not the compiled one."""
    reason = _loaded()[1]
    return available_kernels()[0] + (f" ({reason})" if reason else "")


@functools.cache
def warn_once() -> None:
    """Say that the compiled module is missing, once in a program.

    Warns:
        KernelWarning: it is missing.
    """
    if compiled() is None:
        warnings.warn(
            f"coopqp runs without its compiled kernel, about a hundred times slower: {_loaded()[1]}. {_REMEDY}",
            KernelWarning,
            stacklevel=4,
        )
