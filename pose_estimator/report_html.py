"""The parts that the study's page is built of: one self-contained file that needs no network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 1120px; padding: 28px 28px 80px; background: #fff;
  color: #24292f; font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 27px; line-height: 1.2; margin: 0 0 6px; }
h2 { font-size: 20px; margin: 46px 0 6px; padding-top: 14px; border-top: 2px solid #24292f; }
h3 { font-size: 16px; margin: 26px 0 6px; }
p { margin: 6px 0 12px; max-width: 860px; }
.lead { font-size: 16px; color: #57606a; }
nav { margin: 14px 0 0; font-size: 14px; }
nav a { margin-right: 16px; }
a { color: #0b5cad; text-decoration: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 10px 0 8px; font-size: 14px;
  font-variant-numeric: tabular-nums; }
th, td { padding: 5px 13px; text-align: right; vertical-align: baseline; white-space: nowrap; }
th { font-weight: 600; border-bottom: 1px solid #8c959f; }
th.group { text-align: center; border-bottom: none; color: #57606a; font-weight: 500; }
td { border-bottom: 1px solid #e6e8eb; }
td:first-child, th:first-child { text-align: left; padding-left: 4px; }
tr.mean td { border-top: 1px solid #8c959f; background: #f6f8fa; }
td.text { text-align: left; white-space: normal; }
small { display: block; color: #6e7781; font-size: 11.5px; line-height: 1.25; font-weight: 400; }
.none { color: #9aa1a9; }
.paper, tr.mean td.paper { background: #f5efe3; color: #6b5b3a; font-style: italic; }
th.paper, td.paper { border-left: 3px double #b9a67c; }
.met { color: #116b38; font-weight: 600; }
.short { color: #b3261e; font-weight: 600; }
.unsure { color: #8a5a00; font-weight: 600; }
.notice { background: #fff8e6; border-left: 4px solid #d9a514; padding: 8px 14px; margin: 12px 0; }
figure { margin: 14px 0 22px; }
figure img { width: 100%; height: auto; display: block; }
figcaption, .note { color: #57606a; font-size: 13.5px; max-width: 900px; }
code { font: 13px ui-monospace, "DejaVu Sans Mono", monospace; background: #f3f4f6;
  padding: 1px 5px; overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 3px 18px; font-size: 14px; }
dt { color: #57606a; } dd { margin: 0; overflow-wrap: anywhere; }
@media print { body { max-width: none; padding: 0; } h2 { break-after: avoid; } }
"""

_KINDS = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        text: what it says; empty: a dash.
        below: small text under it, such as the interval.
        best: whether it is set in bold.
        style: a class of the page's style: ``paper``, ``met``, ``text`` ...
    """

    text: str = ""
    below: str = ""
    best: bool = False
    style: str = ""

    def html(self, tag: str = "td") -> str:
        """The cell as HTML."""
        if not self.text and tag == "td":
            content, style = "–", f"{self.style} none".strip()
        else:
            content, style = escape(self.text), self.style
            content = f"<b>{content}</b>" if self.best else content
        small = f"<small>{escape(self.below)}</small>" if self.below else ""
        attribute = f' class="{style}"' if style else ""
        return f"<{tag}{attribute}>{content}{small}</{tag}>"


Row = Sequence["Cell | str"]


def table(
    head: Row,
    rows: Iterable[Row],
    groups: Sequence[tuple[str, int]] = (),
    *,
    last_is_mean: bool = False,
) -> str:
    """A table.

    Args:
        head: names of the columns.
        rows: their cells.
        groups: titles above the columns, and how many columns each is over.
        last_is_mean: sets the last row apart.
    """
    lines = ['<div class="scroll"><table>']
    if groups:
        over = (f'<th class="group" colspan="{n}">{escape(title)}</th>' for title, n in groups)
        lines.append(f"<tr>{''.join(over)}</tr>")
    lines.append(f"<tr>{''.join(_cell(c).html('th') for c in head)}</tr>")
    body = ["".join(_cell(c).html() for c in row) for row in rows]
    lines += [f"<tr>{row}</tr>" for row in body[:-1]]
    last = '<tr class="mean">' if last_is_mean else "<tr>"
    lines += [f"{last}{row}</tr>" for row in body[-1:]]
    lines.append("</table></div>")
    return "\n".join(lines)


def _cell(content: Cell | str) -> Cell:
    return content if isinstance(content, Cell) else Cell(content)


def figure(path: Path, caption: str) -> str:
    """A picture, put into the page itself.

    Raises:
        ValueError: if the file is neither SVG nor PNG.
    """
    if path.suffix not in _KINDS:
        raise ValueError(f"a picture of the page must be {' or '.join(_KINDS)}, got {path.name}")
    data = base64.b64encode(path.read_bytes()).decode()
    source = f"data:{_KINDS[path.suffix]};base64,{data}"
    return (
        f'<figure><img alt="{escape(caption)}" src="{source}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def definitions(entries: Iterable[tuple[str, str]]) -> str:
    """Names with what they stand for; the latter is HTML."""
    return f"<dl>{''.join(f'<dt>{escape(n)}</dt><dd>{text}</dd>' for n, text in entries)}</dl>"


def page(title: str, sections: Sequence[tuple[str, str]], head: str) -> str:
    """The whole page.

    Args:
        title: of the page.
        sections: titles and contents (HTML), with links to them at the top.
        head: HTML below the title.
    """
    links, parts = [], []
    for number, (name, content) in enumerate(sections, start=1):
        links.append(f'<a href="#s{number}">{escape(name)}</a>')
        parts.append(f'<h2 id="s{number}">{escape(name)}</h2>\n{content}')
    return "\n".join(
        [
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
            f"<h1>{escape(title)}</h1>",
            head,
            f"<nav>{' '.join(links)}</nav>",
            *parts,
            "</body></html>\n",
        ]
    )
