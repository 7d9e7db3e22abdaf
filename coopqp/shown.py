"""Objects with a picture in notebooks, which a package above them makes; and results with a short ``repr``."""

from __future__ import annotations

from dataclasses import fields
from importlib.metadata import entry_points
from typing import Any

#: Arrays of more numbers are shown by their shape, and texts that are longer by their type.
_NUMBERS, _LETTERS = 8, 120


class Shown:
    """An object with a picture in notebooks.

    Who makes it is an entry point of the group ``coopqp.pictures``: models, controllers and runs know nothing of
    pictures.
    """

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        """HTML without links to anything else; None, for the plain text, if it cannot be made."""
        for maker in entry_points(group="coopqp.pictures", name="html"):
            return maker.load()(self)
        return None


class Brief:
    """A dataclass whose ``repr`` stays short, whatever it holds: large arrays by their shape, objects by their number.

    The dataclass itself says ``repr=False``.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        parts = (f"{field.name}={_brief(getattr(self, field.name))}" for field in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(parts)})"


def _brief(value: Any) -> str:
    if isinstance(value, (tuple, list)) and value and not isinstance(value[0], (str, float, int)):
        return f"{len(value)} × {type(value[0]).__name__}"
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and value.size > _NUMBERS:
        return f"array{shape}"
    text = " ".join(repr(value).split())
    return text if len(text) <= _LETTERS else f"{type(value).__name__}(…)"
