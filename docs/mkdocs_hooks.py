"""What the site needs beyond MkDocs, so that the same pages read well on GitHub.

Formulas, as GitHub writes them, become MathML when the site is built: browsers draw it without scripts. Links
that lead out of ``docs/``, to other files of the repository, become their text.
"""

import re
from html import unescape
from typing import Final

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

BLOCK: Final = re.compile(r"^```math\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
INLINE: Final = re.compile(r"\$`(.+?)`\$")
OUTWARD: Final = re.compile(r"\[([^\]]+)\]\((?:\.\./)+(?!docs/)[^)\s]*\)")
FORMULA: Final = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">(?:\\\(|\\\[)(?P<latex>.*?)(?:\\\)|\\\])</(?P=tag)>', re.DOTALL
)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """GitHub's formulas as arithmatex takes them, and no links to what is not on the site."""
    markdown = BLOCK.sub(lambda found: f"$$\n{found[1]}\n$$", markdown)
    markdown = INLINE.sub(r"$\1$", markdown)
    if page.file.src_uri.count("/"):
        return markdown
    return OUTWARD.sub(r"\1", markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Formulas as MathML."""

    def mathml(found: re.Match[str]) -> str:
        display = "block" if found["tag"] == "div" else "inline"
        return convert(unescape(found["latex"]).strip(), display=display)

    return FORMULA.sub(mathml, html)
