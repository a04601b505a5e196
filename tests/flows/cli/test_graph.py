"""`slipflow graph` in processes of its own."""

from tests.command import slipflow


def test_graph_draws_text_and_mermaid() -> None:
    assert slipflow("graph", "record").stdout.startswith("flow record\n")
    assert slipflow("graph", "record", "--mermaid").stdout.startswith("flowchart LR\n")
