"""Formulas of the pages as MathML, which browsers draw by themselves: no script, no fonts, no network."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

_TEXT = re.compile(r"\\text\{[^{}]*\}")
NAME = "mathml"
"""Of the renderer, as `html_math_renderer` of `conf.py` asks for it."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer(NAME, inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(page: HTML5Translator, node: nodes.math) -> None:
    _write(page, node.astext(), block=False)


def _block(page: HTML5Translator, node: nodes.math_block) -> None:
    _write(page, node.astext(), block=True)


def _write(page: HTML5Translator, formula: str, *, block: bool) -> None:
    from docutils import nodes
    from docutils.utils.math.latex2mathml import tex2mathml

    plain = _TEXT.sub(lambda found: found[0].replace(r"\_", "_"), formula)
    page.body.append(tex2mathml(plain, as_block=block))
    raise nodes.SkipNode
