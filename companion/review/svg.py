"""Plots and bands as inline SVG: no library, no network, sharp on paper."""

import html
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.session.colors import Color, band_color
from companion.session.flight import CurveData

WIDTH = 1000.0
_LEFT, _RIGHT = 66.0, 8.0
_TOP, _BOTTOM = 20.0, 18.0
_MOST_POINTS = 700
_GAP_S = 1.2
_ROW = 19.0
_LETTER = 5.6  # width of one, roughly


@dataclass(frozen=True)
class Span:
    """The time that all plots of a page share."""

    begin_s: float
    end_s: float

    def x(self, time_s: float) -> float:
        """Return where a time is drawn."""
        share = (time_s - self.begin_s) / max(1e-9, self.end_s - self.begin_s)
        return _LEFT + (WIDTH - _LEFT - _RIGHT) * min(1.0, max(0.0, share))


def plot(
    curve: CurveData,
    span: Span,
    *,
    marks_s: Sequence[float] = (),
    height: float = 150.0,
    widths: Sequence[float] = (),
) -> str:
    """Return one plot: axes, lines with their names, and a tick at each of ``marks_s``."""
    shown = np.isfinite(curve.values)
    low, high = _limits(curve.values[shown] if shown.any() else np.zeros(1))
    inner = height - _TOP - _BOTTOM

    def y(value: float) -> float:
        return _TOP + inner * (1.0 - (value - low) / (high - low))

    parts = [f'<svg class="plot" viewBox="0 0 {WIDTH:g} {height:g}" role="img">']
    parts.append(f'<text class="title" x="{_LEFT:g}" y="12">{html.escape(curve.title)}</text>')
    parts += [_rule(y(value), value) for value in nice_steps(low, high, 4)]
    parts += _time_axis(span, height)
    for time_s in marks_s:
        x = span.x(time_s)
        parts.append(
            f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP:g}" '
            f'y2="{height - _BOTTOM:g}"/>'
        )
    at = WIDTH - _RIGHT
    for index in reversed(range(len(curve.names))):
        name, color = curve.names[index], ink(curve.colors[index])
        at -= _LETTER * len(name) + 6.0
        parts.append(
            f'<text class="key" x="{at:.1f}" y="12" fill="{color}">{html.escape(name)}</text>'
        )
        at -= 14.0
        parts.append(
            f'<line x1="{at:.1f}" x2="{at + 10:.1f}" y1="8.5" y2="8.5" stroke="{color}" '
            'stroke-width="2.5"/>'
        )
        at -= 8.0
        path = _path(curve.time_s, curve.values[:, index], span, y)
        width = widths[index] if index < len(widths) else 1.5
        if path:
            parts.append(f'<path d="{path}" stroke="{color}" stroke-width="{width:g}"/>')
    return "".join([*parts, "</svg>"])


def bands(states: dict[str, list[tuple[float, str]]], span: Span) -> str:
    """Return the states as coloured bands, one above the other."""
    height = 8.0 + _ROW * len(states) + _BOTTOM
    parts = [f'<svg class="plot" viewBox="0 0 {WIDTH:g} {height:g}" role="img">']
    parts += _time_axis(span, height, top=4.0)
    for row, (name, changes) in enumerate(states.items()):
        top = 4.0 + _ROW * row
        words: list[str] = []
        ends = [*(time_s for time_s, _ in changes[1:]), span.end_s]
        for (begin_s, word), end_s in zip(changes, ends, strict=True):
            if word not in words:
                words.append(word)
            left, right = span.x(begin_s), span.x(end_s)
            color = _rgb(band_color(word, words.index(word)))
            wide = max(0.6, right - left)
            parts.append(
                f'<rect x="{left:.1f}" y="{top:.1f}" width="{wide:.1f}" height="{_ROW - 3:g}" '
                f'fill="{color}"><title>{html.escape(word)} from {begin_s:.1f} s to {end_s:.1f} s'
                "</title></rect>"
            )
            letters = int((wide - 6.0) / _LETTER)
            if letters >= min(4, len(word)):
                text = html.escape(word[:letters])
                parts.append(
                    f'<text class="word" x="{left + 3:.1f}" y="{top + 11.5:.1f}">{text}</text>'
                )
        parts.append(
            f'<text class="tick" x="{_LEFT - 4:g}" y="{top + 11.5:.1f}" text-anchor="end">'
            f"{html.escape(name.removeprefix('flight '))}</text>"
        )
    return "".join([*parts, "</svg>"])


