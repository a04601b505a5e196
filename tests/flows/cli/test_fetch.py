from tests.command import slipflow


def test_without_a_name_the_recipes_are_listed_with_size_licence_and_citation() -> None:
    done = slipflow("fetch")
    assert "grasps: Slip in a grasp while the arm moves" in done.stdout
    assert "  47 recordings, 122 MB\n  cite: nomadik" in done.stdout
    assert done.stdout.endswith("\n  licence: none\n")
