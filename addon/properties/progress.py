"""How far a running bake is, for panels and status bar.

The state lives in this module, not in the file: a bake that is running while the file is saved must not be found
running when the file is opened. `WindowManager.radiosity` only reads it.
"""

from dataclasses import dataclass

from bpy.props import BoolProperty, FloatProperty, StringProperty
from bpy.types import PropertyGroup


@dataclass
class ProgressState:
    """One bake at a time: whether it runs, its share done (0 to 1), what it does and the seconds left or None."""

    is_running: bool = False
    stop_requested: bool = False
    fraction: float = 0.0
    message: str = ""
    seconds_left: float | None = None

    def start(self) -> None:
        self.__init__(is_running=True)

    def finish(self) -> None:
        self.__init__()

    @property
    def text(self) -> str:
        """One line for people."""
        left = "" if self.seconds_left is None else f", {duration(self.seconds_left)} left"
        return f"{self.message} {self.fraction:.0%}{left}"


def duration(seconds: float) -> str:
    """Seconds as people say them: 3 s, 2 min 5 s, 1 h 10 min."""
    whole = max(round(seconds), 0)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


state = ProgressState()


class RadiosityProgress(PropertyGroup):
    """Read-only view of `state`."""

    is_running: BoolProperty(name="Running", description="Whether a bake is running", get=lambda self: state.is_running)
    fraction: FloatProperty(
        name="Progress",
        description="Share of the bake that is done",
        min=0.0,
        max=1.0,
        subtype='FACTOR',
        get=lambda self: state.fraction,
    )
    message: StringProperty(
        name="Message", description="What the bake is doing and how long it will take", get=lambda self: state.text
    )
