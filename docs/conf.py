"""Sphinx: ``make docs`` builds these pages, warnings as errors."""

import json
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

import sphinx.util.inspect
from myst_parser.parsers.sphinx_ import MystParser

sys.path.insert(0, str(Path(__file__).parent))
import class_examples
import gallery
from execute_notebooks import as_markdown

project = "coopqp"
author = "The coopqp authors"
version = release = installed_version("coopqp")
copyright = author

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # puts MathJax beside the pages: they are read without a network
]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
mathjax3_config = {"tex": {"macros": {"dt": r"\mathrm{d}t", "Ad": r"\operatorname{Ad}"}}}
myst_heading_anchors = 3
highlight_language = "python"
exclude_patterns = ["examples/**", "_build"]
source_suffix = {".md": "markdown", ".ipynb": "notebook"}

html_theme = "furo"
html_title = f"coopqp {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_extra_path = ["llms.txt", str(gallery.BUILT)]  # an overview for language models; the pages in 3D

autodoc_member_order = "bysource"
autodoc_typehints = "signature"  # shapes and units are in the text
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Placement", "ProgressCallback")}
sphinx.util.inspect.TypeAliasForwardRef.__repr__ = lambda alias: alias.name  # else its own name stands on the page
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_use_rtype = False

ROOT = Path(__file__).parents[1]


def _include_text(app, docname, source):
    """Put a file of the repository in place of ``<!-- include: FILE -->``; links in it that lead elsewhere are cut."""

    def text(match):
        file = ROOT / match[1]
        if not file.is_file():
            return ""
        body = re.sub(r"\A# .*\n", "", file.read_text(encoding="utf-8"))
        return re.sub(r"!?\[([^]]*)\]\((?!https?://)[^)]*\)", r"\1", body)

    source[0] = re.sub(r"<!-- include: (\S+) -->", text, source[0])
    if not (ROOT / "docs/reliability.md").is_file():
        source[0] = source[0].replace("\nreliability\n", "\n")


def _scenes(app, docname, source):
    """Put the pages in 3D in place of ``<!-- 3d: NAME -->`` (a link) and ``<!-- plays: NAME -->`` (a frame)."""

    def frame(match):
        e = gallery.entry(match[1])
        return f'<iframe class="plays" loading="lazy" title="{e.title}, in 3D" src="3d/{e.name}.html"></iframe>'

    def link(match):
        title = gallery.entry(match[1]).title
        return f'<a href="3d/{match[1]}.html" aria-label="{title}, in 3D">plays in 3D</a> · '

    source[0] = re.sub(r"<!-- plays: (\w+) -->", frame, re.sub(r"<!-- 3d: (\w+) -->", link, source[0]))


def _index_entries(app, docname, source):
    """Put the terms of ``<!-- index: A, B -->`` into the index: in the repository itself a comment shows nothing."""
    source[0] = re.sub(r"<!-- index: (.+) -->", r"```{index} \1\n```", source[0])


def _example(app, what, name, obj, options, lines):
    """Show the example of a class below its text."""
    code = class_examples.example_of(name) if what in ("class", "exception") else ""
    if code:
        lines += ["", "Example::", "", *(f"   {line}" for line in code.splitlines()), ""]


def _before_examples(app, docname, source):
    """Show what the examples of a page of the reference go on from."""
    page = docname.partition("reference/")[2]
    before = class_examples.sections(page).get(class_examples.BEFORE) if page else None
    if before:
        head, title, rest = source[0].partition("\n")
        source[0] = (
            f"{head}{title}\nThe examples of this page go on from these lines:\n\n```python\n{before}\n```\n{rest}"
        )


class NotebookParser(MystParser):
    """Shows executed notebooks as they are."""

    supported = ("notebook",)

    def parse(self, inputstring, document):
        name = Path(document.settings.env.doc2path(document.settings.env.docname)).name
        super().parse(as_markdown(json.loads(inputstring), name), document)


def _plain_bars(app, what, name, obj, options, lines):
    """``|x|`` is an absolute value in these docstrings, not a substitution of reStructuredText."""
    inside_literal = re.compile(r"(``.*?``)")
    for i, line in enumerate(lines):
        parts = inside_literal.split(line)
        lines[i] = "".join(p if p.startswith("``") else p.replace("|", "\\|") for p in parts)


def _one_attribute_a_line(app, what, name, obj, options, lines):
    """``a, b: text`` in a list of attributes describes two of them; Sphinx would take ``a,`` for a type."""
    entry, several = re.compile(r"^    \S"), re.compile(r"^    ((?:\w+, )+\w+): (.*)$")
    out, i = [], 0
    while i < len(lines):
        found, end = several.match(lines[i]), i + 1
        while found and end < len(lines) and lines[end].startswith("     ") and not entry.match(lines[end]):
            end += 1  # the lines that go on belong to each of them
        names = found[1].split(", ") if found else []
        for name in names:
            out += [f"    {name}: {found[2]}", *lines[i + 1 : end]]
        out += [] if names else lines[i:end]
        i = end
    lines[:] = out


def _level_of_captions(app, pagename, templatename, context, doctree):
    """The captions of the list of pages are headings: of which level, Sphinx does not say."""
    for name in ("furo_navigation_tree", "body"):
        if context.get(name):
            context[name] = context[name].replace('role="heading"', 'role="heading" aria-level="2"')


def setup(app):
    gallery.make_all()  # those that are up to date stay
    app.add_source_parser(NotebookParser)
    app.connect("source-read", _scenes)
    app.connect("source-read", _index_entries)
    app.connect("source-read", _before_examples)
    app.connect("autodoc-process-docstring", _example, priority=900)  # after napoleon
    app.connect("html-page-context", _level_of_captions, priority=900)  # after the theme has made them
    app.connect("source-read", _include_text)
    app.connect("autodoc-process-docstring", _one_attribute_a_line, priority=300)  # before napoleon
    app.connect("autodoc-process-docstring", _plain_bars)
