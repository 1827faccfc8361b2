"""Render mathematics as MathML, which browsers draw without a script and without a network."""

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

_TAG = re.compile(r"\\tag\{(.+?)\}")


def as_mathml(tex: str, block: bool = False) -> str:
    """Return an element `math`, and the number of the equation behind it if it has one.

    Raises:
        docutils.utils.math.MathError: the formula contains an unknown command.
    """
    number = _TAG.search(tex)
    tex = _TAG.sub("", tex).replace(r"\dots", r"\ldots").strip()
    made = tex2mathml(tex, as_block=block)
    return made + f'<span class="eqno">({html.escape(number[1])})</span>' if number else made


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(as_mathml(node.astext()))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{as_mathml(node.astext(), block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer with Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
