"""Commands are carried out, or refused with a reason."""

from dataclasses import replace
from functools import partial

import pytest

from drivers.camera import Led, SensorConfig
from tests.vo_service.fakes import ScriptedCamera
from vo_service.app import ConfigHandlers, apply_changes
from vo_service.config import Config, ConfigChanges
from vo_service.control import CommandQueue, Control
from vo_service.odom_frame import OdomFrame
from vo_service.types.commands import (
    Command,
    CommandError,
    EpochReply,
    ErrorCode,
    FolderReply,
    LedCommand,
    LedReply,
    NoReply,
    PauseCommand,
    PausedReply,
    ReloadConfig,
    ResetCommand,
    ResumeCommand,
    SavedMapReply,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
    TiltReply,
)
from vo_service.types.messages import MapState
from vo_service.types.outputs import NullMapper, NullRecorder


class ScriptedMotorCamera(ScriptedCamera):
    """A camera with a motor and a light."""

    tilt_deg = 0.0
    led = Led.OFF

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Tilt."""
        self.tilt_deg = tilt_deg

    def set_led(self, led: Led) -> None:
        """Light."""
        self.led = led


class RecordingRecorder(NullRecorder):
    """A recorder that remembers what it was asked for."""

    recording = ""

    def __init__(self) -> None:
        super().__init__()
        self.saved: list[str] = []

    def start_recording(self, name: str) -> str:
        """Begin."""
        self.recording = f"recordings/{name}"
        return self.recording

    def stop_recording(self) -> str:
        """End."""
        folder, self.recording = self.recording, ""
        return folder

    def save(self, reason: str) -> str:
        """Save."""
        self.saved.append(reason)
        return f"incidents/{reason}"


class RecordingMapper(NullMapper):
    """A mapper that begins whatever it is asked for."""

    def save(self, name: str) -> MapState:
        """Begin."""
        self.state = MapState(12, f"maps/{name}.ply")
        return self.state


def carry_out(command: Command, control: Control, inbox: CommandQueue) -> object:
    ticket = inbox.submit(command)
    control.process_pending()
    return ticket.result(0.0)


def test_tilt_and_led_commands_reach_the_camera() -> None:
    inbox = CommandQueue()
    camera = ScriptedMotorCamera()
    control = Control(OdomFrame(), camera, inbox)
    assert carry_out(TiltCommand(12.0), control, inbox) == TiltReply(12.0)
    assert carry_out(LedCommand(Led.RED), control, inbox) == LedReply(Led.RED)
    assert (camera.tilt_deg, camera.led) == (12.0, Led.RED)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (TiltCommand(1.0), "scripted: it has no motor"),
        (LedCommand(Led.RED), "scripted: it has no LED"),
        (SaveIncidentCommand(), "there is no flight recorder"),
        (StartRecordingCommand("x"), "there is no flight recorder"),
        (StopRecordingCommand(), "there is no flight recorder"),
        (SaveMapCommand("x"), "there is no map"),
    ],
)
def test_impossible_commands_are_refused_with_a_reason(command: Command, words: str) -> None:
    inbox = CommandQueue()
    control = Control(OdomFrame(), ScriptedCamera(), inbox)
    with pytest.raises(CommandError, match=words) as raised:
        carry_out(command, control, inbox)
    assert raised.value.code is ErrorCode.NOT_POSSIBLE


def test_recording_commands_reach_the_recorder() -> None:
    inbox = CommandQueue()
    deck = RecordingRecorder()
    control = Control(OdomFrame(), ScriptedCamera(), inbox, deck)
    assert carry_out(StartRecordingCommand("desk"), control, inbox) == FolderReply(
        "recordings/desk"
    )
    assert control.recording == "recordings/desk"
    assert carry_out(StopRecordingCommand(), control, inbox) == FolderReply("recordings/desk")
    assert carry_out(SaveIncidentCommand(), control, inbox) == FolderReply("incidents/command")


def test_map_commands_reach_the_mapper() -> None:
    inbox = CommandQueue()
    control = Control(OdomFrame(), ScriptedCamera(), inbox, mapper=RecordingMapper())
    expected = SavedMapReply("maps/kitchen.ply", 12)
    assert carry_out(SaveMapCommand("kitchen"), control, inbox) == expected
    assert control.map_state.saving == "maps/kitchen.ply"


def test_a_reset_returns_the_new_epoch_and_a_pause_the_state() -> None:
    inbox = CommandQueue()
    control = Control(OdomFrame(), ScriptedCamera(), inbox)
    assert carry_out(ResetCommand(), control, inbox) == EpochReply(1)
    assert carry_out(PauseCommand(), control, inbox) == PausedReply(True)
    assert carry_out(ResumeCommand(), control, inbox) == PausedReply(False)


def test_configuration_changes_are_applied_and_refusals_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    inbox = CommandQueue()
    camera, bare = ScriptedMotorCamera(), ScriptedCamera()
    appliers: ConfigHandlers = {
        "sensor.led": lambda config: camera.set_led(config.sensor.led),
        "sensor.tilt_deg": lambda config: bare.set_tilt_deg(0.0),
    }
    control = Control(OdomFrame(), camera, inbox)
    wanted = replace(Config(), sensor=SensorConfig(led=Led.RED))
    live = ("sensor.tilt_deg", "sensor.led")
    assert (
        carry_out(
            ReloadConfig(partial(apply_changes, ConfigChanges(wanted, live), appliers)),
            control,
            inbox,
        )
        == NoReply()
    )
    assert camera.led is Led.RED
    assert "scripted: it has no motor" in caplog.text
