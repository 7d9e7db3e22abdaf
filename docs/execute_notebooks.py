"""The notebooks of the pages: runs them and keeps their outputs.  python docs/execute_notebooks.py

The outputs are those of Jupyter, without Jupyter: what a cell prints, and the value of its last line, as HTML where it
has some, as a picture for a figure of Matplotlib. `docs/conf.py` shows the files as they are; tests run them again.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "notebooks"
#: Resolution of a figure [1/inch].
_DPI = 72

Notebook = dict[str, Any]
Output = dict[str, Any]


def load(file: Path) -> Notebook:
    """The notebook of a file."""
    found: Notebook = json.loads(file.read_text(encoding="utf-8"))
    return found


def text_of(cell: dict[str, Any], key: str = "source") -> str:
    """A text of a notebook, which may stand as lines."""
    text = cell[key]
    return text if isinstance(text, str) else "".join(text)


def executed(notebook: Notebook) -> list[list[Output]]:
    """Outputs of each code cell of a notebook, run from the first to the last."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [_run(text_of(cell), names, k) for k, cell in enumerate(cells, start=1)]


def _run(source: str, names: dict[str, Any], number: int) -> list[Output]:
    body = ast.parse(source)
    last = body.body.pop() if body.body and isinstance(body.body[-1], ast.Expr) else None
    value = None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(body, f"<cell {number}>", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), names)
    outputs: list[Output] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
    if value is not None:
        data = {kind: _lines(text) for kind, text in _shown(value).items()}
        outputs.append({"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data})
    return outputs


def _shown(value: Any) -> dict[str, str]:
    """A value by media type."""
    if hasattr(value, "savefig"):
        stream = io.BytesIO()
        value.savefig(stream, format="png", dpi=_DPI)
        return {"image/png": base64.b64encode(stream.getvalue()).decode(), "text/plain": "a figure"}
    as_html = getattr(value, "_repr_html_", lambda: None)()
    return {"text/plain": repr(value)} | ({"text/html": as_html} if as_html else {})


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def keep(file: Path) -> None:
    """Run a notebook and write its outputs into its file."""
    notebook = load(file)
    outputs = executed(notebook)
    cells = (cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    for number, (cell, found) in enumerate(zip(cells, outputs, strict=True), start=1):
        cell |= {"outputs": found, "execution_count": number}
    file.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def as_markdown(notebook: Notebook, name: str) -> str:
    """A notebook as a page: its texts, its code, and the outputs that it has. ``name``: of its file."""
    parts = []
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            parts.append(text_of(cell))
            continue
        parts.append(f"```python\n{text_of(cell)}\n```")
        alt = cell["metadata"].get("alt", "")
        parts += [_output(output, alt) for output in cell["outputs"]]
    parts.append(f"The notebook: {{download}}`{name} <{name}>`")
    return "\n\n".join(parts) + "\n"


def _output(output: Output, alt: str) -> str:
    if output["output_type"] == "stream":
        return f"```text\n{text_of(output, 'text').rstrip()}\n```"
    data = output["data"]
    if "image/png" in data:
        picture = "".join(text_of(data, "image/png").split())
        return f'<div class="output"><img alt="{alt}" src="data:image/png;base64,{picture}"></div>'
    if "text/html" in data:
        return f'<div class="output">{text_of(data, "text/html")}</div>'
    return f"```text\n{text_of(data, 'text/plain')}\n```"


if __name__ == "__main__":
    for each in sorted(FOLDER.glob("*.ipynb")):
        keep(each)
