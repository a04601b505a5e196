from collections.abc import Callable
from math import isnan

import numpy as np
import pytest

from connectors.emulators.dashboard_server import answer
from connectors.emulators.ur_control_box import ControlBox, RuntimeState, SafetyMode
from connectors.emulators.ur_program import Command
from connectors.ur.rtde import Value, Version
from operators.batch import Commands, s
from tests.connectors.emulators.faulty_ur import release_emergency, stop_in_emergency
from tests.connectors.emulators.free_arm import FreeArm, PressedArm

SCRIPT = "def rtde_control():\n  global x = read_input_integer_reg(0)"
TARGET = [0.05, 0.02, 0.0, 0.0, 0.0, 0.1]


class Recorder(FreeArm):
    """Arm that keeps the commands it received."""

    def __init__(self) -> None:
        super().__init__(np.zeros(6), acceleration=5.0)
        self.received = list[Commands]()

    def command(self, commands: Commands) -> None:
        """Obey."""
        self.received.append(commands)
        super().command(commands)


class Cell:
    """A control box with an arm, in time of its own."""

    def __init__(self, version: Version = Version(3, 15, 0, 0)) -> None:  # noqa: B008 - it does not change
        self.arm = Recorder()
        self.box = ControlBox(self.arm, version)
        self.time = 0  # cycles

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let it run; give how long it ran, s."""
        for cycle in range(round(seconds * self.box.rate)):
            if until():
                return cycle / self.box.rate
            self.time += 1
            self.box.cycle(round(self.time / self.box.rate * s))
        return seconds

    def ask(self, command: int, *doubles: float, asynchronous: int = 0) -> None:
        """Write a command as a client does."""
        values: dict[str, Value] = {f"input_double_register_{i}": each for i, each in enumerate(doubles)}
        self.box.write({"input_int_register_0": command, "input_int_register_1": asynchronous} | values)

    def done(self) -> bool:
        """Return True if a command is complete."""
        return self.value("output_int_register_0") == 2

    def ready(self) -> None:
        """Take the command back and wait until the program is ready for the next."""
        self.ask(Command.NONE)
        assert self.run(1.0, lambda: self.value("output_int_register_0") == 1) < 1.0

    def value(self, name: str) -> Value:
        """A variable as of the newest cycle."""
        return self.box.values([name])[0]

    @property
    def speed(self) -> float:
        """Speed of the TCP, m/s."""
        velocity = self.value("actual_TCP_speed")
        assert isinstance(velocity, tuple)
        return float(np.linalg.norm(velocity[:3]))

    @property
    def pose(self) -> tuple[float, ...]:
        """Pose of the TCP."""
        pose = self.value("actual_TCP_pose")
        assert isinstance(pose, tuple)
        return pose


@pytest.fixture
def cell() -> Cell:
    """A CB3 control box that runs ur-rtde's program."""
    cell = Cell()
    cell.box.run_script(SCRIPT)
    cell.run(0.1)
    return cell


def test_a_command_is_overdue_only_for_a_client_that_has_set_a_watchdog(cell: Cell) -> None:
    cell.run(1.0)
    assert not cell.box.command_overdue
    cell.ask(Command.SET_WATCHDOG, 1.0)
    cell.run(0.09)
    assert not cell.box.command_overdue
    assert cell.run(1.0, lambda: cell.box.command_overdue) == pytest.approx(0.02, abs=0.01)
    cell.ask(Command.NONE)
    assert not cell.box.command_overdue
    cell.run(2.0)
    assert cell.box.runtime_state == RuntimeState.STOPPED  # by the watchdog
    assert not cell.box.command_overdue


# --- clock and variables ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("major", "rate"), [(3, 125.0), (5, 500.0)])
def test_its_clock_steps_by_its_cycle_and_begins_anew_with_it(major: int, rate: float) -> None:
    cell = Cell(Version(major, 11, 0, 0))
    cell.run(2.0)
    assert cell.box.rate == rate
    assert cell.value("timestamp") == 2.0
    cell.box.power_up()
    cell.run(1 / rate)
    assert cell.value("timestamp") == 1 / rate


def test_an_arm_is_left_alone_until_somebody_wants_it_to_move() -> None:
    cell = Cell()
    cell.run(1.0)
    assert not cell.arm.received


def test_what_the_scene_does_not_have_is_not_invented() -> None:
    cell = Cell()
    cell.run(0.1)
    joints, current = cell.value("actual_q"), cell.value("actual_robot_current")
    assert isinstance(joints, tuple)
    assert isinstance(current, float)
    assert isnan(current)
    assert all(map(isnan, joints))
    force = cell.value("actual_TCP_force")
    assert isinstance(force, tuple)
    assert all(map(isnan, force))
    assert cell.value("joint_mode") == (0,) * 6


