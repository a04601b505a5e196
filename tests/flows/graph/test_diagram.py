import re
from itertools import combinations
from xml.etree import ElementTree as ET

from flows.graph import Flow
from flows.graph.diagram import svg
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Scores

SVG = "{http://www.w3.org/2000/svg}"


def _parsed(flow: Flow) -> ET.Element:
    return ET.fromstring(svg(flow))  # noqa: S314 - ours


def _texts(picture: ET.Element) -> list[str]:
    return [each.text or "" for each in picture.iter(f"{SVG}text")]


def _boxes(picture: ET.Element) -> list[tuple[float, float, float, float]]:
    names = "x", "y", "width", "height"
    found = [[float(each.attrib[name]) for name in names] for each in picture.iter(f"{SVG}rect")]
    return [(x, y, x + width, y + height) for x, y, width, height in found]


def test_every_part_is_a_box_with_its_parameters_and_every_output_is_named(drawn: Flow) -> None:
    picture = _parsed(drawn)
    texts = _texts(picture)
    assert len(_boxes(picture)) == 6
    assert {"Zero", "baseline=400", "Align", "within=10\u00a0ms", "TestSink"} < set(texts)
    kinds = [each.text for each in picture.iter(f"{SVG}text") if each.get("class") == "kind"]
    assert sorted(map(str, kinds)) == ["Labelled", "Motion", "Sample", "Touch", "Zeroed"]


def test_every_edge_is_a_curve(drawn: Flow) -> None:
    edges = [each for each in _parsed(drawn).iter(f"{SVG}path") if each.get("marker-end")]
    assert len(edges) == 6


def test_no_two_boxes_overlap_and_all_lie_in_the_picture(drawn: Flow) -> None:
    for count in range(5):
        (drawn.source(TestSource(Scores)) | Debounce(consecutive=count + 3, threshold=0.9)).to(TestSink())
    picture = _parsed(drawn)
    boxes = _boxes(picture)
    for (x0, y0, x1, y1), (u0, v0, u1, v1) in combinations(boxes, 2):
        assert x1 <= u0 or u1 <= x0 or y1 <= v0 or v1 <= y0
    width, height = float(picture.attrib["width"]), float(picture.attrib["height"])
    assert all(x0 >= 0 and x1 <= width and y0 >= 0 and y1 <= height for x0, y0, x1, y1 in boxes)


def test_an_edge_passes_no_box_on_its_way(drawn: Flow) -> None:
    picture = _parsed(drawn)
    ways = [
        way
        for edge in picture.iter(f"{SVG}path")
        for way in re.findall(r"(?<=[ ])(\d+) (\d+)H(\d+)", edge.attrib["d"])
    ]
    assert ways
    for x0, y, x1 in ways:
        for left, top, right, bottom in _boxes(picture):
            assert not (float(x0) < right and left < float(x1) and top <= float(y) <= bottom)


def test_what_a_name_holds_stays_text() -> None:
    flow = Flow('a"<b>&')
    flow.source(TestSource(Scores)).to(TestSink())
    assert _parsed(flow).attrib["aria-label"] == 'flow a"<b>&'


def test_a_flow_of_nothing_is_an_empty_picture() -> None:
    assert not _boxes(_parsed(Flow("empty")))
