"""Names that are imported on first use only, so that a package of many names stays fast to import (PEP 562).

The stub beside a package, ``__init__.pyi``, lists its names, for type checkers and for :func:`attach` alike.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import lazy_loader  # type: ignore[import-untyped]

from coopqp.errors import MissingExtraError, removed


def attach(
    package: str,
    file: str,
    *,
    extra: tuple[str, ...] = (),
    gone: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names the stub beside ``file`` lists.

    Modules that the stub lists are found as attributes, too, and are not in ``__all__``. A name that is not there is
    an AttributeError, from an import an ImportError, that says which package has it.

    Args:
        package: its name.
        file: its ``__init__.py``.
        extra: name of an extra, then the packages that it brings; a missing one is then a MissingExtraError.
        gone: names of earlier versions, with what replaces each; they raise a RemovedNameError.
    """
    get, listed, names = lazy_loader.attach_stub(package, file)
    beside = Path(file).parent
    public = [name for name in names if not (beside / name).is_dir() and not (beside / f"{name}.py").is_file()]

    def get_or_say(name: str) -> Any:
        if name in gone:
            removed(package, gone)(name)
        if name not in names:
            # Python asks for the name of an import here, before it looks for a module of that name.
            imports = sys._getframe(1).f_code.co_filename == "<frozen importlib._bootstrap>"
            module = imports and find_spec(f"{package}.{name}") is not None
            hint = "" if module or name.startswith("_") else _hint(package, name)
            message = f"module {package!r} has no attribute {name!r}{hint}"
            if imports and not module:
                raise ImportError(message, name=package, path=file)
            raise AttributeError(message, name=name, obj=sys.modules[package])
        try:
            value = get(name)
        except ModuleNotFoundError as error:
            if error.name not in extra[1:]:
                raise
            raise MissingExtraError(extra[0], extra[1]) from error
        setattr(sys.modules[package], name, value)
        return value

    def all_listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *listed()})

    return get_or_say, all_listed, public


def moved(module: str, now: str, *, gone: Mapping[str, str] = MappingProxyType({})) -> None:
    """Keep a module of an earlier version findable, for pickles and programs that name it.

    Args:
        module: its name.
        now: the module that has its names now.
        gone: names that no module has any more, with what replaces each.
    """

    def look(name: str) -> Any:
        if name in gone or name.startswith("__"):  # who looks through all modules asks for those
            return removed(module, gone)(name)
        return getattr(import_module(now), name)

    there = sys.modules.setdefault(module, ModuleType(module))
    vars(there)["__getattr__"] = look


def needed(module: str, extra: str, package: str) -> Any:
    """A module of a package that an extra brings.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        __import__(module)
    except ImportError as error:
        raise MissingExtraError(extra, package) from error
    return sys.modules[module]


def _hint(package: str, name: str) -> str:
    """Where a name is that a package does not have, or the nearest name that it has."""
    places = _places()
    if found := places.get(name):
        return f"; it is in {found}"
    here = [other for other, place in places.items() if place == package]
    for names in (here, places):
        if near := get_close_matches(name, names, n=1):
            return f". Did you mean {near[0]!r}{'' if names is here else f' of {places[near[0]]}'}?"
    return ""


def _places() -> dict[str, str]:
    """The public package of every public name."""
    root, places = Path(__file__).parent, dict[str, str]()
    packages = ["scenarios", *sorted(file.parent.name for file in root.glob("*/__init__.pyi"))]
    for package in ("coopqp.errors", "coopqp.output", "coopqp.spatial", *(f"coopqp.{p}" for p in packages), "coopqp"):
        module = import_module(package)  # the top last: it counts
        own = [name for name, thing in vars(module).items() if getattr(thing, "__module__", "") == package]
        places |= dict.fromkeys(getattr(module, "__all__", own), package)
    return places
