"""A mistake in how the command line was used, told in one line."""

import re

import typer


def mistake(error: typer.TyperException) -> str:
    """What is wrong and where to look it up; the whole help of a command that was given none of its own.

    >>> mistake(typer.BadParameter("--surface cube: is no surface: give plane or sphere"))
    'error: --surface cube: is no surface: give plane or sphere'
    """
    text = error.format_message()
    if text.startswith("Usage: "):
        return text
    if type(error) is typer.BadParameter and error.param is None:  # ours, whole as it is
        return f"error: {_one_line(error.message)}"
    text = (
        _one_line(text).removesuffix(".").replace("Value error, ", "").replace("Input should be", "must be")
    )
    text = re.sub(r", unable to parse string as an? \w+$", "", text)
    text = re.sub(r" \(Possible options: (.*)\)$", r". Did you mean \1?", text)
    text = text[0].lower() + text[1:]
    context = getattr(error, "ctx", None)  # knows the command; not all have it
    if context is not None:
        text += f"{'' if text.endswith('?') else '.'} See {context.command_path} --help"
    return f"error: {text}"


def _one_line(text: str) -> str:
    return " ".join(text.split())