def test_an_arm_that_knows_what_pushes_it_has_it_shown() -> None:
    cell = Cell()
    cell.box = ControlBox(PressedArm(np.array([0.0, 0.0, -0.003, 0.0, 0.0, 0.0])), Version(3, 15, 0, 0))
    cell.run(0.1)
    assert cell.value("actual_TCP_force") == pytest.approx((0.0, 0.0, 3.0, 0.0, 0.0, 0.0))


# --- the program -----------------------------------------------------------------------------------------


def test_an_upload_runs_and_is_ready(cell: Cell) -> None:
    assert cell.value("runtime_state") == 2
    assert cell.value("output_int_register_0") == 1
    assert cell.value("robot_status_bits") == 0b11


def test_a_line_is_done_where_it_should_end_and_once_only(cell: Cell) -> None:
    cell.ask(Command.MOVE_LINE, *TARGET, 0.1, 1.0)
    took = cell.run(10.0, cell.done)
    assert took == pytest.approx(0.1 / 0.1, abs=0.6)
    assert cell.pose == pytest.approx(TARGET, abs=1e-4)
    received = len(cell.arm.received)
    cell.run(1.0)  # the command still stands in the register
    assert len(cell.arm.received) == received
    cell.ready()


def test_a_line_that_runs_by_itself_can_be_stopped_and_shows_in_the_register(cell: Cell) -> None:
    running = 1 << 15
    before = cell.value("output_int_register_2")
    cell.ask(Command.MOVE_LINE, 1.0, *TARGET[1:], 0.1, 1.0, asynchronous=1)
    assert cell.run(1.0, cell.done) < 0.1
    cell.ready()
    cell.run(0.5)
    state = cell.value("output_int_register_2")
    assert isinstance(state, int)
    assert isinstance(before, int)
    assert state & running
    assert (state >> 24) == (before >> 24) + 1
    assert cell.speed > 0.09
    cell.ask(Command.STOP_LINE, 0.5)
    assert cell.run(1.0, cell.done) == pytest.approx(0.1 / 0.5, abs=0.1)
    assert cell.speed < 1e-3
    stopped = cell.value("output_int_register_2")
    assert isinstance(stopped, int)
    assert not stopped & running
    assert 0.02 < cell.pose[0] < 0.2


@pytest.mark.parametrize("stop", [Command.STOP_SPEED, Command.STOP_LINE, Command.STOP_JOINTS])
def test_a_speed_goes_on_until_it_is_stopped(cell: Cell, stop: Command) -> None:
    cell.ask(Command.SPEED, 0.03, -0.04, 0, 0, 0, 0, 1.0, 0.0)
    cell.run(2.0)
    assert cell.value("output_int_register_0") == 1  # ready: a speed is taken at once
    assert cell.speed == pytest.approx(0.05)
    cell.ask(stop, 1.0)
    assert cell.run(1.0, cell.done) < 0.2
    assert cell.speed < 1e-3


def test_a_speed_can_be_changed_on_the_way(cell: Cell) -> None:
    cell.ask(Command.SPEED, 0.05, 0, 0, 0, 0, 0, 1.0)
    cell.run(1.0)
    cell.ask(Command.SPEED, 0, 0, 0, 0, 0, 1.0, 1.0)
    cell.run(2.0)
    assert cell.value("actual_TCP_speed") == pytest.approx((0, 0, 0, 0, 0, 1.0))


def test_whether_it_stands_is_answered(cell: Cell) -> None:
    steady = list[Value]()
    for _ in range(2):
        cell.ask(Command.IS_STEADY)
        cell.run(1.0, cell.done)
        steady.append(cell.value("output_int_register_1"))
        cell.ready()
        cell.ask(Command.SPEED, 0.05, 0, 0, 0, 0, 0, 1.0)
        cell.run(0.5)
    assert steady == [1, 0]


def test_the_end_ends_the_program_and_stops_the_arm(cell: Cell) -> None:
    cell.ask(Command.SPEED, 0.05, 0, 0, 0, 0, 0, 1.0)
    cell.run(1.0)
    cell.ask(Command.END)
    cell.run(0.5)
    assert cell.value("runtime_state") == 1
    assert cell.speed < 1e-3


def test_what_is_not_emulated_ends_the_program_as_an_error_does(
    cell: Cell, caplog: pytest.LogCaptureFixture
) -> None:
    cell.ask(6)  # force mode
    cell.run(0.1)
    assert cell.value("runtime_state") == RuntimeState.STOPPED
    assert not cell.done()
    assert "command 6 is not emulated" in caplog.text
    cell.box.run_script("movej([0, 0, 0, 0, 0, 0])")
    cell.run(0.1)
    assert cell.value("runtime_state") == RuntimeState.STOPPED
    assert "an unsupported script: movej" in caplog.text


