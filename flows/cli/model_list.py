"""The command `slipflow models`."""

import json

import typer

from flows.cli.options import AsJson


def models(*, as_json: AsJson = False) -> None:
    """List the shipped detectors and what each is meant for.

    strokes: a fingertip slides over a surface. grasps: fingers hold an object. A detector misses slips of the
    other task. Their cards, with data and scores, are next to the weights.

    Examples:
      slipflow models
    """
    from storage.models import PURPOSES, load_card, shipped

    rows = list[dict[str, object]]()
    for name, purpose in PURPOSES.items():
        path = shipped(name)
        card = load_card(path) if path else {}
        balanced = card.get("scores", {}).get("test", {}).get("balanced")
        where = None if path is None else str(path)
        rows.append({"name": name, **purpose._asdict(), "balanced_test": balanced, "path": where})
    if as_json:
        typer.echo(json.dumps({"models": rows}))
        return
    width = max(map(len, PURPOSES))
    typer.echo("\n".join(f"{row['name']:{width}}  {row['task']:7}  {row['text']}" for row in rows))
