"""Put a figure into a page: its SVG without what a page has already, in colours that follow the page's.

Text stays text and can be searched.
"""

from __future__ import annotations

import re
from html import escape

COLOURS = {
    "#000000": "var(--ink)",
    "#ffffff": "var(--sheet)",
    "#e4e4e4": "var(--grid)",
    "#707070": "var(--faint)",
    "#606060": "var(--faint)",
    "#1f4e79": "var(--formation)",
}
"""Colours of a figure on paper, and those on a page that may be dark."""
_ID = re.compile(r'\sid="([^"]*)"')
_USE = re.compile(r'(?:xlink:href="|href="|url\()#([^")]+)')


def inline(svg: str, name: str, text: str, *, recolour: bool = True) -> str:
    """Return an SVG file as an element of a page; `name` is unique on it, `text` describes the figure."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", body, flags=re.DOTALL)
    used = set(_USE.findall(body))
    body = _ID.sub(lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", body)
    body = re.sub(r'((?:xlink:href="|href="|url\()#)', rf"\g<1>{name}-", body)
    if recolour:
        body = re.sub("|".join(COLOURS), lambda found: COLOURS[found[0]], body)
    box = re.search(r'viewBox="[^"]*"', body)
    opening = f'<svg {box[0] if box else ""} role="img" aria-label="{escape(text)}">'
    return re.sub(r"<svg[^>]*>", lambda _: opening, body, count=1)
