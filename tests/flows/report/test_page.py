from html.parser import HTMLParser
from pathlib import Path

from flows.report.figures import Figure, grid, styled
from flows.report.page import Page, Section, Table
from flows.report.report_files import write_page

TABLE = Table(["method", "F1 < 90"], [["<b>tcn</b>", "1 & 2"], ["psd", "3"]], caption="a > b")


@styled
def figure() -> Figure:
    drawn, (axis,) = grid(1, 1, (2, 2))
    axis.plot([0, 1], label="x")
    axis.set(title="A <title>", xlabel="x")
    axis.imshow([[0, 1], [1, 0]])
    return drawn


class Tags(HTMLParser):
    """Which elements there are, and that each one that opens also closes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.seen = list[str](), list[str]()
        self.ids = list[str]()
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in {"meta", "image"}:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag: str) -> None:
        if tag != "image":
            assert self.open.pop() == tag


def page() -> Page:
    sections = [Section(name, f"{name} & so <on>", "text", [TABLE], figure()) for name in ("one", "two")]
    return Page("A <page>", "of & findings", sections, "slipflow evaluate 'a<b>'")


def test_everything_that_is_said_is_escaped() -> None:
    html = page().html()
    for text in ("<b>tcn", "<on>", "<page>", "a<b>"):
        assert text not in html
    for text in (
        "&lt;b&gt;tcn&lt;/b&gt;",
        "one &amp; so &lt;on&gt;",
        "A &lt;page&gt;",
        "&#x27;a&lt;b&gt;&#x27;",
    ):
        assert text in html


def test_the_page_needs_nothing_from_outside() -> None:
    html = page().html()
    for text in ("http:", "https:", "src=", "@import", "<script", "<link", "xlink"):
        assert text not in html


def test_the_page_is_well_formed_and_its_figures_share_no_identifier() -> None:
    tags = Tags(page().html())
    assert tags.seen.count("svg") == 2
    assert tags.seen.count("table") == 2
    assert len(set(tags.ids)) == len(tags.ids) > 10


def test_what_a_figure_refers_to_is_in_it() -> None:
    html = page().html()
    tags = Tags(html)
    referred = [part.split('"')[0] for part in html.split('href="#')[1:]]
    referred += [part.split(")")[0] for part in html.split("url(#")[1:]]
    assert referred
    assert set(referred) <= set(tags.ids)


def test_a_section_without_a_figure_has_its_tables() -> None:
    section = Section("one", "title", "text", [TABLE, TABLE])
    assert "<svg" not in section.html()
    assert section.html().count("<table>") == 2
    assert section.markdown().startswith("## title\n\ntext\n\na > b\n\n| method")


def test_words_stand_to_the_left_and_numbers_to_the_right() -> None:
    table = Table(
        ["method", "object", "delay", "how"], [["psd", "ball", "-", "1 missed"], ["tcn", "box", "9", "-"]]
    )
    assert table.markdown().splitlines()[1] == "| ------ | ------ | ----: | -------- |"
    assert '<td class="text">ball</td><td>-</td><td class="text">1 missed</td>' in table.html()


def test_markdown_holds_the_same_tables() -> None:
    markdown = page().markdown()
    assert markdown.startswith("# A <page>\n\nof & findings\n\n## one")
    assert markdown.count("| <b>tcn</b> |   1 & 2 |") == 2
    assert markdown.endswith("\n\n    slipflow evaluate 'a<b>'\n")


def test_the_markdown_of_a_file_shows_the_figures_that_are_written_beside_it(tmp_path: Path) -> None:
    paths = write_page(page(), {}, tmp_path, "found")
    markdown = (tmp_path / "found.md").read_text()
    figures = [path.name for path in paths if path.suffix == ".svg"]
    assert figures
    assert all(f"]({figure})" in markdown for figure in figures)
