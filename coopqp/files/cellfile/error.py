"""The error of cell files, and how their names end."""

from __future__ import annotations

from coopqp.errors import CoopqpError

#: Endings of cell files in TOML, and in YAML.
TOML_SUFFIX, YAML_SUFFIXES = ".toml", (".yaml", ".yml")


class CellFileError(CoopqpError):
    """A cell file is missing, is neither TOML nor YAML, or breaks the schema."""