def test_the_watchdog_stops_an_arm_that_nobody_tends(cell: Cell) -> None:
    cell.ask(Command.SET_WATCHDOG, 10.0)
    cell.run(1.0, cell.done)
    cell.ready()
    for _ in range(20):
        cell.ask(Command.SPEED, 0.05, 0, 0, 0, 0, 0, 1.0)
        cell.run(0.09)
    assert cell.speed == pytest.approx(0.05)
    cell.ask(Command.SPEED, 0.05, 0, 0, 0, 0, 0, 1.0)
    assert cell.run(1.0, lambda: cell.value("runtime_state") == 1) == pytest.approx(0.1, abs=0.02)
    cell.run(0.5)
    assert cell.speed < 1e-3


# --- stops -----------------------------------------------------------------------------------------------


def test_after_a_protective_stop_nothing_moves_or_runs_until_it_is_unlocked(cell: Cell) -> None:
    cell.ask(Command.MOVE_LINE, *TARGET, 0.1, 1.0)
    cell.run(0.5)
    cell.box.stop_protectively("for a test")
    cell.run(0.5)
    assert cell.speed < 1e-3
    assert cell.value("safety_status_bits") == 1 << 2 | 1 << 10
    where = cell.pose
    assert answer(cell.box, "safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    cell.box.run_script(SCRIPT)
    cell.run(5.0)
    assert cell.value("runtime_state") == RuntimeState.STOPPED
    assert cell.pose == pytest.approx(where, abs=1e-9)
    assert answer(cell.box, "unlock protective stop") == "Protective stop releasing"
    assert cell.value("safety_mode") == SafetyMode.PROTECTIVE_STOP  # until the next cycle
    cell.box.run_script(SCRIPT)
    assert cell.run(10.0, cell.done) < 2.0  # the line that is still in the register
    assert cell.value("safety_status_bits") == 1


def test_a_program_may_stop_itself_protectively(cell: Cell) -> None:
    cell.ask(Command.STOP_PROTECTIVELY)
    cell.run(0.1)
    assert cell.value("safety_mode") == SafetyMode.PROTECTIVE_STOP


def test_an_emergency_stop_takes_the_power_until_the_arm_is_switched_on_again(cell: Cell) -> None:
    cell.ask(Command.SPEED, 0.1, 0, 0, 0, 0, 0, 1.0)
    cell.run(1.0)
    stop_in_emergency(cell.box)
    cell.run(0.1)
    assert cell.speed < 1e-3
    assert cell.value("safety_status_bits") == 1 << 6 | 1 << 7 | 1 << 10
    assert cell.value("robot_mode") == 3
    assert cell.value("robot_status_bits") == 0
    cell.box.run_script(SCRIPT)
    assert answer(cell.box, "programState") == "STOPPED rtde_control"
    release_emergency(cell.box)
    cell.ask(Command.NONE)  # else the new program would obey what still stands in the registers
    cell.box.run_script(SCRIPT)
    cell.run(0.1)
    assert cell.speed < 1e-3
    assert cell.value("runtime_state") == RuntimeState.PLAYING


def test_a_restart_stops_the_arm_and_forgets_the_program(cell: Cell) -> None:
    cell.ask(Command.SPEED, 0.1, 0, 0, 0, 0, 0, 1.0)
    cell.run(1.0)
    cell.box.power_up()
    cell.run(0.2)
    assert cell.speed < 1e-3
    assert cell.value("runtime_state") == RuntimeState.STOPPED
    assert cell.value("output_int_register_0") == 0


def test_commands_bear_the_time_of_their_cycle_and_leave_the_force_alone(cell: Cell) -> None:
    cell.ask(Command.SPEED, 0.1, 0, 0, 0, 0, 0, 1.0)
    cell.run(0.5)
    times = [command.time.item() for command in cell.arm.received]
    assert len(times) == pytest.approx(0.1 * 125, abs=2)  # while the speed changes, no longer
    assert np.diff(times).tolist() == [s // 125] * (len(times) - 1)
    assert all(np.isnan(command.force).all() for command in cell.arm.received)


# --- the dashboard ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        ("PolyscopeVersion", "URSoftware 3.15.0.0 (Jan 01 2022)"),
        ("running", "Program running: true"),
        ("programState", "PLAYING rtde_control"),
        ("robotmode", "Robotmode: RUNNING"),
        ("is in remote control", "true"),
        ("stop", "Stopped"),
        ("unlock protective stop", "Protective stop releasing"),
        ("quit", "Disconnected"),
        ("dance", "could not understand: dance"),
        ("", "could not understand: "),
    ],
)
def test_the_dashboard_answers_each_line(cell: Cell, asked: str, answered: str) -> None:
    assert answer(cell.box, asked) == answered
