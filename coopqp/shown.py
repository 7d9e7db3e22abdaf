"""Objects with a picture in notebooks, which a package above them makes."""

from __future__ import annotations

from importlib.metadata import entry_points


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
