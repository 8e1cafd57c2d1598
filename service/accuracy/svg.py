"""Pieces of an SVG drawing as text; everything a caller names is escaped."""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

INK, QUIET, GRID, GROUND, CARD, EDGE = "#1d2129", "#57606a", "#dfe3e8", "#f7f8fa", "#ffffff", "#d0d7de"


def open_svg(width: int, height: int, title: str) -> str:
    """The head of a drawing of so many pixels on a card of its own, so that it reads on any page."""
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    font = f'font-family="system-ui, -apple-system, Segoe UI, Roboto, sans-serif" font-size="12" fill="{INK}"'
    card = f'<rect x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" rx="10" fill="{CARD}" stroke="{EDGE}"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label={quoteattr(title)} {font}>\n{card}'


def text(x: float, y: float, words: str, *, anchor: str = "start", size: int = 12, bold: bool = False, fill: str = INK) -> str:
    """A line of text; (x, y) is on its base line, at its start, middle or end."""
    style = f"{'' if anchor == 'start' else f' text-anchor={quoteattr(anchor)}'}{' font-weight=' + quoteattr('600') if bold else ''}"
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{fill}"{style}>{escape(words)}</text>'


def line(x0: float, y0: float, x1: float, y1: float, color: str = GRID, width: float = 1.0) -> str:
    """A straight line."""
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="{width}"/>'


def steps(corners: list[tuple[float, float]], end: float) -> str:
    """A line that goes to the right, then up or down to the next corner, and on to x = end after the last."""
    (x, y), *others = corners
    path = f"M {x:.1f} {y:.1f} {' '.join(f'H {px:.1f} V {py:.1f}' for px, py in others)} H {end:.1f}"
    return f'<path d="{path}" fill="none" stroke="{INK}" stroke-width="1.3" stroke-linejoin="round" opacity="0.75"/>'


def marker(x: float, y: float, radius: float, *, square: bool, color: str, hollow: bool, opacity: float = 1.0, told: str = "") -> str:
    """A circle or square about (x, y); told: words that show when the pointer rests on it."""
    paint = f'fill="{CARD}" stroke="{color}" stroke-width="1.6"' if hollow else f'fill="{color}" stroke="{CARD}" stroke-width="0.8"'
    faint = "" if opacity == 1.0 else f' opacity="{opacity}"'
    title = f"<title>{escape(told)}</title>" if told else ""
    if square:
        half = 0.9 * radius
        return f'<rect x="{x - half:.1f}" y="{y - half:.1f}" width="{2 * half:.1f}" height="{2 * half:.1f}" {paint}{faint}>{title}</rect>'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" {paint}{faint}>{title}</circle>'


def badge(x: float, y: float, words: str) -> str:
    """A short word on a dark pill about (x, y), BADGE_WIDTH wide."""
    pill = f'<rect x="{x - BADGE_WIDTH / 2:.1f}" y="{y - 7:.1f}" width="{BADGE_WIDTH}" height="14" rx="7" fill="{INK}"/>'
    return pill + text(x, y + 3.5, words, anchor="middle", size=10, bold=True, fill=CARD)


BADGE_WIDTH = 20
"""Pixels."""


def shortened(words: str, most: int) -> str:
    """At most so many characters, the last of them then an ellipsis."""
    return words if len(words) <= most else f"{words[: most - 1]}…"
