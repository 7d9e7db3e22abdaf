"""Make the links of README.md to files of the repository absolute: PyPI shows it without the files beside it.

``python .ci/absolute_links.py REPOSITORY VERSION`` rewrites README.md, for instance before a release is built.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
#: What is left alone: blocks and pieces of code.
_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
#: A target that is no address and no heading, of a picture, and of anything else.
_TARGET = r"\((?![a-z]+:|#)([^)\s]+)\)"
_PICTURE, _LINK = re.compile(rf"(!\[[^\]]*\]){_TARGET}"), re.compile(rf"(\]){_TARGET}")


def absolute(text: str, repository: str, version: str) -> str:
    """Markdown with absolute links; code is left alone.

    Args:
        text: Markdown.
        repository: address of the repository.
        version: tag or commit.
    """
    parts = _CODE.split(text)
    for k in range(0, len(parts), 2):  # the others are code
        for pattern, kind in ((_PICTURE, "raw"), (_LINK, "blob")):
            parts[k] = pattern.sub(rf"\1({repository}/{kind}/{version}/\2)", parts[k])
    return "".join(parts)


if __name__ == "__main__":
    README.write_text(absolute(README.read_text(encoding="utf-8"), *sys.argv[1:]), encoding="utf-8")
