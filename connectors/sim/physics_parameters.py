"""Physical constants of the simulated fingertip and of the touched surface.

Sources: *geometry* of the device; *paper*, "Under Pressure" (2021); *convergence*, a finer value changes
nothing; *fit*, all together by `tests.scene.scene_fit`: the paper's TCN, trained on real recordings, detects
slip in the simulated signal, and statistics, relaxation and spectrum match real ones.
Fitted values are effective: they describe the whole finger, not a sample of rubber.
"""

from dataclasses import dataclass

from operators.checks import check_above, check_at_least


@dataclass(frozen=True, slots=True)
class Parameters:
    """Constants of one fingertip on one material, in SI units.

    Raises:
        ParameterError: if a dimension, stiffness, mass or step is not above 0, or the grid is empty.

    >>> Parameters(columns=6, rows=4).columns
    6
    """

    # pad
    width: float = 0.024  # m, along x; geometry
    height: float = 0.016  # m, along y; geometry
    columns: int = 8  # nodes along x; convergence
    rows: int = 6  # nodes along y; convergence
    normal_stiffness: float = 1.074e8  # Pa/m; fit
    shear_stiffness: float = 3.177e7  # Pa/m; fit

    # touched material
    static_friction: float = 1.443  # fit
    kinetic_friction: float = 0.6559  # fit
    stribeck_speed: float = 0.1918  # m/s; fit
    texture: float = 0.4903  # depth of the friction's modulation along the path; fit
    texture_lengths: tuple[float, float] = (0.006675, 0.00392)  # m; fit

    # finger that carries the pad
    mass: float = 0.1357  # kg; fit
    stiffness: float = 2143.0  # N/m in the pad's plane; fit: resonance at 20 Hz in the air
    damping: float = 0.04358  # damping ratio; fit
    inertia: float = 6e-5  # kg m2 about the pad's normal; assumed, without effect on the scores
    twist_stiffness: float = 0.55  # N m/rad about the pad's normal; assumed: resonance at 15 Hz
    tilt_stiffness: float = 1.083  # N m/rad about x and about y; fit
    lever: float = 0.04397  # m, from the pad's face to the tilt axes; fit

    # barometers under the rubber
    pitch_x: float = 0.008643  # m between cells; fit
    pitch_y: float = 0.00798  # m between rows; fit
    depth: float = 0.00564  # m of rubber over the cells; fit
    shear_gain: float = 2.645  # factor of the half-space's response to shear; fit
    sensitivity: float = 0.01128  # counts/Pa; fit, below the datasheet's 0.016 (1023 counts over 65 kPa)
    relaxation: float = 0.06517  # fraction of the response that is lost per decade of time; fit
    noise: float = 0.6  # counts, standard deviation; paper: 0.43 to 0.7 of unloaded cells
    rest_lowest: int = 420  # counts of an unloaded cell; paper: cells reach 0 at 420 to 502 counts below rest
    rest_highest: int = 502  # counts

    # simulation
    step: float = 0.001  # s; convergence

    def __post_init__(self) -> None:
        for name in ("width", "height", "normal_stiffness", "shear_stiffness", "mass", "stiffness", "step"):
            check_above("Parameters", name, getattr(self, name), 0)
        for name in ("columns", "rows"):
            check_at_least("Parameters", name, getattr(self, name), 1)
