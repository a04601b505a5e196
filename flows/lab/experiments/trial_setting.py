"""What is drawn at random for one trial: friction and mass of the object, place of the grip, vibration."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np

from connectors.sim.grasp import Grasp
from connectors.sim.holding import least_force
from connectors.sim.lift_motion import Lift
from connectors.sim.mallet import Tap
from connectors.sim.objects import Object
from connectors.sim.scene import Faults, Vibration
from flows.lab.experiments.hand_model import Hand
from operators.errors import ParameterError

SPREAD: Final = 0.1  # of mass and friction from trial to trial, to either side; assumed
OFF: Final = (0.004, 0.006)  # m, of the grip from the object's middle, to either side; assumed
SHAKING: Final = 2e-5  # m, of the hand, at 6.5 or 12 Hz as the paper's recordings show; amplitude assumed
SLIDES: Final = 0.003  # m/s: slip by the paper's label


@dataclass(frozen=True, slots=True)
class Nature:
    """How all trials differ from nominal: factors of friction and mass, and cells that do not answer."""

    friction: float = 1.0
    mass: float = 1.0
    dead: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Conditions:
    """What every trial of an experiment shares.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    hand: Hand = field(default_factory=Hand)
    nature: Nature = field(default_factory=Nature)
    rate: float = 100.0  # Hz, of samples
    every: int = 1  # samples, of which the first is a reading; it is held for the others
    weak: float = 1.0  # factor of the grip that a lift begins with
    pace: float = 1.0  # factor of the speed and of the acceleration of a lift

    def __post_init__(self) -> None:
        for name in ("rate", "every", "weak", "pace"):
            if not getattr(self, name) > 0:
                raise ParameterError("Conditions", name, getattr(self, name), "above 0")


@dataclass(frozen=True, slots=True)
class Setting:
    """One trial as it was drawn."""

    held: Object
    seed: int
    friction: float  # factor
    mass: float  # factor
    grip: tuple[float, float]  # m
    vibration: Vibration
    nature: Nature

    @classmethod
    def drawn(cls, held: Object, seed: int, nature: Nature) -> Self:
        """The trial of a seed; the same for every detector and rule."""
        random = np.random.default_rng([seed, 7])
        friction, mass = (
            each * float(random.uniform(1 - SPREAD, 1 + SPREAD)) for each in (nature.friction, nature.mass)
        )
        x, y = (random.uniform(-1, 1, 2) * OFF).tolist()
        shaking = Vibration(SHAKING, float(random.choice([6.5, 12.0])), float(random.uniform(0, 360)))
        return cls(held, seed, friction, mass, (x, y), shaking, nature)

    @property
    def least(self) -> float:
        """The least force that holds it (N)."""
        return least_force(self.held, friction=self.friction, mass=self.mass)

    @property
    def expected(self) -> float:
        """The least force (N), were its nature the nominal one: what a hand reckons with."""
        return self.least * self.nature.friction / self.nature.mass

    def grasp(self, lift: Lift, taps: Sequence[Tap] = ()) -> Grasp:
        """An open hand around the object, to be lifted, and tapped."""
        return Grasp(
            self.held,
            seed=self.seed,
            force=0.0,
            closing=0.0,
            lift=lift,
            taps=taps,
            friction=self.friction,
            mass=self.mass,
            grip=self.grip,
            vibration=self.vibration,
            faults=Faults(dead=self.nature.dead),
        )
