"""Description of a recipe for the terminal and as JSON data."""

from typing import Any, Final

from flows.lab.recipes.dataset_recipe import DatasetRecipe
from flows.report.table import counted

MB: Final = 1_000_000  # bytes

_STATED: Final = (
    *("name", "title", "licence", "terms", "citation", "about", "assumed", "label_rule", "split", "group"),
    *("not_run_here", "rate", "labelled"),
)


def recipe_json(recipe: DatasetRecipe) -> dict[str, Any]:
    """Return a recipe as JSON data, without its columns and files."""
    return {
        **{name: getattr(recipe, name) for name in _STATED},
        "source": recipe.page,
        "recordings": len(recipe.recordings),
        "bytes": recipe.bytes,
    }


def recipe_summary(recipe: DatasetRecipe) -> str:
    """Return title, size, licence and citation of a recipe."""
    recordings = counted(len(recipe.recordings), "recording")
    size = f"{recordings}, {size_text(recipe.bytes)}" if recipe.files else "no files"
    note = "; not run here" if recipe.not_run_here else ""
    lines = f"{recipe.name}: {recipe.title}", f"{size}; licence: {recipe.licence}{note}"
    return "\n  ".join([*lines, f"cite: {recipe.citation}"])


def recipe_text(recipe: DatasetRecipe) -> str:
    """Return everything that a recipe states, without its columns and files."""
    lines = [recipe_summary(recipe), f"source: {recipe.page}", f"terms: {recipe.terms}"]
    for name, text in (("about", recipe.about), ("assumed", recipe.assumed), ("labels", recipe.label_rule)):
        lines += [f"{name}: {text}"] if text else []
    return "\n  ".join(lines)


def size_text(size: int) -> str:
    """Return a number of bytes in kB or MB.

    >>> size_text(546), size_text(122_379_566)
    ('0.546 kB', '122 MB')
    """
    return f"{size / 1e6:.3g} MB" if size >= MB else f"{size / 1e3:.3g} kB"
