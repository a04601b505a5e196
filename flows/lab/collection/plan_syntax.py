"""Surfaces, corners and lists of numbers as a person writes them."""

from typing import TYPE_CHECKING, cast, get_args

from connectors.sim.scene import Curvature
from flows.graph.quantity import quantity
from flows.lab.collection.surfaces import Spot
from operators.errors import ParameterError

if TYPE_CHECKING:
    from flows.lab.collection.collection_run import Box

OWNER = "collect"  # whose options they are


def curvature(text: str, owner: str = OWNER) -> Curvature:
    """The name of a curvature.

    Raises:
        ParameterError: if there is none of that name.
    """
    known = get_args(Curvature)
    if text not in known:
        raise ParameterError(owner, "--surface", text, f"one of {', '.join(known)}")
    return cast("Curvature", text)


def surface(text: str) -> Spot:
    """A surface as ``NAME[:RADIUS][@X,Y,Z,RX,RY,RZ]``; a radius without a unit is in m.

    >>> surface("sphere:60mm@0.4,0,0.1,3.14,0,0")
    Spot(curvature='sphere', place=(0.4, 0.0, 0.1, 3.14, 0.0, 0.0), radius=0.06)

    Raises:
        ParameterError: if it is none.
    """
    body, at, place = text.partition("@")
    name, colon, radius = body.partition(":")
    spot = Spot(curvature(name))
    if colon and name == "plane":
        raise ParameterError(
            OWNER, "--surface", text, "without a radius for a plane; its place comes after @"
        )
    if colon:
        bare = radius.replace(".", "").isdigit()  # in m
        spot = spot._replace(
            radius=quantity(OWNER, "the radius in --surface", f"{radius}m" if bare else radius, "m")
        )
    if at:
        x, y, z, a, b, c = numbers("--surface", place, 6)
        spot = spot._replace(place=(x, y, z, a, b, c))
    return spot


def box(text: str) -> "Box":
    """Two opposite corners, m.

    >>> box("0,0,0,0.1,0.1,0.2")
    ((0.0, 0.0, 0.0), (0.1, 0.1, 0.2))

    Raises:
        ParameterError: if these are not six numbers.
    """
    a, b, c, d, e, f = numbers("--workspace", text, 6)
    return (a, b, c), (d, e, f)


def speeds(text: str) -> tuple[float, ...]:
    """Speeds with commas between, m/s.

    >>> speeds("10mm/s,0.02m/s")
    (0.01, 0.02)

    Raises:
        ParameterError: if these are none.
    """
    return tuple(quantity(OWNER, "--speeds", each, "m/s") for each in text.split(","))


def numbers(option: str, text: str, count: int | None = None) -> list[float]:
    """Numbers with commas between, as many as `count` if it is given.

    >>> numbers("--workspace", "0.1,0.2", 2)
    [0.1, 0.2]

    Raises:
        ParameterError: if these are not.
    """
    try:
        found = [float(each) for each in text.split(",")]
    except ValueError:
        found = []
    if not found or count not in (None, len(found)):
        many = "numbers" if count is None else f"{count} numbers"
        raise ParameterError(OWNER, option, text, f"{many} with commas between")
    return found
