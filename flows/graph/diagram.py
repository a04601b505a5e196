"""A flow as a picture, an SVG: boxes from left to right, each output named by what flows out of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from textwrap import wrap
from typing import Final
from xml.sax.saxutils import escape

from flows.graph.drawing import describe
from flows.graph.flow import Flow
from flows.graph.node import Node
from operators.ports import Sink, Source

_LETTER: Final = 7.3  # px, width of a letter
_LINE: Final = 16  # px
_PAD: Final = 10  # px, about the text of a box
_APART: Final = 18  # px, between boxes one above the other
_GAP: Final = 34  # px, between columns, and what the longest name of an output takes
_LONGEST: Final = 26  # letters of a line of parameters
_HEAD: Final = ' class="head"'

_STYLE: Final = """<style>
svg { background: #fff; font: 12px ui-monospace, Menlo, Consolas, monospace; fill: #1b2733 }
rect { fill: #fff; stroke: #6b7a89 } rect.end { fill: #e3f0fb; stroke: #2f74b5 }
path { fill: none; stroke: #6b7a89; stroke-width: 1.3 } marker path { fill: #6b7a89; stroke: none }
.head { font-weight: 600 } .kind { fill: #2f74b5; font-size: 11px }
.kind { paint-order: stroke; stroke: #fff; stroke-width: 3 }
</style>
<marker id="to" viewBox="0 0 8 8" refX="7.5" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0.5 8 4 0 7.5z"/></marker>"""


@dataclass(eq=False)
class _Box:
    """A part of the flow; without one: where an edge passes a column."""

    node: Node | None
    lines: list[str] = field(default_factory=list[str])
    inputs: list["_Box"] = field(default_factory=list["_Box"])
    y: float = 0.0  # px, of its middle

    @property
    def width(self) -> float:
        return max(map(len, self.lines), default=0) * _LETTER + 2 * _PAD

    @property
    def height(self) -> float:
        return len(self.lines) * _LINE + (_PAD if self.lines else 0)

    @property
    def kind(self) -> str:
        """What it gives."""
        return self.node.gives.__name__ if self.node and self.node.gives else ""


def svg(flow: Flow) -> str:
    """A flow as an SVG document: sources and sinks in blue, operators with what differs from their defaults.

    >>> from flows.graph.testing import TestSource
    >>> from operators import Scores
    >>> flow = Flow("felt")
    >>> stream = flow.source(TestSource(Scores))
    >>> print(svg(flow).splitlines()[0].partition(" width")[0])
    <svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="flow felt"
    """
    columns = _columns(flow.nodes)
    for column in columns:
        _stack(column)
    top = min((box.y - box.height / 2 for column in columns for box in column), default=0) - _APART
    left, right, x = dict[_Box, float](), dict[_Box, float](), float(_APART)
    for column in columns:
        width = max(box.width for box in column)
        for box in column:
            box.y -= top
            left[box], right[box] = x, x + (box.width if box.node else width)
        x += width + _GAP + max(len(box.kind) for box in column) * _LETTER
    boxes = [box for column in columns for box in column if box.node]
    height = max((box.y + box.height / 2 for box in boxes), default=0) + _APART
    width = max(right.values(), default=0) + _APART
    drawn = [_edge(source, box, left, right) for box in boxes for source in box.inputs]
    drawn += [_drawn(box, left[box], right[box]) for box in boxes]
    label = escape(f"flow {flow.name}", {'"': "&quot;"})
    size = f'width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.0f} {height:.0f}"'
    opening = f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{label}" {size}>'
    return "\n".join([opening, _STYLE, *drawn, "</svg>"])


def _columns(nodes: Sequence[Node]) -> list[list[_Box]]:
    """The boxes by how many steps they are from a source; an edge has a box in each column that it passes."""
    depth, boxes = dict[Node, int](), {node: _Box(node, _lines(node)) for node in nodes}

    def deep(node: Node) -> int:
        if node not in depth:
            depth[node] = 1 + max((deep(parent) for parent in node.inputs), default=-1)
        return depth[node]

    columns: list[list[_Box]] = [[] for _ in range(1 + max(map(deep, nodes), default=-1))]
    for node, box in boxes.items():
        columns[deep(node)].append(box)
        for parent in node.inputs:
            source = boxes[parent]
            for column in columns[deep(parent) + 1 : deep(node)]:
                column.append(source := _Box(None, inputs=[source]))
            box.inputs.append(source)
    return columns


def _lines(node: Node) -> list[str]:
    head, _, rest = describe(node.part).partition("(")
    told = rest.removesuffix(")").replace(" ms", "\u00a0ms")  # which no line ends between
    return [head, *wrap(told, _LONGEST, break_long_words=False, break_on_hyphens=False)]


def _stack(column: list[_Box]) -> None:
    """Put the boxes of a column one above the other, near to what feeds them."""

    def wanted(box: _Box) -> float:
        return sum(source.y for source in box.inputs) / len(box.inputs) if box.inputs else 0.0

    column.sort(key=wanted)
    bottom, off = float("-inf"), 0.0
    for box in column:
        box.y = max(wanted(box), bottom + _APART + box.height / 2)
        bottom = box.y + box.height / 2
        off += box.y - wanted(box)
    for box in column:
        box.y -= off / len(column)


def _edge(source: _Box, box: _Box, left: dict[_Box, float], right: dict[_Box, float]) -> str:
    """The curve from what feeds a box, by the columns that it passes."""
    way = [source]
    while not way[0].node:
        way.insert(0, way[0].inputs[0])
    path = f"M{right[way[0]]:.0f} {way[0].y:.0f}"
    for before, after in zip(way, [*way[1:], box], strict=True):
        middle = (right[before] + left[after]) / 2
        path += f"C{middle:.0f} {before.y:.0f} {middle:.0f} {after.y:.0f} {left[after]:.0f} {after.y:.0f}"
        path += "" if after.node else f"H{right[after]:.0f}"
    return f'<path d="{path}" marker-end="url(#to)"/>'


def _drawn(box: _Box, left: float, right: float) -> str:
    """The box of a part, and the name of what it gives."""
    end = isinstance(box.node and box.node.part, Source | Sink)
    top, look = box.y - box.height / 2, ' class="end"' if end else ""
    rounded = box.height / 2 if end and len(box.lines) == 1 else 6 if end else 2
    size = f'width="{right - left:.0f}" height="{box.height:.0f}" rx="{rounded:.0f}"'
    drawn = [f'<rect{look} x="{left:.0f}" y="{top:.0f}" {size}/>']
    for number, line in enumerate(box.lines):
        place = f'x="{left + _PAD:.0f}" y="{top + _PAD / 2 + 12 + number * _LINE:.0f}"'
        drawn.append(f"<text {place}{_HEAD if number == 0 else ''}>{escape(line)}</text>")
    if box.kind:
        drawn.append(f'<text x="{right + 5:.0f}" y="{box.y - 5:.0f}" class="kind">{box.kind}</text>')
    return "\n".join(drawn)
