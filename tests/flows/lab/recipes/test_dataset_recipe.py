from collections import Counter
from pathlib import Path

import pytest

from flows.lab.recipes.dataset_recipe import SHIPPED, SourceFile, load_recipe, shipped_recipes
from operators import InputError, ParameterError
from operators.errors import SlipflowError

DIGEST = "a" * 64
OWN = f"""
title = "Taps"
repository = "someone/taps"
commit = "{"b" * 40}"
licence = "CC-BY-4.0"
terms = "Name the authors."
citation = "Someone, Taps, 2026"
rate = 200
columns = {{ t = "time", a = "left", b = "right" }}
derived = {{ c = "a - b" }}
map = {{ time = "t", counts = "a,b,c" }}
[[recordings]]
name = "one"
files = [{{ path = "data/one.csv", bytes = 12, sha256 = "{DIGEST}" }}]
"""


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def test_recipes_of_the_three_converted_datasets_ship_with_the_package() -> None:
    found = {each.name: each for each in shipped_recipes() if not each.not_run_here}
    assert found.keys() == {"strokes", "grasps", "barometers"}
    assert {name: len(each.recordings) for name, each in found.items()} == {
        "strokes": 47,
        "grasps": 7,
        "barometers": 38,
    }
    assert Counter(each.group for each in found["strokes"].recordings) == {
        "dvp_flat": 12,
        "dvp_back": 8,
        "fabric": 7,
        "oboi": 8,
        "still": 6,
        "tkan": 6,
    }
    assert all(each.rate and each.commit for each in found.values())
    assert {name for name, each in found.items() if each.labelled} == {"strokes", "grasps"}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_recipe_states_source_licence_terms_and_citation(name: str) -> None:
    recipe = load_recipe(name)
    assert recipe.name == name
    assert recipe.page.startswith("https://")
    assert min(map(len, (recipe.licence, recipe.terms, recipe.citation, recipe.about, recipe.assumed))) > 2
    assert recipe.files or recipe.not_run_here


def test_an_own_recipe_has_the_name_of_its_file(tmp_path: Path) -> None:
    recipe = load_recipe(written(tmp_path, OWN))
    assert (recipe.name, recipe.rate, recipe.bytes, recipe.labelled) == ("mine", 200.0, 12, False)
    assert recipe.link(recipe.files[0]) == (
        f"https://raw.githubusercontent.com/someone/taps/{'b' * 40}/data/one.csv"
    )
    assert recipe.link(recipe.files[0], "http://localhost:1/") == "http://localhost:1/data/one.csv"


def test_the_url_of_a_file_is_quoted(tmp_path: Path) -> None:
    text = OWN.replace("data/one.csv", "my data/100%.csv").replace("rate", 'url = "https://host/x/"\nrate', 1)
    recipe = load_recipe(written(tmp_path, text))
    assert recipe.link(recipe.files[0]) == "https://host/x/my%20data/100%25.csv"