def ink(color: Color) -> str:
    """Return a colour of the dark viewer as it is legible on paper."""
    red, green, blue = color
    bright = (0.3 * red + 0.59 * green + 0.11 * blue) / 255.0
    scale = min(1.0, 0.5 / max(0.05, bright))
    return _rgb((round(red * scale), round(green * scale), round(blue * scale)))


def nice_steps(low: float, high: float, count: int) -> list[float]:
    """Return round numbers between ``low`` and ``high``, about ``count`` of them."""
    span = max(1e-9, high - low)
    raw = span / max(1, count)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= raw)
    first = math.ceil(low / step - 1e-9)
    return [round(number * step, 9) for number in range(first, math.floor(high / step + 1e-9) + 1)]


def _limits(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    if low >= 0.0 and low < 0.5 * high:
        low = 0.0
    rim = 0.06 * (high - low) or max(0.5, 0.05 * abs(high))
    return (low if low == 0.0 else low - rim), high + rim


def _rule(at: float, value: float) -> str:
    return (
        f'<line class="grid" x1="{_LEFT:g}" x2="{WIDTH - _RIGHT:g}" y1="{at:.1f}" y2="{at:.1f}"/>'
        f'<text class="tick" x="{_LEFT - 4:g}" y="{at + 3:.1f}" text-anchor="end">{value:g}</text>'
    )


def _time_axis(span: Span, height: float, top: float = _TOP) -> list[str]:
    parts = []
    for time_s in _time_steps(span):
        x = span.x(time_s)
        parts.append(
            f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{top:g}" y2="{height - _BOTTOM:g}"/>'
        )
        parts.append(
            f'<text class="tick" x="{x:.1f}" y="{height - 5:g}" text-anchor="middle">'
            f"{clock_text(time_s)}</text>"
        )
    return parts


def _time_steps(span: Span) -> list[float]:
    """Return times at round seconds, minutes or hours."""
    raw = (span.end_s - span.begin_s) / 9.0
    steps = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400)
    step = next((step for step in steps if step >= raw), math.ceil(raw / 86400) * 86400)
    first = math.ceil(span.begin_s / step)
    return [float(step * index) for index in range(first, math.floor(span.end_s / step) + 1)]


def clock_text(time_s: float) -> str:
    """Return a time since the start: ``42 s`` below two minutes, ``3:05`` above."""
    if time_s < 120.0:
        return f"{time_s:g} s"
    minutes, seconds = divmod(round(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def _path(time_s: FloatArray, values: FloatArray, span: Span, y: Callable[[float], float]) -> str:
    """Return one line: broken at gaps, thinned to what the eye can tell."""
    known = np.isfinite(values)
    time_s, values = time_s[known], values[known]
    time_s, values = _thinned(time_s, values)
    pieces, last_s = [], -math.inf
    for at_s, value in zip(time_s.tolist(), values.tolist(), strict=True):
        step = max(_GAP_S, 3.0 * (span.end_s - span.begin_s) / _MOST_POINTS)
        sign = "M" if at_s - last_s > step else "L"
        pieces.append(f"{sign}{span.x(at_s):.1f} {y(value):.1f}")
        last_s = at_s
    return "".join(pieces)


def _thinned(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Keep the lowest and the highest of every few values."""
    if len(values) <= 2 * _MOST_POINTS:
        return time_s, values
    edges = np.linspace(0, len(values), _MOST_POINTS + 1).astype(int)
    kept: list[int] = []
    for begin, end in itertools.pairwise(edges.tolist()):
        part = values[begin:end]
        kept += sorted({begin + int(part.argmin()), begin + int(part.argmax())})
    return time_s[kept], values[kept]


def _rgb(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)
