"""Links inside the project: files and anchors of Markdown pages, notebooks and the built site.

Needs no network. The tests check the sources. ``python docs/links.py FOLDER`` checks a built site:
its links, anchors and pictures, and that its search finds words on the pages that explain them.
``make linkcheck`` tries the external links, over the network.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

from markdown_it import MarkdownIt
from markdown_it.token import Token

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
GENERATED = {DOCS / "gallery.md"}  # made when the documentation is built
LINK = re.compile(r"\[[^\]]*\]\([^)]*\)")
SEARCHED = {  # words, and a page that a search for each must find
    "catenary": "statics", "encoder": "drivers", "policy": "learned-control", "sway": "mpc",
    "tachymeter": "calibration-tachymeter", "TwinCAT": "plc", "winch": "robot-yaml",
    "workspace": "workspace",
}  # fmt: skip


def pages() -> list[Path]:
    """Return the Markdown pages and notebooks of the project."""
    found = [*ROOT.glob("*.md"), *(ROOT / "benchmarks").glob("*.md")]
    found += [page for kind in ("*.md", "*.ipynb") for page in DOCS.rglob(kind)]
    return sorted(p for p in found if DOCS / "_build" not in p.parents and p not in GENERATED)


def markdown(page: Path) -> str:
    """Return the text of a Markdown page, or of the Markdown cells of a notebook."""
    text = page.read_text(encoding="utf-8")
    if page.suffix != ".ipynb":
        return text
    cells = json.loads(text)["cells"]
    return "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


@cache
def parse(page: Path) -> list[Token]:
    """Return the tokens of a page."""
    return MarkdownIt("commonmark").enable("table").parse(markdown(page))


def inline(tokens: list[Token]) -> Iterator[Token]:
    """Yield all tokens, those inside others included."""
    for token in tokens:
        yield token
        yield from inline(token.children or [])


def links(page: Path) -> Iterator[str]:
    """Yield the targets of links and pictures of a page, in Markdown or HTML."""
    for token in inline(parse(page)):
        target = token.attrGet("href") or token.attrGet("src")
        if target is not None:
            yield str(target)
        if token.type in ("html_block", "html_inline"):
            yield from re.findall(r"""\b(?:href|src|srcset)=["']([^"']+)["']""", token.content)


@cache
def anchors(page: Path) -> frozenset[str]:
    """Return the anchors of the headings of a page, as GitHub and MyST name them."""
    seen: dict[str, int] = {}
    names = set()
    tokens = parse(page)
    for token, following in pairwise(tokens):
        if token.type == "heading_open":
            text = "".join(t.content for t in following.children or [])
            slug = re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")
            count = seen[slug] = seen.get(slug, -1) + 1
            names.add(f"{slug}-{count}" if count else slug)
        elif token.type == "html_block":
            names |= set(re.findall(r"""\bid=["']([^"']+)["']""", token.content))
    return frozenset(names)


def hidden(page: Path) -> list[str]:
    """Return the links of a page that a line of HTML before them keeps from being links."""
    html = "".join(token.content for token in parse(page) if token.type == "html_block")
    return [f"{link}: follows HTML at the start of its line" for link in LINK.findall(html)]


def broken(page: Path) -> list[str]:
    """Return the links of a page that lead to no file or no heading."""
    faults = []
    for target in links(page):
        address = urlsplit(target)
        if address.scheme or address.netloc:
            continue
        file = (page.parent / unquote(address.path)).resolve() if address.path else page
        if file not in GENERATED and not file.exists():
            faults.append(f"{target}: no such file")
        elif address.fragment and file.suffix in (".md", ".ipynb"):
            if address.fragment not in anchors(file):
                faults.append(f"{target}: no such heading")
    return faults


class SitePage(HTMLParser):
    """Anchors and links of a page of the built site."""

    def __init__(self, text: str) -> None:
        """Read the page."""
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what one tag names and where it leads."""
        for name, value in attrs:
            if value and (name == "id" or (name == "name" and tag == "a")):
                self.anchors.add(value)
            elif value and name in ("href", "src"):
                self.links.append(value)


def broken_in_site(folder: Path) -> list[str]:
    """Return the links of a built site that lead to no file or no anchor."""
    read = {p: SitePage(p.read_text(encoding="utf-8")) for p in sorted(folder.rglob("*.html"))}
    faults = []
    for page, content in read.items():
        for target in dict.fromkeys(content.links):
            address = urlsplit(target)
            if address.scheme or address.netloc:
                continue
            path = unquote(address.path)
            file = (page.parent / path).resolve() if path else page
            known = read.get(file)
            place = f"{page.relative_to(folder)}: {target}"
            if not file.exists():
                faults.append(f"{place}: no such file")
            elif known and address.fragment and unquote(address.fragment) not in known.anchors:
                faults.append(f"{place}: no such anchor")
    return faults


def not_found(folder: Path) -> list[str]:
    """Return the words of `SEARCHED` that the search of a built site does not find."""
    from sphinx.search.en import SearchEnglish

    text = (folder / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").rstrip().rstrip(";").removesuffix(")"))
    stem = SearchEnglish({}).stem
    faults = []
    for word, page in SEARCHED.items():
        hits = [index[kind].get(stem(word.lower()), []) for kind in ("terms", "titleterms")]
        numbers = [k for hit in hits for k in (hit if isinstance(hit, list) else [hit])]
        if page not in {index["docnames"][k] for k in numbers}:
            faults.append(f"search: '{word}' does not find the page {page}")
    return faults


def main() -> int:
    """Check a built site; print its faults and return the exit status."""
    if len(sys.argv) != 2 or not (Path(sys.argv[1]) / "index.html").is_file():
        print("usage: python docs/links.py FOLDER, with a built site in FOLDER", file=sys.stderr)
        return 2
    folder = Path(sys.argv[1]).resolve()
    faults = broken_in_site(folder) + not_found(folder)
    print(*faults, sep="\n", end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
