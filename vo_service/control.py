"""Carries out the commands, on the loop's thread, between two frames."""

from drivers.camera import RgbdCamera
from drivers.core.errors import CameraError
from vo_service.command_queue import CommandQueue, CommandResult
from vo_service.odom_frame import OdomFrame
from vo_service.types import (
    Command,
    CommandError,
    ErrorCode,
    LedCommand,
    LoadMapCommand,
    Mapper,
    MapState,
    NullMapper,
    NullRecorder,
    PauseCommand,
    Recorder,
    ReloadConfig,
    ResetCommand,
    ResumeCommand,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
)


class Control:
    """Takes commands from the inbox; none of them blocks."""

    def __init__(
        self,
        odom_frame: OdomFrame,
        camera: RgbdCamera,
        command_queue: CommandQueue[Command] | None = None,
        recorder: Recorder | None = None,
        mapper: Mapper | None = None,
    ) -> None:
        """Without an inbox nobody has anything to say."""
        self._odom_frame = odom_frame
        self._camera = camera
        self._command_queue = command_queue or CommandQueue()
        self._recorder = recorder or NullRecorder()
        self._mapper = mapper or NullMapper()
        self.is_paused = False

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        return self._recorder.recording

    @property
    def map_state(self) -> MapState:
        """What there is of a map."""
        return self._mapper.state

    def process_pending(self) -> None:
        """Carry out what waits, and answer it."""
        for ticket in self._command_queue.take_pending():
            try:
                ticket.set_result(self._execute(ticket.command))
            except CommandError as error:
                ticket.set_exception(error)
            except CameraError as error:
                ticket.set_exception(CommandError(ErrorCode.NOT_POSSIBLE, str(error)))

    def _execute(self, command: Command) -> CommandResult:
        match command:
            case ResetCommand(T_odom_base):
                self._odom_frame.reset(T_odom_base)
                return {"epoch": self._odom_frame.epoch}
            case PauseCommand() | ResumeCommand():
                self.is_paused = isinstance(command, PauseCommand)
                return {"paused": self.is_paused}
            case TiltCommand(tilt_deg):
                self._camera.set_tilt_deg(tilt_deg)
                return {"tilt_deg": tilt_deg}
            case LedCommand(led):
                self._camera.set_led(led)
                return {"led": led}
            case StartRecordingCommand(name):
                return {"folder": self._recorder.start_recording(name)}
            case StopRecordingCommand():
                return {"folder": self._recorder.stop_recording()}
            case SaveIncidentCommand():
                return {"folder": self._recorder.save("command")}
            case SaveMapCommand(name):
                state = self._mapper.save(name)
                return {"file": state.saving, "keyframes": state.mesh_keyframes}
            case LoadMapCommand(name):
                return {"file": self._mapper.load(name).loading}
            case ReloadConfig():
                command.apply()
                return {}
