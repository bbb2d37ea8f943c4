"""Validated requests of clients: the query of a motion, and the JSON messages of a stream.

They contain no paths: a request reads no file of the machine.
"""

import pathlib
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_SEED
from ha2g_jax.motion.control import Controls, read_mute
from ha2g_jax.motion.cues import Cue, check_cue
from ha2g_jax.motion.cues.cue import check_name
from ha2g_jax.motion.formats import choose_rig
from ha2g_jax.motion.rigs import OWN
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD
from ha2g_jax.synthesis.generator import Options
from ha2g_jax.synthesis.style import VARIATION, Style, read_mixture

_SENTENCES = {  # for the kinds of mistakes of pydantic; those of a value are its own
    "extra_forbidden": "no such name; docs/serving.md has all",
    "json_invalid": 'the text is not JSON; send an object, such as {"muted": true}',
    "model_type": 'the text is no object; send one, such as {"muted": true}',
}

State = Literal["auto", "idle", "listen", "think"]
Message = TypeVar("Message", bound="_Message")


def _to_style(
    speaker: str | None, mixture: dict[str, float] | None, seed: int | None, variation: float | None
) -> Style:
    if variation is not None and speaker is None and mixture is None:
        raise UserError("the variation is that of a speaker or a mixture; give one, or leave it out")
    return Style(speaker, mixture, seed=seed, variation=VARIATION if variation is None else variation)


class MotionQuery(BaseModel):
    """Query of `POST /v1/motion`; the names and their meaning are those of the flags of `ha2g generate`."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["npz", "json", "bvh", "glb", "vrma", "csv"] = "npz"
    rig: str = Field(OWN, description="joints of the file, as of ha2g export; not of vrma, whose rig is vrm")
    seed: int = Field(0, ge=0, le=MAX_SEED, description="seed of all random choices")
    fps: float | None = Field(None, description="frames per second, 1 to 240; by default those of the model")
    speaker: str | None = Field(None, description="name of a speaker of the training data")
    style: str | None = Field(None, description="mixture of speakers, such as A:0.3,B:0.7")
    style_seed: int | None = Field(None, ge=0, le=MAX_SEED, description="draw a style with this seed")
    variation: float | None = Field(None, description="how much a seed changes the style of a speaker, 0 to 2")
    energy: float = Field(1.0, description="speed of the motion, 0 to 2")
    extent: float = Field(1.0, description="size of the gestures, 0 to 2")
    handedness: Literal["left", "right", "both"] = Field("both", description="the other arm rests")
    mirror: bool = Field(False, description="exchange left and right")
    mute: list[str] = Field([], max_length=100, description="START:END in seconds, without gestures; may be repeated")
    smooth: float = Field(0.0, description="average poses over a window of this length in seconds")

    def options(self) -> Options:
        """Return the keyword arguments of `Model.generate`.

        Raises:
            UserError: a mixture or a mute has another form, the variation is that of no speaker, or the format does
                not take the rig.
        """
        choose_rig(pathlib.Path(f"motion.{self.format}"), self.rig)
        mixture = None if self.style is None else read_mixture(self.style)
        controls = Controls(
            energy=self.energy,
            extent=self.extent,
            handedness=self.handedness,
            mirror=self.mirror,
            mutes=tuple(read_mute(mute) for mute in self.mute),
        )
        style = _to_style(self.speaker, mixture, self.style_seed, self.variation)
        return {"style": style, "seed": self.seed, "fps": self.fps, "smoothing": self.smooth, "controls": controls}


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class StyleMessage(_Message):
    """A style: at most one of a speaker, a mixture and a seed; random without any; see `Style`."""

    speaker: str | None = None
    mixture: dict[str, float] | None = None
    seed: int | None = None
    variation: float | None = None

    def style(self) -> Style:
        return _to_style(self.speaker, self.mixture, self.seed, self.variation)


class ControlsMessage(_Message):
    """Controls of a stream; those that are left out are neutral."""

    energy: float = 1.0
    extent: float = 1.0
    handedness: Literal["left", "right", "both"] = "both"
    mirror: bool = False

    def controls(self) -> Controls:
        return Controls(**self.model_dump())


class Begin(_Message):
    """First message of a stream."""

    look_ahead: int = DEFAULT_LOOK_AHEAD
    hop: int = DEFAULT_HOP
    seed: int = Field(0, ge=0, le=MAX_SEED)
    style: StyleMessage = StyleMessage()
    controls: ControlsMessage = ControlsMessage()
    muted: bool = False
    rate: int = Field(16000, ge=8000, le=192000)
    channels: Literal[1, 2] = 1
    state: State = "auto"


class Change(_Message):
    """Later message of a stream, which changes the given values, makes a cue, drops speech, or ends the stream."""

    style: StyleMessage | None = None
    controls: ControlsMessage | None = None
    muted: bool | None = None
    state: State | None = None
    clear: int | None = None  # True, or the number of a frame
    cue: str | None = None
    time: float | None = None
    end: Literal[True] | None = None

    @field_validator("clear", mode="plain")
    @classmethod
    def _check_clear(cls, value: Any) -> int:
        if value is True or (type(value) is int and value >= 0):
            return value
        raise ValueError("expected true, or the number of a frame")

    def asked_cue(self) -> Cue | None:
        """Return the cue; clips are not allowed, because they would read a file of the machine.

        Raises:
            UserError: there is no such cue, or the time is not a number of seconds.
        """
        if self.cue is not None:
            return check_cue(Cue(check_name(self.cue, has_files=False), self.time))
        if self.time is not None:
            raise UserError('the time is that of a cue; send both, as in {"cue": "nod", "time": 1.2}')
        return None


def read_message(kind: type[Message], text: str) -> Message:
    """Parse a message of a stream, of the class `Begin` or `Change`.

    Raises:
        UserError: the text is not JSON of this form.
    """
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise UserError(one_line(error.errors())) from None


def one_line(errors: list) -> str:
    """Return the first of the errors of pydantic as one line."""
    first = errors[0]
    where = ".".join(str(part) for part in first["loc"] if part not in ("query", "body"))
    sentences = _SENTENCES | ({"model_type": "expected an object"} if where else {})
    what = sentences.get(first["type"]) or first["msg"].replace("Input should be", "expected").removeprefix(
        "Value error, "
    )
    return shown(f"{where}: {what}" if where else what)
