"""Make the links of README.md to files of the repository absolute: PyPI shows it without the files beside it.

``python .ci/absolute_links.py REPOSITORY VERSION`` rewrites README.md, for instance before a release is built.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
#: A link or a picture whose target is no address and no heading.
_RELATIVE = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)\s]+)\)")


def absolute(text: str, repository: str, version: str) -> str:
    """Markdown with absolute links; code is left alone.

    Args:
        text: Markdown.
        repository: address of the repository.
        version: tag or commit.
    """

    def link(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        return f"{picture}[{words}]({repository}/{'raw' if picture else 'blob'}/{version}/{target})"

    parts = text.split("```")
    return "```".join(part if k % 2 else _RELATIVE.sub(link, part) for k, part in enumerate(parts))


if __name__ == "__main__":
    README.write_text(absolute(README.read_text(encoding="utf-8"), *sys.argv[1:]), encoding="utf-8")
