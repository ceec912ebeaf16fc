"""Carries out the commands, on the loop's thread, between two frames."""

from drivers.camera import RgbdCamera
from drivers.errors import CameraError
from vo_service.control.inbox import Answer, Inbox
from vo_service.pose_tracker import PoseTracker
from vo_service.types import (
    Command,
    CommandError,
    ErrorCode,
    Light,
    LoadMap,
    Mapper,
    MapState,
    NoMapper,
    NoRecorder,
    Pause,
    Reconfigure,
    Recorder,
    Reset,
    Resume,
    SaveIncident,
    SaveMap,
    StartRecording,
    StopRecording,
    Tilt,
)


class Control:
    """Takes commands from the inbox; none of them blocks."""

    def __init__(
        self,
        tracker: PoseTracker,
        camera: RgbdCamera,
        inbox: Inbox[Command] | None = None,
        recorder: Recorder | None = None,
        mapper: Mapper | None = None,
    ) -> None:
        """Without an inbox nobody has anything to say."""
        self._tracker = tracker
        self._camera = camera
        self._inbox = inbox or Inbox()
        self._recorder = recorder or NoRecorder()
        self._mapper = mapper or NoMapper()
        self.is_paused = False

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        return self._recorder.recording

    @property
    def map(self) -> MapState:
        """What there is of a map."""
        return self._mapper.state

    def obey(self) -> None:
        """Carry out what waits, and answer it."""
        for ticket in self._inbox.take():
            try:
                ticket.done(self._do(ticket.command))
            except CommandError as error:
                ticket.failed(error)
            except CameraError as error:
                ticket.failed(CommandError(ErrorCode.NOT_POSSIBLE, str(error)))

    def _do(self, command: Command) -> Answer:
        match command:
            case Reset(T_odom_base):
                self._tracker.reset(T_odom_base)
                return {"epoch": self._tracker.epoch}
            case Pause() | Resume():
                self.is_paused = isinstance(command, Pause)
                return {"paused": self.is_paused}
            case Tilt(tilt_deg):
                self._camera.set_tilt_deg(tilt_deg)
                return {"tilt_deg": tilt_deg}
            case Light(led):
                self._camera.set_led(led)
                return {"led": led}
            case StartRecording(name):
                return {"folder": self._recorder.start_recording(name)}
            case StopRecording():
                return {"folder": self._recorder.stop_recording()}
            case SaveIncident():
                return {"folder": self._recorder.save("command")}
            case SaveMap(name):
                state = self._mapper.save(name)
                return {"file": state.saving, "keyframes": state.keyframes}
            case LoadMap(name):
                return {"file": self._mapper.load(name).loading}
            case Reconfigure():
                command.apply()
                return {}
