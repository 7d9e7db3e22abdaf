"""Names that are imported on first use only, so that a package of many names stays fast to import.

Public names (PEP 562), and the pictures of objects in notebooks.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from coopqp.errors import MissingExtraError


def lazy_names(
    package: str, places: Mapping[str, str], *, extra: tuple[str, ...] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package with names from modules that are not imported yet.

    Args:
        package: its name.
        places: the names that each module has, separated by spaces, by the name of the module.
        extra: name of an extra, then the packages that it brings; a missing one is then a MissingExtraError.
    """
    module_of = {name: module for module, names in places.items() for name in names.split()}

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])
        try:
            value = getattr(import_module(module_of[name]), name)
        except ModuleNotFoundError as error:
            if error.name not in extra[1:]:
                raise
            raise MissingExtraError(extra[0], extra[1]) from error
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *module_of})

    return get, listed


class Shown:
    """An object with a picture in notebooks, which :mod:`coopqp.visualization.notebook` makes when it is asked for."""

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        """HTML without links to anything else; None, for the plain text, if it cannot be made."""
        page: str | None = import_module("coopqp.visualization.notebook").html_of(self)
        return page
