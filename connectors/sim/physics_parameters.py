"""The physical constants of the simulated fingertip and of the surface it touches.

Where each value comes from: *geometry*, of the device; *paper*, "Under Pressure" (2021); *convergence*, a
finer one changes nothing; *fit*, all together by evolution (CMA-ES), so that the paper's TCN, trained on real
recordings, knows slip in the simulated signal, and so that its level, spread, steps and slip-to-static ratio
are the published ones. Fitted values are effective: they describe the whole finger, not a sample of rubber.
"""

from dataclasses import dataclass

from operators.errors import ParameterError


@dataclass(frozen=True, slots=True)
class Parameters:
    """Constants of one fingertip on one material, in SI units.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> Parameters(columns=6, rows=4).columns
    6
    """

    # the pad
    width: float = 0.024  # m, along x; geometry
    height: float = 0.016  # m, along y; geometry
    columns: int = 8  # nodes along x; convergence
    rows: int = 6  # nodes along y; convergence
    normal_stiffness: float = 6.8e7  # Pa/m; fit
    shear_stiffness: float = 7.6e7  # Pa/m; fit

    # the material it touches
    static_friction: float = 2.1  # fit
    kinetic_friction: float = 0.97  # fit
    stribeck_speed: float = 0.245  # m/s; fit
    texture: float = 0.7  # depth of the friction's modulation; fit
    texture_lengths: tuple[float, float] = (0.011, 0.0043)  # m; fit of a prototype

    # the finger that carries the pad
    mass: float = 0.167  # kg; fit
    stiffness: float = 3900.0  # N/m in the pad's plane; fit: rings at 24 Hz in the air
    damping: float = 0.075  # of critical; fit
    inertia: float = 6e-5  # kg m2 about the pad's normal; chosen, the scores do not depend on it
    twist_stiffness: float = 0.55  # N m/rad about the pad's normal; chosen: rings at 15 Hz
    tilt_stiffness: float = 0.61  # N m/rad about x and about y; fit
    lever: float = 0.054  # m, from the pad's face up to the axis it tilts about; fit

    # the barometers under the rubber
    pitch_x: float = 0.009  # m between cells; fit
    pitch_y: float = 0.009  # m between rows; fit
    depth: float = 0.0039  # m of rubber over the cells; fit
    shear_gain: float = 4.5  # of the response to shear over the half-space's; fit
    sensitivity: float = 0.012  # counts/Pa; fit, below the datasheet's 0.016 (1023 counts over 65 kPa)
    creep: float = 0.5  # of the response follows late; fit
    creep_time: float = 0.8  # s; fit of a prototype
    noise: float = 0.0  # counts, standard deviation; real unloaded cells have 0.43 to 0.7: no result changes
    rest_lowest: int = 420  # counts of an unloaded cell; paper: cells floor 420 to 502 below their rest
    rest_highest: int = 502  # counts

    # the simulation
    step: float = 0.001  # s; convergence

    def __post_init__(self) -> None:
        for name in ("width", "height", "normal_stiffness", "shear_stiffness", "mass", "stiffness", "step"):
            if not getattr(self, name) > 0:
                raise ParameterError("Parameters", name, getattr(self, name), "above 0")
        for name in ("columns", "rows"):
            if getattr(self, name) < 1:
                raise ParameterError("Parameters", name, getattr(self, name), "at least 1")
