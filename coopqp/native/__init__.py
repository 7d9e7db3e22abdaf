"""The compiled parts of coopqp: which of them this installation has, and why another is missing."""

from __future__ import annotations

import functools
import warnings
from importlib import import_module
from types import ModuleType

from coopqp.errors import KernelWarning, UnknownNameError

#: Each part by what it computes, and its module. Where a part is missing its definition in NumPy takes its place.
PARTS = {
    "step": "coopqp.native._native",
    "kinematics": "coopqp.native._batch",
    "distances": "coopqp.native._bounds",
}
_REMEDY = "Install a C compiler, then: COOPQP_REQUIRE_KERNEL=1 pip install --force-reinstall --no-binary coopqp coopqp"


@functools.cache
def _loaded(part: str) -> tuple[ModuleType | None, str]:
    """The module of a part, or None and the reason."""
    if part not in PARTS:
        raise UnknownNameError("compiled part", part, PARTS)
    try:
        return import_module(PARTS[part]), ""
    except ModuleNotFoundError:
        return None, "it was not built: there was no C compiler, or it failed"
    except ImportError as error:
        return None, f"it cannot be loaded ({error})"


def compiled(part: str) -> ModuleType | None:
    """The compiled module of a part; None where it is missing."""
    return _loaded(part)[0]


def available_kernels(part: str = "step") -> tuple[str, ...]:
    """Names of what computes a part in this installation, the fastest first.

    Args:
        part: ``"step"`` of a controller, ``"kinematics"`` of many configurations at once, or ``"distances"`` of bodies.

    Returns:
        ``("compiled", "plain")``, or ``("plain",)`` where the part was not built or cannot be loaded.

    Raises:
        UnknownNameError: there is no such part.
    """
    return ("compiled", "plain") if compiled(part) is not None else ("plain",)


def kernel_text() -> str:
    """The kernel that computes each part by default, and why it is not the compiled one."""
    told = ((part, available_kernels(part)[0], _loaded(part)[1]) for part in PARTS)
    return ", ".join(f"{part} {kernel}" + (f" ({reason})" if reason else "") for part, kernel, reason in told)


@functools.cache
def warn_once() -> None:
    """Say which parts are missing, once in a program.

    Warns:
        KernelWarning: a compiled part is missing.
    """
    if missing := [part for part in PARTS if compiled(part) is None]:
        warnings.warn(
            f"coopqp runs without its compiled kernel for {', '.join(missing)}, about a hundred times slower: "
            f"{_loaded(missing[0])[1]}. {_REMEDY}",
            KernelWarning,
            stacklevel=4,
        )