@pytest.mark.parametrize(
    "path",
    [
        "../one.csv",
        "data/../../one.csv",
        "/etc/passwd",
        "data//one.csv",
        "data/./one.csv",
        "data/",
        "",
        ".",
        "..",
        "...",
        "data\\..\\one.csv",
        "C:one.csv",
        "a\0b",
        "a\nb",
        "~\x7f",
        "x" * 201,
        "a/" * 20 + "b",
    ],
)
def test_a_path_cannot_leave_the_folder(path: str) -> None:
    with pytest.raises(ParameterError, match=r"path is .* must be a path inside the repository"):
        SourceFile(path, 1, DIGEST)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('licence = "CC-BY-4.0"', "", "has no key licence, which is required"),
        ("rate = 200", "rte = 200", "unknown key rte; did you mean 'rate'?"),
        ("rate = 200", "", "rate is 0.0, must be above 0"),
        ("b" * 40, "main", "commit is 'main', must be 40 digits"),
        (DIGEST, "a" * 63, "must be 64 digits"),
        ("bytes = 12", "bytes = 0", "bytes is 0, must be from 1 to"),
        ("bytes = 12", 'bytes = "12"', "must be a whole number"),
        ("data/one.csv", "../one.csv", "must be a path inside the repository"),
        ('name = "one"', 'name = "../one"', "must be letters, digits"),
        ("someone/taps", "someone/taps/../other", "must be OWNER/NAME"),
        ("rate = 200", 'rate = 200\nurl = "http://host/"', "must be an address that begins with https"),
        ('c = "a - b"', 'c = "a - d"', "d is none of a, b, t"),
        ('c = "a - b"', 'c = "open(a)"', "must be numbers, columns"),
        ('c = "a - b"', "c = 3", "must be text in quotes"),
        ('counts = "a,b,c"', 'counts = "a,x"', "x is none of a, b, c, t"),
        ('counts = "a,b,c"', 'cells = "a"', "quantity is 'cells'"),
        ("rate = 200", 'rate = 200\nsplit = "group"', "given for one: split is group"),
        ("rate = 200", 'rate = 200\nlayout = "2x2"', "layout is '0,1/2,3', must be of 3 cells"),
        ("rate = 200", 'rate = 200\nlayout = "wide"', "layout is 'wide', must be ROWSxCOLUMNS"),
        ("rate = 200", 'rate = 200\nrange = "4"', "range is '4', must be LOW:HIGH"),
        ("rate = 200", 'rate = 200\nsplit = "windows"', "must be one of group, recording"),
        ("map = {", "map = 3 #", "must be a table"),
        ("[[recordings]]", "[recordings]", "must be a list"),
    ],
)
def test_a_wrong_recipe_is_an_error_that_names_the_key(
    old: str, new: str, expected: str, tmp_path: Path
) -> None:
    assert OWN.count(old) == 1 or old == DIGEST
    with pytest.raises(SlipflowError) as caught:
        load_recipe(written(tmp_path, OWN.replace(old, new)))
    assert expected in str(caught.value)


def test_recordings_and_paths_differ_also_in_lower_case(tmp_path: Path) -> None:
    second = OWN[OWN.index("[[recordings]]") :].replace('"one"', '"ONE"')
    with pytest.raises(ParameterError, match="different, also in lower case"):
        load_recipe(written(tmp_path, OWN + second))


def test_a_recipe_without_recordings_only_documents_a_dataset(tmp_path: Path) -> None:
    text = OWN[: OWN.index("[[recordings]]")]
    with pytest.raises(ParameterError, match="not_run_here = true"):
        load_recipe(written(tmp_path, text))
    assert load_recipe(written(tmp_path, f"not_run_here = true\n{text}")).files == ()


def test_columns_of_several_files_name_their_file(tmp_path: Path) -> None:
    files = f'files = [{{ path = "b/two.csv", bytes = 1, sha256 = "{DIGEST}" }}, '
    with pytest.raises(ParameterError, match=r"FILE:COLUMN, with a file of one: one.csv, two.csv"):
        load_recipe(written(tmp_path, OWN.replace("files = [", files)))


def test_an_unknown_recipe_is_an_error_that_lists_the_shipped_ones() -> None:
    with pytest.raises(ParameterError, match=r"barometers.*grasps.*strokes"):
        load_recipe("stroke")


def test_the_digest_covers_what_determines_the_dataset(tmp_path: Path) -> None:
    def digest(text: str) -> str:
        return load_recipe(written(tmp_path, text)).digest

    assert digest(OWN) == digest(OWN.replace("Name the authors.", "Cite the authors."))
    for old, new in (("a - b", "a + b"), ("rate = 200", "rate = 100"), (DIGEST, "c" * 64), ('"left"', '"l"')):
        assert digest(OWN) != digest(OWN.replace(old, new))


def test_an_unreadable_recipe_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not valid TOML"):
        load_recipe(written(tmp_path, "x ="))
    with pytest.raises(InputError, match="cannot be read"):
        load_recipe(str(tmp_path / "none.toml"))
